"""Plots of danger along paths, of speeds, and of comparisons of planners and paths.

All functions take numbers or motions, write one picture and return it as a `matplotlib.figure.Figure`. The extension of
`file` selects the format (PNG, SVG, PDF or WebP); missing folders are created. `title` is the line above the plot,
`dpi` the resolution in pixels per inch. All functions raise SafeOmplError if Matplotlib is not installed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError
from safe_ompl.drawing.page import ALARM, ALONG, DANGER, DPI, GREY, add_legend_above, curve, draw_limit, page, set_title
from safe_ompl.drawing.style import Colour, PlannerStyle, cap_colours, planner_styles, shades
from safe_ompl.io import ACCELERATION
from safe_ompl.motions import MotionCheck, MotionDanger, Trajectory
from safe_ompl.planning import Tradeoff
from safe_ompl.planning.simplification import SPREAD_PERCENTILES, forced_danger
from safe_ompl.tasks import ProgramResult

# The height of a line of text as a share of the axes.
_LINE_HEIGHT = 0.08
# Clearances below this are shaded as too near.
_TOO_NEAR = 50.0  # [mm]
_CLEARANCES = ("0.25", "0.62")


def plot_plan(
    danger: ArrayLike,
    file: str | Path | None,
    *,
    clearance: Mapping[str, ArrayLike] | None = None,
    planner: str = "",
    title: str | None = None,
    dpi: int = DPI,
) -> Any:
    """Plot the danger (S,) at equal steps of one path, and below it the clearance.

    The danger at start and goal is marked; the avoidable danger is shaded (see `DangerReport`). `clearance` maps kinds
    of obstacles to clearances (S',) [m], the most important kind first. The planner determines the colour, and its name
    is the default title. Without a file the figure is only drawn on its canvas. Raises InputError if an array is empty,
    has the wrong shape, or holds a value that is not finite.
    """
    values = curve(danger, "danger")
    gaps = {to: 1e3 * curve(found, "clearance") for to, found in (clearance or {}).items()}
    rows = 1 + bool(gaps)
    height = 1.2 + 2.5 * rows
    # The axes are placed by hand, because Matplotlib's automatic layout doubles the drawing time.
    with page(file, 7.0, height, dpi, arranged=False) as figure:
        top, bottom = 1 - 0.35 / height, 0.55 / height
        figure.subplots_adjust(left=0.1, right=0.925, top=top, bottom=bottom, hspace=0.25)
        upper = lowest = figure.add_subplot(rows, 1, 1)
        _draw_danger(upper, values, planner_styles([planner])[planner].colour)
        upper.set_title(planner if title is None else title)
        if gaps:
            lowest = figure.add_subplot(rows, 1, 2)
            _draw_clearance(lowest, gaps)
        lowest.set_xlabel(ALONG)
    return figure


def _draw_danger(axes: Any, values: FloatArray, colour: Colour) -> None:
    at, forced = np.linspace(0.0, 1.0, len(values)), forced_danger(values)
    shade = {"color": ALARM, "alpha": 0.25, "lw": 0}
    axes.fill_between(at, forced, values, where=values > forced, interpolate=True, **shade)
    axes.plot(at, values, color=colour, linewidth=2.4)
    top = 1.12 * float(values.max()) or 1.0
    start, goal = float(values[0]), float(values[-1])
    shift = 0.5 * max(0.0, _LINE_HEIGHT - abs(goal - start) / top) * top * (1 if goal >= start else -1)
    for value, name, place in ((start, "start", start - shift), (goal, "goal", goal + shift)):
        axes.axhline(value, color=GREY, linewidth=1.0, linestyle=(0, (4.0, 3.0)))
        # The text stands beside the axes, so it never covers a curve.
        axes.text(1.01, place, name, ha="left", va="center", color=GREY)
    axes.set(ylabel=DANGER, xlim=(0.0, 1.0))
    axes.set_ylim(0.0, top)


def _draw_clearance(axes: Any, gaps: Mapping[str, FloatArray]) -> None:
    axes.axhspan(0.0, _TOO_NEAR, color=ALARM, alpha=0.12, linewidth=0)
    for k, (to, values) in enumerate(gaps.items()):
        at, colour = np.linspace(0.0, 1.0, len(values)), _CLEARANCES[k % len(_CLEARANCES)]
        axes.plot(at, values, color=colour, linewidth=2.4 if k == 0 else 1.6, label=f"to {to}")
    closest = min(gaps, key=lambda to: float(gaps[to].min()))
    values = gaps[closest]
    least = int(np.argmin(values))
    axes.plot(np.linspace(0.0, 1.0, len(values))[least], values[least], "o", color=ALARM, markersize=7, clip_on=False)
    note = f"closest: {values[least]:.0f} mm to {closest}"
    axes.set_title(note, loc="right", color=ALARM, fontsize=11, weight="normal")
    if len(gaps) > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.98), ncols=len(gaps), borderaxespad=0.0)
    axes.set(ylabel="clearance [mm]", xlim=(0.0, 1.0))
    axes.set_ylim(0.0, 1.12 * max(_TOO_NEAR, *(float(values.max()) for values in gaps.values())))


_PLOT_SAMPLES = 1500
_JOINTS = ("#0b62b4", "#b87a00", "#00876a", "#7d2f91", "#c8452b", "#596675", "#6aa84f", "#3aa0c9")


def plot_motion(
    trajectory: Trajectory, file: str | Path | None, *, danger: MotionDanger | None = None, title: str | None = None
) -> Any:
    """Plot a trajectory over time.

    The upper axes show the speed along the path, in the colour of the active limit, and all velocity limits. The lower
    axes show the joint velocities and accelerations, and the jerks if they are limited, as shares of their limits. If
    `danger` (from `Trajectory.danger`) is given, it is plotted last. The default title is the duration.
    """
    jerk = trajectory.limits.jerk
    rows = 3 + (jerk is not None) + (danger is not None)
    with page(file, 7.5, 0.6 + 2.2 * rows + 0.8) as figure:
        upper, *lower = figure.subplots(rows, 1, height_ratios=[1.5] + [1.0] * (rows - 1))
        set_title(figure, f"{trajectory.duration:.2f} s" if title is None else title)
        times = np.linspace(0.0, trajectory.duration, _PLOT_SAMPLES)
        cells, _, speeds, _ = trajectory.law.at(times)
        bounds = {limit.name: limit.speeds[cells] for limit in trajectory.velocity_limits}
        binding = trajectory.binding()
        _draw_speeds(upper, times, speeds, bounds, [binding[cell] for cell in cells])
        add_legend_above(upper)
        state, limits = trajectory.at(times), trajectory.limits
        _draw_joints(lower[0], times, state.qd / limits.velocity, "velocity / limit")
        _draw_joints(lower[1], times, state.qdd / limits.acceleration, "acceleration / limit")
        if jerk is not None:
            _draw_joints(lower[2], times, trajectory.jerks_at(times) / jerk, "jerk / limit")
        _name_joints(figure, lower[0], trajectory.joint_names)
        if danger is not None:
            _draw_danger_in_motion(lower[-1], danger)
        lower[-1].set_xlabel("time [s]")
    return figure


def _draw_speeds(
    axes: Any, times: FloatArray, speeds: FloatArray, bounds: Mapping[str, FloatArray], binding: Sequence[str | None]
) -> int:
    """Plot ṡ (T,) in the colour of the active limit, and all velocity limits (T,) as thin lines.

    Returns the number of different active limits.
    """
    names = list(dict.fromkeys([*bounds, *filter(None, binding), ACCELERATION]))
    colours, top = cap_colours(names), 1.25 * float(speeds.max()) or 1.0
    for name, values in bounds.items():
        axes.plot(times, np.where(values <= 2 * top, values, np.nan), color=colours[name], linewidth=1.2)
    bound_by = np.array([name or ACCELERATION for name in binding])
    used = [name for name in names if (bound_by == name).any()]
    for name in used:
        axes.plot(times, _joined(speeds, bound_by == name), color=colours[name], linewidth=3.4, label=name)
    axes.set(ylabel="speed [rad/s]", xlim=_span(times[-1]), ylim=(0.0, top))
    return len(used)


def _span(end: float, begin: float = 0.0) -> tuple[float, float]:
    """Return the limits of an axis from `begin` to `end`, with a margin for the width of lines at the ends."""
    return begin - 0.004 * (end - begin), end + 0.004 * (end - begin)


def _draw_joints(axes: Any, times: FloatArray, shares: FloatArray, name: str) -> None:
    """Plot joint values (T, n), given as shares of their limits, and mark the limits at −1 and 1."""
    for side in (-1.0, 1.0):
        draw_limit(axes, side)
    for k, values in enumerate(shares.T):
        axes.plot(times, values, color=_JOINTS[k % len(_JOINTS)], linewidth=1.2)
    most = max(1.15, 1.1 * float(np.nanmax(np.abs(shares))))
    axes.set(ylabel=name, xlim=_span(times[-1], times[0]), ylim=(-most, most))


def _name_joints(figure: Any, axes: Any, names: Sequence[str]) -> None:
    """Add a legend of the joints' colours below a figure."""
    lines = [axes.plot([], [], color=_JOINTS[k % len(_JOINTS)], label=name)[0] for k, name in enumerate(names)]
    figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize=8)


