"""The problems of a MotionBenchMaker file, as the benches ask for them."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator

from ompl import util as ou

from safe_ompl import Robot, SafeSetup
from safe_ompl.planning.from_scenario import setup_problem
from safe_ompl.scene.mbm import MbmFile, MbmProblem


def positions(text: str) -> slice:
    """Read a range of positions like Python's: ``0:50``, ``:50``, ``50:``."""
    first, last = text.split(":")
    return slice(int(first) if first else 0, int(last) if last else None)


def problem_parser(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of what to plan, for how long, and with which seed."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file")
    parser.add_argument(
        "--problems", type=positions, default="0:", metavar="A:B", help="slice of each family"
    )
    parser.add_argument("--time", type=float, default=5.0, metavar="S", help="for planning (default: 5)")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def problems(options: argparse.Namespace) -> Iterator[tuple[str, MbmProblem, SafeSetup]]:
    """Yield the chosen problems with their families and setups; limits are widened to hold the problems' ends."""
    ou.setLogLevel(ou.LogLevel.LOG_ERROR)
    logging.disable(logging.WARNING)
    file = MbmFile.load(options.file)
    robot = Robot.from_example(file.robot)
    for family in file.families:
        for problem in list(file.problems(family))[options.problems]:
            yield family, problem, setup_problem(problem, robot)
