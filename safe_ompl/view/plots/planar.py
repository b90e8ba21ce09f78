"""Arms that move in a level plane: their danger field, and their bubbles of free configurations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, bubbles
from safe_ompl.common import FloatArray, InputError, IntArray, finite_array
from safe_ompl.danger import DangerField
from safe_ompl.robot import Robot
from safe_ompl.view.pictures.bodies import RobotBody
from safe_ompl.view.plots.page import GREY, Page
from safe_ompl.view.style import Colour

if TYPE_CHECKING:
    from safe_ompl.robot import Robot
    from safe_ompl.scene import Scene

_GRID_PIXELS = 181  # of a plane, along each side
_IN_COLLISION, _SHADE = "0.72", 0.22
_COLOURS = ("#0b62b4", "#7d2f91", "#00876a", "#b87a00")


def plot_bubbles(
    checker: CollisionChecker,
    configurations: Sequence[ArrayLike],
    file: str | Path,
    *,
    title: str = "Bubbles of free configuration space",
) -> Any:
    """Draw an arm of two joints at some configurations, and its bubbles there (after Fig. 4 of the paper).

    Of each bubble is drawn all that one distance query proves free, and within it the planner's shapes: the diamond
    of all links' distances, the paper's diamond (9), and the cube.

    Parameters
    ----------
    checker : CollisionChecker
        Of a robot of two joints.
    configurations : sequence of (2,) arrays
        Where, free of collision [rad].
    file, title
        As of all pictures, see `safe_ompl.view.plots`.

    Raises
    ------
    InputError
        If the robot has not two joints, there is no configuration, or one is not free.
    """
    poses = _free_configurations(checker, configurations, 2)
    robot = checker.robot
    with Page(file, 9.4, 4.7) as page:
        left, right = page.figure.subplots(1, 2)
        draw_scene(left, checker.scene)
        for q, colour in zip(poses, _COLOURS, strict=False):
            draw_arm(left, robot, q, colour)
            _draw_bubble(right, checker, q, colour)
        left.autoscale_view()
        left.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        left.locator_params(nbins=6)
        grid, free = _plane(checker)
        right.contourf(*grid, np.where(free, 0.0, 1.0), [0.5, 1.5], colors=[_IN_COLLISION])
        right.set(
            aspect="equal", xlim=(robot.lower[0], robot.upper[0]), ylim=(robot.lower[1], robot.upper[1])
        )
        for axes, words in ((left, "workspace"), (right, "configuration space")):
            axes.set_title(words, weight="normal")
        right.set(xlabel=f"{robot.joint_names[0]} [rad]", ylabel=f"{robot.joint_names[1]} [rad]")
        _add_bubble_legend(page.figure)
        page.set_title(title)
    return page.figure


def _draw_bubble(axes: Any, checker: CollisionChecker, q: FloatArray, colour: str) -> None:
    radii, distances = checker.pair_radii_at(q), checker.pair_distances(q)
    bounded = radii.any(axis=1)
    radii, distances = radii[bounded], distances[bounded]
    line = np.linspace(-np.pi, np.pi, 721)
    dx, dy = np.meshgrid(line, line)
    reach = np.max(
        [(r[0] * abs(dx) + r[1] * abs(dy)) / d for r, d in zip(radii, distances, strict=True)], axis=0
    )
    axes.contourf(q[0] + dx, q[1] + dy, reach, [-1.0, 1.0], colors=[colour], alpha=_SHADE)
    link = bubbles.link_diamond(radii, distances)
    paper = bubbles.common_diamond(checker.robot.bounds.displacement_radii_at(q), distances)
    for weights, dashes in ((link, "-"), (paper, "--")):
        a, b = bubbles.extents(weights)
        axes.plot(q[0] + [a, 0, -a, 0, a], q[1] + [0, b, 0, -b, 0], dashes, color=colour, linewidth=1.8)
    a, b = bubbles.extents(bubbles.inscribed_cube(radii, distances))
    axes.plot(q[0] + [a, a, -a, -a, a], q[1] + [b, -b, -b, b, b], ":", color=colour, linewidth=1.8)
    axes.plot(*q, "o", color=colour, markersize=6)


def _add_bubble_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(color=_IN_COLLISION, linewidth=0, label="in collision"),
        Patch(color=_COLOURS[0], alpha=_SHADE, linewidth=0, label="proven free"),
        Line2D([], [], color=GREY, linestyle="-", label="diamond of all links"),
        Line2D([], [], color=GREY, linestyle="--", label="paper's (9)"),
        Line2D([], [], color=GREY, linestyle=":", label="cube"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5)


def _plane(checker: CollisionChecker) -> tuple[list[FloatArray], FloatArray]:
    """Return the grid of two joint angles, and where it is free."""
    robot = checker.robot
    axis = [np.linspace(low, high, _GRID_PIXELS) for low, high in zip(robot.lower, robot.upper, strict=True)]
    x, y = np.meshgrid(*axis)
    free = [not checker.in_collision(q) for q in np.stack([x, y], axis=-1).reshape(-1, 2)]
    return [x, y], np.reshape(free, x.shape)


def _free_configurations(
    checker: CollisionChecker, configurations: Sequence[ArrayLike], joints: int
) -> list[FloatArray]:
    check_joints(checker, joints)
    poses = [finite_array(q, (joints,), "configuration") for q in configurations]
    if not poses:
        raise InputError("no configuration to draw; give at least one")
    for q in poses:
        pair = checker.colliding_pair(q)
        if pair is not None:
            raise InputError(f"{q.tolist()} has no bubble: {pair[0]!r} touches {pair[1]!r}")
    return poses


def check_joints(checker: CollisionChecker, joints: int) -> None:
    """Raise InputError unless the robot of a checker has so many joints."""
    if checker.robot.n != joints:
        raise InputError(f"needs a robot of {joints} joints, {checker.robot.name!r} has {checker.robot.n}")


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
        As of all pictures, see `safe_ompl.view.plots`.

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
        page.set_title(title)
    return page.figure


def _levels(values: FloatArray) -> FloatArray:
    """Return levels between which the area shrinks evenly towards the arm."""
    finite = values[np.isfinite(values)]
    return np.geomspace(finite.min(), np.quantile(finite, _HIGHEST), _LEVELS)


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
