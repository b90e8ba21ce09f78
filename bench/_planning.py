"""Planners on problems, pair by pair: the same checker, in turn, within a limit of CPU time."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from ompl import base as ob, geometric as og

from bench._harness import Report, positions
from safe_ompl import PathReport, Robot, SafeSetup
from safe_ompl.planning import setup_problem
from safe_ompl.scene import MbmFile

FAMILIES = ("RRTConnect", "PRM", "JTRRT", "Bubble")
SAFE = dict(zip(FAMILIES, ("SafeRRTConnect", "SafePRM", "SafeJTRRT", "BubblePlanner"), strict=True))
KINDS = {
    "ours": lambda family: (SAFE[family], f"Classic{family}"),
    "printed": lambda family: (f"PaperSafe{family}", f"Paper{family}"),
    "crossed": lambda family: (SAFE[family], f"Paper{family}"),
}


class Problem(NamedTuple):
    """A problem, the group that it counts in, and parameters of planners by name."""

    group: str
    setup: SafeSetup
    parameters: Mapping[str, Mapping[str, Any]] = {}


class Run(NamedTuple):
    """What a planner came to: CPU time [s], queries, and the report of a proven path; None where there is none."""

    time: float
    queries: int
    report: PathReport | None


def cpu_limit(seconds: float) -> Any:
    """Return a condition that holds when this process has worked for so long from now on."""
    begin = process_time()
    return ob.PlannerTerminationCondition(lambda: process_time() > begin + seconds)


def run(setup: SafeSetup, planner: str, seed: int, limit: float, parameters: Any = None, simplify: str = "") -> Run:
    """Plan for at most so much CPU time [s]; a path is simplified by "ours" or "ompl" until that ends by itself."""
    setup.prepare(planner, seed, parameters)
    before, begin = replace(setup.counts), process_time()
    setup.solve(cpu_limit(limit))
    solved = setup.haveExactSolutionPath()
    if solved and simplify:
        (setup.simplifySolution if simplify == "ours" else lambda: og.SimpleSetup.simplifySolution(setup))()
    time, queries = process_time() - begin, (setup.counts - before).queries
    report = setup.report(setup.solution()) if solved else None
    if report is not None and not report.certified:
        raise RuntimeError(f"{planner} returned a path that is not proven free: {report.refused}")
    return Run(time, queries, report)


def add_options(parser: argparse.ArgumentParser, time: float) -> None:
    """Add the options of `compare`."""
    parser.add_argument("--pairs", nargs="+", choices=KINDS, default=["ours"], help="safe planners and others")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=FAMILIES)
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="runs (deterministic planners: one)")
    parser.add_argument("--time", type=float, default=time, metavar="S", help="CPU time of a plan (%(default)s)")
    parser.add_argument("--simplify", choices=("ours", "ompl"), default="", help="paths, too")
    parser.add_argument("--problems", type=positions, default="0:", metavar="A:B", help="of each group")


def compare(report: Report, problems: Iterable[Problem], options: argparse.Namespace) -> None:
    """Run the pairs of planners on problems, and report a table for each pair."""
    pairs = [KINDS[kind](family) for family in options.families for kind in options.pairs]
    found: dict[tuple[str, str], dict[str, list[tuple[Run, Run]]]] = {pair: {} for pair in pairs}
    for group, setup, parameters in problems:
        state = setup.query.start
        setup.motion_prover.is_free(state, state)  # what all planners share is made now: none of them pays for it
        if not any(found.values()):
            for name in dict.fromkeys(name for pair in pairs for name in pair):
                run(setup, name, 0, 1.0, parameters.get(name), options.simplify)  # kernels are loaded
        for pair in pairs:
            for seed in range(1 if "Bubble" in pair[0] else options.seeds):
                both = [run(setup, name, seed, options.time, parameters.get(name), options.simplify) for name in pair]
                found[pair].setdefault(group, []).append((both[0], both[1]))
    header = ("", "solved", "", "only", "", "time", "time, 90 %", "queries", "danger", "avoidable", "")
    header += ("min clearance [mm]", "", "mean [mm]", "", "length")
    for pair, groups in found.items():
        rows = [(group, *_row(runs, options.time)) for group, runs in groups.items()]
        if len(rows) > 1:
            rows.append(("all", *_row([both for runs in groups.values() for both in runs], options.time)))
        report.table(header, rows, f"{pair[0]} / {pair[1]}")


def _row(runs: list[tuple[Run, Run]], limit: float) -> tuple[object, ...]:
    """Return counts, ratios of medians (without a path: the limit), and medians over the runs that both solved."""
    solved = np.array([[one.report is not None for one in both] for both in runs])
    times = np.where(solved, [[one.time for one in both] for both in runs], limit)
    queries = np.median([[one.queries for one in both] for both in runs], axis=0)
    middle, late = np.median(times, axis=0), np.percentile(times, 90, axis=0)
    only = (int((solved[:, k] & ~solved[:, 1 - k]).sum()) for k in (0, 1))
    counts = (*(f"{n}/{len(runs)}" for n in solved.sum(axis=0)), *only)
    ratios = tuple(float(a / b) if b else np.nan for a, b in (middle, late, queries))
    reports = [[one.report for one in both] for both, all_ in zip(runs, solved.all(axis=1), strict=True) if all_]
    if not reports:
        return (*counts, *ratios, *["–"] * 8)
    values = np.array([[_values(found) for found in both] for both in reports])
    danger, length = (float(np.median(values[:, 0, k] / values[:, 1, k])) for k in (0, 4))
    avoidable, least, mean = (np.median(values[:, :, k], axis=0).tolist() for k in (1, 2, 3))
    return (*counts, *ratios, danger, *avoidable, *least, *mean, length)


def _values(found: PathReport | None) -> tuple[float, ...]:
    assert found is not None
    danger, clearance = found.danger, found.clearance
    assert danger is not None
    return danger.mean, danger.avoidable, 1e3 * clearance.min, 1e3 * clearance.mean, found.length


def mbm_problems(file: str, chosen: slice) -> Iterator[Problem]:
    """Yield problems of each family of a MotionBenchMaker file; the tip's place at the goal is a goal, too."""
    content = MbmFile.load(file)
    robot = Robot.from_example(content.robot)
    for family in content.families:
        for k in range(content.families[family])[chosen]:
            problem = content.problem(family, k)
            setup = setup_problem(problem, robot)
            goal = problem.goal_configurations(setup.robot)[0]
            setup.setWorkspaceGoal(setup.robot.tip_pose(goal).translation)
            yield Problem(family, setup)
