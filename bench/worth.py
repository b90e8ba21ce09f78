"""What a safer path is worth in time, beside a person before whom the robot must be able to stop.

    python -m bench worth [--scenes N] [--seeds N] [--seconds S]

The person may move at 1.6 m/s and is seen 0.1 s late. All paths are timed by the same law; a path "may not move" if
somewhere on it the person is so near that no speed is proven to stop in time. Problems: panda_shelf, ur5_handover, and
random scenes with a Panda, a person in front of it and things around. Seconds of search are those of the process.

ours         SafeRRTConnect, optimised for danger and length
RRTConnect   OMPL's, with OMPL's simplifier until it ends
BIT*         OMPL's, for the length of the path
bound        no path: what the slowest joint takes alone, with nobody there; no motion is shorter
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from time import process_time
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from bench._harness import Report
from bench._scenes import ACCELERATIONS, free_configuration, scattered
from safe_ompl import (
    CollisionChecker,
    InputError,
    Obstacle,
    PathTimer,
    People,
    Person,
    Pose,
    RateLimits,
    Robot,
    SafeSetup,
    Scenario,
    Scene,
    StandstillError,
)
from safe_ompl.common import FloatArray
from safe_ompl.planning import setup_scenario

CLAIM = "beside a person our paths may always be driven"
PEOPLE = People(speed=1.6, reaction_time=0.1)
METHODS = ("ours", "RRTConnect", "BIT*", "bound")
ROOM = 0.35  # [m] between the person and the robot at start and goal
APART = 2.5  # [rad] between start and goal, at least


class Problem(NamedTuple):
    """What plans a problem, ours with danger and OMPL's without, and the distance (G, n) from start to goals [rad]."""

    name: str
    safe: SafeSetup
    plain: SafeSetup
    ways: FloatArray

    @property
    def limits(self) -> RateLimits:
        """Limits of the joints."""
        robot = self.safe.robot
        return RateLimits.of(robot, acceleration=ACCELERATIONS[robot.name])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--scenes", type=int, default=30, help="random ones (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=1, help="runs of each problem (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each search (default: %(default)s)")


# Limits of time, those of planners and those of simplification, count CPU time.
@patch("safe_ompl.planning.planners.registry.perf_counter", process_time)
@patch("safe_ompl.planning.run.perf_counter", process_time)
@patch("safe_ompl.planning.safe_setup.perf_counter", process_time)
@patch("safe_ompl.planning.simplification.simplifier.perf_counter", process_time)
def main(options: argparse.Namespace, report: Report) -> None:
    """Run all methods on all problems."""
    found: dict[str, list[float]] = {method: [] for method in METHODS}
    rows: list[tuple[object, ...]] = []
    for problem in problems(options.scenes):
        for seed in range(options.seeds):
            durations = [duration(problem, method, seed, options.seconds) for method in METHODS]
            rows.append((f"{problem.name}, seed {seed}", *map(shown, durations)))
            for method, seconds in zip(METHODS, durations, strict=True):
                found[method].append(seconds)
    report.table(("duration [s]", *METHODS), rows)
    report.table(
        ("", "median [s]", "may not move", "no path", "median of ours / it", "both may move", "of these"),
        [(method, *compared(np.array(found["ours"]), np.array(found[method]))) for method in METHODS],
        "all",
    )


def duration(problem: Problem, method: str, seed: int, seconds: float) -> float:
    """Return how long the path of a method takes [s]; +inf where nothing allows motion, NaN where there is no path."""
    safe, plain = problem.safe, problem.plain
    if method == "bound":
        v, a = problem.limits.velocity, problem.limits.acceleration
        ways = np.abs(problem.ways)
        times = np.where(ways > v * v / a, ways / v + v / a, 2 * np.sqrt(ways / a))
        return float(times.max(axis=1).min())
    if method == "ours":
        result = safe.plan(seed=seed, optimise=seconds)
    elif method == "RRTConnect":
        result = plain.plan("RRTConnect", seed=seed, time=seconds, simplify=True)
    else:
        result = plain.plan("BITstar", seed=seed, time=seconds)
    timer = PathTimer(safe.robot, problem.limits, motion=safe.motion_prover, people=PEOPLE)
    try:
        return np.nan if result.path is None else timer.time(result.path).duration
    except (InputError, StandstillError):  # nothing allows motion
        return np.inf


