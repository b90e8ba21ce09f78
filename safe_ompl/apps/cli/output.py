"""Where the output of commands goes: consoles, log lines, tables, and files, checked before the work begins."""

from __future__ import annotations

import argparse
import io
import logging
import math
import os
import statistics
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from errno import EISDIR
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple

from ompl import util as ou
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from safe_ompl.apps.benchmark import Campaign, Summary
from safe_ompl.common import InputError, files
from safe_ompl.io import strict_json
from safe_ompl.paths import ClearanceReport, DangerReport
from safe_ompl.planning import PlanResult
from safe_ompl.view import PLOT_ENDINGS

STANDARD_OUTPUT = "-"
# Module, and what it is for.
EXTRAS = {
    "plots": ("matplotlib", "pictures"),
    "viewer": ("viser", "the viewer"),
    "mcap": ("mcap", "logs and recordings"),
    "ros": ("rclpy", "the node of ROS 2"),
}
_WIDTH = 120  # of tables that go to a file or pipe


def console() -> Console:
    """Return where tables go: standard output; what its encoding lacks becomes a question mark."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    return Console(highlight=False, width=_width(sys.stdout.isatty()))


def error_console() -> Console:
    """Return where progress and messages go: standard error. Messages are not wrapped."""
    return Console(
        stderr=True, highlight=False, markup=False, soft_wrap=True, width=_width(sys.stderr.isatty())
    )


def _width(is_terminal: bool) -> int | None:
    return None if is_terminal or "COLUMNS" in os.environ else _WIDTH


def progress_bar(console: Console, *, hidden: bool = False) -> Progress:
    """Return a progress bar that shows only on a terminal, and leaves nothing behind."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        redirect_stdout=False,
        disable=hidden or not console.is_terminal,
    )


# ---------------------------------------------------------------------------------------------------- logs


class LogLines(logging.Handler):
    """A log handler that shows one line for each record, above a progress bar if there is one.

    If it is to `hold` records back at first, `show` ends that: to bad input the answer is one line, not a list of
    warnings.
    """

    def __init__(self, console: Console, hold: bool) -> None:
        super().__init__()
        self._console = console
        self._held: list[str] | None = [] if hold else None

    def emit(self, record: logging.LogRecord) -> None:
        """Show or hold a record."""
        line = f"safe-ompl: {record.levelname.lower()}: {' '.join(record.getMessage().split())}"
        if self._held is None:
            self._console.print(line)
        else:
            self._held.append(line)

    def show(self) -> None:
        """Show what was held back, and from now on everything at once."""
        held, self._held = self._held, None
        for line in held or ():
            self._console.print(line)


@contextmanager
def shown_log(console: Console, verbose: bool) -> Iterator[LogLines]:
    """Show the package's warnings, and what it is doing if `verbose`, while the block runs."""
    logger = logging.getLogger("safe_ompl")
    before, propagates = logger.level, logger.propagate
    handler = LogLines(console, hold=not verbose)
    logger.addHandler(handler)
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    logger.propagate = False
    try:
        yield handler
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
        logger.propagate = propagates


