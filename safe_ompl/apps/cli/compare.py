"""`safe-ompl compare`: several planners on one scenario; `mbm`: a file of problems."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from rich.table import Table
from rich.text import Text

from safe_ompl.apps.benchmark import Campaign, Run, Summary, default_planners, failure, lost, run_planner, summarize
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.plan import record
from safe_ompl.common import InputError, in_order
from safe_ompl.drawing import plots, render_comparison
from safe_ompl.io import strict_json as json_line
from safe_ompl.planning import PlanResult, SafeSetup, setup_problem, setup_scenario
from safe_ompl.planning.planners import make_planner
from safe_ompl.robot import EXAMPLES, Robot, RobotSpec
from safe_ompl.scene import WHERE_FROM, MbmFile, Scene

_RUNS = 10


def add_commands(commands: Any) -> None:
    """Add `compare` and `mbm` to the commands."""
    parser = arguments.add_parser(
        commands,
        "compare",
        prepare,
        "compare planners: table, report.json and pictures",
        "Run several planners with several seeds each, and compare them: a table, report.json, "
        "and pictures of danger and of the robot along each planner's typical path. Paths are simplified.",
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
    arguments.add_workers(parser, "runs")
    option(parser, "--out DIR", "folder for report and pictures (default: compare-SCENARIO)", Path)
    _add_mbm(commands)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    scenario = arguments.load_scenario(options.scenario, options.package_dir, goal=True)
    planners = options.planners or default_planners(scenario)
    campaign = Campaign(scenario, planners, options.runs, options.time, options.seed, options.simplify)
    setup = setup_scenario(scenario)
    campaign.check(setup)
    folder = options.out or Path(f"compare-{scenario.name}")
    output.make_folder(folder, ("report.json",), force=options.force)
    return partial(_compare, campaign, setup, options.workers or 1, folder)


def _compare(campaign: Campaign, setup: SafeSetup, workers: int, folder: Path) -> int:
    """Run the campaign, show the table, write the report, draw the pictures."""
    name, robot = campaign.scenario.name, setup.robot
    with output.progress_bar(output.error_console()) as progress:
        runs = campaign.results(setup, workers)
        results: list[PlanResult] = []
        tracked = progress.track(runs, total=len(campaign), description=f"planning {name}")
        status = output.each_until_ctrl_c(tracked, results.append)
    summaries = summarize(results)
    report = {
        "scenario": name,
        "robot": robot.name,
        "seed": campaign.seed,
        "summary": [summary.as_dict() for summary in summaries],
        "runs": [record(name, robot, result) for result in results],
    }
    output.write_json(str(folder / "report.json"), report)
    title = f"{name} · {robot.name} · {campaign.runs} runs each"
    output.console().print(summary_table("planner", summaries, title, mark_best=True))
    console, advice = output.error_console(), output.missing_extra("plots")
    if advice:
        console.print(f"safe-ompl: no pictures: {advice}")
    else:
        typical = {summary.planner: summary.typical for summary in summaries if summary.typical}
        with console.status("drawing"):
            plots.plot_profiles({summary.planner: summary.profiles for summary in summaries}, folder / "profiles.png")
            if typical:
                render_comparison(setup.robot, setup.scene, typical, folder / "paths.png")
    console.print(f"report{'' if advice else ' and pictures'} in {folder}")
    console.print(f"see them move: safe-ompl view {campaign.scenario.file or name}")
    return status or int(not all(summary.solved for summary in summaries))


_BEST = "*"


class _Column(NamedTuple):
    """One quantity of a comparison: its heading, which median it is, how that is written, which ones are good."""

    heading: str
    metric: str  # Of `Summary.metrics`; empty: how many runs are solved
    digits: int = 0
    scale: float = 1.0
    more_is_better: bool = False

    def value(self, summary: Summary) -> float:
        return self.scale * summary.percentile(self.metric) if self.metric else summary.solved / summary.runs

    def cells(self, summaries: Sequence[Summary], mark_best: bool) -> list[Text]:
        """Return a cell for each summary; those that look as good as the best may be marked."""
        values = [self.value(summary) for summary in summaries]
        written = [f"{value:.{self.digits}f}" if math.isfinite(value) else "–" for value in values]
        if not self.metric:
            written = [f"{summary.solved}/{summary.runs}" for summary in summaries]
        best = None
        if mark_best and len(set(written)) > 1:
            choose = max if self.more_is_better else min
            best = written[values.index(choose(value for value in values if not math.isnan(value)))]
        return [Text(text + _BEST, "bold green") if text == best else Text(f"{text} ") for text in written]


_COLUMNS = (
    _Column("solved", "", more_is_better=True),
    _Column("time\nms", "planning_time", 0, 1e3),
    _Column("path\nrad", "length", 2),
    _Column("danger\nmean", "danger_mean", 2),
    _Column("danger\nmax", "danger_max", 2),
    _Column("avoid-\nable", "danger_avoidable", 2),
    _Column("clear.\nmm", "clearance_min", 1, 1e3, more_is_better=True),
    _Column("near\nrad", "length_below_50mm", 2),
)


def summary_table(name: str, summaries: Sequence[Summary], title: str | None = None, mark_best: bool = False) -> Table:
    """Return a table with one row per summary: medians over the solved runs. `name` heads the first column."""
    table = output.plain_table(title=title, gap=1)
    best = f"; {_BEST} best" if mark_best else ""
    table.caption = f"Medians over the solved runs{best}. near: length of path with less than 50 mm of clearance"
    if not any(summary.percentile("danger_max") for summary in summaries):
        table.caption += ". Danger is 0, as no obstacle has a danger weight"
    table.add_column(name, no_wrap=True)
    for column in _COLUMNS:
        # A space at the end of each line: headings stand above the digits, not above the mark.
        heading = column.heading.replace("\n", " \n") + " "
        table.add_column(heading, justify="right", vertical="bottom", no_wrap=True)
    rows = zip(*(column.cells(summaries, mark_best) for column in _COLUMNS), strict=True)
    for summary, cells in zip(summaries, rows, strict=True):
        table.add_row(summary.planner, *cells)
    return table


USUAL_TIME = 5.0  # [s]
_Solved: TypeAlias = tuple[str, int, dict[str, Any], PlanResult]  # family, index, limits that were widened, result


def _add_mbm(commands: Any) -> None:
    parser = arguments.add_parser(
        commands,
        "mbm",
        prepare_mbm,
        "run a MotionBenchMaker file, one JSON line per problem",
        "Run the problems of a MotionBenchMaker file (JSON form), one JSON line per problem. "
        f"Every obstacle is dangerous, with weight 1; {WHERE_FROM}.",
    )
    option(parser, "file FILE", "the problems")
    arguments.add_planner_options(parser, usual_time=f"{USUAL_TIME:g}")
    read = output.output_file(".jsonl", ".json", output.STANDARD_OUTPUT)
    option(parser, "--json FILE", "a line for each; default: standard output", read, output.STANDARD_OUTPUT)
    arguments.add_workers(parser, "problems")
    option(parser, "--robot ROBOT", "an example robot, or a scenario with the robot; default: the file's")


def prepare_mbm(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    file = MbmFile.load(options.file)
    if not any(file.families.values()):
        raise InputError("holds no problem", options.file)
    robot = _robot(file, options)
    parameters = arguments.given_parameters(options)
    empty = SafeSetup(robot, Scene(), danger=None)
    make_planner(options.planner, empty.getSpaceInformation(), parameters)
    return partial(_solve_all, file, robot, parameters, options)


def _solve_all(file: MbmFile, robot: Robot, parameters: dict[str, Any], options: argparse.Namespace) -> int:
    """Solve the problems, write a line for each, and show a table by family."""
    to_terminal = options.json == output.STANDARD_OUTPUT and sys.stdout.isatty()
    console = output.error_console()
    results: dict[str, list[PlanResult]] = {}
    run, time = Run(options.planner, options.seed), options.time or USUAL_TIME
    problems = [(family, k) for family, count in file.families.items() for k in range(count)]

    def solve(at: tuple[str, int]) -> _Solved:
        family, index, widened = *at, dict[str, Any]()
        try:
            problem = file.problem(*at)
            index, widened = problem.index, problem.widened_limits(robot)
            setup = setup_problem(problem, robot)
            result = run_planner(setup, run, time=time, parameters=parameters, simplify=options.simplify)
        except InputError as error:
            result = failure(f"Invalid input: {error}", *run, robot.joint_names)
        return family, index, widened, result

    def lost_problem(at: tuple[str, int], words: str) -> _Solved:
        return *at, {}, lost(run, words, robot.joint_names)

    with output.opened(options.json) as stream, output.progress_bar(console, hidden=to_terminal) as progress:

        def write(solved: _Solved) -> None:
            family, index, widened, result = solved
            told = record(f"{family}/{index}", robot, result)
            line = {"family": family, "index": index, **told, "widened_limits": widened}
            print(json_line(line), file=stream, flush=True)
            results.setdefault(family, []).append(result)

        solutions = in_order(solve, problems, options.workers or 1, lost_problem)
        tracked = progress.track(solutions, total=len(problems), description=file.path.name)
        status = output.each_until_ctrl_c(tracked, write)
    console.print(summary_table("family", [Summary.of(*of_family) for of_family in results.items()]))
    return status or int(not all(result for of_family in results.values() for result in of_family))


def _robot(file: MbmFile, options: argparse.Namespace) -> Robot:
    """Return the robot of the options or of the file; its joints must be those of the file."""
    name = options.robot or file.robot
    if name in EXAMPLES:
        robot = Robot(RobotSpec(name))
    elif options.robot is not None:
        robot = arguments.load_scenario(name, options.package_dir).build_robot()
    else:
        raise InputError(f"{name!r} is not an example robot: give --robot", f"{file.path}: robot")
    if file.joint_names and set(file.joint_names) != set(robot.joint_names):
        raise InputError(
            f"the problems are for the joints {', '.join(file.joint_names)}, "
            f"but {robot.name} moves {', '.join(robot.joint_names)}; a scenario's robot says what is locked",
            f"{file.path}: joints",
        )
    return robot
