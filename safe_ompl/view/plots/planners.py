"""Plots that compare planners and paths: danger profiles, clearance against danger, length against danger."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError
from safe_ompl.planning import Tradeoff
from safe_ompl.view.plots.page import ALONG, DANGER, GREY, Page, natural
from safe_ompl.view.style import planner_styles, shades

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


def plot_tradeoff(front: Tradeoff, file: str | Path | None, *, title: str = "What safety costs") -> Any:
    """Draw mean danger over length of the paths of a front, and beside it the danger along each; not if it is empty."""
    reports = [result.report for result in front.results if result.report is not None]
    measured = [(report, report.danger) for report in reports if report.danger is not None]
    if not measured:
        raise InputError("there is no path to draw")
    lengths = np.array([report.length for report, _ in measured])
    means = np.array([danger.mean for _, danger in measured])
    colours = shades(len(measured))
    with Page(file, 10.0, 4.4) as page:
        left, right = page.figure.subplots(1, 2)
        left.step(lengths, means, where="post", color="0.75", linewidth=1.4, zorder=1)
        left.scatter(lengths, means, s=80, color=colours, edgecolor="white", linewidth=1.0, zorder=3)
        for weight, length, mean in zip(front.weights, lengths, means, strict=True):
            near = {"xytext": (7, 6), "textcoords": "offset points", "fontsize": 9, "color": GREY}
            left.annotate(f"{weight:g}", (length, mean), **near)
        left.set(xlabel="length [rad]", ylabel="mean danger")
        left.margins(0.10, 0.12)
        left.set_title("Each path, with its weight of danger", fontsize=11, weight="normal")
        for (report, danger), colour in zip(measured, colours, strict=True):
            along = report.length * natural(len(danger.profile))
            right.plot(along, danger.profile, color=colour, linewidth=2.0, marker="o", markevery=[-1], clip_on=False)
        right.set(xlabel="along the path, from its start [rad]", ylabel=DANGER, xlim=(0.0, 1.03 * lengths[-1]))
        right.set_ylim(bottom=0.0)
        right.set_title("Danger along each path", fontsize=11, weight="normal")
        page.set_title(title)
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