@contextmanager
def ompl_messages(verbose: bool) -> Iterator[None]:
    """Let OMPL report errors only, and what it is doing if `verbose`, while the block runs."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LogLevel.LOG_INFO if verbose else ou.LogLevel.LOG_ERROR)
    try:
        yield
    finally:
        ou.setLogLevel(level)


# -------------------------------------------------------------------------------------------------- files


class OutputFile(str):
    """A file that a command writes, as its option names it: `output_file` reads one, `check_outputs` checks all."""

    endings: tuple[str, ...]
    extra: str | None  # of the package, that writes it


def output_file(*endings: str, extra: str | None = None) -> Callable[[str], OutputFile]:
    """Return what reads an option that names an output; `STANDARD_OUTPUT` among the endings allows that, too."""

    def read(text: str) -> OutputFile:
        file = OutputFile(text)
        file.endings, file.extra = endings, extra
        return file

    return read


JSON_FILE = output_file(".json", STANDARD_OUTPUT)
PICTURE = output_file(*PLOT_ENDINGS, extra="plots")
PAGE = output_file(".html", extra="viewer")
LOG = output_file(".mcap", extra="mcap")


def check_outputs(options: argparse.Namespace) -> None:
    """Check all outputs that the options name, before the work begins; files are left as they are.

    An InputError names the option whose file has a wrong ending, cannot be written, is read by the same command, is
    written by another option, or exists already where there is no --force; or whose extra is not installed.
    """
    outputs = {key: value for key, value in vars(options).items() if isinstance(value, OutputFile)}
    others = [value for key, value in vars(options).items() if key not in outputs]
    listed = [item for value in others for item in (value if isinstance(value, (list, tuple)) else [value])]
    inputs = [item for item in listed if isinstance(item, (str, Path))]
    written: dict[Path, str] = {}
    for key, file in outputs.items():
        option, path = f"--{key.replace('_', '-')}", Path(file)
        if file == STANDARD_OUTPUT and STANDARD_OUTPUT in file.endings:
            continue
        is_pipe = path.exists() and not path.is_file() and not path.is_dir()
        if not is_pipe and path.suffix.lower() not in file.endings:
            endings = (ending for ending in file.endings if ending != STANDARD_OUTPUT)
            raise InputError(f"{str(file)!r} must end in {' or '.join(endings)}", option)
        if file.extra is not None:
            need_extra(file.extra, option)
        if not is_pipe:
            _check_place(path, option, inputs, force=options.force)
        place = path.resolve()
        if place in written:
            raise InputError(
                f"{str(file)!r} is written by {written[place]} already: give another file", option
            )
        written[place] = option


def _check_place(path: Path, option: str, inputs: Sequence[str | Path], *, force: bool) -> None:
    """Raise InputError if a file cannot be written, is an input, or would be lost."""
    file = str(path)
    if any(_same_file(given, path) for given in inputs):
        raise InputError(f"{file!r} is read by this command: give another file", option)
    try:
        if path.is_dir():
            raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
        with TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise InputError(f"cannot write {file!r} ({error.strerror})", option) from None
    if path.exists() and not force:
        raise InputError(f"{file!r} is there already: give another file, or --force", option)


def missing_extra(extra: str) -> str | None:
    """Return what to install for an extra of the package, or None if it is installed."""
    module, purpose = EXTRAS[extra]
    if find_spec(module) is not None:
        return None
    return f"{module} missing; get {purpose} with: pip install 'safe-ompl[{extra}]'"


def need_extra(extra: str, key: str | None = None) -> None:
    """Raise InputError, which says what to install, unless an extra of the package is installed."""
    advice = missing_extra(extra)
    if advice:
        raise InputError(advice, key)


def _same_file(given: str | Path, path: Path) -> bool:
    with suppress(OSError, ValueError):  # where `given` is no file at all
        return os.path.samefile(given, path)
    return False


def make_folder(folder: Path, option: str, names: Iterable[str], *, force: bool) -> None:
    """Create a folder, or raise InputError, naming `option`; also if it holds files of these names, without --force."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"cannot write into the folder {str(folder)!r} ({error.strerror})", option) from None
    for name in names:
        if (folder / name).exists() and not force:
            raise InputError(
                f"the folder {str(folder)!r} holds {name} already: give another folder, or --force", option
            )


@contextmanager
def opened(file: str) -> Iterator[IO[str]]:
    """Open a file to write lines to, of which those that are finished are kept; ``-`` is standard output."""
    if file == STANDARD_OUTPUT:
        yield sys.stdout
        sys.stdout.flush()
    else:
        with Path(file).open("w", encoding="utf-8") as stream:
            yield stream


def write_json(file: str, content: Any) -> None:
    """Write one line of strict JSON to a file, or to standard output for ``-``."""
    write_text(file, f"{strict_json(content)}\n")


def write_text(file: str, text: str) -> None:
    """Write text to a file, or to standard output for ``-``."""
    if file == STANDARD_OUTPUT:
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        files.write(file, text)


_BEST = "*"


def plain_table(*columns: str, title: str | None = None, gap: int = 2) -> Table:
    """Return a table with text columns and no frame, and `gap` spaces between columns."""
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, gap - 1, 0, 0),
    )
    for column in columns:
        table.add_column(column, overflow="fold")
    return table


