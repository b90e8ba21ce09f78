"""The surface on which values on a grid are zero, for drawing."""

from __future__ import annotations

from itertools import combinations, product
from typing import TypeVar

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray, IntArray

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
