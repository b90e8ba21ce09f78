"""The case studies of the paper: python bench/paper.py [--runs N] --out DIR [--planners A,B] [--processes P].

Runs every planner and its classical counterpart, both as printed and in our own form, N times on both scenarios
(bubble planners, which are deterministic, once), and writes DIR/report.md: Tables I and II beside the paper's,
figures after Figs. 1, 3, 4 and 6–13, and each of the paper's claims with a verdict. A third study takes 30 scenes
drawn at random, none left out. Results are kept in DIR/study_N/runs.jsonl as they come; started again, the bench does
only what is missing, so after a change of the planners give another folder. DIR/study_N/benchmark.log and
DIR/benchmark.db are the same runs for OMPL's tools and Planner Arena.

With --simplify the report also says whether safe planning still wins after smoothing: the runs are done again with
danger-aware simplification (DIR/study_N_simplified) and, as is usual, with OMPL's simplifier (DIR/study_N_shortened,
classical planners only). With --sweep the bench shows instead how danger, success and time depend on the planners'
parameters.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from _paper.effort import Hardness
from _paper.evidence import Evidence
from _paper.figures import draw_ideas, draw_study
from _paper.logs import write_log
from _paper.random_scenes import SCENES, RandomStudy, random_scenarios, scene_campaigns
from _paper.report import write_report
from _paper.runs import TIME, campaigns, do_runs, open_store, study_folder, study_scenario
from _paper.smoothed import Smoothed
from _paper.smoothed_page import FIGURE, plot_smoothing
from _paper.smoothing import Smoothing
from _paper.studies import PAIRS, STUDIES, Pair, chosen_pairs
from _paper.sweep import sweep
from ompl import util as ou

from safe_ompl.apps.benchmark.log import save_database
from safe_ompl.apps.cli.arguments import count, names
from safe_ompl.apps.cli.output import error_console, progress_bar
from safe_ompl.common.errors import InputError, UnknownNameError
from safe_ompl.planning.result import PlanResult

RUNS, SIMPLIFIED_RUNS, SWEEP_RUNS, HARDNESS_RUNS = 1000, 200, 20, 20
RANDOM_RUNS = 5  # of each planner on each random scene, at most


def main(arguments: Sequence[str] | None = None) -> None:
    """Do what the command line asks for."""
    options = _options(arguments)
    ou.setLogLevel(ou.LogLevel.LOG_WARN)
    pairs = _pairs(options.planners)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.sweep:
        ours = [pair for pair in pairs if not pair.as_printed]
        page = sweep(options.out, ours, options.runs or SWEEP_RUNS, options.processes)
    else:
        simplified = (options.runs or SIMPLIFIED_RUNS) if options.simplify else 0
        page = study(options.out, pairs, options.runs or RUNS, options.processes, simplified)
    error_console().print(f"report in {page}")


def study(folder: Path, pairs: Sequence[Pair], runs: int, processes: int, simplified: int = 0) -> Path:
    """Do both studies as far as they are not done, and write the report; return its file.

    Parameters
    ----------
    folder : path
        Where results and report go.
    pairs : sequence of Pair
        The planners.
    runs : int
        Of each planner.
    processes : int
        How many runs go on at the same time.
    simplified : int
        Runs of each planner whose paths are smoothed as well.
    """
    planned = _results(folder, pairs, runs, processes)
    evidence = [Evidence.of(one, pairs, own) for one, own in zip(STUDIES, planned, strict=True)]
    smoothed = _smoothed(folder, pairs, simplified, processes, planned) if simplified else []
    at_random = _random_study(folder / "study_3", pairs, min(runs, RANDOM_RUNS), processes)
    scenarios = [study_scenario(one) for one in STUDIES]
    _write_logs(folder, evidence)
    with error_console().status("drawing"):
        for found, scenario in zip(evidence, scenarios, strict=True):
            draw_study(found, scenario, study_folder(folder, found.study))
        if smoothed:
            plot_smoothing(smoothed, folder / FIGURE)
        ideas = draw_ideas(folder)
    hardness = [Hardness.of(scenario, HARDNESS_RUNS) for scenario in scenarios]
    write_report(folder / "report.md", evidence, scenarios, hardness, smoothed, at_random, ideas)
    return folder / "report.md"


def _results(
    folder: Path, pairs: Sequence[Pair], runs: int, processes: int, smoothing: Smoothing = Smoothing.PLANNED
) -> list[list[PlanResult]]:
    """Do the runs of both studies as far as they are not done; return all of each study."""
    stores = [open_store(folder, one, smoothing) for one in STUDIES]
    with progress_bar(error_console()) as progress:
        for one, store in zip(STUDIES, stores, strict=True):
            todo = campaigns(study_scenario(one), pairs, runs, store, smoothing)
            task = progress.add_task(f"study {one.number}, {smoothing.value}", total=sum(map(len, todo)))
            do_runs(store, todo, processes, lambda task=task: progress.advance(task))
    return [store.results() for store in stores]


def _random_study(folder: Path, pairs: Sequence[Pair], runs: int, processes: int) -> RandomStudy:
    """Do the runs on the random scenes as far as they are not done."""
    every = list(scene_campaigns(folder, pairs, runs, random_scenarios(SCENES)))
    with progress_bar(error_console()) as progress:
        task = progress.add_task("study 3", total=sum(len(one) for _, todo in every for one in todo))
        for store, todo in every:
            do_runs(store, todo, processes, lambda: progress.advance(task))
    return RandomStudy.of([store for store, _ in every], pairs)


def _smoothed(
    folder: Path, pairs: Sequence[Pair], runs: int, processes: int, planned: Sequence[Sequence[PlanResult]]
) -> list[Smoothed]:
    """Smooth the paths of so many runs of each planner, and compare them with what they were."""
    results = {Smoothing.PLANNED: planned}
    for kind in (Smoothing.SHORTENED, Smoothing.SIMPLIFIED):
        results[kind] = _results(folder, pairs, runs, processes, kind)
    return [
        Smoothed.of(one, pairs, {kind: own[k] for kind, own in results.items()})
        for k, one in enumerate(STUDIES)
    ]


def _write_logs(folder: Path, evidence: Sequence[Evidence]) -> None:
    """Write the runs of each study as an OMPL benchmark log, and both to one database."""
    logs = []
    for found in evidence:
        logs.append(study_folder(folder, found.study) / "benchmark.log")
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
        help=f"of each planner (default: {RUNS}, the first {SIMPLIFIED_RUNS} of them smoothed; "
        f"with --sweep {SWEEP_RUNS})",
    )
    parser.add_argument(
        "--planners", type=names, default=(), metavar="A,B,...", help="these and their counterparts"
    )
    parser.add_argument(
        "--processes", type=count, default=os.cpu_count() or 1, metavar="P", help="default: all cores"
    )
    more = parser.add_mutually_exclusive_group()
    more.add_argument("--simplify", action="store_true", help="also with simplified paths")
    more.add_argument("--sweep", action="store_true", help="how the results depend on the parameters")
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
