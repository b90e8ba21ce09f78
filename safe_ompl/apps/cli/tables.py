"""Tables of the command line."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from rich import box
from rich.table import Table
from rich.text import Text

from safe_ompl.apps.benchmark import Campaign, Summary
from safe_ompl.paths import ClearanceReport, DangerReport
from safe_ompl.planning import PlanResult

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


@dataclass(frozen=True)
class _Column:
    """One quantity of a comparison: its heading, its value and how that is written, which ones are good."""

    heading: str
    value: Callable[[Summary], float]
    written: Callable[[Summary], str]
    more_is_better: bool = False

    def cells(self, summaries: Sequence[Summary]) -> list[Text]:
        """Return a cell for each planner; those that look as good as the best are marked."""
        written = [self.written(summary) for summary in summaries]
        values = [(-1 if self.more_is_better else 1) * self.value(summary) for summary in summaries]
        known = [k for k, value in enumerate(values) if not math.isnan(value)]
        best = written[min(known, key=values.__getitem__)] if len(set(written)) > 1 and known else None
        return [Text(text + _BEST, "bold green") if text == best else Text(f"{text} ") for text in written]


def _median(
    heading: str, metric: str, digits: int, scale: float = 1.0, more_is_better: bool = False
) -> _Column:
    def value(summary: Summary) -> float:
        return scale * summary.median(metric)

    return _Column(heading, value, lambda summary: written_number(value(summary), digits), more_is_better)


_SOLVED = _Column(
    "solved", lambda s: s.solved / s.runs, lambda s: f"{s.solved}/{s.runs}", more_is_better=True
)
_TIME_COLUMN = _median("time\nms", "planning_time", 0, 1e3)
_SIMPLIFICATION = _median("simpl.\nms", "simplification_time", 0, 1e3)
_PATH = (
    _median("path\nrad", "length", 2),
    _median("danger\nmean", "danger_mean", 2),
    _median("danger\nmax", "danger_max", 2),
    _median("avoid-\nable", "danger_avoidable", 2),
    _median("clear.\nmin\nmm", "clearance_min", 1, 1e3, more_is_better=True),
    _median("clear.\nmean\nmm", "clearance_mean", 0, 1e3, more_is_better=True),
    _median("near\nrad", "length_below_50mm", 2),
)
_WORK = (_median("checks", "queries", 0), _median("field\nevals", "field_configurations", 0))


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
        middle = statistics.median(found) if found else math.nan
        table.add_row(
            planner,
            written_number(middle, 2),
            written_number(min(found, default=math.nan), 2),
            f"{sum(map(math.isinf, found))} of {len(found)}",
        )
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
    return (
        f"mean {danger.mean:.3f}, {_peak(danger)}, integral {danger.integral:.2f}, "
        f"avoidable {danger.avoidable:.3f}"
    )


def _peak(danger: DangerReport) -> str:
    if danger.max_bound is None or not math.isfinite(danger.max_bound):
        return f"peak at least {danger.max:.3f}"
    return f"peak between {danger.max:.3f} and {danger.max_bound:.3f}"


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
