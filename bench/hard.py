"""Hard problems: whether heeding danger ever costs a solution, and what it costs in time.

    python bench/hard.py [--problems A:B] [--planners A,B] [--time S] [--seeds N] [--json FILE] [--export FOLDER]

Narrow openings of seven kinds for four robots, made by rule from a seed (`_hard.py`), each with a proven way; no draw
is left out. Safe planners and their classical counterparts plan each of them in turn, in one process, with the same
checker; JT-RRTs to the place of the tip, the others to the configuration. Times are the process's, which a busy machine
changes little, and so is their limit. Printed for each planner: solved, time and queries (unsolved ones count with the
whole time), and for each pair the ratios of times and queries; then danger where both solve. With --export the
problems are written instead, for others to solve (`safe-ompl judge`), with the proven ways as an entry.
"""

from __future__ import annotations

import argparse
import json
import logging
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from _hard import HardProblem, hard_problems, mbm_form
from _problems import positions
from _timing import print_table
from ompl import base as ob
from ompl import util as ou

from safe_ompl import SafeSetup
from safe_ompl.apps.benchmark import checksum
from safe_ompl.apps.cli.arguments import names
from safe_ompl.collision.motion import MotionProver

PAIRS = {
    "SafeRRTConnect": "ClassicRRTConnect",
    "SafePRM": "ClassicPRM",
    "SafeJTRRT": "ClassicJTRRT",
    "BubblePlanner": "ClassicBubble",
}
ALONE = ("PaperRRTConnect", "RRTConnect")
_COUNT = 112


def main() -> None:
    """Run the planners on the problems, and print what came of it."""
    options = _options()
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    logging.disable(logging.WARNING)
    if options.export:
        export(list(hard_problems(range(_COUNT)[options.problems])), options.export)
        return
    every = [name for pair in PAIRS.items() for name in pair] + list(ALONE)
    chosen = [name for name in every if not options.planners or name in options.planners]
    rows = []
    for problem in hard_problems(range(_COUNT)[options.problems]):
        for seed in range(options.seeds):
            runs = dict(_runs(problem, chosen, seed, options.time))
            rows.append({"problem": problem.name, "kind": problem.kind, "seed": seed, "runs": runs})
            if options.json:
                Path(options.json).write_text(json.dumps(rows), encoding="utf-8")
    for file in options.also:
        rows += json.loads(Path(file).read_text(encoding="utf-8"))
    report(rows, options.time)


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


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problems", type=positions, default="0:", metavar="A:B")
    parser.add_argument("--planners", type=names, default=(), metavar="A,B,...", help="these only")
    parser.add_argument(
        "--time", type=float, default=5.0, metavar="S", help="of the process, for each plan (default: 5)"
    )
    parser.add_argument("--seeds", type=int, default=1, metavar="N")
    parser.add_argument("--json", metavar="FILE", help="write every run")
    parser.add_argument("--also", nargs="*", default=[], metavar="FILE", help="runs of earlier calls to join")
    parser.add_argument("--export", type=Path, metavar="FOLDER", help="write the problems instead")
    return parser.parse_args()


def _runs(problem: HardProblem, names: list[str], seed: int, limit: float) -> Iterator[tuple[str, Any]]:
    setup = SafeSetup(problem.robot, problem.scene)
    setup.setConfigurations(problem.start, problem.goal)
    setup.setWorkspaceGoal(problem.robot.tip_pose(problem.goal).translation)
    # The first question of a scene prepares what all planners share: none of them is to pay for it.
    MotionProver(setup.checker).is_free(problem.start, problem.goal)
    for name in names:
        yield name, _run(setup, name, seed, limit)


def _run(setup: SafeSetup, name: str, seed: int, limit: float) -> dict[str, Any]:
    """Plan for at most so much of the process's time [s], and return what came of it."""
    setup.prepare(name, seed)
    before, begin = setup.counts.copy(), process_time()
    setup.solve(ob.PlannerTerminationCondition(lambda: process_time() > begin + limit))
    counts = setup.counts - before
    run = {
        "solved": bool(setup.haveExactSolutionPath()),
        "time": process_time() - begin,
        "queries": counts.queries,
    }
    if run["solved"]:
        report = setup.report(setup.solution())
        if not report.certified:
            raise RuntimeError(f"{name} returned a path that is not proven free: {report.validation.why}")
        run |= {"danger": report.danger.mean, "avoidable": report.danger.avoidable}
    return run


def report(rows: list[dict[str, Any]], limit: float) -> None:
    """Print the tables."""
    names = list(rows[0]["runs"])
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    lines = []
    for name in names:
        runs = [row["runs"][name] for row in rows]
        times = [run["time"] if run["solved"] else limit for run in runs]
        unsolved = [sum(not row["runs"][name]["solved"] for row in rows if row["kind"] == k) for k in kinds]
        lines.append(
            (
                name,
                f"{sum(run['solved'] for run in runs)}/{len(runs)}",
                *(1e3 * float(np.quantile(times, q)) for q in (0.5, 0.75, 0.9)),
                float(np.median([run["queries"] for run in runs])),
                *unsolved,
            )
        )
    print_table(("planner", "solved", "median ms", "75 %", "90 %", "queries", *kinds), lines)
    for safe, classic in PAIRS.items():
        if safe in names and classic in names:
            for line in _compared([(row["runs"][safe], row["runs"][classic]) for row in rows], limit):
                print(f"{safe} / {classic}: {line}")


def _compared(pairs: list[tuple[dict[str, Any], dict[str, Any]]], limit: float) -> Iterator[str]:
    """Yield what there is to say about a safe planner's runs beside those of its classical counterpart."""
    times = np.array([[run["time"] if run["solved"] else limit for run in pair] for pair in pairs])
    yield f"time {_ratio(times, 0.5)} (medians), {_ratio(times, 0.9)} (at 90 %)"
    queries = np.array([[run["queries"] if run["solved"] else np.inf for run in pair] for pair in pairs])
    yield f"queries {_ratio(queries, 0.5)} (medians), {_ratio(queries, 0.75)} (at 75 %)"
    first, second = (sum(pair[k]["solved"] and not pair[1 - k]["solved"] for pair in pairs) for k in (0, 1))
    yield f"solved by the first only {first}, by the second only {second}"
    both = [pair for pair in pairs if pair[0]["solved"] and pair[1]["solved"]]
    if not both:
        return
    mean, avoidable = (
        np.array([[run[key] for run in pair] for pair in both]) for key in ("danger", "avoidable")
    )
    lower = float(np.mean(mean[:, 0] < mean[:, 1]))
    yield f"mean danger {np.median(mean[:, 0] / mean[:, 1]):.2f}, lower in {lower:.0%} of {len(both)}"
    yield f"avoidable danger {avoidable[:, 0].mean():.2f} against {avoidable[:, 1].mean():.2f}"


def _ratio(pairs: np.ndarray, share: float) -> str:
    """Return the ratio of the quantiles of two columns (N, 2)."""
    first, second = np.quantile(pairs, share, axis=0, method="lower")
    return f"{first / second:.2f}" if np.isfinite([first, second]).all() else "–"


if __name__ == "__main__":
    main()
