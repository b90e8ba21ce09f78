"""Configuration spaces of small arms: obstacles, paths and bubbles in joint angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.errors import InputError
from safe_ompl.maths import bubbles
from safe_ompl.pictures.plots.isosurface import isosurface
from safe_ompl.pictures.plots.page import GREY, Page
from safe_ompl.pictures.plots.silhouette import draw_arm, draw_scene
from safe_ompl.pictures.style import planner_styles

_GRID_PIXELS = 181  # of a plane, along each side
_IN_COLLISION, _SHADE = "0.72", 0.22
_VOXELS = 45  # of a cube
_COLOURS = ("#0b62b4", "#7d2f91", "#00876a", "#b87a00")
_LIGHT = np.array([0.35, -0.5, 0.79])


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
        As of all pictures, see `safe_ompl.pictures.plots`.

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
        page.figure.suptitle(title, x=0.01, ha="left", fontsize=12, weight="bold")
    return page.figure


def plot_cspace_path(
    checker: CollisionChecker,
    paths: Mapping[str, ArrayLike],
    file: str | Path,
    *,
    title: str = "Paths in configuration space",
) -> Any:
    """Draw the cube of an arm's three joint angles, its obstacles, and paths in it (after Fig. 1 of the paper).

    Parameters
    ----------
    checker : CollisionChecker
        Of a robot of three joints.
    paths : mapping of str to (N, 3) array
        Planner name → way points [rad].
    file, title
        As of all pictures, see `safe_ompl.pictures.plots`.

    Raises
    ------
    InputError
        If the robot has not three joints, there is no path, or one has the wrong shape.
    """
    _need_joints(checker, 3)
    robot = checker.robot
    ways = {name: finite_array(path, (None, 3), f"path of {name}") for name, path in paths.items()}
    if not ways:
        raise InputError("no path to draw; give at least one")
    axis = [np.linspace(low, high, _VOXELS) for low, high in zip(robot.lower, robot.upper, strict=True)]
    grid = np.stack(np.meshgrid(*axis, indexing="ij"), axis=-1)
    clearance = [checker.distances(q).min(initial=np.inf) for q in grid.reshape(-1, 3)]
    vertices, faces = isosurface(np.reshape(clearance, grid.shape[:3]), robot.lower, robot.upper)
    with Page(file, 6.4, 6.0) as page:
        axes = page.figure.add_subplot(projection="3d", computed_zorder=False)
        _draw_solid(axes, vertices[faces])
        for name, style in planner_styles(ways).items():
            dashes = (0, style.dashes) if style.dashes else "-"
            line = {"color": style.colour, "linewidth": 2.6, "linestyle": dashes}
            axes.plot(
                *ways[name].T, **{**line, "color": "white", "linewidth": 4.6, "linestyle": "-"}, zorder=3
            )
            axes.plot(*ways[name].T, **line, label=name, zorder=4)
        first = next(iter(ways.values()))
        for q, colour, words in ((first[0], GREY, " start"), (first[-1], "black", " goal")):
            axes.plot(*q[:, None], "o", color=colour, markersize=7, zorder=5)
            axes.text(*q, words, zorder=6)
        for k, name in enumerate("xyz"):
            axes.set(**{f"{name}lim": (robot.lower[k], robot.upper[k])})
            axes.set(**{f"{name}label": f"{robot.joint_names[k]} [rad]"})
        axes.set_box_aspect(robot.upper - robot.lower, zoom=0.88)
        axes.view_init(elev=24, azim=-56)
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.98))
        axes.set_title(title)
    return page.figure


def _draw_solid(axes: Any, corners: FloatArray) -> None:
    """Draw quadrilaterals (F, 4, 3) in grey, lit from one side."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    shade = 0.55 + 0.35 * np.abs(normals @ _LIGHT)
    colours = np.column_stack([shade, shade, 1.03 * shade, np.full_like(shade, 0.5)])
    axes.add_collection3d(
        Poly3DCollection(corners, facecolors=np.clip(colours, 0, 1), linewidths=0, zorder=1)
    )


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
    _need_joints(checker, joints)
    poses = [finite_array(q, (joints,), "configuration") for q in configurations]
    if not poses:
        raise InputError("no configuration to draw; give at least one")
    for q in poses:
        pair = checker.colliding_pair(q)
        if pair is not None:
            raise InputError(f"{q.tolist()} has no bubble: {pair[0]!r} touches {pair[1]!r}")
    return poses


def _need_joints(checker: CollisionChecker, joints: int) -> None:
    if checker.robot.n != joints:
        raise InputError(f"needs a robot of {joints} joints, {checker.robot.name!r} has {checker.robot.n}")