def _draw_danger_in_motion(axes: Any, danger: MotionDanger) -> None:
    axes.plot(danger.times, danger.values, color="0.25", linewidth=2.0)
    if np.isfinite(danger.proven_peak):
        draw_limit(axes, danger.proven_peak)
        note = f"mean {danger.mean:.2f}, peak {danger.peak:.2f}, proven below {danger.proven_peak:.2f}"
        axes.set_title(note, loc="right", color=ALARM, fontsize=9, weight="normal")
    axes.set(ylabel="danger in motion", xlim=_span(danger.times[-1]))
    axes.set_ylim(0.0, 1.15 * max(danger.peak, 1e-9))


SIZE = (6.0, 2.7)
"""Width and height of the picture [inch]."""
AXES = (0.105, 0.19, 0.87, 0.58)
"""Left, bottom, width and height of the axes, as shares of the picture. The browser view places its cursor by them."""


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
    """Plot the speeds (T,) [rad/s] along a path over times (T,) [s], in the colour of the active limit.

    `bounds` maps the names of velocity limits to the largest ṡ (T,) that each limit allows; +inf if it allows any ṡ.
    `binding` holds T names of active limits; None stands for an acceleration limit. Without a file the figure is only
    drawn on its canvas. Raises InputError if lengths differ, there is nothing to draw, or a value is not finite.
    """
    t, s = curve(times, "times"), curve(speeds, "speeds")
    velocity_limits = {name: np.asarray(values, dtype=float) for name, values in bounds.items()}
    if {len(s), len(binding), *map(len, velocity_limits.values())} != {len(t)}:
        raise InputError(f"times, speeds, bounds and binding must have equal numbers of entries, got {len(t)} times")
    with page(file, *SIZE, dpi, arranged=False) as figure:
        axes = figure.add_axes(AXES)
        used = _draw_speeds(axes, t, s, velocity_limits, binding)
        axes.set(xlabel="time [s]", xlim=(0.0, float(t[-1])))
        figure.text(AXES[0], 0.93, title, weight="bold", fontsize=12)
        figure.text(0.985, 0.93, f"{t[-1]:.2f} s", ha="right", color=GREY, fontsize=12)
        # The names of four limits only fit in a smaller font.
        small = 8.5 if used < 4 else 7.5
        add_legend_above(axes, small, handlelength=1.0, handletextpad=0.5, columnspacing=1.0)
    return figure


