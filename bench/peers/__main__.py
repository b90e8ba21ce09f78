"""Other planners on the same robot, geometry and problems, judged by one neutral program.

    python bench/peers FILE --out FOLDER [--problems 0:30] [--seeds 2] [--time 5] [--only NAME …] [--skip NAME …]

FILE holds MotionBenchMaker problems. Every system runs in a process and a virtual environment of its own (made on
the first run, in FOLDER/environments), on one core, in turn problem by problem. CPU seconds of building, planning and
smoothing are each system's own; robots are loaded once, before the first problem, and every system answers one problem
before the others, which does not count, so that kernels are compiled then. The judge is plain Pinocchio and coal at
0.005 rad. Problems whose start or goal touches something are left out and listed. A system that raises an error has not
solved that problem; one whose process ends or hangs is started anew, three times at most. Unless --no-repair, every
path of another system is proven, or repaired where it cannot be, and judged again. Writes table.md, figure.png and
runs.json; what cannot be installed is listed with the reason.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from _problems import positions
from export import export
from judge import read
from processes import WARMING, Comparison, Runner
from systems import REPAIR, REPAIRED, SYSTEMS
from table import Run, figure, markdown, repairs

from safe_ompl.scene.mbm import MbmFile


def main() -> None:
    """Run the comparison."""
    options = _options()
    out: Path = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    environments = (options.environments or out / "environments").resolve()
    robot, problems = export(MbmFile.load(options.file), options.problems, out)
    named = {s.name for s in SYSTEMS if _chosen(s.name, options.only, options.skip)}
    named |= {s.after for s in SYSTEMS if s.name in named}
    chosen = [s for s in SYSTEMS if s.name in named]
    judge, comparison = read(robot), Comparison(chosen, robot, environments)
    blocked = [problem["name"] for problem in problems if judge.ends_touch(problem)]
    open_ones = [problem for problem in problems if problem["name"] not in blocked]
    if open_ones:
        comparison.warm_up({**open_ones[0], "seed": 0, "time": options.time})
    repair = None if options.no_repair else Runner(REPAIR, robot, environments)
    if repair is not None and open_ones:
        straight = [open_ones[0]["start"], open_ones[0]["goal"]]
        repair.ask({**open_ones[0], "seed": 0, "time": options.time, "given": straight}, WARMING)
    after: dict[str, list[Run]] = {name: [] for name in named}
    for k, problem in enumerate(open_ones):
        for seed in range(options.seeds):
            question = {**problem, "seed": seed, "time": options.time}
            for name, answer in comparison.ask(question).items():
                run = _judged(answer, judge, problem, seed)
                comparison.runs[name].append(run)
                if repair is not None and not name.startswith("safe_ompl"):
                    after[name].append(_repaired(answer, run, repair, judge, question))
        print(f"{k + 1}/{len(open_ones)} {problem['name']}", file=sys.stderr)
    comparison.close()
    if repair is not None:
        repair.close()
    comparison.runs |= {f"{name} + our proof and repair": after[name] for name in REPAIRED if name in named}
    runs, unavailable = comparison.runs, comparison.unavailable
    (out / "runs.json").write_text(
        json.dumps({"runs": runs, "repaired": after, "unavailable": unavailable, "left_out": blocked})
    )
    shown = {name: answers for name, answers in runs.items() if answers}
    text = markdown(shown, unavailable, blocked)
    if repair is not None:
        text += "\n\n" + repairs({name: (runs[name], answers) for name, answers in after.items() if answers})
    (out / "table.md").write_text(text + "\n")
    figure(shown, out / "figure.png")
    print(text)


def _judged(answer: dict[str, Any], judge: Any, problem: dict[str, Any], seed: int) -> Run:
    """Return the times of an answer and what the judge says; a path with wrong ends counts as none."""
    run: Run = {key: answer[key] for key in ("building", "planning", "smoothing")}
    run |= {
        "path": answer["path"],
        "problem": problem["name"],
        "seed": seed,
        "solved": bool(answer["path"]),  # some return an empty path
        "error": answer.get("error"),
    }
    if run["solved"]:
        verdict = judge.verdict(problem, np.array(answer["path"]))
        run |= asdict(verdict)
        run["solved"] = verdict.ends
    return run


def _repaired(answer: dict[str, Any], run: Run, repair: Runner, judge: Any, question: dict[str, Any]) -> Run:
    """Return what the judge says of an answer's path when it is proven or repaired, and the times of both together."""
    if not run["solved"]:
        return run
    found = repair.ask({**question, "given": answer["path"]})
    remarks = {
        key: found.get(key) for key in ("proven", "proof", "how", "repaired", "deviation", "tool_deviation")
    }
    remarks["repair"] = found["smoothing"]
    times = {key: answer[key] + found[key] for key in ("building", "planning", "smoothing")}
    judged = _judged({**found, **times}, judge, {**question}, question["seed"])
    judged["solved"] = judged["solved"] and bool(remarks["proven"] or remarks["repaired"])
    return {**judged, **remarks}


def _chosen(name: str, only: list[str], skip: list[str]) -> bool:
    return (not only or any(part in name for part in only)) and not any(part in name for part in skip)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python bench/peers", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
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
    return parser.parse_args()


if __name__ == "__main__":
    main()
