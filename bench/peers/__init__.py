"""Other planners on the same robot, geometry and problems, judged by one neutral program.

    python -m bench peers FILE --out FOLDER [--problems 0:30] [--seeds 2] [--time 5] [--only NAME …] [--skip NAME …]

FILE holds MotionBenchMaker problems. Every system runs in a process and a virtual environment of its own (made on
the first run, in FOLDER/environments), on one core, in turn problem by problem. CPU seconds of building, planning and
smoothing are each system's own; robots are loaded once, before the first problem, and every system answers one problem
before the others, which does not count, so that kernels are compiled then. The judge takes samples (`_plain.py`).
Problems whose start or goal touches something, or is outside limits of joints, are left out and listed. A system that
raises an error has not solved that problem; one whose process ends or hangs is started anew, three times at most.
Unless --no-repair, every path of another system is proven, or repaired where it cannot be, and judged again. Writes
the answers of each system with what the judge says (NAME.json); what cannot be installed is listed with the reason.
VAMP is installed from its sources, in the folder that VAMP_DIR names. plainmp needs Boost with `serialization`.

solved       within the limit of time
contacts     paths that touch something at a sample, 0.0002 rad apart
building     of a new scene; the median of CPU times, as of planning, smoothing and all together (90 % in brackets)
clearance    the distance from obstacles, least and mean, and how much of a path [rad] is nearer than 50 mm
danger       mean, peak and integral of the danger field along the path
numbers      after a name are steps [rad] at which that planner looks for collisions
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bench._harness import Report, positions
from bench._plain import ROUNDING
from bench.peers.export import Problem, export
from bench.peers.processes import WARMING, Comparison, Runner
from bench.peers.systems import REPAIR, SYSTEMS
from bench.peers.table import NO_PATH, WITH_OURS, Run, comparison as compared, remarks, repairs
from safe_ompl import InputError, Motion
from safe_ompl.scene.mbm import MbmFile

CLAIM = "beside other planners: no contacts, more clearance, less danger; what that costs in time"
STEPS = ("building", "planning", "smoothing")


def main(options: argparse.Namespace, report: Report) -> None:
    """Run the comparison."""
    out: Path = options.out.resolve()
    environments = (options.environments or out / "environments").resolve()
    out.mkdir(parents=True, exist_ok=True)
    robot, problems, outside = export(MbmFile.load(options.file), options.problems, out)
    chosen = [s for s in SYSTEMS if _chosen(s.name, options.only, options.skip)]
    open_ones = [problem for problem in problems if not problem.blocked]
    comparison = Comparison(chosen, robot, environments)
    if open_ones:
        comparison.warm_up({**open_ones[0].question, "seed": 0, "time": options.time})
    repair = None if options.no_repair else Runner(REPAIR, robot, environments)
    if repair is not None and open_ones:
        first = open_ones[0].question
        given = [first["start"], first["goal"]]
        repair.ask({**first, "seed": 0, "time": options.time, "given": given}, WARMING)
    runs: dict[str, list[Run]] = {name: [] for name in comparison.runs}
    after: dict[str, list[Run]] = {name: [] for name in comparison.runs}
    for k, problem in enumerate(open_ones):
        for seed in range(options.seeds):
            question = {**problem.question, "seed": seed, "time": options.time}
            for name, answer in comparison.ask(question).items():
                runs[name].append(judged(answer, problem, seed))
                if repair is not None and not name.startswith("safe_ompl"):
                    after[name].append(_repaired(runs[name][-1], repair, problem, question))
        print(f"{k + 1}/{len(open_ones)} {problem.name}", file=sys.stderr)
    comparison.close()
    if repair is not None:
        repair.close()
    fixed = {name: (runs[name], rows) for name, rows in after.items() if rows}
    runs |= {f"{name}{WITH_OURS}": rows for name, (_, rows) in fixed.items()}
    given = {name: rows for name, rows in runs.items() if rows}
    for name, rows in given.items():
        (out / f"{re.sub('[^a-z0-9.]+', '-', name.lower())}.json").write_text(json.dumps(rows))
    report.table(*compared(given))
    if fixed:
        report.table(*repairs(fixed), "Proofs and repairs of their paths")
    blocked = [problem.name for problem in problems if problem.blocked]
    if said := remarks(given, comparison.unavailable, blocked, outside):
        report.table(("remark", ""), said, "Remarks")
    report.table(("package", "version"), sorted(comparison.versions.items()), "Versions")


def judged(answer: dict[str, Any], problem: Problem, seed: int) -> Run:
    """Return an answer with what the judge says; a path with wrong ends, or an empty one, counts as none."""
    path = answer["path"]
    run = {"problem": problem.name, "seed": seed, "times": {key: answer[key] for key in STEPS}}
    run |= {"path": path, "solved": False, "error": " ".join((answer.get("error") or NO_PATH).split())[:300]}
    if not path:
        return run
    try:
        verdict = asdict(problem.judge.verdict(Motion.through(path)))
    except InputError as error:
        return {**run, "error": str(error)}
    ends = np.array([problem.question[key] for key in ("start", "goal")])
    if np.abs(problem.robot.difference(np.array(path)[[0, -1]], ends)).max() > ROUNDING:
        return {**run, "error": "the path has other ends than the problem"}
    outside = verdict.pop("outside")
    return {**run, **verdict, "solved": not outside, "error": outside or None}


def _repaired(run: Run, repair: Runner, problem: Problem, question: dict[str, Any]) -> Run:
    """Return the run when its path is proven or repaired, the times of both together, and remarks on the repair."""
    if not run["path"]:
        return run
    found = repair.ask({**question, "given": run["path"]})
    if not (found.get("proven") or found.get("repaired")):
        found = {**found, "path": None, "error": "neither proven nor repaired"}
    remarks = ("proven", "proof", "how", "repaired", "deviation", "tool_deviation")
    times = {key: run["times"][key] + found[key] for key in STEPS}
    said = {**{key: found.get(key) for key in remarks}, "repair": found["smoothing"]}
    return {**judged({**found, **times}, problem, run["seed"]), **said}


def _chosen(name: str, only: list[str], skip: list[str]) -> bool:
    return (not only or any(part in name for part in only)) and not any(part in name for part in skip)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--environments", type=Path, metavar="FOLDER", help="default: OUT/environments")
    parser.add_argument("--problems", type=positions, default="0:10", metavar="A:B", help="slice of each family")
    parser.add_argument("--seeds", type=int, default=2, metavar="N")
    parser.add_argument("--time", type=float, default=5.0, metavar="S", help="for planning (default: 5)")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="systems whose name holds this")
    parser.add_argument("--no-repair", action="store_true", help="leave out our proofs and repairs")
    parser.add_argument("--skip", nargs="+", default=[], metavar="NAME")
