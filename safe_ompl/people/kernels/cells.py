"""A cubic grid of cells in which something may be: 64 cells of a row in a word of bits, known bodies, balls about them.

The first cell of a row is the lowest bit of its first word. Bits beyond the end of a row are 0.
"""

from __future__ import annotations

from math import floor, inf, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.geometry.kernels import Records, Shapes, distance_bounds, from_box, place_bodies

_LEVELS = 5  # of nodes in `cover`: the largest have 16 cells on a side
_COARSER = 1.5  # by which nodes may be larger where there are too many balls
_BLOCK = 4  # cells on a side of what is marked, or left out, at once
_ROW = (1 << _BLOCK) - 1  # bits of a row of these
_DIAGONAL = sqrt(0.75)  # from the middle of a cell to its corners, in edges


class Cells(NamedTuple):
    """A cubic grid of cells: its lowest corner (3,), the edge of a cell [m], and how many there are on a side."""

    low: FloatArray
    edge: float
    side: int


class Known(NamedTuple):
    """Bodies that cameras may see: shapes and poses; those of the robot (G,), and those that stand still (S,).

    The last body but one is a point, the last one a cell. `cells` (bits) hold a point of the robot or of these.
    """

    shapes: Shapes
    poses: Records
    robot: IntArray
    still: IntArray
    cells: IntArray


@compiled
def spread(words: IntArray, within: IntArray, steps: int) -> None:
    """Add in so many steps to cells (N, N, W) their neighbours, also across edges and corners, that are within."""
    N, last = len(words), words.shape[2] - 1
    row, size = last + 1, len(words) * (last + 1)
    wide, plane = np.zeros(size + 2 * row, np.int64), np.zeros((N + 2, size), np.int64)
    flat, allowed = words.reshape(N, size), within.reshape(N, size)
    for _ in range(steps):
        for i in range(N):
            for j in range(N):
                for k in range(row):
                    word = words[i, j, k]
                    near = word | word << 1 | (word >> 1 & 0x7FFFFFFFFFFFFFFF)
                    if k > 0:
                        near |= words[i, j, k - 1] >> 63 & 1
                    if k < last:
                        near |= words[i, j, k + 1] << 63
                    wide[(j + 1) * row + k] = near
            for m in range(size):
                plane[i + 1, m] = wide[m] | wide[m + row] | wide[m + 2 * row]
        for i in range(N):
            for m in range(size):
                flat[i, m] = (plane[i, m] | plane[i + 1, m] | plane[i + 2, m]) & allowed[i, m]


@compiled
def opened(words: IntArray) -> IntArray:
    """Return the cells (N, N, W) that are in a cube of 2 × 2 × 2 of them."""
    N, last = len(words), words.shape[2] - 1
    core, found = np.zeros((N + 1, N + 1, last + 1), np.int64), np.empty_like(words)
    for i in range(N - 1):
        for j in range(N - 1):
            for k in range(last, -1, -1):
                word = words[i, j, k] & words[i, j + 1, k] & words[i + 1, j, k] & words[i + 1, j + 1, k]
                after = 0
                if k < last:
                    after = words[i, j, k + 1] & words[i, j + 1, k + 1]
                    after &= words[i + 1, j, k + 1] & words[i + 1, j + 1, k + 1]
                core[i + 1, j + 1, k] = word & ((word >> 1 & 0x7FFFFFFFFFFFFFFF) | after << 63)
    for i in range(N):
        for j in range(N):
            before = 0
            for k in range(last + 1):
                word = core[i, j, k] | core[i, j + 1, k] | core[i + 1, j, k] | core[i + 1, j + 1, k]
                found[i, j, k] = word | word << 1 | (before >> 63 & 1)
                before = word
    return found


@compiled
def place(shapes: Shapes, poses: Records, rotations: FloatArray, origins: FloatArray, moving: bool) -> None:
    """Write the poses of the bodies that joints with these frames carry, or of those that none does."""
    place_bodies(shapes.bodies, poses, rotations, origins, moving)


