"""Paths on a MotionBenchMaker file, simplified: SafeRRTConnect and ours, OMPL's RRTConnect and OMPL's simplifier.

Same checker, same validator, in turn; both end by themselves. With --planned neither path is simplified. Medians and
ratios are over the problems that both solved. No path can be clearer than its ends, so the least clearance is compared
with that, too; and every path that ours went through is looked at: proven or not, and whether its cost J is above that
of the path that the planner had found. Then how J falls with CPU time, and what a simplification asked of the models.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from time import process_time

import numpy as np
from ompl import geometric as og

from bench._harness import Report, positions
from bench._planning import cpu_limit, mbm_problems
from safe_ompl import PathReport, SafeSetup
from safe_ompl.common import FloatArray

CLAIM = "simplified paths are shorter, safer and clearer than the planner's and than OMPL's, and always proven"
INSTANTS = (0.005, 0.01, 0.02, 0.05, 0.1)  # [s]
STEEP, NEARLY = 5.0, 0.9  # times their least clearance; share of what the ends have


@dataclass(frozen=True)
class Outcome:
    """A simplified path: CPU times [s], its report, and J before, on the way, and after."""

    planning: float
    simplifying: float
    report: PathReport
    raw: FloatArray
    steps: list[FloatArray]
    costs: list[float]
    times: list[float]  # [s] since the simplification began
    counts: dict[str, int]

    def cost_after(self, seconds: float) -> float:
        """Return J of the best path after a time."""
        return [cost for cost, at in zip(self.costs, self.times, strict=True) if at <= seconds][-1]


def ours(setup: SafeSetup, raw: FloatArray, planning: float) -> Outcome:
    """Simplify a path."""
    simplifier = setup.simplifier  # made before the clock starts
    steps, times, before = [raw], [0.0], _counts(setup)
    begin = process_time()

    def note(better: FloatArray, cost: float) -> None:
        steps.append(better)
        times.append(process_time() - begin)

    run = simplifier.begin(raw, lambda: False, note, proven=True)
    run.improve()
    path = run.best
    took, after = process_time() - begin, _counts(setup)
    costs = [simplifier.cost.of(step) for step in steps]
    counts = {name: after[name] - before[name] for name in after}
    return Outcome(planning, took, setup.report(path), raw, steps, costs, times, counts)


def _counts(setup: SafeSetup) -> dict[str, int]:
    """Return what the models were asked so far; checker and field may count together."""
    assert setup.field is not None
    return {**vars(setup.field.counts), **vars(setup.checker.counts)}


def as_planned(setup: SafeSetup, raw: FloatArray, planning: float) -> Outcome:
    """Return a path that is not simplified."""
    return Outcome(planning, 0.0, setup.report(raw), raw, [raw], [setup.simplifier.cost.of(raw)], [0.0], {})


def theirs(setup: SafeSetup, options: argparse.Namespace) -> Outcome | None:
    """Plan with OMPL's planner and its simplifier."""
    begin = process_time()
    raw = _planned(setup, "RRTConnect", options.time, options.seed)
    if raw is None:
        return None
    middle = process_time()
    if options.planned:
        return as_planned(setup, raw, middle - begin)
    og.SimpleSetup.simplifySolution(setup)
    end = process_time()
    path = setup.solution()
    costs = [setup.simplifier.cost.of(raw), setup.simplifier.cost.of(path)]
    times = [0.0, end - middle]
    return Outcome(middle - begin, end - middle, setup.report(path), raw, [raw, path], costs, times, {})


