"""What OMPL costs on top of validity and motion checks: python bench/overhead.py [--rounds 15].

OMPL's RRTConnect solves problems with the plug-ins of this package, written in Python. Its calls are recorded, and
then run again without OMPL, on arrays, in a bare loop. The ratio of the times, in turn in one process, is what states,
callbacks and the planner itself cost; the bar is 1.15.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np
from _scenes import bookshelf, scattered
from _timing import print_table
from ompl import geometric as og
from ompl import util as ou

from safe_ompl import CertifiedMotionValidator, CollisionFreeValidity, Robot, SafeSetup, Scene
from safe_ompl.planning.ompl.states import StateBridge

PROBLEMS = 30  # of each robot
Call = tuple[Callable[..., bool], tuple[Any, ...]]


class RecordedValidity(CollisionFreeValidity):
    """Notes what it is asked."""

    def __init__(self, si: Any, checker: Any, calls: list[Call]) -> None:
        super().__init__(si, checker)
        self._calls, self._states = calls, StateBridge(si.getStateSpace())

    def isValid(self, state: Any) -> bool:
        """Note and answer."""
        q = self._states.read(state)
        self._calls.append((self.checker.in_collision, (q,)))
        return super().isValid(state)


class RecordedMotions(CertifiedMotionValidator):
    """Notes what it is asked."""

    def __init__(self, si: Any, checker: Any, calls: list[Call]) -> None:
        super().__init__(si, checker)
        self._calls, self._states = calls, StateBridge(si.getStateSpace())

    def checkMotion(self, start: Any, end: Any) -> bool:
        """Note and answer."""
        ends = self._states.read(start), self._states.read(end)
        self._calls.append((self.motion.is_free, ends))
        return super().checkMotion(start, end)


def problem(robot: Robot, scene: Scene, seed: int) -> SafeSetup:
    """Return a setup between two free configurations."""
    setup = SafeSetup(robot, scene, danger=None)
    rng = np.random.default_rng(seed)
    free: list[Any] = []
    while len(free) < 2:
        q = rng.uniform(robot.lower, robot.upper)
        if not setup.checker.in_collision(q):
            free.append(q)
    setup.setConfigurations(*free)
    return setup


def solve(setup: SafeSetup, seed: int) -> float:
    """Solve with RRTConnect, and return the time of it [s]; the same seed makes the same calls."""
    ou.RNG.setSeed(seed)
    setup.clear()
    setup.setPlanner(og.RRTConnect(setup.getSpaceInformation()))
    setup.setup()
    begin = process_time()
    setup.solve(20.0)
    return process_time() - begin


def row(name: str, scene_name: str, scene: Scene, rounds: int) -> tuple[object, ...]:
    """Return a row of the table."""
    robot = Robot.from_example(name)
    calls: list[Call] = []
    setups = [problem(robot, scene, seed) for seed in range(PROBLEMS)]
    for seed, setup in enumerate(setups, 1):
        si, checker = setup.getSpaceInformation(), setup.checker
        plug_in(setup, RecordedValidity(si, checker, calls), RecordedMotions(si, checker, calls))
        solve(setup, seed)
        plug_in(setup, CollisionFreeValidity(si, checker), CertifiedMotionValidator(si, checker))
    queries = [count_queries(setups, action) for action in (lambda: solve_all(setups), lambda: run(calls))]
    times = np.array([(solve_all(setups), run(calls)) for _ in range(rounds)])
    ratio = float(np.median(times[:, 0] / times[:, 1]))
    return name, scene_name, len(calls), *queries, *(1e6 * np.median(times, axis=0) / len(calls)), ratio


def plug_in(setup: SafeSetup, validity: CollisionFreeValidity, validator: CertifiedMotionValidator) -> None:
    """Put plug-ins in the place of a setup's own, not beside them as those of a user are."""
    setup.wiring.plug_in(validity, validator)


def solve_all(setups: list[SafeSetup]) -> float:
    """Solve every problem, and return the time of it [s]."""
    return sum(solve(setup, seed) for seed, setup in enumerate(setups, 1))


def run(calls: list[Call]) -> float:
    """Make the recorded calls, and return the time of it [s]."""
    begin = process_time()
    for check, arguments in calls:
        check(*arguments)
    return process_time() - begin


def count_queries(setups: list[SafeSetup], action: Callable[[], object]) -> int:
    """Return how many collision queries an action makes."""
    for setup in setups:
        setup.counts.reset()
    action()
    return sum(setup.counts.queries for setup in setups)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    rows = [
        row("ur5", "6 obstacles", scattered(6, 1), options.rounds),
        row("panda", "bookshelf", bookshelf(), options.rounds),
    ]
    header = ("robot", "scene", "calls", "queries, OMPL", "queries, bare", "OMPL [µs]", "bare [µs]", "ratio")
    print_table(header, rows)


if __name__ == "__main__":
    main()
