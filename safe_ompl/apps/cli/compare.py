"""`safe-ompl compare`: several planners on one scenario, in a table and in pictures."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from safe_ompl.apps.benchmark import Campaign, Summary, default_planners, summarize
from safe_ompl.apps.cli import arguments, output, tables
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.plan import record
from safe_ompl.planning import PlanResult, SafeSetup, path_timer, setup_scenario
from safe_ompl.trajectories import PathTimer, duration_of
from safe_ompl.view import drawn_path, plots, render_comparison

_RUNS = 10


def add_commands(commands: Any) -> None:
    """Add `compare` to the commands."""
    parser = arguments.add_parser(
        commands,
        "compare",
        prepare,
        "compare planners: table, report.json and pictures",
        "Run several planners with several seeds each, and compare them: a table, report.json, "
        "and pictures of danger, times, and the robot along each planner's typical path. Paths are simplified; "
        "the table, the report and the picture of the paths say what they were before.",
    )
    arguments.add_scenario(parser)
    option(parser, "--planners A,B,...", "default: OMPL's RRTConnect and all of ours", arguments.names)
    option(parser, "--runs N", "runs of each planner", arguments.count, _RUNS)
    arguments.add_run_options(parser, usual_time="the scenario's", simplify=True)
    parser.add_argument(
        "--no-simplify",
        dest="simplify",
        action="store_false",
        help="compare the paths as they are planned, without simplification",
    )
    option(parser, "--processes N", "runs at the same time; times are cleanest with one", arguments.count, 1)
    option(parser, "--out DIR", "folder for report and pictures (default: compare-SCENARIO)", Path)
    arguments.add_force(parser)
    option(parser, "--timed", "also compare durations, within the scenario's limits and beside its people")
    arguments.add_package_dirs(parser)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    scenario = arguments.load_scenario(options.scenario, options.package_dir)
    planners = options.planners or default_planners(scenario)
    campaign = Campaign(scenario, planners, options.runs, options.time, options.seed, options.simplify)
    setup = setup_scenario(scenario)
    campaign.check(setup)
    timer = path_timer(scenario, setup) if options.timed else None
    folder = options.out or Path(f"compare-{scenario.name}")
    output.make_folder(folder, "--out", ("report.json",), force=options.force)
    return partial(_compare, campaign, setup, options.processes, folder, timer)


def _compare(campaign: Campaign, setup: SafeSetup, processes: int, folder: Path, timer: PathTimer | None) -> int:
    """Run the campaign, show the table, write the report, draw the pictures."""
    name, robot = campaign.scenario.name, setup.robot
    with output.progress_bar(output.error_console()) as progress:
        runs = campaign.results(setup, processes)
        results: list[PlanResult] = []
        tracked = progress.track(runs, total=len(campaign), description=f"planning {name}")
        status = output.each_until_ctrl_c(tracked, results.append)
    summaries, planned = summarize(results), _as_planned(results, setup)
    report: dict[str, Any] = {
        "scenario": name,
        "robot": robot.name,
        "seed": campaign.seed,
        "summary": [summary.as_dict() for summary in summaries],
        "summary_as_planned": [summary.as_dict() for summary in planned],
        "runs": [record(name, robot, result) for result in results],
    }
    # +inf where nothing allows motion, None where there is no path
    durations = [
        None if timer is None or result.path is None else duration_of(timer, result.path)
        for result in (() if timer is None else results)
    ]
    for run, duration in zip(report["runs"], durations, strict=False):
        run["duration"] = duration if duration is not None and math.isfinite(duration) else None
    output.write_json(str(folder / "report.json"), report)
    output.console().print(tables.comparison_table(campaign, robot.name, summaries, planned))
    if timer is not None:
        output.console().print(tables.durations_table([result.planner for result in results], durations))
    console, advice = output.error_console(), output.missing_extra("plots")
    if advice:
        console.print(f"safe-ompl: no pictures: {advice}")
    else:
        with console.status("drawing"):
            draw_comparison(setup, summaries, folder)
    console.print(f"report{'' if advice else ' and pictures'} in {folder}")
    console.print(f"see them move: safe-ompl view {campaign.scenario.file or name}")
    return status or int(not all(summary.solved for summary in summaries))


def _as_planned(results: Sequence[PlanResult], setup: SafeSetup) -> list[Summary]:
    """Return the summaries of the paths before they were simplified; none if no path was."""
    found = []
    for result in results:
        path = result.planned_path
        if path is not None:
            result = replace(result, path=path, report=setup.report(path), simplification_time=0.0)
        found.append(result)
    return summarize(found) if any(result.planned_path is not None for result in results) else []


def draw_comparison(setup: SafeSetup, summaries: Sequence[Summary], folder: Path) -> None:
    """Draw what a campaign found: danger profiles and bands, times, and the robot along the typical paths."""
    profiles = {summary.planner: summary.profiles for summary in summaries}
    plots.plot_profiles(profiles, folder / "profiles.png")
    plots.plot_bands(profiles, folder / "bands.png")
    plots.plot_times({s.planner: s.metrics["planning_time"] for s in summaries}, folder / "times.png")
    plots.plot_clearance_danger(
        {s.planner: s.metrics["clearance_min"] for s in summaries},
        {s.planner: s.metrics["danger_mean"] for s in summaries},
        folder / "clearances.png",
    )
    # Without accents: planners beside each other choose their colours together.
    typical = {s.planner: replace(drawn_path(s.typical), accent=None) for s in summaries if s.typical}
    if typical:
        render_comparison(setup.robot, setup.scene, typical, folder / "paths.png")
