"""Figures and page of the parameter sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from _paper.tables import markdown_table
from safe_ompl.view.plots.page import GREY, Page

_ROWS = (
    ("danger_ratio", "mean danger, safe/classic"),
    ("solved", "share solved"),
    ("time_ratio", "time, safe/classic"),
)
_COLOURS = ("#0b62b4", "#b87a00", "#00876a", "#7d2f91", "#c8452b", "#596675", "#3fa0c8", "#a0a832")
_PREAMBLE = """# What the safe planners' danger depends on

One parameter at a time; the others have their defaults. Danger is the mean along the path in the scenario's own field,
time the median, both relative to the classical counterpart. In the tables: means over the scenarios, and in brackets
the worst.
"""


@dataclass(frozen=True)
class Point:
    """The outcome of one parameter value on one scenario.

    Attributes
    ----------
    scenario, planner, parameter : str
        Names.
    value : Any
        Of the parameter.
    danger_ratio : float
        Mean danger, divided by that of the classical counterpart.
    solved : float
        Share of the runs.
    time_ratio : float
        Median time, divided by that of the classical counterpart.
    """

    scenario: str
    planner: str
    parameter: str
    value: Any
    danger_ratio: float
    solved: float
    time_ratio: float


def plot_dependence(points: Sequence[Point], labels: Mapping[str, str], file: Path) -> Any:
    """Draw how one planner depends on each parameter: a line for each scenario.

    Parameters
    ----------
    points : sequence of Point
        All of one planner.
    labels : mapping of str to str
        Parameter → what it is.
    file : path
        Where the picture goes.
    """
    parameters = list(dict.fromkeys(point.parameter for point in points))
    scenarios = list(dict.fromkeys(point.scenario for point in points))
    with Page(file, 0.8 + 2.5 * len(parameters), 7.6) as page:
        grid = page.figure.subplots(3, len(parameters), sharex="col", sharey="row", squeeze=False)
        for column, parameter in zip(grid.T, parameters, strict=True):
            for k, scenario in enumerate(scenarios):
                own = [p for p in points if (p.parameter, p.scenario) == (parameter, scenario)]
                for axes, (quantity, _) in zip(column, _ROWS, strict=True):
                    _draw_line(axes, own, quantity, _COLOURS[k % len(_COLOURS)], scenario)
            column[0].axhline(1.0, color=GREY, linewidth=1.0, linestyle=(0, (4.0, 3.0)))
            column[2].set_xlabel(labels[parameter])
        for axes, (_, label) in zip(grid[:, 0], _ROWS, strict=True):
            axes.set_ylabel(label)
        grid[0, 0].set_ylim(bottom=0.0)
        grid[1, 0].set_ylim(-0.03, 1.05)
        grid[2, 0].set_yscale("log")
        grid[2, 0].yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        page.figure.suptitle(points[0].planner, x=0.01, ha="left", fontsize=12, weight="bold")
        handles, names = grid[0, 0].get_legend_handles_labels()
        page.figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    return page.figure


def _draw_line(axes: Any, points: Sequence[Point], quantity: str, colour: str, label: str) -> None:
    values = [point.value if isinstance(point.value, str) else f"{point.value:g}" for point in points]
    heights = [getattr(point, quantity) for point in points]
    axes.plot(values, heights, "o-", color=colour, markersize=4, linewidth=1.6, label=label)


def write_page(page: Path, points: Sequence[Point], pictures: Mapping[str, Path]) -> None:
    """Write the page: for each planner its picture, and a table of the means over the scenarios."""
    parts = [_PREAMBLE]
    for planner, file in pictures.items():
        own = [point for point in points if point.planner == planner]
        choices = dict.fromkeys((point.parameter, point.value) for point in own)
        rows = [_row(choice, own) for choice in choices]
        parts += [
            f"## {planner}",
            f"![{planner}]({file.name})",
            markdown_table((planner, "danger", "solved", "time"), rows),
        ]
    page.write_text("\n\n".join(part.strip() for part in parts) + "\n", encoding="utf-8")


def _row(choice: tuple[str, Any], points: Sequence[Point]) -> tuple[str, ...]:
    same = [point for point in points if (point.parameter, point.value) == choice]
    danger, solved, time = (np.array([getattr(point, key) for point in same]) for key, _ in _ROWS)
    return (
        f"{choice[0]} = {choice[1]}",
        f"{np.nanmean(danger):.2f} ({np.nanmax(danger):.2f})",
        f"{solved.mean():.0%} ({solved.min():.0%})",
        f"{np.exp(np.nanmean(np.log(time))):.2f} ({np.nanmax(time):.2f})",
    )
