"""A trajectory: its speed under the caps that bind, and joint velocities and accelerations against their limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.pictures.plots.page import ALARM, DPI, GREY, Page
from safe_ompl.trajectories.danger import MotionDanger
from safe_ompl.trajectories.trajectory import Trajectory

_COLOURS = {  # the same cap in every picture; distinct to the colour-blind
    "joint velocity": "#0b62b4",
    "bends beside people": "#7d2f91",
    "separation": "#c8452b",
    "separation or contact": "#c8452b",
    "danger": "#b87a00",
    "tool speed": "#00876a",
    "link speed": "#6aa84f",
}
_OTHER = "#3a444f"
_SAMPLES = 1500
_JOINTS = ("#0b62b4", "#b87a00", "#00876a", "#7d2f91", "#c8452b", "#596675", "#6aa84f", "#3aa0c9")


def plot_motion(
    trajectory: Trajectory,
    file: str | Path,
    *,
    danger: MotionDanger | None = None,
    title: str | None = None,
    dpi: int = DPI,
) -> Any:
    """Draw a trajectory.

    Above its speed along the path, in the colour of the cap that binds, and the caps themselves; below the velocities
    and accelerations of its joints as shares of their limits, and the danger where it is given.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    danger : MotionDanger, optional
        From `Trajectory.danger`.
    title : str, optional
        Above the axes; by default how long it takes.
    file, dpi
        As of all pictures, see `safe_ompl.pictures.plots`.
    """
    rows = 3 + (danger is not None)
    with Page(file, 7.5, 0.6 + 2.2 * rows + 0.8, dpi) as page:
        upper, *lower = page.figure.subplots(rows, 1, height_ratios=[1.5] + [1.0] * (rows - 1))
        _draw_speed(upper, trajectory)
        upper.set_title(f"{trajectory.duration:.2f} s" if title is None else title)
        times = np.linspace(0.0, trajectory.duration, _SAMPLES)
        state, limits = trajectory.at(times), trajectory.limits
        _draw_joints(lower[0], times, state.qd / limits.velocity, "velocity / limit")
        _draw_joints(lower[1], times, state.qdd / limits.acceleration, "acceleration / limit")
        for k, name in enumerate(trajectory.joint_names):
            lower[0].plot([], [], color=_JOINTS[k % len(_JOINTS)], label=name)
        page.figure.legend(
            handles=lower[0].lines[-len(trajectory.joint_names) :],
            loc="outside lower center",
            ncols=4,
            fontsize=8,
        )
        if danger is not None:
            _draw_danger(lower[2], danger)
        lower[-1].set_xlabel("time [s]")
    return page.figure


def _draw_speed(axes: Any, trajectory: Trajectory) -> None:
    """Draw ṡ over the arc length: it is curved in each cell, which many points resolve."""
    law = trajectory.law
    s = np.unique(np.concatenate([law.edges, np.linspace(0.0, law.edges[-1], _SAMPLES)]))
    speed = np.sqrt(law.squares_at(s))
    top = 1.15 * float(speed.max())
    binding = trajectory.binding()
    for cap in trajectory.caps:
        if np.isfinite(cap.speeds).any():
            bound = np.where(np.isfinite(cap.speeds), cap.speeds, np.nan)
            axes.stairs(bound, law.edges, baseline=None, color=_colour(cap.name), linewidth=1.0, alpha=0.55)
    axes.plot(s, speed, color="0.25", linewidth=2.0, label="accelerations")
    middles = (s[1:] + s[:-1]) / 2
    cells = np.clip(np.searchsorted(law.edges, middles, side="right") - 1, 0, len(binding) - 1)
    names = np.array([binding[k] or "" for k in cells])
    for cap in trajectory.caps:
        bound = np.append(names == cap.name, False)
        bound[1:] |= names == cap.name
        if bound.any():
            line = np.where(bound, speed, np.nan)
            axes.plot(s, line, color=_colour(cap.name), linewidth=3.4, solid_capstyle="butt", label=cap.name)
    for corner in trajectory.curve.stops:
        axes.axvline(trajectory.curve.starts[corner], color=GREY, linewidth=0.8, linestyle=(0, (2.0, 2.0)))
    axes.set(
        xlabel="arc length [rad]", ylabel="speed along the path [rad/s]", xlim=(0.0, s[-1]), ylim=(0.0, top)
    )
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=4,
        fontsize=8,
        borderaxespad=0.2,
        title="bounded by",
    )
    axes.get_legend().set_title(None)


def _draw_joints(axes: Any, times: FloatArray, shares: FloatArray, name: str) -> None:
    for side in (-1.0, 1.0):
        axes.axhline(side, color=ALARM, linewidth=1.0, linestyle=(0, (4.0, 3.0)))
    for k, values in enumerate(shares.T):
        axes.plot(times, values, color=_JOINTS[k % len(_JOINTS)], linewidth=1.2)
    axes.set(ylabel=name, xlim=(0.0, times[-1]), ylim=(-1.15, 1.15))


def _draw_danger(axes: Any, danger: MotionDanger) -> None:
    axes.plot(danger.times, danger.values, color="0.25", linewidth=2.0)
    if np.isfinite(danger.proven_peak):
        axes.axhline(danger.proven_peak, color=ALARM, linewidth=1.0, linestyle=(0, (4.0, 3.0)))
        note = f"mean {danger.mean:.2f}, peak {danger.peak:.2f}, proven below {danger.proven_peak:.2f}"
        axes.set_title(note, loc="right", color=ALARM, fontsize=9, weight="normal")
    axes.set(ylabel="danger in motion", xlim=(0.0, danger.times[-1]))
    axes.set_ylim(0.0, 1.15 * max(danger.peak, 1e-9))


def _colour(name: str) -> str:
    return _COLOURS.get(name, _OTHER)
