"""Problems beside a person: two scenarios of the package, and random scenes with a Panda and a person before it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from _scenes import scattered

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.geometry.person import Person
from safe_ompl.geometry.pose import Pose
from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.constraints import MotionLimits
from safe_ompl.scene.people import People
from safe_ompl.scene.scenario import Scenario, find_scenario
from safe_ompl.scene.scene import Scene

PEOPLE = People(speed=1.6, reaction_time=0.1)
ACCELERATIONS = {"panda": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0), "ur5": 8.0}
NAMED = ("panda_shelf", "ur5_handover")
ROOM = 0.35  # [m] between the person and the robot at start and goal
APART = 2.5  # [rad] between start and goal, at least


class WorthSetups(NamedTuple):
    """What plans a problem, ours with danger and OMPL's without, and its start (n,) and goals (G, n)."""

    safe: SafeSetup
    plain: SafeSetup
    start: np.ndarray
    goals: np.ndarray

    @property
    def bound(self) -> float:
        """The time [s] that no motion goes below: that of the slowest joint, alone, from rest to rest."""
        limits = self.safe.timer.limits
        v, a = limits.velocity, limits.acceleration
        ways = np.abs(self.safe.robot.difference(np.broadcast_to(self.start, self.goals.shape), self.goals))
        times = np.where(ways > v * v / a, ways / v + v / a, 2 * np.sqrt(ways / a))
        return float(times.max(axis=1).min())


@dataclass(frozen=True)
class WorthProblem:
    """A problem by its name; what it takes is made when it is asked for.

    Attributes
    ----------
    name : str
        A scenario of the package, or "random" and a seed.
    """

    name: str

    def setups(self) -> WorthSetups:
        """Return the setups of the problem."""
        if self.name in NAMED:
            return _named(self.name)
        robot, scene, start, goal = random_scene(int(self.name.removeprefix("random ")))
        with_danger, without = (_setup(robot, scene, start, goal[None], danger=d) for d in (True, False))
        return WorthSetups(with_danger, without, start, goal[None])


def problems(number: int) -> Iterator[WorthProblem]:
    """Yield the scenarios, then random scenes."""
    yield from map(WorthProblem, NAMED)
    yield from (WorthProblem(f"random {seed}") for seed in range(number))


def _named(name: str) -> WorthSetups:
    scenario = Scenario.load(find_scenario(name))
    robot = scenario.build_robot()
    scenario = replace(
        scenario, people=PEOPLE, motion=MotionLimits(acceleration=ACCELERATIONS[name.partition("_")[0]])
    )
    ends = scenario.start_configuration(robot), scenario.goal_configurations(robot)
    plain = _setup(robot, scenario.scene, *ends, danger=False)
    return WorthSetups(setup_scenario(scenario, robot), plain, *ends)


def _setup(robot: Robot, scene: Scene, start: np.ndarray, goals: np.ndarray, *, danger: bool) -> SafeSetup:
    setup = SafeSetup(robot, scene, danger={} if danger else None)
    setup.setConfigurations(start, goals)
    setup.setMotionLimits(MotionLimits(acceleration=ACCELERATIONS[robot.name]), PEOPLE)
    return setup


def random_scene(seed: int) -> tuple[Robot, Scene, np.ndarray, np.ndarray]:
    """Return a scene with a person in front of a Panda, and a start and a goal on both sides of her."""
    robot = Robot.from_example("panda")
    rng = np.random.default_rng(seed)
    turn, away = rng.uniform(-0.6, 0.6), rng.uniform(0.75, 1.0)
    place = (away * np.cos(turn), away * np.sin(turn), rng.uniform(-0.9, -0.6))
    person = Obstacle(
        "person",
        Person(height=float(rng.uniform(1.55, 1.9))),
        Pose.from_rpy(place, (0, 0, turn + np.pi)),
        weight=1.0,
    )
    alone = CollisionChecker(robot, Scene((person,)))
    things = tuple(o for o in scattered(5, seed) if np.hypot(*np.subtract(o.pose.position, place)[:2]) > 0.45)
    scene = Scene((person, *things))
    checker = CollisionChecker(robot, scene)

    def side(sign: int) -> np.ndarray:
        while True:
            q = rng.uniform(robot.lower, robot.upper)
            tip = robot.tip_pose(q).translation
            bearing = np.arctan2(tip[1], tip[0]) - turn
            beside = 0.6 < sign * bearing < 2.0 and np.hypot(*tip[:2]) > 0.35 and tip[2] > 0.1
            if beside and not checker.in_collision(q) and alone.clearance(q).distance > ROOM:
                return q

    while True:
        start, goal = side(1), side(-1)
        if np.linalg.norm(goal - start) > APART:
            return robot, scene, start, goal