def _planned(setup: SafeSetup, planner: str, time: float, seed: int) -> FloatArray | None:
    """Return a path without a report, whose work would be part of the time."""
    setup.prepare(planner, seed)
    setup.solve(cpu_limit(time))
    return setup.solution() if setup.haveExactSolutionPath() else None


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file")
    parser.add_argument("--problems", type=positions, default="0:", metavar="A:B", help="slice of each family")
    parser.add_argument("--time", type=float, default=5.0, metavar="S", help="CPU time of a plan (default: 5)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--planned", action="store_true", help="compare paths as they are planned")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run the bench."""
    pairs: list[tuple[str, Outcome, Outcome]] = []
    solved, problems, steps, unproven, rising = [0, 0], 0, 0, 0, 0
    caps: list[float] = []
    for problems, (family, setup, _) in enumerate(mbm_problems(options.file, options.problems), 1):
        begin = process_time()
        raw = _planned(setup, "SafeRRTConnect", options.time, options.seed)
        shown = as_planned if options.planned else ours
        own = None if raw is None else shown(setup, raw, process_time() - begin)
        other = theirs(setup, options)
        solved = [solved[0] + (own is not None), solved[1] + (other is not None)]
        if own is None or other is None:
            print(f"unsolved: {family}, problem {problems}", own is not None, other is not None, file=sys.stderr)
            continue
        pairs.append((family, own, other))
        caps.append(min(setup.checker.clearance(q).distance for q in own.raw[[0, -1]]))
        motion = setup.simplifier.motion
        steps += len(own.steps) - 1
        rising += own.costs[-1] > own.costs[0]
        unproven += sum(not all(motion.is_free(a, b) for a, b in pairwise(step)) for step in own.steps[1:])
    families = dict.fromkeys(family for family, _, _ in pairs)
    for name in (*families, "all"):
        show(report, name, [(own, other) for family, own, other in pairs if name in (family, "all")])
    report.figure("solved", f"{solved[0]} and {solved[1]} of {problems}")
    least = np.array([[found.report.clearance.min for found in both[1:]] for both in pairs])
    reached = least[:, 0] >= np.minimum(STEEP * least[:, 1], NEARLY * np.array(caps))
    report.figure("least clearance of the ends, median [mm]", 1e3 * float(np.median(caps)))
    report.figure("least clearance 5 times theirs, or 0.9 of what the ends have", f"{reached.sum()}/{len(reached)}")
    peaks = np.array([[found.report.danger.max for found in both[1:]] for both in pairs])
    report.figure("peak danger lower / equal / higher", _comparison(peaks))
    if not options.planned:
        report.figure("paths on the way", steps)
        report.figure("of these not proven", unproven)
        report.figure("J above the planner's path", rising)
        show_course(report, [own for _, own, _ in pairs])
    return int(unproven + rising > 0)


def show_course(report: Report, outcomes: list[Outcome]) -> None:
    """Report how J falls with time, and what it takes."""
    rows = []
    for instant in INSTANTS:
        ratios = [outcome.cost_after(instant) / outcome.costs[-1] for outcome in outcomes]
        rows.append((1e3 * instant, *map(float, np.percentile(ratios, [50, 90]))))
    report.table(("after [ms CPU]", "J / J at the end, median", "90 %"), rows)
    first = [outcome.times[1] if len(outcome.times) > 1 else np.inf for outcome in outcomes]
    report.figure("first better path after [ms CPU], median", 1e3 * float(np.median(first)))
    names = outcomes[0].counts
    rows = [(name, float(np.median([outcome.counts[name] for outcome in outcomes]))) for name in names]
    report.table(("asked", "median"), rows)


def _comparison(values: FloatArray) -> str:
    difference = (values[:, 0] - values[:, 1]) / values[:, 1]
    counts = (difference < -1e-3).sum(), (abs(difference) <= 1e-3).sum(), (difference > 1e-3).sum()
    return " / ".join(map(str, counts))


ROWS: dict[str, Callable[[Outcome], float]] = {
    "planning [ms CPU]": lambda o: 1e3 * o.planning,
    "simplification [ms CPU]": lambda o: 1e3 * o.simplifying,
    "total [ms CPU]": lambda o: 1e3 * (o.planning + o.simplifying),
    "J": lambda o: o.costs[-1],
    "length [rad]": lambda o: o.report.length,
    "way points": lambda o: len(o.steps[-1]),
    "mean danger": lambda o: o.report.danger.mean,
    "peak danger": lambda o: o.report.danger.max,
    "integral of danger": lambda o: o.report.danger.integral,
    "avoidable danger": lambda o: o.report.danger.avoidable,
    "min clearance [mm]": lambda o: 1e3 * o.report.clearance.min,
    "mean clearance [mm]": lambda o: 1e3 * o.report.clearance.mean,
    "length nearer than 50 mm [rad]": lambda o: o.report.clearance.length_below_50mm,
}


def show(report: Report, name: str, pairs: list[tuple[Outcome, Outcome]]) -> None:
    """Report medians, their ratio, the median of the ratios, and means."""
    rows = []
    for label, value in ROWS.items():
        both = np.array([[value(outcome) for outcome in pair] for pair in pairs])
        (own, other), each = np.median(both, axis=0), both[both[:, 1] > 0]
        of_each = float(np.median(each[:, 0] / each[:, 1])) if len(each) else "–"
        ratio = float(own / other) if other else "–"
        rows.append((label, float(own), float(other), ratio, of_each, *map(float, both.mean(axis=0))))
    for share in (90, 99):
        own, other = np.percentile([[1e3 * found.planning for found in pair] for pair in pairs], share, axis=0)
        rows.append((f"planning, {share} % [ms CPU]", float(own), float(other), float(own / other), *["–"] * 3))
    header = ("ours", "theirs", "ratio", "of each", "mean, ours", "theirs")
    report.table((f"{len(pairs)} problems", *header), rows, name)