def _joined(values: FloatArray, chosen: Any) -> FloatArray:
    """Return values where `chosen`, and one value after each chosen part so that lines connect; NaN elsewhere."""
    shown = chosen | np.concatenate([[False], chosen[:-1]])
    return np.where(shown, values, np.nan)


_CHECKED = 400
_DERIVATIVES = ("position", "velocity", "acceleration")


def plot_check(check: MotionCheck, file: str | Path | None, *, title: str | None = None) -> Any:
    """Plot the result of a check of a motion. Violations are shaded.

    The upper axes show joint positions as shares of their limits (1 is the upper limit, −1 the lower limit), and
    velocities and accelerations if their limits were checked. The lowest axes show the distance of the pair with the
    smallest margin, and its required distance [mm]. The default title states whether the motion is proven.
    """
    motion, proof, limits = check.motion, check.proof, check.limits
    robot = proof.checker.robot
    times = np.linspace(motion.times[0], motion.times[-1], _CHECKED)
    Q = motion.at(times)
    around = np.where(robot.continuous, (Q + np.pi) % (2 * np.pi) - np.pi, Q)
    around[1:][robot.continuous & (np.abs(np.diff(around, axis=0)) > np.pi)] = np.nan  # full turns
    middle, half = 0.5 * (robot.upper + robot.lower), 0.5 * (robot.upper - robot.lower)
    shares = [(around - middle) / np.where(half > 0, half, 1.0)]
    if limits is not None:
        shares += [
            motion.derivative(times, order) / getattr(limits, _DERIVATIVES[order])
            for order in range(1, len(_DERIVATIVES))
        ]
    with page(file, 7.5, 2.0 + 2.0 * len(shares) + 2.2) as figure:
        every = figure.subplots(len(shares) + 1, 1, sharex=True)
        for axes, values, kind in zip(every, shares, _DERIVATIVES, strict=False):
            _draw_joints(axes, times, values, f"{kind} / limit")
        _name_joints(figure, every[0], robot.joint_names)
        _draw_distances(every[-1], times, Q, proof)
        every[-1].set(xlabel="time [s]" if motion.timed else "way point", xlim=_span(times[-1], times[0]))
        # The shading of short violations is widened so that it is visible.
        for found in check.violations:
            room = max(0.0, 0.5 * (0.004 * motion.duration - (found.last - found.first)))
            for axes in every:
                axes.axvspan(found.first - room, found.last + room, color=ALARM, alpha=0.16, linewidth=0)
        stretches = len(check.violations)
        default_title = "proven" if check else f"{stretches} stretch{'es' * (stretches > 1)} not proven"
        set_title(figure, default_title if title is None else title)
    return figure


