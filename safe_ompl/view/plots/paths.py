"""One path: its danger and clearance, its speed in time and what bounds it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, finite_array
from safe_ompl.io import ACCELERATION
from safe_ompl.paths import forced_danger
from safe_ompl.trajectories import MotionDanger, Trajectory
from safe_ompl.view.plots.page import (
    ALARM,
    ALONG,
    DANGER,
    DPI,
    GREY,
    Page,
    add_legend_above,
    curve,
    draw_limit,
    natural,
)
from safe_ompl.view.style import Colour, cap_colours, planner_styles

_LINE = 0.08  # of the height of the axes: what a line of words needs
_NEAR = 50.0  # [mm]; the clearance under which a path is too near, shaded
_CLEARANCES = ("0.25", "0.62")


def plot_plan(
    danger: ArrayLike,
    file: str | Path | None,
    *,
    clearance: ArrayLike | Mapping[str, ArrayLike] | None = None,
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
    improvements : (K, 2) array, optional
        Of an optimisation: times [s] at which better paths were found, and their costs.
    planner : str
        Who planned it; decides the colour.
    title : str, optional
        Above the axes; the name of the planner by default.
    file
        None: only the canvas of the figure is drawn.

    Raises
    ------
    InputError
        If an array is empty, has the wrong shape, or holds a value that is not finite.
    """
    values = curve(danger, "danger")
    gaps = None if clearance is None else _checked_clearances(clearance)
    steps = None if improvements is None else _checked_improvements(improvements)
    rows = 1 + (gaps is not None) + (steps is not None)
    height = 1.2 + 2.5 * rows
    with Page(file, 7.0, height, dpi, arranged=False) as page:  # half the time of an arranged figure
        apart = 0.25 if steps is None else 0.4
        top, bottom = 1 - 0.35 / height, 0.55 / height
        page.figure.subplots_adjust(left=0.1, right=0.925, top=top, bottom=bottom, hspace=apart)
        upper = page.figure.add_subplot(rows, 1, 1)
        _draw_danger(upper, values, planner_styles([planner])[planner].colour)
        upper.set_title(planner if title is None else title)
        lowest = upper
        if gaps is not None:
            lowest = page.figure.add_subplot(rows, 1, 2)
            _draw_clearance(lowest, gaps)
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
    for names in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
        names(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
    note = f"{costs[-1]:.1f} after {times[-1]:.2g} s"
    axes.set_title(note, loc="right", color="0.25", fontsize=11, weight="normal")


def _draw_danger(axes: Any, values: FloatArray, colour: Colour) -> None:
    at, forced = natural(len(values)), forced_danger(values)
    shade = {"color": ALARM, "alpha": 0.25, "lw": 0}
    axes.fill_between(at, forced, values, where=values > forced, interpolate=True, **shade)
    axes.plot(at, values, color=colour, linewidth=2.4)
    top = 1.12 * float(values.max()) or 1.0
    start, goal = float(values[0]), float(values[-1])
    shift = 0.5 * max(0.0, _LINE - abs(goal - start) / top) * top * (1 if goal >= start else -1)
    for value, name, place in ((start, "start", start - shift), (goal, "goal", goal + shift)):
        axes.axhline(value, color=GREY, linewidth=1.0, linestyle=(0, (4.0, 3.0)))
        # beside the axes, never over a curve
        axes.text(1.01, place, name, ha="left", va="center", color=GREY)
    axes.set(ylabel=DANGER, xlim=(0.0, 1.0))
    axes.set_ylim(0.0, top)


def _draw_clearance(axes: Any, gaps: Mapping[str, FloatArray]) -> None:
    axes.axhspan(0.0, _NEAR, color=ALARM, alpha=0.12, linewidth=0)
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
    axes.set_ylim(0.0, 1.12 * max(_NEAR, *(float(values.max()) for values in gaps.values())))


_SAMPLES = 1500
_JOINTS = ("#0b62b4", "#b87a00", "#00876a", "#7d2f91", "#c8452b", "#596675", "#6aa84f", "#3aa0c9")


def plot_motion(
    trajectory: Trajectory,
    file: str | Path,
    *,
    danger: MotionDanger | None = None,
    title: str | None = None,
) -> Any:
    """Draw a trajectory.

    Above its speed along the path, in the colour of the cap that binds, and the caps themselves; below the velocities
    and accelerations of its joints, and the jerks if they are limited, as shares of their limits, and the danger where
    it is given; all of them against time.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    danger : MotionDanger, optional
        From `Trajectory.danger`.
    title : str, optional
        Above the axes; by default how long it takes.
    """
    jerk = trajectory.limits.jerk
    rows = 3 + (jerk is not None) + (danger is not None)
    with Page(file, 7.5, 0.6 + 2.2 * rows + 0.8) as page:
        upper, *lower = page.figure.subplots(rows, 1, height_ratios=[1.5] + [1.0] * (rows - 1))
        page.set_title(f"{trajectory.duration:.2f} s" if title is None else title)
        times = np.linspace(0.0, trajectory.duration, _SAMPLES)
        cells, _, speeds, _ = trajectory.law.at(times)
        bounds = {cap.name: cap.speeds[cells] for cap in trajectory.caps}
        binding = trajectory.binding()
        _draw_speeds(upper, times, speeds, bounds, [binding[cell] for cell in cells])
        add_legend_above(upper)
        state, limits = trajectory.at(times), trajectory.limits
        draw_joints(lower[0], times, state.qd / limits.velocity, "velocity / limit")
        draw_joints(lower[1], times, state.qdd / limits.acceleration, "acceleration / limit")
        if jerk is not None:
            draw_joints(lower[2], times, trajectory.jerks_at(times) / jerk, "jerk / limit")
        name_joints(page.figure, lower[0], trajectory.joint_names)
        if danger is not None:
            _draw_danger_in_motion(lower[-1], danger)
        lower[-1].set_xlabel("time [s]")
    return page.figure


def _draw_speeds(
    axes: Any,
    times: FloatArray,
    speeds: FloatArray,
    bounds: Mapping[str, FloatArray],
    binding: Sequence[str | None],
) -> int:
    """Draw ṡ (T,) in the colour of what binds, thinly the caps (T,) near it; return how many things bind."""
    names = list(dict.fromkeys([*bounds, *filter(None, binding), ACCELERATION]))
    colours, top = cap_colours(names), 1.25 * float(speeds.max()) or 1.0
    for name, values in bounds.items():
        axes.plot(times, np.where(values <= 2 * top, values, np.nan), color=colours[name], linewidth=1.2)
    bound_by = np.array([name or ACCELERATION for name in binding])
    used = [name for name in names if (bound_by == name).any()]
    for name in used:
        axes.plot(times, _joined(speeds, bound_by == name), color=colours[name], linewidth=3.4, label=name)
    axes.set(ylabel="speed [rad/s]", xlim=span(times[-1]), ylim=(0.0, top))
    return len(used)


def span(end: float, begin: float = 0.0) -> tuple[float, float]:
    """Return the limits of an axis from `begin` to `end`, wide enough for lines that run along its ends."""
    return begin - 0.004 * (end - begin), end + 0.004 * (end - begin)


def draw_joints(axes: Any, times: FloatArray, shares: FloatArray, name: str) -> None:
    """Draw values (T, n) of the joints as shares of their limits, which are marked."""
    for side in (-1.0, 1.0):
        draw_limit(axes, side)
    for k, values in enumerate(shares.T):
        axes.plot(times, values, color=_JOINTS[k % len(_JOINTS)], linewidth=1.2)
    most = max(1.15, 1.1 * float(np.nanmax(np.abs(shares))))
    axes.set(ylabel=name, xlim=span(times[-1], times[0]), ylim=(-most, most))


def name_joints(figure: Any, axes: Any, names: Sequence[str]) -> None:
    """Say below a figure which joint has which colour."""
    lines = [
        axes.plot([], [], color=_JOINTS[k % len(_JOINTS)], label=name)[0] for k, name in enumerate(names)
    ]
    figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize=8)


