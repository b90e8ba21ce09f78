"""Planar arms and their obstacles from above, in axes whose units are metres."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.pictures.render.bodies import RobotBody
from safe_ompl.pictures.style import Colour

if TYPE_CHECKING:
    from safe_ompl.robot.robot import Robot
    from safe_ompl.scene.scene import Scene

_HARMLESS_FILL = "#b9bdc4"
_DANGEROUS_FILL = "#d9822b"


def draw_scene(axes: Any, scene: Scene) -> None:
    """Draw the obstacles, what is dangerous to approach in its own colour."""
    for obstacle in scene.obstacles:
        colour = _DANGEROUS_FILL if obstacle.weight > 0 else _HARMLESS_FILL
        vertices, faces = obstacle.triangles()
        _fill(axes, vertices, faces.astype(np.intp), color=colour, zorder=2)


def draw_arm(axes: Any, robot: Robot, q: FloatArray, colour: Colour | str, *, opacity: float = 1.0) -> None:
    """Draw the robot at `q: (n,)`, and its joints as dots."""
    body = RobotBody(robot, coarse=True).posed(q)
    _fill(axes, body.vertices, body.faces, color=colour, alpha=opacity, zorder=3)
    if opacity == 1.0:
        joints = robot.keypoints(q)
        axes.plot(joints[:-1, 0], joints[:-1, 1], "o", color="white", markersize=4, zorder=4)


def _fill(axes: Any, vertices: FloatArray, faces: IntArray, **style: Any) -> None:
    """Fill the shadow of triangles on the floor: one area, so that a translucent one is even."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    corners = vertices[faces][:, :, :2]
    side, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = side[:, 0] * other[:, 1] - side[:, 1] * other[:, 0]
    corners = np.where((area < 0)[:, None, None], corners[:, ::-1], corners)[area != 0]
    closed = np.concatenate([corners, corners[:, :1]], axis=1)
    codes = np.tile([Path.MOVETO, Path.LINETO, Path.LINETO, Path.CLOSEPOLY], len(closed))
    axes.add_patch(PathPatch(Path(closed.reshape(-1, 2), codes), linewidth=0, **style))
