"""Safe planners beside classical ones: danger, clearance, time and queries on scenarios, random scenes and files.

    python -m bench planners [SET ...] [--pairs ours printed crossed] [--seeds N] [--simplify ours|ompl]

A SET is a scenario of the package, `random` or a MotionBenchMaker file; all scenarios by default. `paper_1`, `paper_2`
and `random` are the studies of the paper: `random` are 30 scenes for its arm, drawn from a seed, none left out. Pairs
are a safe planner and its classical counterpart in our form, both as printed, and ours beside the printed classical
one. Time is the process's; runs without a path count with the limit. Danger and length are medians of ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench._harness import Report
from bench._planning import Problem, add_options as add_planning_options, compare, mbm_problems
from bench._scenes import free_configuration
from safe_ompl import Box, CollisionChecker, Obstacle, Pose, Scenario, Scene, Sphere
from safe_ompl.geometry import Shape
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import Goal, list_scenarios

CLAIM = "paths of safe planners are less dangerous and farther from obstacles; what that costs in time"
SCENES, SEED = 30, 2013
ROOM = 0.3  # [m] around the base's axis that stays empty


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("sets", nargs="*", metavar="SET")
    add_planning_options(parser, 5.0)


def main(options: argparse.Namespace, report: Report) -> None:
    """Compare the planners."""
    compare(report, problems(options), options)


def problems(options: argparse.Namespace) -> Iterator[Problem]:
    """Yield the problems of all sets."""
    for name in options.sets or list_scenarios():
        if Path(name).suffix == ".json":
            yield from mbm_problems(name, options.problems)
        elif name == "random":
            for number in range(SCENES)[options.problems]:
                scenario = random_scenario(number)
                yield Problem(name, setup_scenario(scenario), scenario.planners)
        else:
            scenario = Scenario.load(name)
            yield Problem(name, setup_scenario(scenario), scenario.planners)


def random_scenario(number: int) -> Scenario:
    """Return the paper's arm between boxes and balls, from one free configuration to another, however easy or hard.

    The first obstacle is dangerous to approach, each other one with probability ½.
    """
    model, rng = Scenario.load("paper_1"), np.random.default_rng([SEED, number])
    robot, obstacles, wanted = model.build_robot(), [model.scene["floor"]], int(rng.integers(4, 11))
    while len(obstacles) <= wanted:
        place = rng.uniform([-0.9, -0.9, 0.05], [0.9, 0.9, 1.1])
        sides, is_box = rng.uniform(0.08, 0.4, 3), rng.random() < 0.5
        shape: Shape = Box(tuple(sides.tolist())) if is_box else Sphere(float(sides[0]) / 2)
        turn = tuple(rng.uniform(-np.pi, np.pi, 3).tolist())
        if np.hypot(*place[:2]) > ROOM:
            weight = 1.0 if rng.random() < 0.5 or len(obstacles) == 1 else 0.0
            pose = Pose.from_rpy(tuple(place), turn)
            obstacles.append(Obstacle(f"obstacle_{len(obstacles)}", shape, pose, weight=weight))
    scene = Scene(tuple(obstacles), spacing=model.scene.spacing)
    checker = CollisionChecker(robot, scene)
    start, goal = (free_configuration(checker, rng) for _ in range(2))
    tip = tuple(robot.tip_pose(goal).translation.tolist())
    ends = Goal(configurations=(tuple(goal.tolist()),), position=tip)
    return replace(model, name=f"random_{number}", scene=scene, start=tuple(start.tolist()), goal=ends)
