"""Simplified paths on a MotionBenchMaker file: SafeRRTConnect + simplify_danger, RRT-Connect + OMPL's simplifier.

    python bench/simplify.py FILE [--problems 0:100] [--time 5] [--simplify SECONDS] [--seed 0]
                             [--baseline NAME|none]

The baseline is OMPL's own RRTConnect, or with --baseline PaperRRTConnect RRT-Connect as printed in this package. Same
checker, same validator, in turn. Ours end by themselves, or after so many seconds; OMPL's simplifier ends by itself.
Prints medians and ratios over the problems that both solved. No path can be clearer than its ends, so the least
clearance is compared with that, too; and every path that ours went through is looked at: proven or not, and whether
the cost J of one is above that of the path that the planner had found. Then how J falls with CPU time, what a
simplification asked of the models, and, with --simplify, by how much it overran its time.

    python bench/simplify.py FILE --save RAW     plan only, and save the paths
    python bench/simplify.py FILE --paths RAW    simplify saved paths: the same ones for two versions of the code
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import process_time

import numpy as np
from _problems import problem_parser, problems
from ompl import geometric as og

from safe_ompl import PathReport, SafeSetup
from safe_ompl.common import FloatArray

OURS, THEIRS = "SafeRRTConnect", ("RRTConnect", "PaperRRTConnect")
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


def ours(setup: SafeSetup, raw: FloatArray, planning: float, seconds: float | None) -> Outcome:
    """Simplify a path."""
    simplifier = setup.simplifier  # made before the clock starts
    steps, times, before = [raw], [0.0], _counts(setup)
    begin = process_time()

    def stop() -> bool:
        return seconds is not None and process_time() - begin >= seconds

    def note(better: FloatArray, cost: float) -> None:
        steps.append(better)
        times.append(process_time() - begin)

    path = simplifier.simplify(raw, stop, note, proven=True)
    took, after = process_time() - begin, _counts(setup)
    costs = [simplifier.cost.of(step) for step in steps]
    counts = {name: after[name] - before[name] for name in after}
    return Outcome(planning, took, setup.report(path), raw, steps, costs, times, counts)


def _counts(setup: SafeSetup) -> dict[str, int]:
    """Return what the models were asked so far; checker and field may count together."""
    assert setup.field is not None
    return {**vars(setup.field.counts), **vars(setup.checker.counts)}


def theirs(setup: SafeSetup, planner: str, time: float, seed: int) -> Outcome | None:
    """Plan with a baseline and OMPL's simplifier."""
    begin = process_time()
    raw = _planned(setup, planner, time, seed)
    if raw is None:
        return None
    middle = process_time()
    og.SimpleSetup.simplifySolution(setup)
    end = process_time()
    path = setup.solution()
    costs = [setup.simplifier.cost.of(raw), setup.simplifier.cost.of(path)]
    times = [0.0, end - middle]
    return Outcome(middle - begin, end - middle, setup.report(path), raw, [raw, path], costs, times, {})


def _planned(setup: SafeSetup, planner: str, time: float, seed: int) -> FloatArray | None:
    """Return a path without a report, whose work would be part of the time."""
    setup.prepare(planner, seed)
    setup.solve(time)
    return setup.solution() if setup.haveExactSolutionPath() else None


