"""Contour plot of the danger field around a planar arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.pictures.plots.page import GREY, Page
from safe_ompl.pictures.plots.silhouette import draw_arm
from safe_ompl.robot.robot import Robot

_FIELD_PIXELS = 241  # of the grid, along each side
_LEVELS = 14
_HIGHEST = 0.985  # quantile of the values at which the colours end


def plot_field(
    robot: Robot,
    configurations: Sequence[ArrayLike],
    file: str | Path,
    *,
    height: float = 0.0,
    title: str = "Danger field around the arm",
) -> Any:
    """Draw contours of the danger field of an arm that moves in a level plane (after Fig. 3 of the paper).

    Parameters
    ----------
    robot : Robot
        The arm; its field is that of eq. (5) with unit weighting.
    configurations : sequence of (n,) arrays
        One panel for each [rad].
    height : float
        Of the plane [m].
    file, title
        As of all pictures, see `safe_ompl.pictures.plots`.

    Raises
    ------
    InputError
        If there is no configuration, or one has the wrong shape or is not finite.
    """
    poses = [finite_array(q, (robot.n,), "configuration") for q in configurations]
    if not poses:
        raise InputError("no configuration to draw; give at least one")
    reach = 1.25 * float(np.linalg.norm(robot.keypoints_batch(np.array(poses))[..., :2], axis=-1).max())
    line = np.linspace(-reach, reach, _FIELD_PIXELS)
    x, y = np.meshgrid(line, line)
    points = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
    field = DangerField(robot, points)
    values = [field.field(q, points).reshape(x.shape) for q in poses]
    levels = _levels(np.array(values))
    with Page(file, 1.5 + 3.5 * len(poses), 4.2) as page:
        panels = page.figure.subplots(1, len(poses), sharey=True, squeeze=False)[0]
        for axes, q, level in zip(panels, poses, values, strict=True):
            shades = axes.contourf(x, y, level, levels, cmap="YlOrRd", extend="both")
            axes.contour(x, y, level, levels, colors="white", linewidths=0.6)
            draw_arm(axes, robot, q, "0.25")
            axes.plot(
                0, 0, "o", color="white", markeredgecolor="0.1", markeredgewidth=2, markersize=9, zorder=5
            )
            axes.set(aspect="equal", xlabel="x [m]")
            axes.grid(visible=False)
        panels[0].set_ylabel("y [m]")
        bar = page.figure.colorbar(shades, ax=panels, label="danger field [1/m]", shrink=0.9)
        bar.outline.set_edgecolor(GREY)
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1f}")
        page.figure.suptitle(title, x=0.01, ha="left", fontsize=12, weight="bold")
    return page.figure


def _levels(values: FloatArray) -> FloatArray:
    """Return levels between which the area shrinks evenly towards the arm."""
    finite = values[np.isfinite(values)]
    return np.geomspace(finite.min(), np.quantile(finite, _HIGHEST), _LEVELS)
