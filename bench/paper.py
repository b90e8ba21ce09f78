"""The case studies of the paper: python bench/paper.py [--runs N] --out DIR [--planners A,B] [--processes P] [--sweep].

Runs every planner and its classical counterpart N times on both scenarios (bubble planners, which are deterministic,
once), and writes DIR/report.md: Tables I and II beside the paper's, figures after Figs. 1, 3, 4 and 6–13, and each of
the paper's claims with a verdict. Results are kept in DIR/study_N/runs.jsonl as they come; started again, the
bench does only what is missing, so after a change of the planners give another folder. DIR/study_N/benchmark.log
and DIR/benchmark.db are the same runs for OMPL's tools and Planner Arena. With --sweep it shows instead how danger,
success and time depend on the planners' parameters.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from _paper.effort import Hardness
from _paper.evidence import Evidence
from _paper.figures import draw_ideas, draw_study
from _paper.report import write_report
from _paper.runs import TIME, campaigns, do_runs, open_store, study_scenario
from _paper.studies import PAIRS, STUDIES, Pair, chosen_pairs
from _paper.sweep import sweep
from ompl import util as ou

from safe_ompl.benchmark.log import save_database, write_log
from safe_ompl.cli.arguments import count, names
from safe_ompl.cli.console import error_console, progress_bar
from safe_ompl.errors import InputError, UnknownNameError

RUNS, SWEEP_RUNS, HARDNESS_RUNS = 1000, 20, 20


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the command line asks for."""
    options = _options(arguments)
    ou.setLogLevel(ou.LogLevel.LOG_WARN)
    pairs = _pairs(options.planners)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.sweep:
        page = sweep(options.out, pairs, options.runs or SWEEP_RUNS, options.processes)
    else:
        page = study(options.out, pairs, options.runs or RUNS, options.processes)
    error_console().print(f"report in {page}")


def study(folder: Path, pairs: Sequence[Pair], runs: int, processes: int) -> Path:
    """Do both studies as far as they are not done, and write the report; return its file."""
    stores = [open_store(folder, one) for one in STUDIES]
    scenarios = [study_scenario(one) for one in STUDIES]
    with progress_bar(error_console()) as progress:
        for one, scenario, store in zip(STUDIES, scenarios, stores, strict=True):
            todo = campaigns(scenario, pairs, runs, store)
            task = progress.add_task(f"study {one.number}", total=sum(map(len, todo)))
            do_runs(store, todo, processes, lambda task=task: progress.advance(task))
    evidence = [Evidence.of(one, pairs, store.results()) for one, store in zip(STUDIES, stores, strict=True)]
    _write_logs(folder, evidence)
    with error_console().status("drawing"):
        for found, scenario, store in zip(evidence, scenarios, stores, strict=True):
            draw_study(found, scenario, store.folder)
        ideas = draw_ideas(folder)
    hardness = [Hardness.of(scenario, HARDNESS_RUNS) for scenario in scenarios]
    write_report(folder / "report.md", evidence, scenarios, hardness, ideas)
    return folder / "report.md"


def _write_logs(folder: Path, evidence: Sequence[Evidence]) -> None:
    """Write the runs of each study as an OMPL benchmark log, and both to one database."""
    logs = []
    for found in evidence:
        logs.append(folder / f"study_{found.study.number}" / "benchmark.log")
        results = [result for own in found.results.values() for result in own]
        write_log(results, logs[-1], name=found.study.scenario, time_limit=TIME)
    database = folder / "benchmark.db"
    database.unlink(missing_ok=True)
    save_database(logs, database)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="where results and report go")
    parser.add_argument(
        "--runs",
        type=count,
        metavar="N",
        help=f"of each planner (default: {RUNS}; with --sweep {SWEEP_RUNS})",
    )
    parser.add_argument(
        "--planners", type=names, default=(), metavar="A,B,...", help="these and their counterparts"
    )
    parser.add_argument(
        "--processes", type=count, default=os.cpu_count() or 1, metavar="P", help="default: all cores"
    )
    parser.add_argument("--sweep", action="store_true", help="how the results depend on the parameters")
    return parser.parse_args(arguments)


def _pairs(planners: Sequence[str]) -> tuple[Pair, ...]:
    known = [name for pair in PAIRS for name in pair.planners]
    for name in planners:
        if name not in known:
            raise UnknownNameError("planner", name, known, "--planners")
    pairs = chosen_pairs(planners)
    if not pairs:
        raise InputError("none of these planners is in this version", "--planners")
    return pairs


if __name__ == "__main__":
    main()