def main() -> None:
    """Run the bench."""
    parser = problem_parser(__doc__)
    parser.add_argument("--simplify", type=float, metavar="S", help="for ours (default: until it ends)")
    parser.add_argument("--baseline", choices=(*THEIRS, "none"), default=THEIRS[0])
    parser.add_argument("--save", type=Path, metavar="FILE", help="plan only, and save the paths")
    parser.add_argument("--paths", type=Path, metavar="FILE", help="simplify these instead of planning")
    options = parser.parse_args()
    saved: dict[str, list[list[float]]] = {}
    if options.paths:
        saved = json.loads(options.paths.read_text())
    pairs: list[tuple[Outcome, Outcome]] = []
    families: list[str] = []
    steps = unproven = rising = 0
    caps: list[float] = []
    for family, problem, setup in problems(options):
        key, begin = f"{family} {problem.index}", process_time()
        known = saved.get(key) if options.paths else None
        raw = np.array(known) if known else _planned(setup, OURS, options.time, options.seed)
        planning = process_time() - begin
        if options.save:
            if raw is not None:
                saved[key] = raw.tolist()
            continue
        own = None if raw is None else ours(setup, raw, planning, options.simplify)
        other = own
        if options.baseline != "none":
            other = theirs(setup, options.baseline, options.time, options.seed)
        if own is None or other is None:
            print(f"unsolved: {key}", own is not None, other is not None, file=sys.stderr)
            continue
        pairs.append((own, other))
        families.append(family)
        caps.append(min(setup.checker.clearance(q).distance for q in own.raw[[0, -1]]))
        motion = setup.simplifier.motion
        steps += len(own.steps) - 1
        rising += own.costs[-1] > own.costs[0]
        unproven += sum(not all(motion.is_free(a, b) for a, b in pairwise(step)) for step in own.steps[1:])
    if options.save:
        options.save.write_text(json.dumps(saved))
        return
    for family in dict.fromkeys(families):
        print(f"\n{family}")
        show([pair for pair, of in zip(pairs, families, strict=True) if of == family])
    print("\nall")
    show(pairs)
    least = np.array([[outcome.report.clearance.min for outcome in pair] for pair in pairs])
    reached = least[:, 0] >= np.minimum(STEEP * least[:, 1], NEARLY * np.array(caps))
    print(f"least clearance of the ends, median [mm]: {1e3 * np.median(caps):.2f}")
    print(f"least clearance 5 times theirs, or 0.9 of what the ends have: {reached.sum()}/{len(reached)}")
    peaks = np.array([[outcome.report.danger.max for outcome in pair] for pair in pairs])
    print(f"peak danger lower / equal / higher: {_comparison(peaks)}")
    print(f"paths on the way: {steps}, not proven: {unproven}; J above the planner's path: {rising}")
    show_course([own for own, _ in pairs], options.simplify)


def show_course(outcomes: list[Outcome], limit: float | None) -> None:
    """Print how J falls with time, what it takes, and by how much a time limit is overrun."""
    print("\nafter [ms CPU]       J / J at the end, median and 90 %")
    for instant in INSTANTS:
        ratios = [outcome.cost_after(instant) / outcome.costs[-1] for outcome in outcomes]
        print(f"{1e3 * instant:14.0f}" + "".join(f"{q:15.3f}" for q in np.percentile(ratios, [50, 90])))
    first = [outcome.times[1] if len(outcome.times) > 1 else np.inf for outcome in outcomes]
    print(f"first better path after [ms CPU], median: {1e3 * np.median(first):.1f}")
    for name in outcomes[0].counts:
        print(f"{name:24s}{np.median([outcome.counts[name] for outcome in outcomes]):10.0f}")
    if limit is not None:
        overrun = [1e3 * max(0.0, outcome.simplifying - limit) for outcome in outcomes]
        print(
            "overrun [ms CPU], median, 90 % and largest: {:.1f} {:.1f} {:.1f}".format(
                *np.percentile(overrun, [50, 90, 100])
            )
        )


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


def show(pairs: list[tuple[Outcome, Outcome]]) -> None:
    """Print medians, their ratio, and the median of the ratios."""
    columns = ("ours", "theirs", "ratio", "of each", "mean, ours", "theirs")
    head = f"{f'{len(pairs)} problems':32s}" + "".join(f"{column:>11s}" for column in columns)
    print(head)
    for label, value in ROWS.items():
        both = np.array([[value(outcome) for outcome in pair] for pair in pairs])
        own, other = np.median(both, axis=0)
        each = both[both[:, 1] > 0]
        ratio = f"{own / other:11.2f}" if other else f"{'–':>11s}"
        of_each = f"{np.median(each[:, 0] / each[:, 1]):11.2f}" if len(each) else f"{'–':>11s}"
        means = both.mean(axis=0)
        print(f"{label:32s}{own:11.4g}{other:11.4g}{ratio}{of_each}{means[0]:11.4g}{means[1]:11.4g}")


if __name__ == "__main__":
    main()