def _draw_distances(axes: Any, times: FloatArray, Q: FloatArray, proof: MotionProver) -> None:
    """Plot distance and required distance of the pairs with the smallest margins, to obstacles and between links."""
    checker = proof.checker
    distances = 1e3 * np.array([checker.pair_distances(q) for q in Q])
    required = 1e3 * proof.separation.required(checker).least[: distances.shape[1]]
    meets = np.array([pair[1] in checker.scene.names for pair in checker.pair_names], dtype=bool)
    top, bottom = 1.0, 0.0
    for label, chosen, colour in (("to obstacles", meets, "0.25"), ("between links", ~meets, "0.62")):
        if not chosen.any():
            continue
        least = np.flatnonzero(chosen)[(distances - required)[:, chosen].argmin(axis=1)]
        found, kept = distances[range(len(times)), least], required[least]
        axes.plot(times, found, color=colour, linewidth=2.0, label=label)
        if kept.any():
            least_kept = np.where(kept > 0.0, kept, np.nan)
            axes.plot(times, least_kept, color=colour, linewidth=1.4, linestyle=":", label=f"{label}, required")
        top, bottom = max(top, found.max(), kept.max()), min(bottom, found.min())
    draw_limit(axes, 0.0)
    axes.set(ylabel="distance [mm]", ylim=(1.15 * bottom, 1.15 * top))
    if axes.get_legend_handles_labels()[1]:
        add_legend_above(axes, bbox_to_anchor=(0.0, 0.98), columnspacing=1.2)


_LINE_LETTERS = 44  # letters of a step


def plot_program(result: ProgramResult, file: str | Path | None, *, dpi: int = DPI) -> Any:
    """Plot the time span of each step of a program as a bar. Steps without motion are drawn as lines."""
    steps = () if result.scenario.program is None else result.scenario.program.steps
    colours = cap_colours(step.kind for step in steps)
    with page(file, 7.5, 1.2 + 0.4 * max(len(steps), 10), dpi) as figure:
        axes, time = figure.add_subplot(), 0.0
        for k, step in enumerate(steps):
            spans = [(s.begin, s.motion.duration) for s in result.stretches if s.step == k]
            axes.broken_barh(spans or [(time, 0.0)], (k - 0.32, 0.64), color=colours[step.kind], linewidth=1.6)
            time = max([time, *(begin + span for begin, span in spans)])
        words = [f"{k + 1}  {shorten(str(step), _LINE_LETTERS, placeholder=' …')}" for k, step in enumerate(steps)]
        axes.set_yticks(range(len(steps)), words)
        axes.grid(axis="y", visible=False)
        axes.set(xlabel="time [s]", xlim=_span(time), ylim=(len(steps) - 0.4, -0.6))
        set_title(figure, result.scenario.name)
    return figure


# At most this many planners share one plot, because more bands cannot be told apart.
_MOST_IN_AXES = 4
_COLUMNS = 4  # of small axes


