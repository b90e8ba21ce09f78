"""SafeRRTConnect beside OMPL's RRTConnect on a MotionBenchMaker file: same checker, same validator, in turn.

    python bench/mbm.py FILE [--problems 0:100] [--time 5] [--seed 0] [--contacts]

Prints medians and ratios; with --contacts every path is also judged as `safe-ompl judge` does, and what touches
is counted.
"""

from __future__ import annotations

import sys

import numpy as np
from _problems import problem_parser, problems

from safe_ompl import Motion, PlanResult
from safe_ompl.apps.benchmark import Judge

PLANNERS = ("SafeRRTConnect", "RRTConnect")


def main() -> None:
    """Run the bench."""
    parser = problem_parser(__doc__)
    parser.add_argument("--contacts", action="store_true", help="judge every path by samples")
    options = parser.parse_args()
    results: dict[str, list[PlanResult]] = {planner: [] for planner in PLANNERS}
    touching = dict.fromkeys(PLANNERS, 0)
    for family, problem, setup in problems(options):
        for planner in PLANNERS:
            result = setup.plan(planner, time=options.time, seed=options.seed)
            results[planner].append(result)
            if not result:
                print(f"unsolved: {planner} {family} {problem.index}", file=sys.stderr)
            elif options.contacts:
                judge = Judge(setup.robot, problem.scene)
                touching[planner] += judge.verdict(Motion.through(result.path)).touching
    show(results, touching if options.contacts else None)


def show(results: dict[str, list[PlanResult]], touching: dict[str, int] | None) -> None:
    """Print medians for each planner, and their ratio, over the problems that both solved."""
    both = [k for k in range(len(results[PLANNERS[0]])) if all(runs[k] for runs in results.values())]
    rows = {
        "planning time [ms]": lambda r: 1e3 * r.planning_time,
        "queries": lambda r: r.counts.queries,
        "field evaluations": lambda r: r.counts.field_configurations,
        "nodes": lambda r: r.counts.nodes,
        "length [rad]": lambda r: r.report.length,
        "mean danger": lambda r: r.report.danger.mean,
        "peak danger": lambda r: r.report.danger.max,
        "integral of danger": lambda r: r.report.danger.integral,
        "avoidable danger": lambda r: r.report.danger.avoidable,
        "min clearance [mm]": lambda r: 1e3 * r.report.clearance.min,
        "mean clearance [mm]": lambda r: 1e3 * r.report.clearance.mean,
        "length nearer than 50 mm [rad]": lambda r: r.report.clearance.length_below_50mm,
    }
    print(f"{'':32s}" + "".join(f"{planner:>16s}" for planner in PLANNERS) + f"{'ratio':>8s}")
    solved = [f"{sum(map(bool, runs))}/{len(runs)}" for runs in results.values()]
    print(f"{'solved':32s}" + "".join(f"{text:>16s}" for text in solved))
    if touching is not None:
        print(f"{'touch, sampled at 0.0002 rad':32s}" + "".join(f"{n:16d}" for n in touching.values()))
    for label, value in rows.items():
        ours, theirs = (float(np.median([value(runs[k]) for k in both])) for runs in results.values())
        ratio = f"{ours / theirs:8.2f}" if theirs else f"{'–':>8s}"
        print(f"{label:32s}{ours:16.4g}{theirs:16.4g}{ratio}")
    times = [1e3 * np.array([run.planning_time for run in runs]) for runs in results.values()]
    for percent in (90, 99, 100):
        ours, theirs = (float(np.percentile(t, percent)) for t in times)
        print(f"{f'planning time, {percent} % [ms]':32s}{ours:16.4g}{theirs:16.4g}{ours / theirs:8.2f}")


if __name__ == "__main__":
    main()
