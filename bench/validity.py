"""State validity through OMPL against the bare Pinocchio call: python bench/validity.py [--states N] [--rounds N].

Both look at the same random configurations, in turn, in one process. `bare` is one call of
`pin.computeCollisions` with a broad-phase manager on the same bodies and pairs; `isValid` is `si.isValid(state)`
on the same configurations as OMPL states: joint limits, NaN and the collision query. The target is a ratio of 1.5.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin
from _scenes import scattered
from _timing import in_turn, print_table
from ompl import base as ob

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.planning.ompl.states import StateBridge, joint_space
from safe_ompl.planning.ompl.validity import CollisionFreeValidity
from safe_ompl.robot.robot import Robot


def measure(name: str, number: int, rounds: int) -> tuple[object, ...]:
    """Return a row of the table for one example robot among 10 obstacles."""
    robot = Robot.from_example(name)
    checker = CollisionChecker(robot, scattered(10))
    si = ob.SpaceInformation(joint_space(robot))
    si.setStateValidityChecker(CollisionFreeValidity(si, checker))
    si.setup()

    rng = np.random.default_rng(0)
    configurations = list(rng.uniform(robot.lower, robot.upper, (number, robot.n)))
    bridge = StateBridge(si.getStateSpace())
    states = [si.getStateSpace().allocState() for _ in configurations]
    for q, state in zip(configurations, states, strict=True):
        bridge.write(q, state)

    geometry = checker.geometry
    contacts = pin.GeometryData(geometry)
    manager = pin.BroadPhaseManager_NaiveCollisionManager(robot.shared.model, geometry, contacts)
    data = robot.shared.model.createData()

    def bare() -> int:
        return sum(pin.computeCollisions(robot.shared.model, data, manager, q, True) for q in configurations)

    def through_ompl() -> int:
        return sum(si.isValid(state) for state in states)

    assert bare() + through_ompl() == number, "they disagree"
    times = in_turn({"bare": bare, "isValid": through_ompl}, number, rounds)
    share = through_ompl() / number
    return (
        name,
        len(checker.pair_names),
        f"{share:.0%}",
        times.microseconds("bare"),
        times.microseconds("isValid"),
        times.ratio("isValid", "bare"),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--states", type=int, default=2000, help="configurations per robot")
    parser.add_argument("--rounds", type=int, default=15, help="how often each is timed")
    options = parser.parse_args()
    rows = [measure(name, options.states, options.rounds) for name in ("ur5", "panda")]
    print_table(("robot, 10 obstacles", "pairs", "valid", "bare [µs]", "isValid [µs]", "ratio"), rows)


if __name__ == "__main__":
    main()
