"""Plots that compare planners: danger profiles, and clearance against danger."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.view.plots.page import ALONG, DANGER, Page, natural
from safe_ompl.view.style import planner_styles

_MOST_IN_AXES = 5  # planners whose legend finds room among their curves or points


def plot_profiles(
    profiles: Mapping[str, FloatArray], file: str | Path, *, title: str = "Mean danger along the path"
) -> Any:
    """Draw the mean danger profile of each planner in one axes (after Figs. 7 and 11 of the paper).

    Profiles are arrays (R, S): danger at S equal steps of the path, one row for each of R runs; no rows if none was
    solved.
    """
    with Page(file, _width(len(profiles)), 4.4) as page:
        axes = page.figure.add_subplot()
        for name, style in planner_styles(profiles).items():
            runs = profiles[name]
            line = runs.mean(axis=0) if len(runs) else []
            axes.plot(
                natural(len(line)),
                line,
                label=_label(name, len(runs)),
                color=style.colour,
                linewidth=2.6 if style.strong else 1.9,
                linestyle=(0, style.dashes) if style.dashes else "-",
                zorder=3 if style.strong else 2,
            )
        axes.set(xlabel=ALONG, ylabel=DANGER, xlim=(0.0, 1.0))
        axes.set_ylim(bottom=0.0)
        axes.set_title(title)
        _add_legend(axes, len(profiles), handlelength=3.2)
    return page.figure


def plot_clearance_danger(
    clearances: Mapping[str, FloatArray], dangers: Mapping[str, FloatArray], file: str | Path
) -> Any:
    """Draw the mean dangers (R,) of the runs over their least clearances (R,) [m]: the safest are at lower right."""
    with Page(file, _width(len(clearances)), 4.6) as page:
        axes = page.figure.add_subplot()
        for name, style in planner_styles(clearances).items():
            axes.scatter(
                1e3 * clearances[name],
                dangers[name],
                label=_label(name, len(dangers[name])),
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
        _add_legend(axes, len(clearances), scatteryoffsets=[0.5])
    return page.figure


def _label(planner: str, runs: int) -> str:
    return planner if runs else f"{planner} (no runs)"


def _width(planners: int) -> float:
    """Return how wide [inch] a picture of planners in one axes is; the legend of many stands beside them."""
    return 9.0 if planners > _MOST_IN_AXES else 7.0


def _add_legend(axes: Any, planners: int, **options: Any) -> None:
    if planners > _MOST_IN_AXES:
        axes.figure.legend(loc="outside right upper", **options)
    else:
        axes.legend(**options)
