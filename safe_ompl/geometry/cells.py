"""Cubic cells that cover balls: the collision geometry of large point clouds."""

from __future__ import annotations

from itertools import product
from math import ceil

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray

_HALF_DEPTH = 1 << 15  # an OcTree of coal has this many cells on each side of its origin, along each axis
_ROUNDING = 1e-9  # relative; a ball that comes this near to a cell counts as touching it
_SINGLE = 1.2e-7  # relative rounding of single precision
_TABLE = 1 << 25  # cells of a grid that is kept as a table


def touched_cells(centres: FloatArray, radius: float, edge: float) -> IntArray:
    """Return the cells of a grid that balls touch; their union contains the balls.

    Parameters
    ----------
    centres : ndarray, shape (N, 3)
        Centres of the balls [m].
    radius : float
        Radius of all of them [m].
    edge : float
        Edge of the cells [m]; the grid has a corner at the origin.

    Returns
    -------
    ndarray of int, shape (C, 3)
        Cell k covers [k·edge, (k + 1)·edge] along each axis. Each is touched by a ball, so that no point of the
        union is farther than √3·edge from one.
    """
    home = np.floor(centres / edge).astype(np.intp)
    reach = range(-ceil(radius / edge) - 1, ceil(radius / edge) + 2)
    low = home.min(axis=0) + reach[0]
    extent = home.max(axis=0) + reach[-1] + 1 - low
    stride = np.array([extent[1] * extent[2], extent[2], 1])
    first = (home - low) @ stride
    beyond = np.ascontiguousarray((centres - home * edge).T)  # (3, N), from 0 to edge
    # A coal tree rounds its extent to single precision: what it covers is grown by as much.
    limit = (radius * (1 + _ROUNDING) + _SINGLE * edge * float(extent.max())) ** 2
    # Squared distance, along each axis, of a ball's centre from the cells that are k cells away from its own.
    gaps = {
        k: np.square(np.maximum(np.maximum(k * edge - beyond, beyond - (k + 1) * edge), 0.0)) for k in reach
    }
    flat = _Numbers(int(extent.prod()))
    for i, j in product(reach, repeat=2):
        across = gaps[i][0] + gaps[j][1]
        if across.min() <= limit:
            for k in reach:
                flat.add(first[across + gaps[k][2] <= limit] + int(np.array([i, j, k]) @ stride))
    cells: IntArray = np.column_stack(np.unravel_index(flat.all(), tuple(extent))) + low
    return cells


class _Numbers:
    """A set of whole numbers from 0 to `count`: a table where that is small, else a list."""

    def __init__(self, count: int) -> None:
        self._table = np.zeros(count, dtype=bool) if count <= _TABLE else None
        self._lists: list[IntArray] = []

    def add(self, numbers: IntArray) -> None:
        if self._table is not None:
            self._table[numbers] = True
        else:
            self._lists.append(np.unique(numbers))

    def all(self) -> IntArray:
        """Return them in order, each once."""
        if self._table is not None:
            return np.asarray(np.flatnonzero(self._table), dtype=np.intp)
        numbers: IntArray = np.unique(np.concatenate(self._lists))
        return numbers


def cell_tree(cells: IntArray, edge: float) -> tuple[coal.OcTree, pin.SE3]:
    """Return a solid whose points are those of the `cells: (C, 3)`, and where it is.

    Raises
    ------
    InputError
        If the cells spread over more than coal's trees can hold.
    """
    middle = (cells.min(axis=0) + cells.max(axis=0)) // 2
    if np.abs(cells - middle).max() >= _HALF_DEPTH:
        extent = float(np.ptp(cells, axis=0).max() * edge)
        raise InputError(
            f"{edge:g} m is too fine for points that are {extent:g} m apart; give at least "
            f"{extent / _HALF_DEPTH / 2:.2g}, or leave the far ones out",
            "resolution",
        )
    tree = coal.makeOctree((cells - middle + 0.5) * edge, edge)
    tree.computeLocalAABB()
    return tree, pin.SE3(np.eye(3), middle * edge)


def occupied(points: FloatArray, edge: float) -> int:
    """Return how many cells of a grid hold a point at least."""
    return len(one_per_cell(points, edge))


def one_per_cell(points: FloatArray, edge: float) -> FloatArray:
    """Return the first of the points, shape (N, 3), in each cell of a grid; the order is kept."""
    home = np.floor((points - points.min(axis=0)) / edge).astype(np.intp)
    extent = home.max(axis=0) + 1
    flat = (home[:, 0] * extent[1] + home[:, 1]) * extent[2] + home[:, 2]
    chosen: FloatArray = points[np.sort(np.unique(flat, return_index=True)[1])]
    return chosen