def _draw_danger_in_motion(axes: Any, danger: MotionDanger) -> None:
    axes.plot(danger.times, danger.values, color="0.25", linewidth=2.0)
    if np.isfinite(danger.proven_peak):
        draw_limit(axes, danger.proven_peak)
        note = f"mean {danger.mean:.2f}, peak {danger.peak:.2f}, proven below {danger.proven_peak:.2f}"
        axes.set_title(note, loc="right", color=ALARM, fontsize=9, weight="normal")
    axes.set(ylabel="danger in motion", xlim=span(danger.times[-1]))
    axes.set_ylim(0.0, 1.15 * max(danger.peak, 1e-9))


SIZE = (6.0, 2.7)
"""Width and height of the picture [inch]."""
AXES = (0.105, 0.19, 0.87, 0.58)
"""Left, bottom, width and height of the axes, as shares of the picture: where a cursor has to go."""


def plot_speeds(
    times: ArrayLike,
    speeds: ArrayLike,
    bounds: Mapping[str, ArrayLike],
    binding: Sequence[str | None],
    file: str | Path | None,
    *,
    title: str = "Speed along the path",
    dpi: int = DPI,
) -> Any:
    """Draw the speed along a path against time, in the colour of what bounds it, and the caps above it.

    Parameters
    ----------
    times : (T,) array
        [s]
    speeds : (T,) array
        ṡ [rad/s].
    bounds : mapping of str to (T,) array
        Name of a cap → the largest ṡ that it allows; +inf where it allows any.
    binding : sequence of str or None
        T names: the cap that the speed reaches; None where accelerations bind.
    file
        None: only the canvas of the figure is drawn.

    Raises
    ------
    InputError
        If lengths differ, there is nothing to draw, or a time or speed is not finite.
    """
    t, s = curve(times, "times"), curve(speeds, "speeds")
    caps = {name: np.asarray(values, dtype=float) for name, values in bounds.items()}
    if {len(s), len(binding), *map(len, caps.values())} != {len(t)}:
        raise InputError(f"times, speeds, bounds and binding must be equally many, got {len(t)} times")
    with Page(file, *SIZE, dpi, arranged=False) as page:
        axes = page.figure.add_axes(AXES)
        used = _draw_speeds(axes, t, s, caps, binding)
        axes.set(xlabel="time [s]", xlim=(0.0, float(t[-1])))
        page.figure.text(AXES[0], 0.93, title, weight="bold", fontsize=12)
        page.figure.text(0.985, 0.93, f"{t[-1]:.2f} s", ha="right", color=GREY, fontsize=12)
        small = 8.5 if used < 4 else 7.5  # four names of caps are just within the axes
        add_legend_above(axes, small, handlelength=1.0, handletextpad=0.5, columnspacing=1.0)
    return page.figure


def _joined(values: FloatArray, chosen: Any) -> FloatArray:
    """Return values where chosen or just after, NaN elsewhere, so that the pieces of a line meet."""
    shown = chosen | np.concatenate([[False], chosen[:-1]])
    return np.where(shown, values, np.nan)