def plot_profiles(
    profiles: Mapping[str, FloatArray], file: str | Path, *, title: str = "Mean danger along the path"
) -> Any:
    """Plot each planner's mean danger along the path, and a band from the 15th to the 85th percentile (Figs. 7, 11).

    Profiles are arrays (R, S): the danger at S equal steps of the path, with one row for each of R solved runs. Up to
    four planners share one plot. With more planners, the first two share the large plot, and each other planner has a
    small plot of its own, which also shows the mean of the first planner.
    """
    first, *others = profiles
    large = [first, *others] if len(profiles) <= _MOST_IN_AXES else [first, others[0]]
    small = [name for name in others if name not in large]
    rows = -(-len(small) // _COLUMNS)
    styles = planner_styles(profiles)
    with page(file, 7.0 if not small else 10.0, 4.4 + 1.9 * rows) as figure:
        grid = figure.add_gridspec(1 + rows, _COLUMNS, height_ratios=[4.4, *[1.9] * rows])
        upper = figure.add_subplot(grid[0, :])
        for name in large:
            _draw_profile(upper, name, profiles[name], styles[name])
        upper.set(xlabel=ALONG, ylabel=DANGER, xlim=(0.0, 1.0))
        set_title(figure, title)
        add_legend_above(upper, 10.0, handlelength=2.6, ncols=2)
        low, high = SPREAD_PERCENTILES
        note = f"line: mean, band: {low}th to {high}th percentile"
        upper.text(0.99, 0.03, note, ha="right", color=GREY, fontsize=9, transform=upper.transAxes)
        for k, name in enumerate(small):
            axes = figure.add_subplot(grid[1 + k // _COLUMNS, k % _COLUMNS], sharex=upper, sharey=upper)
            if len(profiles[first]):
                shown = profiles[first].mean(axis=0)
                axes.plot(np.linspace(0.0, 1.0, len(shown)), shown, color=styles[first].colour, linewidth=1.2)
            line = _draw_profile(axes, name, profiles[name], styles[name])
            axes.set_title(line.get_label(), fontsize=10)
            axes.tick_params(labelsize=9, labelleft=k % _COLUMNS == 0, labelbottom=k + _COLUMNS >= len(small))
        upper.set_ylim(bottom=0.0)
        upper.locator_params(axis="y", nbins=5)
    return figure


def _draw_profile(axes: Any, name: str, runs: FloatArray, style: PlannerStyle) -> Any:
    """Plot the mean of profiles (R, S) and their band, and return the line of the mean."""
    along = np.linspace(0.0, 1.0, runs.shape[-1])
    low, high = np.percentile(runs, SPREAD_PERCENTILES, axis=0) if len(runs) else ([], [])
    if len(runs):
        axes.fill_between(along, low, high, color=style.colour, alpha=0.18, linewidth=0)
    (line,) = axes.plot(
        along if len(runs) else [],
        runs.mean(axis=0) if len(runs) else [],
        label=name if len(runs) else f"{name} (no runs)",
        color=style.colour,
        linewidth=2.6 if style.strong else 1.9,
        linestyle=(0, style.dashes) if style.dashes else "-",
        zorder=3 if style.strong else 2,
    )
    return line


def plot_tradeoff(front: Tradeoff, file: str | Path | None, *, title: str = "What safety costs") -> Any:
    """Plot mean danger over length for the paths of a front, and on the right the danger along each path.

    Raises InputError if the front has no path.
    """
    reports = [result.report for result in front.results if result.report is not None]
    measured = [(report, report.danger) for report in reports if report.danger is not None]
    if not measured:
        raise InputError("there is no path to draw")
    lengths = np.array([report.length for report, _ in measured])
    means = np.array([danger.mean for _, danger in measured])
    colours = shades(len(measured))
    with page(file, 10.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        left.step(lengths, means, where="post", color="0.75", linewidth=1.4, zorder=1)
        left.scatter(lengths, means, s=80, color=colours, edgecolor="white", linewidth=1.0, zorder=3)
        for weight, length, mean in zip(front.weights, lengths, means, strict=True):
            near = {"xytext": (7, 6), "textcoords": "offset points", "fontsize": 9, "color": GREY}
            left.annotate(f"{weight:g}", (length, mean), **near)
        left.set(xlabel="length [rad]", ylabel="mean danger")
        left.margins(0.10, 0.12)
        left.set_title("Each path, with its weight of danger", fontsize=11, weight="normal")
        for (report, danger), colour in zip(measured, colours, strict=True):
            along = report.length * np.linspace(0.0, 1.0, len(danger.profile))
            right.plot(along, danger.profile, color=colour, linewidth=2.0, marker="o", markevery=[-1], clip_on=False)
        right.set(xlabel="along the path, from its start [rad]", ylabel=DANGER, xlim=(0.0, 1.03 * lengths[-1]))
        right.set_ylim(bottom=0.0)
        right.set_title("Danger along each path", fontsize=11, weight="normal")
        set_title(figure, title)
    return figure
