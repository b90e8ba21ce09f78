"""Plots that compare planners: danger profiles, bands, times, and clearance against danger."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError
from safe_ompl.view.plots.page import ALONG, DANGER, GREY, Page, by_planner, natural
from safe_ompl.view.style import PlannerStyle, grid_columns, planner_styles

_BAND = (15.0, 85.0)  # percentiles, as in the paper
_MOST_IN_AXES = 5  # planners whose legend finds room among their curves or points
_LOG_SPREAD = 30.0  # largest over smallest value from which an axis is logarithmic


def plot_profiles(
    profiles: Mapping[str, ArrayLike], file: str | Path, *, title: str = "Mean danger along the path"
) -> Any:
    """Draw the mean danger profile of each planner in one axes (after Figs. 7 and 11 of the paper).

    Profiles are arrays (R, S): danger at S equal steps of the path, one row for each of R runs; no rows if none was
    solved. Raises InputError if there is no planner, an array has the wrong shape, or a value is not finite.
    """
    data = by_planner(profiles, "profiles", 2)
    with Page(file, _box_width(data), 4.4) as page:
        axes = page.figure.add_subplot()
        for name, style in planner_styles(data).items():
            runs = data[name]
            line = runs.mean(axis=0) if len(runs) else np.empty(0)
            axes.plot(natural(len(line)), line, label=name if len(runs) else f"{name} (no runs)", **_line(style))
        axes.set(xlabel=ALONG, ylabel=DANGER, xlim=(0.0, 1.0))
        axes.set_ylim(bottom=0.0)
        axes.set_title(title)
        _add_planner_legend(axes, data, handlelength=3.2)
    return page.figure


def plot_bands(profiles: Mapping[str, ArrayLike], file: str | Path) -> Any:
    """Draw mean, median and 15–85 % band of the profiles, one panel per planner (after Figs. 8 and 12).

    Parameters and errors are those of `plot_profiles`.
    """
    data = by_planner(profiles, "profiles", 2)
    columns = grid_columns(len(data))
    lines = -(-len(data) // columns)
    with Page(file, 0.6 + 3.3 * columns, 1.0 + 2.6 * lines) as page:
        grid = page.figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(data) :]:
            axes.remove()
        for axes in grid.flat[max(0, len(data) - columns) : len(data)]:
            axes.tick_params(labelbottom=True)
        for axes, (name, style) in zip(grid.flat, planner_styles(data).items(), strict=False):
            axes.set_title(name, weight="normal")
            _draw_band(axes, data[name], style)
        grid[0, 0].set_xlim(0.0, 1.0)
        grid[0, 0].set_ylim(bottom=0.0)
        page.figure.supxlabel(ALONG, fontsize=11)
        page.figure.supylabel(DANGER, fontsize=11)
        page.set_title("Danger along the path, all runs")
        _add_band_legend(page.figure)
    return page.figure


def plot_times(times: Mapping[str, ArrayLike], file: str | Path) -> Any:
    """Draw a box plot of the times (R,) [s] per planner, with mean (dot) and outliers (after Figs. 9 and 13).

    Boxes span the quartiles, whiskers 1.5 times that; the axis is logarithmic if the values spread widely. Raises
    InputError as `plot_profiles`, and if a value is negative.
    """
    data = by_planner(times, "times", 1)
    values = np.concatenate(list(data.values()))
    if (values < 0.0).any():
        raise InputError(f"times must not be negative, got {values.min():g}")
    with Page(file, 7.0, 1.3 + 0.55 * len(data)) as page:
        axes = page.figure.add_subplot()
        for row, (name, style) in enumerate(planner_styles(data).items()):
            _draw_box(axes, data[name], row, style)
        axes.set_yticks(range(len(data)), list(data))
        axes.set_ylim(len(data) - 0.4, -0.6)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("time [s]")
        axes.set_title("Planning time")
        _set_scale(axes, values)
    return page.figure


def plot_clearance_danger(
    clearances: Mapping[str, ArrayLike], dangers: Mapping[str, ArrayLike], file: str | Path
) -> Any:
    """Draw the mean dangers (R,) of the runs over their least clearances (R,) [m]: the safest are at the lower right.

    Raises InputError as `plot_profiles`, and if names or numbers of runs differ.
    """
    across, up = by_planner(clearances, "clearances", 1), by_planner(dangers, "dangers", 1)
    for name in {**across, **up}:
        counts = [len(table[name]) if name in table else None for table in (across, up)]
        if counts[0] != counts[1]:
            raise InputError(f"{name} has {counts[0]} clearances but {counts[1]} dangers; give one pair per run")
    with Page(file, _box_width(across), 4.6) as page:
        axes = page.figure.add_subplot()
        for name, style in planner_styles(across).items():
            axes.scatter(
                1e3 * across[name],
                up[name],
                label=name if len(up[name]) else f"{name} (no runs)",
                s=30,
                color=style.colour,
                marker="o" if style.strong else "X",
                alpha=0.75,
                edgecolor="white",
                linewidth=0.5,
            )
        axes.set(xlabel="least clearance [mm]", ylabel="mean danger")
        axes.set_xlim(left=0.0)
        axes.set_ylim(bottom=0.0)
        axes.set_title("Each run: danger and clearance")
        _add_planner_legend(axes, across, scatteryoffsets=[0.5])
    return page.figure


def _box_width(planners: Sized) -> float:
    """Return how wide [inch] a picture of planners in one axes is; the legend of many stands beside them."""
    return 9.0 if len(planners) > _MOST_IN_AXES else 7.0


def _add_planner_legend(axes: Any, planners: Sized, **options: Any) -> None:
    if len(planners) > _MOST_IN_AXES:
        axes.figure.legend(loc="outside right upper", **options)
    else:
        axes.legend(**options)


def _line(style: PlannerStyle) -> dict[str, Any]:
    return {
        "color": style.colour,
        "linewidth": 2.6 if style.strong else 1.9,
        "linestyle": (0, style.dashes) if style.dashes else "-",
        "zorder": 3 if style.strong else 2,
    }


def _draw_band(axes: Any, runs: FloatArray, style: PlannerStyle) -> None:
    if not len(runs):
        axes.text(0.5, 0.5, "no runs", transform=axes.transAxes, ha="center", color=GREY)
        return
    at = natural(runs.shape[1])
    low, high = np.percentile(runs, _BAND, axis=0)
    axes.fill_between(at, low, high, color=style.colour, alpha=0.22, linewidth=0)
    axes.plot(at, np.median(runs, axis=0), color=style.colour, linewidth=1.4, linestyle=(0, (4.0, 1.5)))
    axes.plot(at, runs.mean(axis=0), color=style.colour, linewidth=2.4)


def _add_band_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=GREY, linewidth=2.4, label="mean"),
        Line2D([], [], color=GREY, linewidth=1.4, linestyle=(0, (4.0, 1.5)), label="median"),
        Patch(color=GREY, alpha=0.22, linewidth=0, label="15–85 %"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3)


def _draw_box(axes: Any, values: FloatArray, row: int, style: PlannerStyle) -> None:
    if not len(values):
        place = {"transform": axes.get_yaxis_transform(), "ha": "center", "va": "center"}
        axes.text(0.5, row, "no runs", **place, color=GREY)
        return
    pale = tuple(0.72 + 0.28 * level for level in style.colour)
    axes.boxplot(
        values,
        positions=[row],
        orientation="horizontal",
        widths=0.55,
        patch_artist=True,
        showmeans=True,
        manage_ticks=False,
        boxprops={"facecolor": pale, "edgecolor": style.colour, "linewidth": 1.4},
        medianprops={"color": style.colour, "linewidth": 2.0},
        whiskerprops={"color": style.colour, "linewidth": 1.4},
        capprops={"color": style.colour, "linewidth": 1.4},
        meanprops={"marker": "o", "markerfacecolor": "black", "markeredgecolor": "white", "markersize": 6.5},
        flierprops={"marker": ".", "markerfacecolor": style.colour, "markeredgecolor": "none", "alpha": 0.5},
    )


def _set_scale(axes: Any, values: FloatArray) -> None:
    """Make the axis logarithmic if the values spread widely."""
    if len(values) and values.min() > 0.0 and values.max() > _LOG_SPREAD * values.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    else:
        axes.set_xlim(left=0.0)