# ---------------------------------------------------------------------------------------------- comparison


class _Column(NamedTuple):
    """One quantity of a comparison: its heading, which median it is, how that is written, which ones are good."""

    heading: str
    metric: str  # Of `Summary.metrics`; empty: how many runs are solved
    digits: int = 0
    scale: float = 1.0
    more_is_better: bool = False

    def value(self, summary: Summary) -> float:
        return self.scale * summary.median(self.metric) if self.metric else summary.solved / summary.runs

    def written(self, summary: Summary) -> str:
        if self.metric:
            return written_number(self.value(summary), self.digits)
        return f"{summary.solved}/{summary.runs}"

    def cells(self, summaries: Sequence[Summary]) -> list[Text]:
        """Return a cell for each planner; those that look as good as the best are marked."""
        written = [self.written(summary) for summary in summaries]
        values = [(-1 if self.more_is_better else 1) * self.value(summary) for summary in summaries]
        known = [k for k, value in enumerate(values) if not math.isnan(value)]
        best = written[min(known, key=values.__getitem__)] if len(set(written)) > 1 and known else None
        return [Text(text + _BEST, "bold green") if text == best else Text(f"{text} ") for text in written]


_SOLVED = _Column("solved", "", more_is_better=True)
_TIME_COLUMN = _Column("time\nms", "planning_time", 0, 1e3)
_SIMPLIFICATION = _Column("simpl.\nms", "simplification_time", 0, 1e3)
_PATH = (
    _Column("path\nrad", "length", 2),
    _Column("danger\nmean", "danger_mean", 2),
    _Column("danger\nmax", "danger_max", 2),
    _Column("avoid-\nable", "danger_avoidable", 2),
    _Column("clear.\nmin\nmm", "clearance_min", 1, 1e3, more_is_better=True),
    _Column("clear.\nmean\nmm", "clearance_mean", 0, 1e3, more_is_better=True),
    _Column("near\nrad", "length_below_50mm", 2),
)
_WORK = (_Column("checks", "queries"), _Column("field\nevals", "field_configurations"))


def _chosen_columns(summaries: Sequence[Summary], more: Sequence[_Column] = ()) -> list[_Column]:
    """Return the columns of a table; what simplification took is one of them if there was any."""
    simplified = any(summary.median("simplification_time") > 0 for summary in summaries)
    return [_SOLVED, _TIME_COLUMN, *([_SIMPLIFICATION] if simplified else []), *_PATH, *more]


def comparison_table(
    campaign: Campaign, robot: str, summaries: Sequence[Summary], planned: Sequence[Summary] = ()
) -> Table:
    """Return a table with one row per planner: medians over the solved runs, the best ones marked.

    If paths were simplified, a second row gives the values before, from the summaries `planned`.
    """
    title = f"{campaign.scenario.name} · {robot} · {campaign.runs} runs each"
    table = plain_table("planner", title=title, gap=1)
    table.caption = (
        f"Medians over the solved runs; {_BEST} best. near: length of path with less than 50 mm of "
        "clearance; checks: collision and margin queries"
        + ("; as planned: the path before it was simplified" if planned else "")
    )
    columns = _chosen_columns(summaries, _WORK)
    _add_columns(table, columns)
    rows = zip(*(column.cells(summaries) for column in columns), strict=True)
    before = {summary.planner: summary for summary in planned}
    for summary, cells in zip(summaries, rows, strict=True):
        table.add_row(summary.planner, *cells)
        if summary.planner in before:
            raw = before[summary.planner]
            values = [column.written(raw) + " " if column in _PATH else "" for column in columns]
            table.add_row("  as planned", *values, style="dim")
    return table


def _add_columns(table: Table, columns: Sequence[_Column]) -> None:
    for column in columns:
        # A space at the end of each line: headings stand above the digits, not above the mark.
        heading = column.heading.replace("\n", " \n") + " "
        table.add_column(heading, justify="right", vertical="bottom", no_wrap=True)


