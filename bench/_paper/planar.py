"""Arms of two or three joints: danger field, bubbles, paths in configuration space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, bubbles
from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, finite_array
from safe_ompl.danger import DangerField
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.view.pictures.surface import RobotBody
from safe_ompl.view.plots.page import GREY, Page
from safe_ompl.view.style import Colour, planner_styles

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
        right.set(aspect="equal", xlim=(robot.lower[0], robot.upper[0]))
        right.set_ylim(robot.lower[1], robot.upper[1])
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
    levels = [(r[0] * abs(dx) + r[1] * abs(dy)) / d for r, d in zip(radii, distances, strict=True)]
    reach = np.max(levels, axis=0)
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
            edge = {"markeredgecolor": "0.1", "markeredgewidth": 2}
            axes.plot(0, 0, "o", color="white", markersize=9, zorder=5, **edge)
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


_VOXELS = 45  # of a cube
_LIGHT = np.array([0.35, -0.5, 0.79])


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

    Raises
    ------
    InputError
        If the robot has not three joints, there is no path, or one has the wrong shape.
    """
    check_joints(checker, 3)
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
            axes.plot(*ways[name].T, color="white", linewidth=4.6, zorder=3)
            look = {"color": style.colour, "linewidth": 2.6, "linestyle": dashes}
            axes.plot(*ways[name].T, **look, label=name, zorder=4)
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
    solid = Poly3DCollection(corners, facecolors=np.clip(colours, 0, 1), linewidths=0, zorder=1)
    axes.add_collection3d(solid)


Grid = TypeVar("Grid", FloatArray, BoolArray)

_CUBE_CORNERS = tuple(product((0, 1), repeat=3))  # of a cell
_EDGES = tuple((i, j) for i, j in combinations(range(8), 2) if (i ^ j).bit_count() == 1)


def isosurface(values: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the surface between negative and other values (A, B, C), as quadrilaterals (naive surface nets [1]_).

    Where negative values reach the border of the grid, whose corners are `lower` and `upper: (3,)`, the border closes
    the surface. Returned are vertices (V, 3), and the corners (F, 4) of each quadrilateral in order, either way round.

    References
    ----------
    .. [1] S. Gibson: Constrained elastic surface nets. MICCAI 1998.
    """
    padded = np.pad(values, 1, constant_values=float(np.abs(values).max(initial=0.0)) or 1.0)
    inside = padded < 0
    cells, vertices = _cell_vertices(padded, inside)
    number = np.full(np.array(padded.shape) - 1, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    faces = np.vstack([_faces(inside, number, axis) for axis in range(3)])
    share = np.clip((vertices - 1) / (np.array(values.shape) - 1), 0.0, 1.0)
    return lower + share * (upper - lower), faces


def _cell_vertices(values: FloatArray, inside: BoolArray) -> tuple[IntArray, FloatArray]:
    """Return the cells (V, 3) that the surface passes, and in each the mean (V, 3) of where it cuts the edges."""
    levels = np.stack([_shifted(values, corner) for corner in _CUBE_CORNERS], axis=-1)
    signs = np.stack([_shifted(inside, corner) for corner in _CUBE_CORNERS], axis=-1)
    cells = np.argwhere(signs.any(axis=-1) & ~signs.all(axis=-1))
    levels, signs = levels[tuple(cells.T)], signs[tuple(cells.T)]
    total, count = np.zeros((len(cells), 3)), np.zeros((len(cells), 1))
    for a, b in _EDGES:
        cut = signs[:, a] != signs[:, b]
        share = levels[cut, a] / (levels[cut, a] - levels[cut, b])
        start, end = np.array(_CUBE_CORNERS[a]), np.array(_CUBE_CORNERS[b])
        total[cut] += start + share[:, None] * (end - start)
        count[cut] += 1
    return cells, cells + total / count


def _shifted(grid: Grid, corner: tuple[int, ...]) -> Grid:
    """Return for every cell of the grid the value at one of its corners."""
    cells: Grid = grid[tuple(slice(c, size - 1 + c) for c, size in zip(corner, grid.shape, strict=True))]
    return cells


def _faces(inside: BoolArray, number: IntArray, axis: int) -> IntArray:
    """Return a quadrilateral (F, 4) across every edge along `axis` that the surface cuts."""
    here, there = np.moveaxis(inside, axis, 0)[:-1], np.moveaxis(inside, axis, 0)[1:]
    k, a, b = np.argwhere(here != there).T
    around = np.moveaxis(number, axis, 0)
    faces: IntArray = np.stack(
        [around[k, a - 1, b - 1], around[k, a, b - 1], around[k, a, b], around[k, a - 1, b]], axis=1
    )
    return faces
