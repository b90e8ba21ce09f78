"""The danger and the clearance along one path."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.paths.measures import forced_danger
from safe_ompl.pictures.plots.data import curve
from safe_ompl.pictures.plots.page import ALARM, ALONG, DANGER, DPI, GREY, Page, natural
from safe_ompl.pictures.style import Colour, planner_styles

_LINE = 0.08  # of the height of the axes: what a line of words needs
_CLEARANCES = ("0.25", "0.62")


def plot_plan(
    danger: ArrayLike,
    file: str | Path | None,
    *,
    clearance: ArrayLike | Mapping[str, ArrayLike] | None = None,
    near: float = 0.05,
    improvements: ArrayLike | None = None,
    planner: str = "",
    title: str | None = None,
    dpi: int = DPI,
) -> Any:
    """Draw the danger along one path, and the clearance below it.

    The levels of start and goal are marked; the avoidable danger is shaded (`safe_ompl.paths.measures.DangerReport`).

    Parameters
    ----------
    danger : (S,) array
        Danger at equal steps of the path.
    clearance : (S',) array, or mapping of str to (S',) array, optional
        Clearance at equal steps of the path [m]; or several, by what they are to, the most important one first.
    near : float
        Clearance under which the path is too near [m]; shaded.
    improvements : (K, 2) array, optional
        Of an optimisation: times [s] at which better paths were found, and their costs.
    planner : str
        Who planned it; decides the colour.
    title : str, optional
        Above the axes; the name of the planner by default.
    dpi : int
        Pixels per inch.
    file
        As of all pictures, see `safe_ompl.pictures.plots`; None: only the canvas of the figure is drawn.

    Raises
    ------
    InputError
        If an array is empty, has the wrong shape, or holds a value that is not finite.
    """
    values = curve(danger, "danger")
    gaps = None if clearance is None else _checked_clearances(clearance)
    steps = None if improvements is None else _checked_improvements(improvements)
    rows = 1 + (gaps is not None) + (steps is not None)
    with Page(file, 7.0, 1.2 + 2.5 * rows, dpi) as page:
        upper = page.figure.add_subplot(rows, 1, 1)
        _draw_danger(upper, values, planner_styles([planner])[planner].colour)
        upper.set_title(planner if title is None else title)
        lowest = upper
        if gaps is not None:
            lowest = page.figure.add_subplot(rows, 1, 2)
            _draw_clearance(lowest, gaps, 1e3 * near)
        lowest.set_xlabel(ALONG)
        if steps is not None:
            _draw_improvements(page.figure.add_subplot(rows, 1, rows), steps)
    return page.figure


def _checked_clearances(clearance: ArrayLike | Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    """Return clearances [mm] by what they are to."""
    given = clearance if isinstance(clearance, Mapping) else {"": clearance}
    if not given:
        raise InputError("clearance must have one curve at least, got none")
    return {to: 1e3 * curve(values, "clearance") for to, values in given.items()}


def _checked_improvements(improvements: ArrayLike) -> FloatArray:
    steps = finite_array(improvements, (None, 2), "improvements")
    if not (len(steps) and (steps[:, 0] > 0).all()):
        raise InputError(f"improvements must be at times > 0, at least one, got {steps.tolist()}")
    return steps


def _draw_improvements(axes: Any, steps: FloatArray) -> None:
    """Draw the cost of the best path against time, as a staircase."""
    times, costs = steps.T
    end = max(1.3 * float(times[-1]), 1.0)
    axes.step([*times, end], [*costs, costs[-1]], where="post", color="0.25", linewidth=2.4)
    axes.set(xscale="log", xlabel="time [s]", ylabel="cost of the best path", xlim=(0.8 * times[0], end))
    axes.set_ylim(0.0, 1.12 * float(costs.max()))
    note = f"{costs[-1]:.1f} after {times[-1]:.2g} s"
    axes.set_title(note, loc="right", color="0.25", fontsize=11, weight="normal")


def _draw_danger(axes: Any, values: FloatArray, colour: Colour) -> None:
    at, forced = natural(len(values)), forced_danger(values)
    axes.fill_between(
        at, forced, values, where=values > forced, interpolate=True, color=ALARM, alpha=0.25, lw=0
    )
    axes.plot(at, values, color=colour, linewidth=2.4)
    top = 1.12 * float(values.max()) or 1.0
    start, goal = float(values[0]), float(values[-1])
    shift = 0.5 * max(0.0, _LINE - abs(goal - start) / top) * top * (1 if goal >= start else -1)
    for value, name, place in ((start, "start", start - shift), (goal, "goal", goal + shift)):
        axes.axhline(value, color=GREY, linewidth=1.0, linestyle=(0, (4.0, 3.0)))
        axes.text(
            1.01, place, name, ha="left", va="center", color=GREY
        )  # beside the axes, never over a curve
    axes.set(ylabel=DANGER, xlim=(0.0, 1.0))
    axes.set_ylim(0.0, top)


def _draw_clearance(axes: Any, gaps: Mapping[str, FloatArray], near: float) -> None:
    axes.axhspan(0.0, near, color=ALARM, alpha=0.12, linewidth=0)
    for k, (to, values) in enumerate(gaps.items()):
        at, colour = natural(len(values)), _CLEARANCES[k % len(_CLEARANCES)]
        axes.plot(at, values, color=colour, linewidth=2.4 if k == 0 else 1.6, label=f"to {to}")
    closest = min(gaps, key=lambda to: float(gaps[to].min()))
    values = gaps[closest]
    least = int(np.argmin(values))
    axes.plot(natural(len(values))[least], values[least], "o", color=ALARM, markersize=7, clip_on=False)
    note = f"closest: {values[least]:.0f} mm" + (f" to {closest}" if closest else "")
    axes.set_title(note, loc="right", color=ALARM, fontsize=11, weight="normal")
    if len(gaps) > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=len(gaps), borderaxespad=0.0)
    axes.set(ylabel="clearance [mm]", xlim=(0.0, 1.0))
    axes.set_ylim(0.0, 1.12 * max(near, *(float(values.max()) for values in gaps.values())))
