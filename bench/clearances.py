"""The least clearance of raw paths, safe beside classical: on every scenario, and on problems of MotionBenchMaker.

    python bench/clearances.py [--seeds 8] [--planners A,B] [--time S] [--scenarios A,B] [--mbm FILE [--problems A:B]]

Danger knows dangerous things only: a safe planner should not graze a shelf on its way round a person. Safe planners
and their classical counterparts plan each problem in turn, in one process, several seeds of each scenario (one of
deterministic planners) and one of each MotionBenchMaker problem. A row is a scenario, or a family of problems: how
many runs both solved, and over those medians of the least clearance and of the mean danger, and ratios of the
process's time and of the queries. JT-RRTs plan to the place of the tip, the others to the configuration.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator, Sequence
from time import process_time
from typing import NamedTuple

import numpy as np
from _problems import positions
from _timing import print_table
from ompl import base as ob
from ompl import util as ou

from safe_ompl import Robot, SafeSetup
from safe_ompl.apps.cli.arguments import names
from safe_ompl.planning.from_scenario import setup_problem, setup_scenario
from safe_ompl.scene.mbm import MbmFile
from safe_ompl.scene.scenario import Scenario, find_scenario, list_scenarios

PAIRS = {
    "SafeRRTConnect": "ClassicRRTConnect",
    "SafePRM": "ClassicPRM",
    "SafeJTRRT": "ClassicJTRRT",
    "BubblePlanner": "ClassicBubble",
}
_DETERMINISTIC = ("BubblePlanner",)


class Run(NamedTuple):
    """What a planner came to: least clearance [m], mean danger, time of the process [s], and queries."""

    clearance: float
    danger: float
    time: float
    queries: int


def main() -> None:
    """Run the planners, and print the table."""
    options = _options()
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    logging.disable(logging.WARNING)
    chosen = [safe for safe in PAIRS if not options.planners or safe in options.planners]
    found: dict[tuple[str, str], list[tuple[Run | None, Run | None]]] = {}
    for group, setup, seeds in _problems(options):
        for safe in chosen:
            for seed in range(1 if safe in _DETERMINISTIC else seeds):
                safe_run, classic_run = (run(setup, name, seed, options.time) for name in (safe, PAIRS[safe]))
                found.setdefault((safe, group), []).append((safe_run, classic_run))
    report(found)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=8, metavar="N", help="of each scenario (default: 8)")
    parser.add_argument("--planners", type=names, default=(), metavar="A,B,...", help="these safe ones only")
    parser.add_argument("--scenarios", type=names, default=None, metavar="A,B,...", help="default: all")
    parser.add_argument("--mbm", metavar="FILE", help="problems of MotionBenchMaker besides")
    parser.add_argument(
        "--problems", type=positions, default="0:", metavar="A:B", help="slice of each family of them"
    )
    parser.add_argument(
        "--time", type=float, default=5.0, metavar="S", help="of the process, for each plan (default: 5)"
    )
    return parser.parse_args()


def _problems(options: argparse.Namespace) -> Iterator[tuple[str, SafeSetup, int]]:
    """Yield the problems, each with the row that it counts in and its number of seeds."""
    for name in list_scenarios() if options.scenarios is None else options.scenarios:
        if name:
            yield name, setup_scenario(Scenario.load(find_scenario(name))), options.seeds
    if options.mbm:
        file = MbmFile.load(options.mbm)
        robot = Robot.from_example(file.robot)
        for family in file.families:
            for problem in list(file.problems(family))[options.problems]:
                setup = setup_problem(problem, robot)
                setup.setWorkspaceGoal(
                    setup.robot.tip_pose(problem.goal_configurations(setup.robot)[0]).translation
                )
                yield family, setup, 1


def run(setup: SafeSetup, name: str, seed: int, limit: float) -> Run | None:
    """Plan for at most so much of the process's time [s]; None where nothing is found."""
    setup.prepare(name, seed)
    before, begin = setup.counts.copy(), process_time()
    setup.solve(ob.PlannerTerminationCondition(lambda: process_time() > begin + limit))
    time, queries = process_time() - begin, (setup.counts - before).queries
    if not setup.haveExactSolutionPath():
        return None
    found = setup.report(setup.solution())
    return Run(found.clearance.min, found.danger.mean, time, queries)


def report(found: dict[tuple[str, str], list[tuple[Run | None, Run | None]]]) -> None:
    """Print a table for each pair of planners."""
    for safe in dict.fromkeys(safe for safe, _ in found):
        rows: list[tuple[object, ...]] = []
        everything: list[tuple[Run | None, Run | None]] = []
        for (planner, group), runs in found.items():
            if planner == safe:
                rows.append((group, *_row(runs)))
                everything += runs
        if len(rows) > 1:
            rows.append(("all", *_row(everything)))
        print(f"\n{safe} / {PAIRS[safe]}")
        header = ("", "solved", "", "clearance [mm]", "", "danger", "", "time ratio", "queries")
        print_table(header, rows)


def _row(runs: Sequence[tuple[Run | None, Run | None]]) -> tuple[object, ...]:
    """Return solved (two), medians of clearance and danger (two each), and median ratios of time and queries."""
    solved = tuple(f"{sum(pair[k] is not None for pair in runs)}/{len(runs)}" for k in (0, 1))
    both = [(a, b) for a, b in runs if a is not None and b is not None]
    if not both:
        return (*solved, *["–"] * 6)
    first, second = (np.array([pair[k] for pair in both]) for k in (0, 1))
    (c1, d1, t1, q1), (c2, d2, t2, q2) = np.median(first, axis=0), np.median(second, axis=0)
    return (*solved, *(float(x) for x in (1e3 * c1, 1e3 * c2, d1, d2, t1 / t2, q1 / q2)))


if __name__ == "__main__":
    main()
