"""The configuration space of an arm of three joints: obstacles and paths in it."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, product
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker
from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, finite_array
from safe_ompl.view.plots.page import GREY, Page
from safe_ompl.view.plots.planar import check_joints
from safe_ompl.view.style import planner_styles

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
    file, title
        As of all pictures, see `safe_ompl.view.plots`.

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


Grid = TypeVar("Grid", FloatArray, BoolArray)

_CUBE_CORNERS = tuple(product((0, 1), repeat=3))  # of a cell
_EDGES = tuple((i, j) for i, j in combinations(range(8), 2) if (i ^ j).bit_count() == 1)


def isosurface(values: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the surface between negative and other values, as quadrilaterals (naive surface nets [1]_).

    Where negative values reach the border of the grid, the border closes the surface.

    Parameters
    ----------
    values : ndarray, shape (A, B, C)
        Values at equal steps along each axis.
    lower, upper : ndarray, shape (3,)
        Where the first and the last values of each axis are.

    Returns
    -------
    vertices : ndarray, shape (V, 3)
    faces : ndarray of int, shape (F, 4)
        Corners of each quadrilateral, in order; seen from outside some go round to the left, some to the right.

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
