"""The Bubble planner's steadiness: python bench/bubbles.py [--scenes N] [--time S] [--robot NAME] [--forms a,b].

The paper says of its Bubble planner that its running time is erratic and needs tuning scene by scene. Here every form
of it plans once (it is deterministic) in each of N random scenes with 5 to 9 obstacles, from one free configuration to
another whose straight motion is blocked; one set of parameters for all scenes. The last columns tell how steady it is:
the 90th percentile over the 10th, of seconds and of bubbles. Scenes that are not solved count with the time limit.
Where α = 0 danger is off; "as printed" is the paper's planner without anything of ours.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from _scenes import scattered
from _timing import print_table

from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

PAPER, OURS = "PaperSafeBubble", "BubblePlanner"
FORMS: dict[str, tuple[str, dict[str, Any]]] = {
    "as printed": (PAPER, {"alpha": 1.0, "beta": 3.0}),
    "as printed, alpha 0": ("PaperBubble", {"beta": 3.0}),
    "as printed, little danger": (PAPER, {"alpha": 0.1, "beta": 20.0}),
    "as printed, little diversity": (PAPER, {"alpha": 0.1, "beta": 2.0}),
    "ours": (OURS, {}),
    "ours, alpha 0": (OURS, {"alpha": 0.0}),
    "ours, cubes": (OURS, {"shape": "cube"}),
}


def problem(robot: Robot, seed: int) -> SafeSetup:
    """Return a random problem whose straight motion is blocked."""
    rng = np.random.default_rng(seed)
    scene = scattered(int(rng.integers(5, 10)), seed)
    dangerous = [Obstacle(o.name, o.shape, o.pose, weight=1.0) for o in scene]
    setup = SafeSetup(robot, Scene(tuple(dangerous)), danger={"spacing": 0.2})
    motion = setup.getSpaceInformation().getMotionValidator().motion
    while True:
        start, goal = (rng.uniform(robot.lower, robot.upper) for _ in range(2))
        ends_are_free = not (setup.checker.in_collision(start) or setup.checker.in_collision(goal))
        if ends_are_free and not motion.is_free(start, goal):
            setup.setConfigurations(start, goal)
            return setup


def row(form: str, results: list[PlanResult], limit: float) -> tuple[object, ...]:
    """Return the row of a form."""
    solved = [r for r in results if r]
    times = np.percentile([1e3 * (r.planning_time if r else limit) for r in results], (10, 50, 90))
    nodes = np.percentile([r.counts.nodes for r in solved] or [np.nan], (10, 50, 90))
    dangers = [r.report.danger.mean for r in solved if r.report and r.report.danger]
    return (
        form,
        f"{len(solved)}/{len(results)}",
        *(f"{value:.0f}" for value in (*times, *nodes)),
        float(np.median(dangers or [np.nan])),
        f"{times[2] / times[0]:.1f}",
        f"{nodes[2] / nodes[0]:.1f}",
    )


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=30)
    parser.add_argument("--time", type=float, default=10.0, help="limit of a run [s]")
    parser.add_argument("--robot", default="ur5")
    parser.add_argument(
        "--forms", type=lambda text: text.split(";"), default=list(FORMS), help="separated by ;"
    )
    options = parser.parse_args()
    robot = Robot.from_example(options.robot)
    results: dict[str, list[PlanResult]] = {form: [] for form in options.forms}
    for seed in range(options.scenes):
        setup = problem(robot, seed)
        for form, runs in results.items():
            planner, parameters = FORMS[form]
            runs.append(setup.plan(planner, time=options.time, parameters=parameters))
    header = ("form", "solved", "10 %", "50 % ms", "90 %", "10 %", "50 % bubbles", "90 %", "mean danger")
    rows = [row(form, runs, options.time) for form, runs in results.items()]
    print_table((*header, "90/10 ms", "90/10 bubbles"), rows)


if __name__ == "__main__":
    main()
