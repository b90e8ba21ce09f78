"""Which vertices of a body may be extreme, by direction: lists that supports are looked up in."""

from __future__ import annotations

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part

_OVERLAP = 1e-9  # of cells, so that a direction on their border may be looked up in either


@part
def cell_of(x: float, y: float, z: float, grid: int) -> int:
    """Return the cell of a direction: six sides (±x, ±y, ±z) of grid × grid cells; 0 where there is no grid."""
    if grid == 0:
        return 0
    ax, ay, az = abs(x), abs(y), abs(z)
    side, major, u, v = (4 if z > 0 else 5), az, x, y
    if ax >= ay and ax >= az:
        side, major, u, v = (0 if x > 0 else 1), ax, y, z
    elif ay >= az:
        side, major, u, v = (2 if y > 0 else 3), ay, z, x
    if not major > 0.0:
        return 0
    half = 0.5 * grid
    column = min(int((u / major + 1.0) * half), grid - 1)
    row = min(int((v / major + 1.0) * half), grid - 1)
    return (side * grid + row) * grid + column


@part
def _corner(side: int, u: float, v: float) -> tuple[float, float, float]:
    sign = 1.0 if side % 2 == 0 else -1.0
    if side < 2:
        return sign, u, v
    if side < 4:
        return v, sign, u
    return u, v, sign


@part
def _beats(heights: FloatArray, k: int, other: int) -> bool:
    """Return whether vertex k is as high as another one, or higher, in the directions of all corners."""
    return bool(
        heights[k, 0] >= heights[other, 0]
        and heights[k, 1] >= heights[other, 1]
        and heights[k, 2] >= heights[other, 2]
        and heights[k, 3] >= heights[other, 3]
    )


@compiled
def extreme_vertices(vertices: FloatArray, grid: int) -> tuple[IntArray, IntArray]:
    """Return where the list of each cell begins and the last one ends, (6g² + 1,), and the lists, indices (E,).

    `vertices: (V, 3)` are any points, those inside their hull drop out; `grid` is g ≥ 1. The cube about the origin is
    divided into cells, g × g on each side. The directions through a cell are the cone of its corners c_1 … c_4; a
    vertex v that another one w beats in all of them, c_j·w ≥ c_j·v, need not be looked at there. The few that remain
    are kept cell by cell: whatever the direction, the extreme vertex is in the list of its cell.
    """
    V, cells = len(vertices), 6 * grid * grid
    starts, found = np.empty(cells + 1, np.intp), np.empty(8 * cells + V, np.intp)
    heights, kept = np.empty((V, 4)), np.empty(V, np.intp)
    number = 0
    for cell in range(cells):
        starts[cell] = number
        side, row, column = cell // (grid * grid), cell // grid % grid, cell % grid
        width = 2.0 / grid
        for j in range(4):
            u = width * (column + j % 2) - 1.0 + (_OVERLAP if j % 2 else -_OVERLAP)
            v = width * (row + j // 2) - 1.0 + (_OVERLAP if j // 2 else -_OVERLAP)
            x, y, z = _corner(side, u, v)
            for k in range(V):
                heights[k, j] = x * vertices[k, 0] + y * vertices[k, 1] + z * vertices[k, 2]
        count = 0
        for k in range(V):
            remaining, beaten = 0, False
            for n in range(count):
                other = kept[n]
                if _beats(heights, other, k):
                    beaten = True
                    break
                if not _beats(heights, k, other):
                    kept[remaining] = other
                    remaining += 1
            if not beaten:
                kept[remaining] = k
                count = remaining + 1
        if number + count > len(found):
            longer = np.empty(2 * (number + count), np.intp)
            for n in range(number):
                longer[n] = found[n]
            found = longer
        for n in range(count):
            found[number + n] = kept[n]
        number += count
    starts[cells] = number
    return starts, found[:number].copy()
