"""Commands `compare` (benchmark planners on one scenario) and `mbm` (solve the problems of a MotionBenchMaker file)."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from rich.table import Table
from rich.text import Text

from safe_ompl.apps.benchmark import (
    BASELINE,
    SAFEST_OF_ROUTES,
    Campaign,
    Run,
    Summary,
    as_planned,
    default_planners,
    failure,
    planner_of,
    result_of_crash,
    run_planner,
    summarize,
)
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.plan import record
from safe_ompl.common import InputError, in_order
from safe_ompl.drawing import plots, render_comparison
from safe_ompl.io import strict_json as json_line
from safe_ompl.planning import PlanResult, SafeSetup, setup_problem, setup_scenario
from safe_ompl.planning.planners import make_planner
from safe_ompl.planning.simplification import SPREAD_PERCENTILES
from safe_ompl.robot import EXAMPLES, Robot, RobotSpec
from safe_ompl.scene import MBM_FILES_ORIGIN, MbmFile, Scene

_RUNS = 10


def add_commands(commands: Any) -> None:
    """Add `compare` and `mbm` to the commands."""
    parser = arguments.add_parser(
        commands,
        "compare",
        prepare,
        "compare planners: table, report.json and pictures",
        "Run the baseline (OMPL's RRTConnect and OMPL's simplifier) and several planners with several seeds "
        "each, and compare their paths, as planned and simplified: a table, report.json, and pictures of danger and of "
        "the robot along each planner's typical path.",
    )
    arguments.add_scenario(parser)
    option(
        parser,
        "--planners A,B,...",
        "planners to compare with the baseline (default: all planners of safe-ompl)",
        arguments.names,
    )
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
    """Validate the options of `compare` and return a function that runs the command."""
    scenario = arguments.load_scenario(options.scenario, options.package_dir, goal=True)
    planners = options.planners or default_planners(scenario)[1:]
    # The baseline is the first row. Without simplification the baseline is only its planner, OMPL's RRTConnect, and the
    # planner that searches several routes is left out, because it always simplifies. If the user names the baseline
    # twice, the list stays as it is, and Campaign refuses the duplicate.
    first = BASELINE if options.simplify else planner_of(BASELINE)
    left_out = {SAFEST_OF_ROUTES} if first != BASELINE else set()
    if list(planners).count(first) < 2:
        planners = (first, *(name for name in planners if name not in {first, *left_out}))
    campaign = Campaign(scenario, planners, options.runs, options.time, options.seed, options.simplify)
    setup = setup_scenario(scenario)
    campaign.check(setup)
    folder = options.out or Path(f"compare-{scenario.name}")
    output.make_folder(folder, ("report.json",), force=options.force)
    return partial(_compare, campaign, setup, options.workers or 1, folder)


def _compare(campaign: Campaign, setup: SafeSetup, workers: int, folder: Path) -> int:
    """Run all planners with all seeds, then print the table, write report.json and draw the pictures."""
    name, robot = campaign.scenario.name, setup.robot
    with output.progress_bar(output.error_console()) as progress:
        new_results = campaign.results(setup, workers)
        results: list[PlanResult] = []
        tracked = progress.track(new_results, total=len(campaign), description=f"planning {name}")
        status = output.each_until_ctrl_c(tracked, results.append)
    summaries = summarize(results)
    planned = summarize([as_planned(setup, result) for result in results])
    groups = {"as planned": planned, "simplified": summaries} if campaign.simplify else {"as planned": planned}
    # `first_two` holds the baseline and the safest planner. They are drawn first, since the first two panels of a
    # picture with many panels are the largest. The list is empty if the user pressed Ctrl-C before the first run ended.
    first_two = [summaries[0], safest(summaries)] if summaries else []
    words = in_words(first_two[0], first_two[-1], list(groups)[-1]) if first_two else ""
    report = {
        "scenario": name,
        "robot": robot.name,
        "seed": campaign.seed,
        "summary": [
            {**summary.as_dict(), "as_planned": before.as_dict()}
            for summary, before in zip(summaries, planned, strict=True)
        ],
        "safest": first_two[-1].planner if first_two else None,
        "words": words,
        "runs": [record(name, robot, result) for result in results],
    }
    output.write_json(str(folder / "report.json"), report)
    title = f"{name} · {robot.name} · {campaign.runs} runs each"
    output.console().print(summary_table("planner", groups, title, mark_best=True))
    output.console().print(words, highlight=False)
    console, advice = output.error_console(), output.missing_extra("plots")
    if advice:
        console.print(f"safe-ompl: no pictures: {advice}")
    else:
        shown = sorted(summaries, key=lambda summary: summary not in first_two)
        typical = {summary.planner: summary.typical for summary in shown if summary.typical}
        with console.status("drawing"):
            plots.plot_profiles({summary.planner: summary.profiles for summary in shown}, folder / "profiles.png")
            if typical:
                # The caption of the picture leaves out the last part of the text, which is the planning time.
                caption = words.rpartition(", ")[0] if all(summary.solved for summary in first_two) else words
                render_comparison(setup.robot, setup.scene, typical, folder / "paths.png", words=caption)
    console.print(f"report{'' if advice else ' and pictures'} in {folder}")
    console.print(f"see them move: safe-ompl view {campaign.scenario.file or name}")
    return status or int(not all(summary.solved for summary in summaries))


_BEST = "*"
# A relative difference below this counts as no difference, even if the runs hardly spread.
_VISIBLE = 0.01


class _Column(NamedTuple):
    """A column of the comparison table: its two heading lines, and the metric whose median is shown."""

    # The upper heading line. Adjacent columns with the same title share this line.
    title: str
    # The lower heading line: a unit, or which statistic of the path is shown ("mean", "peak").
    subtitle: str
    # A key of `Summary.metrics`.
    metric: str
    scale: float = 1.0
    more_is_better: bool = False

    def value(self, summary: Summary) -> float:
        """Return the median of the metric over the solved runs, in the unit of the column."""
        return self.scale * summary.percentile(self.metric)

    def beats(self, one: Summary, other: Summary) -> bool:
        """Return whether the median of `one` is better than the median of `other` by more than the larger spread."""
        spread = max(one.spread(self.metric), other.spread(self.metric))
        return self._ahead(one, other) > max(self.scale * spread, _VISIBLE * self.value(one))

    def is_best(self, summary: Summary, summaries: Sequence[Summary]) -> bool:
        """Return whether a summary is marked as best.

        It must beat at least one other summary, and its median must lie within the spread of the best summary.
        """
        best = max(summaries, key=lambda other: self._ahead(other, summary) if other.solved else -math.inf)
        near = self._ahead(best, summary) <= max(self.scale * best.spread(self.metric), _VISIBLE * self.value(best))
        return near and any(self.beats(summary, other) for other in summaries)

    def _ahead(self, one: Summary, other: Summary) -> float:
        return (self.value(one) - self.value(other)) * (1 if self.more_is_better else -1)

    def cells(self, summaries: Sequence[Summary], mark_best: bool) -> list[Text]:
        """Return one table cell per summary. Each cell ends in the mark for the best or in a space.

        All values get the same number of decimals: 0 if the largest is 100 or more, 1 if it is 10 or more, else 2.
        """
        values = [self.value(summary) for summary in summaries]
        largest = max((value for value in values if math.isfinite(value)), default=0.0)
        decimals = 0 if largest >= 100 else 1 if largest >= 10 else 2
        cells = []
        for summary, value in zip(summaries, values, strict=True):
            written = f"{value:.{decimals}f}" if math.isfinite(value) else "–"
            best = mark_best and self.is_best(summary, summaries)
            cells.append(Text(written + _BEST, "bold green") if best else Text(f"{written} "))
        return cells


_TIME = _Column("time", "ms", "total_time", 1e3)
_MEAN = _Column("danger", "mean", "danger_mean")
_PEAK = _Column("danger", "peak", "danger_max")
_CLEARANCE = _Column("clear.", "mm", "clearance_min", 1e3, more_is_better=True)
_LENGTH = _Column("path", "rad", "length")
_COLUMNS = (_TIME, _MEAN, _PEAK, _CLEARANCE, _LENGTH)


def safest(summaries: Sequence[Summary]) -> Summary:
    """Return the first planner's summary that no other of the candidates beats in both mean and peak danger.

    The candidates are the planners that found a path, without the baseline, which is `summaries[0]`. If there is no
    candidate, the last summary is returned.
    """
    candidates = [summary for summary in summaries[1:] if summary.solved] or summaries[-1:]

    def is_beaten(one: Summary) -> bool:
        return any(_MEAN.beats(other, one) and _PEAK.beats(other, one) for other in candidates)

    return next(candidate for candidate in candidates if not is_beaten(candidate))


def in_words(baseline: Summary, planner: Summary, kind: str) -> str:
    """Return a sentence that compares a planner with the baseline; `kind` is "as planned" or "simplified"."""
    for summary, name in ((baseline, "the baseline"), (planner, planner.planner)):
        if not summary.solved:
            return f"{name}: no path in {summary.runs} runs"

    def compared(column: _Column, difference: float, unit: str, quantity: str) -> str:
        if not round(difference):
            return f"the same {quantity}"
        clear = column.beats(planner, baseline) or column.beats(baseline, planner)
        note = "" if clear else " (within the spread over the seeds)"
        return f"{abs(difference):.0f} {unit} {'more' if difference > 0 else 'less'} {quantity}{note}"

    parts = []
    if peak := _PEAK.value(baseline):
        parts.append(compared(_PEAK, 100 * (_PEAK.value(planner) / peak - 1), "%", "peak danger"))
    clearance = _CLEARANCE.value(planner) - _CLEARANCE.value(baseline)
    if math.isfinite(clearance):
        parts.append(compared(_CLEARANCE, clearance, "mm", "clearance"))
    parts.append(compared(_TIME, _TIME.value(planner) - _TIME.value(baseline), "ms", "planning time"))
    return f"{planner.planner}, {kind}, compared with the baseline: {', '.join(parts)}"


def summary_table(
    name: str, groups: Mapping[str, Sequence[Summary]], title: str | None = None, mark_best: bool = False
) -> Table:
    """Return a table of medians over the solved runs, with one row per planner or family.

    `groups` maps the heading of each block of columns to its summaries. All blocks have the same rows. `name` is the
    heading of the first column.
    """
    table = output.plain_table(title=title, gap=1)
    table.caption = "Medians over the solved runs. time: to plan and to simplify. clear.: least clearance"
    if mark_best:
        table.caption += (
            f". {_BEST}: within the spread of the best row, and better than at least one row by more than the spread "
            f"(spread: {SPREAD_PERCENTILES[0]}th to {SPREAD_PERCENTILES[1]}th percentile over the seeds)"
        )
    rows = list(groups.values())[-1]
    if not any(summary.percentile("danger_max") for summary in rows):
        table.caption += ". Danger is 0, as no obstacle has a danger weight"
    table.add_column(name, overflow="fold", vertical="bottom")
    table.add_column("paths\nfound", justify="right", vertical="bottom", no_wrap=True)
    blocks = []
    for group, summaries in groups.items():
        # Only the last block shows the path length. A second length column would make the table wider than 80
        # characters.
        columns = _COLUMNS if summaries is rows else _COLUMNS[:-1]
        heading, *lines = _block(group, columns, summaries, mark_best)
        blocks.append(lines)
        table.add_column(heading, no_wrap=True, vertical="bottom")
    for summary, *cells in zip(rows, *blocks, strict=True):
        table.add_row(re.sub(r"(?<= \+|\w,) ", "\n", summary.planner), f"{summary.solved}/{summary.runs}", *cells)
    return table


def _block(group: str, columns: Sequence[_Column], summaries: Sequence[Summary], mark_best: bool) -> list[Text]:
    """Join the columns of a group into single texts: a heading with the name of the group, then a line per summary."""
    # Each heading ends in a space so that it is aligned with the digits and not with the mark.
    cells = [[Text(f"{column.subtitle} "), *column.cells(summaries, mark_best)] for column in columns]
    widths, titles = [max(map(len, of_column)) for of_column in cells], []
    for title, members in groupby(range(len(columns)), lambda k: columns[k].title):
        span = list(members)
        width = sum(widths[k] for k in span) + len(span) - 1
        widths[span[-1]] += max(0, len(title) - width)
        titles.append(title.center(max(width, len(title))))
    lines = [
        Text(" ").join(Text(" " * (width - len(cell))) + cell for width, cell in zip(widths, row, strict=True))
        for row in zip(*cells, strict=True)
    ]
    headings = [Text(words) for words in (group.center(len(lines[0])), " ".join(titles)) if words.strip()]
    return [Text("\n").join([*headings, lines[0]]), *lines[1:]]


USUAL_TIME = 5.0  # [s]
# The family of the problem, its index, the joint limits that were widened for it, and the result.
_Solved: TypeAlias = tuple[str, int, dict[str, Any], PlanResult]


def _add_mbm(commands: Any) -> None:
    parser = arguments.add_parser(
        commands,
        "mbm",
        prepare_mbm,
        "run a MotionBenchMaker file, one JSON line per problem",
        "Run the problems of a MotionBenchMaker file (JSON form), one JSON line per problem. "
        f"Every obstacle is dangerous, with weight 1; {MBM_FILES_ORIGIN}.",
    )
    option(parser, "file FILE", "the problems")
    arguments.add_planner_options(parser, usual_time=f"{USUAL_TIME:g}")
    output_name = output.output_file(".jsonl", ".json", output.STANDARD_OUTPUT)
    option(
        parser,
        "--json FILE",
        "write one JSON line per problem to this file; default: standard output",
        output_name,
        output.STANDARD_OUTPUT,
    )
    arguments.add_workers(parser, "problems")
    option(parser, "--robot ROBOT", "an example robot, or a scenario with the robot; default: the file's")


def prepare_mbm(options: argparse.Namespace) -> Callable[[], int]:
    """Validate the options of `mbm` and return a function that runs the command."""
    file = MbmFile.load(options.file)
    if not any(file.families.values()):
        raise InputError("holds no problem", options.file)
    robot = _robot(file, options)
    parameters = arguments.given_parameters(options)
    # Setup and planner are made only to check the planner's name and parameters.
    empty = SafeSetup(robot, Scene(), danger=None)
    make_planner(options.planner, empty.getSpaceInformation(), parameters)
    return partial(_solve_all, file, robot, parameters, options)


def _solve_all(file: MbmFile, robot: Robot, parameters: dict[str, Any], options: argparse.Namespace) -> int:
    """Solve the problems, write one JSON line per problem, and print a table with one row per family."""
    to_terminal = options.json == output.STANDARD_OUTPUT and sys.stdout.isatty()
    console = output.error_console()
    results: dict[str, list[PlanResult]] = {}
    run, time = Run(options.planner, options.seed), options.time or USUAL_TIME
    problems = [(family, k) for family, count in file.families.items() for k in range(count)]

    def solve(task: tuple[str, int]) -> _Solved:
        # If the problem cannot be read, its position k in the family stands for its index.
        family, k = task
        problem_index, widened = k, dict[str, Any]()
        try:
            problem = file.problem(family, k)
            problem_index, widened = problem.index, problem.widened_limits(robot)
            setup = setup_problem(problem, robot)
            result = run_planner(setup, run, time=time, parameters=parameters, simplify=options.simplify)
        except InputError as error:
            result = failure(f"Invalid input: {error}", *run, robot.joint_names)
        return family, problem_index, widened, result

    def result_of_crashed_process(task: tuple[str, int], words: str) -> _Solved:
        return *task, {}, result_of_crash(run, words, robot.joint_names)

    with output.opened(options.json) as stream, output.progress_bar(console, hidden=to_terminal) as progress:

        def write(solved: _Solved) -> None:
            family, problem_index, widened, result = solved
            content = record(f"{family}/{problem_index}", robot, result)
            line = {"family": family, "index": problem_index, **content, "widened_limits": widened}
            print(json_line(line), file=stream, flush=True)
            results.setdefault(family, []).append(result)

        solutions = in_order(solve, problems, options.workers or 1, result_of_crashed_process)
        tracked = progress.track(solutions, total=len(problems), description=file.path.name)
        status = output.each_until_ctrl_c(tracked, write)
    console.print(summary_table("family", {"": [Summary.of(*of_family) for of_family in results.items()]}))
    return status or int(not all(result for of_family in results.values() for result in of_family))


def _robot(file: MbmFile, options: argparse.Namespace) -> Robot:
    """Return the robot that --robot or the file names. Raise InputError unless it has the joints of the file."""
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
            f"but {robot.name} moves {', '.join(robot.joint_names)}; to lock joints, give a scenario with --robot",
            f"{file.path}: joints",
        )
    return robot
