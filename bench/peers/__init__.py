"""Other planners on the same robot, geometry and problems, judged by one neutral program.

    python -m bench peers FILE --out FOLDER [--problems 0:30] [--seeds 2] [--time 5] [--only NAME …] [--skip NAME …]

FILE holds MotionBenchMaker problems. Every system runs in a process and a virtual environment of its own (made on
the first run, in FOLDER/environments), on one core, in turn problem by problem. CPU seconds of building, planning and
smoothing are each system's own; robots are loaded once, before the first problem, and every system answers one problem
before the others, which does not count, so that kernels are compiled then. The judge is that of `safe-ompl judge`.
Problems whose start or goal touches something, or is outside limits of joints, are left out and listed. A system that
raises an error has not solved that problem; one whose process ends or hangs is started anew, three times at most.
Unless --no-repair, every path of another system is proven, or repaired where it cannot be, and judged again. Writes an
entry of the open table for each system (`entries/`), what the judge says of them with a page of all
(`judged/index.html`), table.md and figure.png; what cannot be installed is listed with the reason.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import sys
from pathlib import Path
from typing import Any

from bench._harness import Report, markdown_table, positions
from bench.peers.export import export
from bench.peers.processes import WARMING, Comparison, Runner, UnavailableError, version_of
from bench.peers.systems import REPAIR, REPAIRED, SYSTEMS, System
from bench.peers.table import NO_PATH, Run, figure, markdown, repairs
from bench.peers.table import comparison as compared
from safe_ompl.apps.benchmark import Entry, ProblemSet, answered
from safe_ompl.apps.benchmark.entries import LONGEST
from safe_ompl.apps.cli.judge import judge_into, write_page
from safe_ompl.common import InputError
from safe_ompl.scene.mbm import MbmFile

CLAIM = "beside other planners: no contacts, more clearance, less danger; what that costs in time"
STEPS = ("building", "planning", "smoothing")
WITH_OURS = "{} + our proof and repair"


def main(options: argparse.Namespace, report: Report) -> None:
    """Run the comparison."""
    out: Path = options.out.resolve()
    environments = (options.environments or out / "environments").resolve()
    for folder in ("entries", "repaired", "judged"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    known = ProblemSet.load(options.file)
    robot, problems, outside = export(MbmFile.load(options.file), options.problems, out)
    named = {s.name for s in SYSTEMS if _chosen(s.name, options.only, options.skip)}
    named |= {s.after for s in SYSTEMS if s.name in named}
    chosen = [s for s in SYSTEMS if s.name in named]
    blocked = [p["name"] for p in problems if _ends_touch(known, p["name"])]
    open_ones = [problem for problem in problems if problem["name"] not in blocked]
    comparison = Comparison(chosen, robot, environments)
    if open_ones:
        comparison.warm_up({**open_ones[0], "seed": 0, "time": options.time})
    repair = None if options.no_repair else Runner(REPAIR, robot, environments)
    if repair is not None and open_ones:
        straight = [open_ones[0]["start"], open_ones[0]["goal"]]
        repair.ask({**open_ones[0], "seed": 0, "time": options.time, "given": straight}, WARMING)
    after: dict[str, list[dict[str, Any]]] = {name: [] for name in named}
    remarks: dict[str, list[dict[str, Any]]] = {name: [] for name in named}
    for k, problem in enumerate(open_ones):
        for seed in range(options.seeds):
            question = {**problem, "seed": seed, "time": options.time}
            for name, answer in comparison.ask(question).items():
                comparison.runs[name].append(_answer(answer, known, question))
                if repair is not None and not name.startswith("safe_ompl"):
                    found, said = _repaired(comparison.runs[name][-1], repair, known, question)
                    after[name].append(found)
                    remarks[name].append(said)
        print(f"{k + 1}/{len(open_ones)} {problem['name']}", file=sys.stderr)
    comparison.close()
    if repair is not None:
        repair.close()
    runs: dict[str, list[Run]] = {}
    fixed: dict[str, tuple[list[Run], list[Run]]] = {}
    for system in chosen:
        name = system.name
        told = _told(system, environments)
        entry = _entry(name, told, comparison.runs[name], comparison.unavailable.get(name, ""), known)
        runs[name] = _judged(out, "entries", entry, known)
        if after[name]:
            entry = _entry(WITH_OURS.format(name), told, after[name], "", known)
            rows = _judged(out, "entries" if name in REPAIRED else "repaired", entry, known)
            fixed[name] = runs[name], [{**row, **said} for row, said in zip(rows, remarks[name], strict=True)]
    runs |= {WITH_OURS.format(name): fixed[name][1] for name in REPAIRED if name in fixed}
    shown = {name: rows for name, rows in runs.items() if rows}
    report.table(*compared(shown))
    text = markdown(shown, comparison.unavailable, blocked, outside)
    if fixed:
        report.table(*repairs(fixed), "Our proofs and repairs of their paths")
        text += "\n\n" + markdown_table(*repairs(fixed))
    (out / "table.md").write_text(text + "\n")
    figure(shown, out / "figure.png")
    print(write_page(out / "judged"))


def _ends_touch(known: ProblemSet, name: str) -> bool:
    """Return whether the robot touches something or itself at the start or the first goal: nobody can solve that."""
    problem = known.problems[name]
    return any(problem.judge.plain.touches(q) for q in (problem.start, problem.goals[0]))


def _answer(answer: dict[str, Any], known: ProblemSet, question: dict[str, Any]) -> dict[str, Any]:
    """Return an answer as entries have it; a path with wrong ends, or an empty one, counts as none."""
    found = {
        "problem": question["name"],
        "seed": question["seed"],
        "times": {key: answer[key] for key in STEPS},
    }
    if not answer["path"]:
        return {**found, "failed": _line(answer.get("error") or NO_PATH)}
    try:
        answered(known.problems[question["name"]], answer["path"])
    except InputError as error:
        return {**found, "failed": _line(str(error))}
    return {**found, "path": answer["path"]}


def _line(error: str) -> str:
    """Return an error as an entry may hold it."""
    return " ".join(error.split())[:LONGEST]


def _repaired(
    answer: dict[str, Any], repair: Runner, known: ProblemSet, question: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the answer when its path is proven or repaired, the times of both together, and remarks on the repair."""
    if "path" not in answer:
        return answer, {}
    found = repair.ask({**question, "given": answer["path"]})
    remarks = {
        key: found.get(key) for key in ("proven", "proof", "how", "repaired", "deviation", "tool_deviation")
    }
    remarks["repair"] = found["smoothing"]
    if not (remarks["proven"] or remarks["repaired"]):
        found = {**found, "path": None, "error": "neither proven nor repaired"}
    times = {key: answer["times"][key] + found[key] for key in STEPS}
    return _answer({**found, **times}, known, question), remarks