def durations_table(planners: Sequence[str], durations: Sequence[float | None]) -> Table:
    """Return a table of how long paths take: by planner median and best, and on how many the robot may not move."""
    table = plain_table("planner", "duration, s", "shortest, s", "may not move", gap=1)
    for planner in dict.fromkeys(planners):
        rows = zip(planners, durations, strict=True)
        found = [duration for name, duration in rows if name == planner and duration is not None]
        middle, least = statistics.median(found or [math.nan]), min(found, default=math.nan)
        still = f"{sum(map(math.isinf, found))} of {len(found)}"
        table.add_row(planner, written_number(middle, 2), written_number(least, 2), still)
    return table


# --------------------------------------------------------------------------------------------- one result


def plan_table(scenario: str, robot: str, result: PlanResult) -> Table:
    """Return a table of the facts that the JSON of a plan holds."""
    table = plain_table("", "", title=f"{scenario} · {robot} · {result.planner} · seed {result.seed}")
    table.show_header = False
    for key, fact in _facts(result):
        table.add_row(Text(key, "dim"), fact)
    return table


def _facts(result: PlanResult) -> Iterator[tuple[str, str]]:
    counts, report = result.counts, result.report
    yield "status", result.status
    yield "planning time", f"{1e3 * result.planning_time:.1f} ms"
    if result.simplification_time:
        yield "simplification", f"{1e3 * result.simplification_time:.1f} ms"
    if result.improvements:
        first, last = result.improvements[0], result.improvements[-1]
        yield (
            "optimisation",
            f"cost {first.cost:.2f} after {1e3 * first.time:.0f} ms, {last.cost:.2f} after {last.time:.2f} s, "
            f"{len(result.improvements)} improvements",
        )
    if result.path is not None and report is not None:
        proof = "every motion proven free" if report.certified else "not proven free"
        yield "path", f"{len(result.path)} way points, {report.length:.2f} rad; {proof}"
        if report.danger is not None:
            yield "danger", _danger_cell(report.danger)
        yield "clearance", _clearance_cell(report.clearance)
        if result.moving_obstacles is not None:
            yield "moving", _moving_cell(**result.moving_obstacles)
        if report.links_without_collision:
            yield "not known", f"no collision geometry: {', '.join(report.links_without_collision)}"
    yield (
        "work",
        f"{counts.nodes} nodes; {counts.collision_queries} collision, {counts.margin_queries} margin, "
        f"{counts.bound_queries} bound, {counts.distance_queries} distance queries; "
        f"field at {counts.field_configurations} configurations ({counts.field_points} points)",
    )


def _moving_cell(speeds: Mapping[str, float], time: float) -> str:
    told = ", ".join(f"{name} up to {speed:g} m/s" for name, speed in speeds.items())
    return f"free whatever they do for {time:g} s: {told}"


def _danger_cell(danger: DangerReport) -> str:
    peak = f"at least {danger.max:.3f}"
    if danger.max_bound is not None and math.isfinite(danger.max_bound):
        peak = f"between {danger.max:.3f} and {danger.max_bound:.3f}"
    sums = f"integral {danger.integral:.2f}, avoidable {danger.avoidable:.3f}"
    return f"mean {danger.mean:.3f}, peak {peak}, {sums}"


def _clearance_cell(clearance: ClearanceReport) -> str:
    if clearance.obstacle is None:
        return "no obstacle"
    return (
        f"min {1e3 * clearance.min:.1f} mm ({clearance.link} to {clearance.obstacle}, "
        f"at {100 * clearance.at:.0f} % of the path), mean {1e3 * clearance.mean:.1f} mm; "
        f"{clearance.length_below_50mm:.2f} rad nearer than 50 mm"
    )


# ------------------------------------------------------------------------------------------------ families


def families_table(results: Mapping[str, Sequence[PlanResult]]) -> Table:
    """Return a table with one row per family of problems: medians over the solved ones."""
    table = plain_table("family", gap=1)
    summaries = [Summary.of(family, of_family) for family, of_family in results.items()]
    columns = _chosen_columns(summaries)
    _add_columns(table, columns)
    for summary in summaries:
        table.add_row(summary.planner, *(column.written(summary) for column in columns))
    return table


def written_number(value: float, digits: int) -> str:
    """Return a number as text, or a dash if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"