@part
def apart(shapes: Shapes, poses: Records, body: int, other: int, wanted: float, memory: FloatArray) -> float:
    """Return an upper bound of the distance of two bodies if it is at most the wanted one; else infinity.

    The other body is at its middle, `memory: (5, 3)` is for the algorithm.
    """
    p, q = poses[other].centre, poses[body].centre
    x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    wide = wanted + shapes.bodies[other].reach
    if sqrt(x * x + y * y + z * z) - shapes.bodies[body].reach > wide:
        return inf
    u, v, w = from_box(shapes.bodies[body], poses[body], p)
    if sqrt(u * u + v * v + w * w) > wide:
        return inf
    axis = memory[4]
    axis[0], axis[1], axis[2] = x, y, z + 1e-9
    _, upper, _ = distance_bounds(shapes, poses, body, other, axis, memory[:4], wanted, wanted)
    return upper if upper <= wanted else inf


@compiled
def mark(known: Known, bodies: IntArray, cells: Cells, margin: float) -> IntArray:
    """Return the cells (N, N, W) that are proven to be within a margin [m] of one of some bodies.

    The distance of its middle decides for a block of 4 x 4 x 4 cells if all of them are nearer or farther.
    """
    shapes, poses, edge, N = known.shapes, known.poses, cells.edge, cells.side
    last, point = len(shapes.bodies) - 1, len(shapes.bodies) - 2
    marked, memory = np.zeros((N, N, (N + 63) // 64), np.int64), np.empty((5, 3))
    first, end, block = np.empty(3, np.intp), np.empty(3, np.intp), np.empty(3, np.intp)
    inner, outer = margin - (_BLOCK - 1) * _DIAGONAL * edge, margin + _BLOCK * _DIAGONAL * edge
    for g in bodies:
        far = shapes.bodies[g].reach + margin + edge
        for x in range(3):
            at = poses[g].centre[x] - cells.low[x]
            first[x] = min(max(floor((at - far) / edge), 0), N) // _BLOCK
            end[x] = -(-min(max(floor((at + far) / edge) + 1, 0), N) // _BLOCK)
        for block[0] in range(first[0], end[0]):
            for block[1] in range(first[1], end[1]):
                for block[2] in range(first[2], end[2]):
                    rows = marked[_BLOCK * block[0] :, _BLOCK * block[1] :, block[2] * _BLOCK >> 6]
                    shift, bits = block[2] * _BLOCK & 63, _ROW
                    for i in range(_BLOCK):
                        for j in range(_BLOCK):
                            bits &= rows[i, j] >> shift
                    if bits == _ROW:
                        continue
                    for x in range(3):
                        at = cells.low[x] + (block[x] + 0.5) * _BLOCK * edge
                        poses[point].origin[x] = poses[point].centre[x] = at
                    if apart(shapes, poses, g, point, outer, memory) > outer:
                        continue
                    whole = inner > 0.0 and apart(shapes, poses, g, point, inner, memory) <= inner
                    for i in range(_BLOCK):
                        for j in range(_BLOCK):
                            bits = _ROW if whole else rows[i, j] >> shift & _ROW
                            for k in range(0 if bits == _ROW else _BLOCK):
                                if not bits >> k & 1:
                                    for x, index in enumerate((i, j, k)):
                                        at = cells.low[x] + (_BLOCK * block[x] + index + 0.5) * edge
                                        poses[last].origin[x] = poses[last].centre[x] = at
                                    bits |= int(apart(shapes, poses, g, last, margin, memory) <= margin) << k
                            rows[i, j] |= bits << shift
    return marked


@compiled
def within_limbs(limbs: FloatArray, radii: FloatArray, cells: Cells, among: IntArray) -> tuple[IntArray, BoolArray]:
    """Return those among some cells (N, N, W) with middles within radii (M,) [m] of limbs (M, 2, 3).

    Then come the limbs (M,) that have such cells.
    """
    found, shown, N = np.zeros_like(among), np.zeros(len(limbs), np.bool_), cells.side
    first, end = np.empty(3, np.intp), np.empty(3, np.intp)
    for m in range(len(limbs)):
        start, way = limbs[m, 0], limbs[m, 1] - limbs[m, 0]
        squared = max((way * way).sum(), 1e-12)
        for c in range(3):
            low, high = min(start[c], limbs[m, 1, c]), max(start[c], limbs[m, 1, c])
            first[c] = min(max(floor((low - radii[m] - cells.low[c]) / cells.edge), 0), N)
            end[c] = min(max(floor((high + radii[m] - cells.low[c]) / cells.edge) + 1, 0), N)
        for i in range(first[0], end[0]):
            for j in range(first[1], end[1]):
                for k in range(first[2], end[2]):
                    if not among[i, j, k >> 6] >> (k & 63) & 1:
                        continue
                    x = cells.low[0] + (i + 0.5) * cells.edge - start[0]
                    y = cells.low[1] + (j + 0.5) * cells.edge - start[1]
                    z = cells.low[2] + (k + 0.5) * cells.edge - start[2]
                    share = min(max((x * way[0] + y * way[1] + z * way[2]) / squared, 0.0), 1.0)
                    x, y, z = x - share * way[0], y - share * way[1], z - share * way[2]
                    if x * x + y * y + z * z <= radii[m] ** 2:
                        found[i, j, k >> 6] |= 1 << (k & 63)
                        shown[m] = True
    return found, shown


@compiled
def cover(
    front: IntArray, seen: IntArray, others: IntArray, cells: Cells, known: Known, share: float, most: int
) -> tuple[FloatArray, IntArray]:
    """Return at most so many balls (M, 4) that hold the cells of a front, and for each (M,) what cells it holds.

    That is 1 if any of them was seen, and 2 if any is one of the others. A node of cells is one ball if its radius is
    at most a share of its distance from the robot, and its cells are balls of their own if not. The share, and then
    the smallest node, grows until there are no more than `most`.
    """
    N, edge = cells.side, cells.edge
    marks = np.zeros((_LEVELS, N // 2, N // 2, N // 2), np.uint8)  # 1: front, 2: seen, 4: others
    for i in range(N // 2):
        for j in range(N // 2):
            for k in range(N // 2):
                word, at = 2 * k >> 6, 2 * k & 63
                for x in range(2 * i, 2 * i + 2):
                    for y in range(2 * j, 2 * j + 2):
                        bits = front[x, y, word] >> at & 3
                        mark = (bits != 0) | 2 * (bits & seen[x, y, word] >> at != 0)
                        marks[1, i, j, k] |= mark | 4 * (bits & others[x, y, word] >> at != 0)
    for level in range(2, _LEVELS):
        for i in range(N >> level):
            for j in range(N >> level):
                for k in range(N >> level):
                    mark = 0
                    for x in range(2 * i, 2 * i + 2):
                        for y in range(2 * j, 2 * j + 2):
                            mark |= marks[level - 1, x, y, 2 * k] | marks[level - 1, x, y, 2 * k + 1]
                    marks[level, i, j, k] = mark
    found, kinds = np.empty((most, 4)), np.empty(most, np.intp)
    todo = np.empty((8 * _LEVELS, 4), np.intp)
    middle = np.empty(3)
    side, least = N >> (_LEVELS - 1), edge
    while True:
        count = 0
        for top in range(side**3):
            todo[0, 0], left = _LEVELS - 1, 1
            todo[0, 1], todo[0, 2], todo[0, 3] = top // side**2, top // side % side, top % side
            while left and count <= most:
                left -= 1
                level, i, j, k = todo[left, 0], todo[left, 1], todo[left, 2], todo[left, 3]
                if level:
                    kind = int(marks[level, i, j, k])
                else:
                    kind = front[i, j, k >> 6] >> (k & 63) & 1
                    kind |= (kind & seen[i, j, k >> 6] >> (k & 63)) << 1 | (
                        kind & others[i, j, k >> 6] >> (k & 63)
                    ) << 2
                if not kind:
                    continue
                size = edge * (1 << level)
                x, y, z = (
                    cells.low[0] + (i + 0.5) * size,
                    cells.low[1] + (j + 0.5) * size,
                    cells.low[2] + (k + 0.5) * size,
                )
                radius, away = sqrt(0.75) * size, inf
                middle[0], middle[1], middle[2] = x, y, z
                for g in known.robot:
                    a, b, c = from_box(known.shapes.bodies[g], known.poses[g], middle)
                    away = min(away, sqrt(a * a + b * b + c * c))
                if level == 0 or radius <= share * (away - radius) or radius < least:
                    if count < most:
                        found[count, 0], found[count, 1], found[count, 2], found[count, 3] = x, y, z, radius
                        kinds[count] = kind >> 1
                    count += 1
                    continue
                for which in range(8):
                    todo[left, 0], todo[left, 1] = level - 1, 2 * i + (which >> 2)
                    todo[left, 2], todo[left, 3] = 2 * j + (which >> 1 & 1), 2 * k + (which & 1)
                    left += 1
        if count <= most:
            return found[:count], kinds[:count]
        share *= _COARSER
        if share > 1.0:
            least *= 2
