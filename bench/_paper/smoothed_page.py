"""Page and figure of safety after smoothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from _paper.smoothed import MEAN, QUANTITIES, Smoothed, answer
from _paper.smoothing import Smoothing
from _paper.studies import Pair
from _paper.tables import markdown_table
from safe_ompl.apps.benchmark.campaign import BAND
from safe_ompl.view.plots.page import GREY, Page
from safe_ompl.view.style import PlannerStyle, planner_styles

FIGURE = "smoothing.png"
_CAPTION = "Mean danger of paths as planned and smoothed: mean over the runs and 15–85 %"
_LABELS = {
    Smoothing.PLANNED: "as\nplanned",
    Smoothing.SHORTENED: "OMPL's\nsimplifier",
    Smoothing.SIMPLIFIED: "danger-\naware",
}
_FOOT = 0.06  # share of the height at which ratios are written
_APART = 0.09  # half the distance between the marks of a safe and a classical planner
_EXPLANATION = """The same runs as above, or the first of them: as planned → simplified, until nothing more is to gain
(`simplify=True` of `SafeSetup.plan`). In the lines "OMPL's simplifier" the paths of the classical planner were smoothed
as is usual. Numbers are means over the solved runs; time is that of planning and smoothing together."""


def smoothing_section(studies: Sequence[Smoothed]) -> str:
    """Return the section of the report: answer, figure, and a table for each study."""
    parts = ["## Does safe planning still win after smoothing?"]
    for as_printed, words in ((True, "Planners as printed"), (False, "Ours")):
        parts += [f"### {words}", answer([study.of_form(as_printed=as_printed) for study in studies])]
    parts += [f"![{_CAPTION}]({FIGURE})\n\n*{_CAPTION}.*", _EXPLANATION]
    for study in studies:
        parts += [f"Study {study.study.number}:", smoothing_table(study)]
    return "\n\n".join(parts)


def smoothing_table(study: Smoothed) -> str:
    """Return a study's table: every quantity of every planner, and their ratios, before and after."""
    header = ("", "solved", *(quantity.heading for quantity in QUANTITIES))
    return markdown_table(header, [row for pair in study.pairs for row in _rows(study, pair)])


def _rows(study: Smoothed, pair: Pair) -> Iterator[tuple[str, ...]]:
    yield _planner_row(study, pair.classic, pair.classic, Smoothing.PLANNED, Smoothing.SIMPLIFIED)
    yield _planner_row(study, "– with OMPL's simplifier", pair.classic, Smoothing.SHORTENED)
    yield _planner_row(study, pair.safe, pair.safe, Smoothing.PLANNED, Smoothing.SIMPLIFIED)
    ratios = (
        _changes([study.ratio(quantity, pair, kind) for kind in (Smoothing.PLANNED, Smoothing.SIMPLIFIED)], 2)
        for quantity in QUANTITIES
    )
    yield f"**{pair.title}, safe / classic**", "", *ratios


def _planner_row(study: Smoothed, label: str, planner: str, *kinds: Smoothing) -> tuple[str, ...]:
    summaries = [study.summary(planner, kind) for kind in kinds]
    solved = [f"{summary.solved}/{summary.runs}" for summary in summaries]
    cells = (_changes([study.mean(q, planner, kind) for kind in kinds], q.digits) for q in QUANTITIES)
    return label, " → ".join(dict.fromkeys(solved)), *cells


def _changes(values: Sequence[float], digits: int) -> str:
    return " → ".join("–" if isnan(value) else f"{value:.{digits}f}" for value in values)


# ----------------------------------------------------------------------------------------------- the figure


def plot_smoothing(studies: Sequence[Smoothed], file: Path) -> Any:
    """Draw the mean danger of safe and classical paths as planned and smoothed: studies below each other, pairs beside.

    Parameters
    ----------
    studies : sequence of Smoothed
        Of which to draw the pairs.
    file : path
        Where the picture goes.
    """
    labels = list(dict.fromkeys(pair.title for study in studies for pair in study.pairs))
    with Page(file, 1.0 + 2.35 * len(labels), 0.9 + 2.6 * len(studies)) as page:
        grid = page.figure.subplots(len(studies), len(labels), sharex=True, sharey=True, squeeze=False)
        for row, study in zip(grid, studies, strict=True):
            row[0].set_ylabel(f"study {study.study.number}: mean danger")
            for pair in study.pairs:
                _draw_pair(row[labels.index(pair.title)], study, pair)
        for axes, label in zip(grid[0], labels, strict=True):
            axes.set_title(label)
        grid[0, 0].set_xticks(range(len(_LABELS)), list(_LABELS.values()))
        grid[0, 0].set_ylim(bottom=0.0)
        grid[0, 0].set_xlim(-0.5, len(_LABELS) - 0.5)
        page.figure.legend(handles=_legend(), loc="outside lower center", ncols=4)
    return page.figure


def _draw_pair(axes: Any, study: Smoothed, pair: Pair) -> None:
    styles = planner_styles(pair.planners)
    for planner, side in zip(pair.planners, (_APART, -_APART), strict=True):
        _draw_planner(axes, study, planner, styles[planner], side)
    for at, kind in enumerate(_LABELS):
        if kind is not Smoothing.SHORTENED:
            ratio = f"× {study.ratio(MEAN, pair, kind):.2f}"
            axes.text(at, _FOOT, ratio, ha="center", transform=axes.get_xaxis_transform())


def _draw_planner(axes: Any, study: Smoothed, planner: str, style: PlannerStyle, side: float) -> None:
    """Draw band and mean of whatever was done with the paths, and lines from the mean as planned to the others."""
    values = {kind: study.values(MEAN, planner, kind) for kind in _LABELS}
    begin = values[Smoothing.PLANNED].mean()
    for at, (kind, own) in enumerate(values.items()):
        if len(own):
            band = np.percentile(own, BAND)
            axes.vlines(at + side, *band, color=style.colour, linewidth=6, alpha=0.35)
            line = ("o" if style.strong else "s") + (":" if kind is Smoothing.SHORTENED else "-")
            axes.plot([side, at + side], [begin, own.mean()], line, color=style.colour, linewidth=1.8)


def _legend() -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Line2D([], [], color="0.25", marker="o", label="safe"),
        Line2D([], [], color="0.65", marker="s", label="classical"),
        Patch(color=GREY, alpha=0.35, linewidth=0, label="15–85 % of the runs"),
        Line2D([], [], color="black", linestyle="", marker=r"$\times$", label="safe / classical"),
    ]
