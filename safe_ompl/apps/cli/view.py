"""Command `view`: show scenarios, results, trajectories or a certificate in the browser, as HTML or as animation."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from safe_ompl.apps.benchmark import BASELINE, SAFEST_OF_ROUTES, Run, planner_of, run_planner
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.common import InputError, files
from safe_ompl.drawing import (
    ANIMATION_ENDINGS,
    RECORDING_ENDING,
    BrowserView,
    ViewerContent,
    read_recording,
    save_animation,
    save_page,
)
from safe_ompl.io import MotionRecord, load, read_ticks, schema
from safe_ompl.planning import PlanResult, check_named_planner, setup_scenario
from safe_ompl.robot import PackageDir
from safe_ompl.scene import Scenario
from safe_ompl.tasks import PROGRAM_TIME, plan_program

_SHOWN_PLANNERS = (BASELINE, SAFEST_OF_ROUTES)
_NONE = ("none",)


def add_commands(commands: Any) -> None:
    """Add `view` to the commands."""
    parser = arguments.add_parser(
        commands,
        "view",
        prepare,
        "show a scenario, results, trajectories or a certificate in the browser",
        "Show robot, scene, people, paths, danger and proofs in the browser. A scenario is planned first; "
        "a certificate is shown, not verified.",
    )
    option(
        parser,
        "what SCENARIO|RESULT|CERTIFICATE|TRAJECTORY|TICKS",
        "name or YAML file of a scenario; or files of `plan --json`, or of `plan --trajectory`, side by side; "
        "or one of `plan --certificate`, or ticks.jsonl or a log (.mcap) of `live`",
        nargs="+",
    )
    option(
        parser,
        "--planners A,B,…",
        "planners for a scenario (default: the baseline, OMPL's RRTConnect and OMPL's simplifier, and "
        "the safest way of SafeRRTConnect, both simplified); none: show its start only",
        arguments.names,
    )
    arguments.add_run_options(parser, usual_time="the scenario's")
    option(parser, "--html FILE", "write one file that opens offline, with a play bar (.html)", output.PAGE)
    words = "write the motions side by side as one moving picture (.webp or .gif)"
    option(parser, "--animation FILE", words, output.output_file(*ANIMATION_ENDINGS, extra="plots"))
    option(parser, "--port N", "port; the next free one if it is taken", arguments.port, 8080)
    option(parser, "--no-browser", "print the address instead of opening the browser")


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Validate the options and return a function that runs the command."""
    if options.animation is None:
        output.need_extra("viewer")
    recordings = [name for name in options.what if Path(name).suffix.lower() in TICK_READERS]
    if recordings:
        if len(options.what) > 1:
            raise InputError(f"one recording at a time, not {', '.join(options.what)}")
        read = TICK_READERS[Path(recordings[0]).suffix.lower()]
        recorded = read_recording(recordings[0], package_dirs=options.package_dir, read=read)
        return lambda: _show(recorded, options)
    files = [name for name in options.what if Path(name).suffix.lower() == ".json"]
    if not files:
        if len(options.what) > 1:
            raise InputError(f"one scenario at a time, not {', '.join(options.what)}")
        scenario = arguments.load_scenario(options.what[0], options.package_dir)
        return lambda: _show(_planned(scenario, options), options)
    if len(files) < len(options.what):
        raise InputError(f"either a scenario or files of results, not both: {', '.join(options.what)}")
    content = _loaded(files, options.package_dir)
    return lambda: _show(content, options)


def _read_log(file: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return header and ticks of an MCAP log."""
    output.need_extra("mcap", str(file))
    from safe_ompl.live.ros import read_log  # needs the extra

    return read_log(file)


TICK_READERS = {RECORDING_ENDING: read_ticks, ".mcap": _read_log}


def _show(content: ViewerContent, options: argparse.Namespace) -> int:
    """Write the files that the options name. Without such an option, serve the view until Ctrl-C."""
    if options.animation is not None:
        with output.error_console().status("drawing"):
            save_animation(content, options.animation)
        output.error_console().print(f"moving picture in {options.animation}")
    if options.html is not None:
        save_page(content, options.html)
        output.error_console().print(f"view in {options.html}")
    if options.html is not None or options.animation is not None:
        return 0
    view = BrowserView(content, port=options.port)
    output.error_console().print(f"view at {view.url}; Ctrl-C ends it")
    try:
        view.run(browser=not options.no_browser)
    except KeyboardInterrupt:
        view.stop()
    return 0


def _planned(scenario: Scenario, options: argparse.Namespace) -> ViewerContent:
    if scenario.program is not None and options.planners != _NONE:
        found = plan_program(scenario, time=options.time or PROGRAM_TIME, seed=options.seed)
        if not found:
            output.error_console().print(f"safe-ompl: {found.why}")
        return ViewerContent.of_program(found)
    robot = scenario.build_robot()
    start = scenario.start_configuration(robot)
    # No setup is built here, so a start in collision can be shown, too.
    if options.planners == _NONE:
        return ViewerContent(robot, scenario.scene, posture=start, danger=scenario.danger, title=scenario.name)
    setup = setup_scenario(scenario, robot)
    results = []
    for planner in options.planners or _SHOWN_PLANNERS:
        check_named_planner(scenario, planner_of(planner), setup)
        chosen = arguments.run_options(options, scenario, planner_of(planner))
        if not options.planners:
            chosen["simplify"] = options.simplify or True
        if planner in _SHOWN_PLANNERS:
            del chosen["seed"]
            result = run_planner(setup, Run(planner, options.seed), **chosen)
        else:
            result = setup.plan(planner, **chosen)
        if not result:
            output.error_console().print(f"safe-ompl: {planner} found no path: {result.status}")
        results.append(result)
    return ViewerContent.of_results(results, title=scenario.name, posture=start)


def _loaded(given: Sequence[str], package_dirs: Sequence[PackageDir]) -> ViewerContent:
    with files.reading_json(given[0]) as content:
        form = content.get("format") if isinstance(content, dict) else None
        if form == schema.FORMAT:
            if len(given) > 1:
                raise InputError(f"one certificate at a time, not {', '.join(given)}")
            return ViewerContent.of_certificate(content, Path(given[0]).stem, package_dirs)
    loaded = [load(file, package_dirs=package_dirs) for file in given]
    title = Path(given[0]).stem
    motions = [thing for thing in loaded if isinstance(thing, MotionRecord)]
    if motions and len(motions) == len(given):
        return ViewerContent.of_motions(motions, title=title)
    if motions and all(isinstance(thing, MotionRecord | PlanResult) for thing in loaded):
        raise InputError(f"either results or trajectories, not both: {', '.join(given)}")
    for file, thing in zip(given, loaded, strict=True):
        if not isinstance(thing, MotionRecord | PlanResult):
            raise InputError(f"must be a result, a certificate or a trajectory, not a {type(thing).__name__}", file)
    return ViewerContent.of_results([thing for thing in loaded if isinstance(thing, PlanResult)], title=title)
