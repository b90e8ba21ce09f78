"""What a safer path is worth in time: `python bench/safety_worth.py [--scenes N] [--seeds N] [--figure FILE]`.

Beside a person who may move at 1.6 m/s, and is seen 0.1 s late, a robot may only be as fast as it can stop before she
reaches it: a path that keeps away may be driven faster. All paths are timed by the same law with the same caps.
Problems: panda_shelf, ur5_handover, and random scenes with a Panda, a person in front of it and things around. Paths:

safest      SafeRRTConnect, optimised for danger and length for S seconds
fastest     SafeRRTConnect, optimised for duration for S seconds
RRTConnect  OMPL's, with OMPL's simplifier until it ends
BIT*        OMPL's, for the length of the path, for S seconds

"none": nothing allows the robot to move somewhere on the path. The full run, 30 scenes and 3 seeds at 10 s, takes about
(30 + 2)·3·3·10 s = 48 minutes on one core.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from _scenes import scattered
from _timing import print_table
from ompl import util as ou

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.motion_limits import MotionLimits
from safe_ompl.scenario.people import People
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.person import Person
from safe_ompl.setup.from_scenario import setup_scenario
from safe_ompl.setup.safe_setup import SafeSetup
from safe_ompl.trajectories.faster import duration_of
from safe_ompl.trajectories.timing import CELLS

PEOPLE = People(speed=1.6, reaction_time=0.1)
ACCELERATIONS = {"panda": (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0), "ur5": 8.0}
LOOKS = {
    "safest": ("o", "#0b62b4"),
    "fastest": ("D", "#00876a"),
    "RRTConnect": ("s", "#8b96a1"),
    "BIT*": ("^", "#3a444f"),
}
METHODS = tuple(LOOKS)
ROOM = 0.35  # [m] between the person and the robot at start and goal
APART = 2.5  # [rad] between start and goal, at least

Problem = tuple[str, Callable[[bool], SafeSetup]]


def named(name: str) -> Problem:
    """Return a scenario of the package with people; the setup is one with danger, or without."""
    scenario = Scenario.load(find_scenario(name))
    robot = scenario.build_robot()
    scenario = replace(
        scenario, people=PEOPLE, motion=MotionLimits(acceleration=ACCELERATIONS[name.partition("_")[0]])
    )

    def made(danger: bool) -> SafeSetup:
        if danger:
            return setup_scenario(scenario, robot)
        ends = scenario.start_configuration(robot), scenario.goal_configurations(robot)
        return _setup(robot, scenario.scene, *ends, danger=False)

    return name, made


def _setup(robot: Robot, scene: Scene, start: np.ndarray, goals: np.ndarray, *, danger: bool) -> SafeSetup:
    setup = SafeSetup(robot, scene, danger={} if danger else None)
    setup.setConfigurations(start, goals)
    setup.setMotionLimits(MotionLimits(acceleration=ACCELERATIONS[robot.name]), PEOPLE)
    return setup


def random_scene(seed: int) -> tuple[Scene, np.ndarray, np.ndarray, Robot]:
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
            return scene, start, goal, robot


def problems(number: int) -> Iterator[Problem]:
    """Yield the scenarios, then random scenes."""
    yield named("panda_shelf")
    yield named("ur5_handover")
    for seed in range(number):
        scene, start, goal, robot = random_scene(seed)
        yield (
            f"random {seed}",
            lambda danger, scene=scene, start=start, goal=goal, robot=robot: _setup(
                robot, scene, start, goal[None], danger=danger
            ),
        )


def durations(problem: Problem, seed: int, seconds: float) -> list[float]:
    """Return the duration [s] of each method's path; +inf where nothing allows motion, NaN where there is no path."""
    safe, plain = problem[1](True), problem[1](False)
    results = [
        safe.plan(seed=seed, optimise=seconds, report=False),
        safe.plan(seed=seed, optimise=seconds, cost="duration", report=False),
        plain.plan("RRTConnect", seed=seed, time=seconds, simplify=True, report=False),
        plain.plan("BITstar", seed=seed, time=seconds, report=False),
    ]
    return [np.nan if r.path is None else duration_of(safe.timer, r.path, CELLS) for r in results]


def draw(rows: dict[str, np.ndarray], file: Path) -> None:
    """Draw the durations of all problems, method by method, as a picture."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.6))
    found = np.array([np.median(values, axis=0) for values in rows.values()])
    top = 1.15 * np.max(found[np.isfinite(found)])
    order = np.argsort(found[:, METHODS.index("fastest")])
    for k, (method, (mark, colour)) in enumerate(LOOKS.items()):
        values = found[order, k]
        stuck = np.flatnonzero(np.isinf(values))
        axes.plot(np.where(np.isfinite(values), values, np.nan), mark, color=colour, ms=5, label=method)
        axes.plot(
            stuck, np.full(len(stuck), top * (1 + 0.04 * (k % 2))), mark, color=colour, ms=4, mfc="none"
        )
    axes.axhline(0.94 * top, color="0.8", lw=0.8)
    axes.text(0, 0.955 * top, "no motion allowed:", fontsize=8, color="0.4")
    axes.set(
        xlabel="problem, by its fastest path", ylabel="duration beside a person [s]", ylim=(0, 1.08 * top)
    )
    axes.legend(ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, bbox_inches="tight", dpi=160)


def main() -> None:
    """Run, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=30, help="random ones (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each problem (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each search (default: %(default)s)")
    parser.add_argument("--figure", type=Path, help="draw it (.png, .svg)")
    options = parser.parse_args()
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)
    logging.disable(logging.WARNING)
    rows: dict[str, np.ndarray] = {}
    for problem in problems(options.scenes):
        rows[problem[0]] = np.array(
            [durations(problem, seed, options.seconds) for seed in range(options.seeds)]
        )
        print(
            problem[0], " ".join(f"{value:.2f}" for value in np.median(rows[problem[0]], axis=0)), flush=True
        )
    if options.figure is not None:
        draw(rows, options.figure)
    every = np.concatenate(list(rows.values()))
    table = [
        (
            method,
            *(_shown(float(np.median(rows[name][:, k]))) for name in ("panda_shelf", "ur5_handover")),
            _shown(float(np.nanmedian(every[:, k]))),
            f"{100 * np.isinf(every[:, k]).mean():.0f} %",
            int(np.isnan(every[:, k]).sum()),
        )
        for k, method in enumerate(METHODS)
    ]
    header = ("duration [s], medians", "panda_shelf", "ur5_handover", "all runs", "may not move", "unsolved")
    print_table(header, table)
    ours = every[:, METHODS.index("fastest")]
    for method in ("safest", "RRTConnect", "BIT*"):
        theirs = every[:, METHODS.index(method)]
        with np.errstate(invalid="ignore"):
            both = np.isfinite(ours) & np.isfinite(theirs)
            known = np.isfinite(ours) & ~np.isnan(theirs)
            ratio = ours[known] / theirs[known]
        moving = np.median(ours[both] / theirs[both]) if both.any() else np.nan
        print(
            f"fastest/{method}: median {np.median(ratio):.3f} of {known.sum()} runs (0: theirs may not move); "
            f"{moving:.3f} of the {both.sum()} in which both may move"
        )


def _shown(seconds: float) -> str:
    return "none" if np.isinf(seconds) else f"{seconds:.2f}"


if __name__ == "__main__":
    main()