def _told(system: System, environments: Path) -> dict[str, str]:
    """Return what an entry tells of a system."""
    options = ", ".join(f"{key} {value}" for key, value in system.options.items())
    told = {
        "planner": options or "as it comes",
        "timing": "CPU seconds on one core: building, planning, smoothing",
    }
    try:
        told["version_of_planner"] = version_of(system, environments)
    except UnavailableError:
        return told
    return {
        **told,
        "machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    }


def _entry(
    name: str, told: dict[str, str], answers: list[dict[str, Any]], failed: str, known: ProblemSet
) -> dict[str, Any]:
    entry = {"format": "safe-ompl entry", "version": 1, "system": name, **told}
    if not answers:
        return {**entry, "sets": [], "failed": _line(failed or "no problem was asked")}
    return {**entry, "sets": [{"name": known.name, "sha256": known.sha256, "answers": answers}]}


def _judged(out: Path, folder: str, entry: dict[str, Any], known: ProblemSet) -> list[Run]:
    """Write an entry, and return the rows of its judgement; the page shows those in `entries`."""
    name = re.sub(r"[^a-z0-9.]+", "-", entry["system"].lower())
    file = out / folder / f"{name}.json"
    file.write_text(json.dumps(entry))
    read = Entry.load(file, [known])
    return judge_into(read, name, out / "judged")["rows"] if folder == "entries" else read.judged()["rows"]


def _chosen(name: str, only: list[str], skip: list[str]) -> bool:
    return (not only or any(part in name for part in only)) and not any(part in name for part in skip)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("file")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--environments", type=Path, metavar="FOLDER", help="default: OUT/environments")
    parser.add_argument(
        "--problems", type=positions, default="0:10", metavar="A:B", help="slice of each family"
    )
    parser.add_argument("--seeds", type=int, default=2, metavar="N")
    parser.add_argument("--time", type=float, default=5.0, metavar="S", help="for planning (default: 5)")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="systems whose name holds this")
    parser.add_argument("--no-repair", action="store_true", help="leave out our proofs and repairs")
    parser.add_argument("--skip", nargs="+", default=[], metavar="NAME")
