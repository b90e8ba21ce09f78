"""Hard problems: whether keeping away from danger ever costs a solution, and what it costs in time.

    python -m bench hard [--problems A:B] [--families ...] [--time S] [--seeds N] [--export FOLDER]

112 narrow openings of seven kinds for four robots, made by rule from a seed (`_hard.py`), each with a proven way; no
draw is left out. Tables are those of `planners`. With --export the problems are written instead, for others to solve
(`safe-ompl judge`), with the proven ways as an entry.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

from bench._hard import HardProblem, hard_problems, mbm_form
from bench._harness import Report
from bench._planning import Problem, compare
from bench._planning import add_options as add_planning_options
from safe_ompl import SafeSetup
from safe_ompl.apps.benchmark import checksum

CLAIM = "safe planners solve as many narrow problems as their classical counterparts"
COUNT = 112


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add_planning_options(parser, 5.0)
    parser.add_argument("--export", type=Path, metavar="FOLDER", help="write the problems instead")


def main(options: argparse.Namespace, report: Report) -> None:
    """Compare the planners, or export the problems."""
    chosen = hard_problems(range(COUNT)[options.problems])
    if options.export:
        export(list(chosen), options.export)
    else:
        compare(report, problems(chosen), options)


def problems(chosen: Iterator[HardProblem]) -> Iterator[Problem]:
    """Yield problems by their kinds; the tip's place at the goal is a goal, too."""
    for problem in chosen:
        setup = SafeSetup(problem.robot, problem.scene)
        setup.setConfigurations(problem.start, problem.goal)
        setup.setWorkspaceGoal(problem.robot.tip_pose(problem.goal).translation)
        yield Problem(problem.kind, setup)


def export(problems: list[HardProblem], folder: Path) -> None:
    """Write a file of problems for each robot, and an entry with the ways by which they were made."""
    folder.mkdir(parents=True, exist_ok=True)
    sets = []
    for robot, content in mbm_form(problems).items():
        file = folder / f"hard_{robot}.json"
        file.write_text(json.dumps(content), encoding="utf-8")
        ways = [
            {"problem": f"{problem.kind} {problem.name.split()[-1]}", "path": problem.witness.tolist()}
            for problem in problems
            if problem.robot.name == robot
        ]
        sets.append({"name": file.stem, "sha256": checksum(file), "answers": ways})
    entry = {"format": "safe-ompl entry", "version": 1, "system": "as they were made", "sets": sets}
    (folder / "as_made.json").write_text(json.dumps(entry), encoding="utf-8")
