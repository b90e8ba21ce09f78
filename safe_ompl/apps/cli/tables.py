"""Tables of what was planned: planners beside each other, one result, families of problems; of what is proven."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from rich.console import Console, ConsoleOptions
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from safe_ompl.apps.benchmark import Campaign, Summary
from safe_ompl.apps.cli.output import plain_table
from safe_ompl.common import FloatArray
from safe_ompl.motions import MotionCheck
from safe_ompl.paths import ClearanceReport, DangerReport
from safe_ompl.planning import PlanResult
from safe_ompl.robot import Robot

_BEST = "*"
_ENDLESS = 10_000  # more than any table is wide


class _Column(NamedTuple):
    """One quantity of a comparison: its heading, which median it is, how that is written, which ones are good."""

    heading: str
    metric: str  # Of `Summary.metrics`; empty: how many runs are solved
    digits: int = 0
    scale: float = 1.0
    more_is_better: bool = False

    def value(self, summary: Summary) -> float:
        return self.scale * summary.percentile(self.metric) if self.metric else summary.solved / summary.runs

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
    simplified = any(summary.percentile("simplification_time") > 0 for summary in summaries)
    return [_SOLVED, _TIME_COLUMN, *([_SIMPLIFICATION] if simplified else []), *_PATH, *more]


@dataclass(frozen=True)
class FittingTable:
    """A table that leaves out the last of its columns where they do not fit; the names, which come first, stay."""

    columns: Sequence[_Column]
    of: Callable[[Sequence[_Column]], Table]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Table]:
        endless, left_out = options.update_width(_ENDLESS), list[str]()
        for count in range(len(self.columns), 0, -1):
            table = self.of(self.columns[:count])
            if count == 1 or Measurement.get(console, endless, table).maximum <= options.max_width:
                break
            left_out.insert(0, self.columns[count - 1].heading.replace("-\n", "").replace("\n", " "))
        if left_out:
            table.caption = f"{table.caption or ''}; not shown, as the terminal is narrow: {', '.join(left_out)}"
        yield table


def comparison_table(
    campaign: Campaign, robot: str, summaries: Sequence[Summary], planned: Sequence[Summary] = ()
) -> FittingTable:
    """Return a table with one row per planner: medians over the solved runs, the best ones marked.

    If paths were simplified, a second row gives the values before, from the summaries `planned`.
    """
    title = f"{campaign.scenario.name} · {robot} · {campaign.runs} runs each"
    caption = (
        f"Medians over the solved runs; {_BEST} best. near: length of path with less than 50 mm of "
        "clearance; checks: collision and margin queries"
        + ("; as planned: the path before it was simplified" if planned else "")
    )
    before = {summary.planner: summary for summary in planned}

    def of(columns: Sequence[_Column]) -> Table:
        table = _table_of_columns("planner", columns, title, caption)
        rows = zip(*(column.cells(summaries) for column in columns), strict=True)
        for summary, cells in zip(summaries, rows, strict=True):
            table.add_row(summary.planner, *cells)
            if summary.planner in before:
                raw = before[summary.planner]
                values = [column.written(raw) + " " if column in _PATH else "" for column in columns]
                table.add_row("  as planned", *values, style="dim")
        return table

    return FittingTable(_chosen_columns(summaries, _WORK), of)


def _table_of_columns(
    name: str, columns: Sequence[_Column], title: str | None = None, caption: str | None = None
) -> Table:
    """Return a table without rows: a column of names, which are never cut, and those given."""
    table = plain_table(title=title, gap=1)
    table.caption = caption
    table.add_column(name, no_wrap=True)
    for column in columns:
        # A space at the end of each line: headings stand above the digits, not above the mark.
        heading = column.heading.replace("\n", " \n") + " "
        table.add_column(heading, justify="right", vertical="bottom", no_wrap=True)
    return table


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


def families_table(results: Mapping[str, Sequence[PlanResult]]) -> FittingTable:
    """Return a table with one row per family of problems: medians over the solved ones."""
    summaries = [Summary.of(family, of_family) for family, of_family in results.items()]

    def of(columns: Sequence[_Column]) -> Table:
        table = _table_of_columns("family", columns)
        for summary in summaries:
            table.add_row(summary.planner, *(column.written(summary) for column in columns))
        return table

    return FittingTable(_chosen_columns(summaries), of)


def written_number(value: float, digits: int) -> str:
    """Return a number as text, or a dash if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "–"


def check_table(title: str, found: MotionCheck, widest: FloatArray | None, without: str) -> Table:
    """Return what is proven, or a row for each stretch that is not; `without` says why people are not looked at."""
    robot = found.proof.checker.robot
    tube = np.array(found.separation.tube or np.zeros(robot.n))
    facts = [("motion", repr(found.motion)), ("tube", _widths(tube, robot))]
    beside = " (people aside)" * (found.people is not None)
    facts += [] if widest is None else [(f"widest tube{beside}", _widths(widest, robot))]
    facts += [("people", without)] * bool(without)
    if found:
        facts.insert(0, ("proven", ", ".join(found.claims)))
        table = plain_table("", "", title=title)
        table.show_header = False
        for key, fact in facts:
            table.add_row(Text(key, "dim"), Text(fact))
        return table
    unit = "\ns" if found.motion.timed else "\nway point"
    table = plain_table("not proven", f"from–to{unit}", f"worst{unit}", "what", "value", "limit", title=title)
    for k in (1, 2):
        table.columns[k].no_wrap = True
    for violation in found.violations:
        kind = violation.kind if violation.decided else f"{violation.kind}, undecided"
        table.add_row(
            Text(kind),
            f"{violation.first:.3f}–{violation.last:.3f}" if violation.last > violation.first else "",
            f"{violation.at:.3f}",
            Text(" – ".join(violation.names)),
            *violation.quantities,
        )
    table.caption = Text("\n".join(f"{key}: {fact}" for key, fact in facts))
    return table


def _widths(widths: FloatArray, robot: Robot) -> str:
    if not widths.any():
        return "none"
    if np.ptp(widths) < 1e-12 and not robot.prismatic.any():
        return f"±{widths[0]:.3g} rad"
    units = np.where(robot.prismatic, "m", "rad")
    each = zip(robot.joint_names, widths.tolist(), units, strict=True)
    return ", ".join(f"{name} ±{width:.3g} {unit}" for name, width, unit in each)