def compared(ours: FloatArray, theirs: FloatArray) -> tuple[object, ...]:
    """Return the median of durations (N,), counts, and median ratios; what may not move takes for ever.

    A ratio is 0 where only theirs may not move, +inf where only ours may not, and none where neither may.
    """
    known = np.isfinite(ours) | np.isfinite(theirs)
    known &= ~(np.isnan(ours) | np.isnan(theirs))
    moving = np.isfinite(ours) & np.isfinite(theirs)
    ratios = ours[known] / np.where(np.isinf(ours[known]), 1.0, theirs[known])
    counts = shown(float(np.nanmedian(theirs))), int(np.isinf(theirs).sum()), int(np.isnan(theirs).sum())
    of_moving = float(np.median(ours[moving] / theirs[moving])) if moving.any() else np.nan
    return (*counts, float(np.median(ratios)) if known.any() else np.nan, int(moving.sum()), of_moving)


def shown(seconds: float) -> str:
    """Return a duration as text."""
    return "no path" if np.isnan(seconds) else "may not move" if np.isinf(seconds) else f"{seconds:.2f}"


# ----------------------------------------------------------------------------------------------------- problems


def problems(scenes: int) -> Iterator[Problem]:
    """Yield the scenarios, then random scenes."""
    for name in ("panda_shelf", "ur5_handover"):
        scenario = Scenario.load(name)
        safe = setup_scenario(scenario)
        ends = scenario.start_configuration(safe.robot), scenario.goal_configurations(safe.robot)
        yield Problem(name, safe, setup(safe.robot, scenario.scene, *ends, danger=None), _ways(safe.robot, *ends))
    for seed in range(scenes):
        robot, scene, start, goal = random_scene(seed)
        both = (setup(robot, scene, start, goal[None], danger=danger) for danger in ({}, None))
        yield Problem(f"random {seed}", *both, _ways(robot, start, goal[None]))


def _ways(robot: Robot, start: FloatArray, goals: FloatArray) -> FloatArray:
    return robot.difference(np.broadcast_to(start, np.shape(goals)), goals)


def setup(
    robot: Robot, scene: Scene, start: FloatArray, goals: FloatArray, *, danger: dict[str, object] | None
) -> SafeSetup:
    """Return a setup with start and goals."""
    made = SafeSetup(robot, scene, danger=danger)
    made.setConfigurations(start, goals)
    return made


def random_scene(seed: int) -> tuple[Robot, Scene, FloatArray, FloatArray]:
    """Return a scene with a person in front of a Panda, and a start and a goal on both sides of the person."""
    robot, rng = Robot.from_example("panda"), np.random.default_rng(seed)
    turn, away = rng.uniform(-0.6, 0.6), rng.uniform(0.75, 1.0)
    place = (away * np.cos(turn), away * np.sin(turn), rng.uniform(-0.9, -0.6))
    body, pose = Person(height=float(rng.uniform(1.55, 1.9))), Pose.from_rpy(place, (0, 0, turn + np.pi))
    person = Obstacle("person", body, pose, weight=1.0)
    alone = CollisionChecker(robot, Scene((person,)))
    things = tuple(o for o in scattered(5, seed) if np.hypot(*np.subtract(o.pose.position, place)[:2]) > 0.45)
    scene = Scene((person, *things))
    checker = CollisionChecker(robot, scene)

    def side(sign: int) -> FloatArray:
        while True:
            q = free_configuration(checker, rng)
            tip = robot.tip_pose(q).translation
            beside = 0.6 < sign * (np.arctan2(tip[1], tip[0]) - turn) < 2.0
            if beside and np.hypot(*tip[:2]) > 0.35 and tip[2] > 0.1 and alone.clearance(q).distance > ROOM:
                return q

    while True:
        start, goal = side(1), side(-1)
        if np.linalg.norm(goal - start) > APART:
            return robot, scene, start, goal
