"""A motion that something else made: its joints, its distances, and the stretches that are not proven."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray
from safe_ompl.motions import MotionCheck
from safe_ompl.view.plots.page import ALARM, Page, add_legend_above, draw_limit
from safe_ompl.view.plots.paths import draw_joints, name_joints, span

_SAMPLES = 400
_KINDS = ("position", "velocity", "acceleration")


def plot_check(check: MotionCheck, file: str | Path | None, *, title: str | None = None) -> Any:
    """Draw what was checked of a motion; what is not proven is shaded.

    Joints as shares of their limits (1 is the upper one, −1 the lower one), positions and, where limits were checked,
    velocities and accelerations; below the distance of the pair that has least to spare, and what it must keep.

    Parameters
    ----------
    check : MotionCheck
        What was found.
    title : str, optional
        Above the axes; by default what is proven.
    """
    motion, proof, limits = check.motion, check.proof, check.limits
    robot = proof.checker.robot
    times = np.linspace(motion.times[0], motion.times[-1], _SAMPLES)
    Q = motion.at(times)
    around = np.where(robot.continuous, (Q + np.pi) % (2 * np.pi) - np.pi, Q)
    around[1:][robot.continuous & (np.abs(np.diff(around, axis=0)) > np.pi)] = np.nan  # steps of whole turns
    middle, half = 0.5 * (robot.upper + robot.lower), 0.5 * (robot.upper - robot.lower)
    shares = [(around - middle) / np.where(half > 0, half, 1.0)]
    if limits is not None:
        shares += [
            motion.derivative(times, order) / getattr(limits, _KINDS[order])
            for order in range(1, len(_KINDS))
        ]
    with Page(file, 7.5, 2.0 + 2.0 * len(shares) + 2.2) as page:
        every = page.figure.subplots(len(shares) + 1, 1, sharex=True)
        for axes, values, kind in zip(every, shares, _KINDS, strict=False):
            draw_joints(axes, times, values, f"{kind} / limit")
        name_joints(page.figure, every[0], robot.joint_names)
        _draw_distances(every[-1], times, Q, proof)
        every[-1].set(xlabel="time [s]" if motion.timed else "way point", xlim=span(times[-1], times[0]))
        _mark(every, check, 0.004 * motion.duration)
        stretches = len(check.violations)
        said = "proven" if check else f"{stretches} stretch{'es' * (stretches > 1)} not proven"
        page.set_title(said if title is None else title)
    return page.figure


def _draw_distances(axes: Any, times: FloatArray, Q: FloatArray, proof: MotionProver) -> None:
    """Draw the distances of the pairs with least to spare, to obstacles and between links, and what they must keep."""
    checker = proof.checker
    distances = 1e3 * np.array([checker.pair_distances(q) for q in Q])
    required = 1e3 * proof.separation.required(checker).at_start[: distances.shape[1]]
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
            axes.plot(
                times, least_kept, color=colour, linewidth=1.4, linestyle=":", label=f"{label}, required"
            )
        top, bottom = max(top, found.max(), kept.max()), min(bottom, found.min())
    draw_limit(axes, 0.0)
    axes.set(ylabel="distance [mm]", ylim=(1.15 * bottom, 1.15 * top))
    if axes.get_legend_handles_labels()[1]:
        add_legend_above(axes, bbox_to_anchor=(0.0, 0.98), columnspacing=1.2)


def _mark(every: Any, check: MotionCheck, least: float) -> None:
    """Shade the stretches that are not proven, the short ones as wide as `least` [s]."""
    for found in check.violations:
        room = max(0.0, 0.5 * (least - (found.last - found.first)))
        for axes in every:
            axes.axvspan(found.first - room, found.last + room, color=ALARM, alpha=0.16, linewidth=0)
