"""Hard problems: whether keeping away from danger ever costs a solution, and what it costs in time.

    python -m bench hard [--problems A:B] [--families ...] [--time S] [--seeds N]

112 narrow openings of seven kinds for four robots, made by rule from a seed (`_hard.py`), each with a proven way; no
draw is left out. Tables are those of `planners`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from bench._hard import HardProblem, hard_problems
from bench._harness import Report
from bench._planning import Problem, compare
from bench._planning import add_options as add_planning_options
from safe_ompl import SafeSetup

CLAIM = "safe planners solve as many narrow problems as their classical counterparts"
COUNT = 112


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add_planning_options(parser, 5.0)


def main(options: argparse.Namespace, report: Report) -> None:
    """Compare the planners."""
    compare(report, problems(hard_problems(range(COUNT)[options.problems])), options)


def problems(chosen: Iterator[HardProblem]) -> Iterator[Problem]:
    """Yield problems by their kinds; the tip's place at the goal is a goal, too."""
    for problem in chosen:
        setup = SafeSetup(problem.robot, problem.scene)
        setup.setConfigurations(problem.start, problem.goal)
        setup.setWorkspaceGoal(problem.robot.tip_pose(problem.goal).translation)
        yield Problem(problem.kind, setup)
