"""Depth images against a grid of cells: which are seen to be free, which hold what is not known, balls about them.

A pixel of depth d says that its ray is free up to d. Pixels come in square blocks; the `few`-th smallest depth of each
counts, and what is no depth counts as 0: nothing is seen there. A cell is free if the ball about it lies in front of
all blocks that it covers in the image. Smallest and largest depths of 2 × 2, 4 × 4, … blocks (a hierarchical depth
buffer: Greene, Kass & Miller, SIGGRAPH 1993) decide that for 64 cells at once where they agree: an image costs at most
65/64 looks at each cell of the grid, of 25 depths each.
"""

from __future__ import annotations

from math import floor, inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.geometry.kernels import Records, Shapes, distance_bounds, from_box, place_bodies

_WIDE = 4  # blocks on a side of what is looked at, before larger ones are taken
NODE = 4  # cells on a side of a node that is decided at once
_NONE, _ALL = -1, -2  # of the blocks of an image: what is beside it, and what is around the camera
_LEVELS = 5  # of nodes in `cover`: the largest have 16 cells on a side
_FLYING = 0.05  # [m]
_COARSER = 1.5  # by which nodes may be larger where there are too many balls


class View(NamedTuple):
    """A camera: focal lengths and principal point [px], side of a block [px], rotation and origin in the world."""

    focal: tuple[float, float]
    middle: tuple[float, float]
    block: int
    rotation: FloatArray
    origin: FloatArray


class SeenImage(NamedTuple):
    """Smallest and largest depths, less noise, of the blocks of an image and of larger ones, see `pyramid`."""

    view: View
    least: FloatArray
    most: FloatArray


class Cells(NamedTuple):
    """A cubic grid of cells: its lowest corner (3,), the edge of a cell [m], and how many there are on a side."""

    low: FloatArray
    edge: float
    side: int


@part
def _insert(depths: FloatArray, pixels: IntArray, depth: float, pixel: int) -> None:
    """Keep a depth and its pixel if it is one of the smallest ones, which are in order."""
    k = len(depths) - 1
    if depth >= depths[k]:
        return
    while k > 0 and depths[k - 1] > depth:
        depths[k], pixels[k] = depths[k - 1], pixels[k - 1]
        k -= 1
    depths[k], pixels[k] = depth, pixel


@compiled
def image_blocks(image: Any, block: int, few: int, near: float, far: float) -> tuple[FloatArray, IntArray]:
    """Return of each block of an image (H, W) the `few`-th smallest depth, and its pixel (row · W + column).

    Depths that are not finite, or less than `near`, are 0; none is larger than `far`. Less than that pixel by H · W is
    one between a near surface and one farther behind: the smallest depth is `_FLYING` less.
    """
    rows, columns = image.shape[0] // block, image.shape[1] // block
    found, where = np.empty((rows, columns)), np.empty((rows, columns), np.intp)
    depths, least = np.empty((block * block, columns), np.float32), np.empty((few, columns), np.float32)
    close, distant, rest = np.float32(near), np.float32(far), np.empty(columns, np.float32)
    for i in range(rows):  # all blocks of a row at once, which compilers turn into vector instructions
        least[:] = np.float32(inf)
        for k in range(block * block):
            row = image[i * block + k // block]
            for j in range(columns):
                depth = row[j * block + k % block]
                rest[j] = min(depth, distant) if close <= depth < np.float32(inf) else np.float32(0.0)
                depths[k, j] = rest[j]
            for m in range(few):
                for j in range(columns):
                    before, depth = least[m, j], rest[j]
                    least[m, j], rest[j] = min(before, depth), max(before, depth)
        for j in range(columns):
            found[i, j] = least[few - 1, j]
        for k in range(block * block - 1, -1, -1):
            pixel = (i * block + k // block) * image.shape[1] + k % block
            for j in range(columns):
                where[i, j] = pixel + j * block if depths[k, j] == least[few - 1, j] else where[i, j]
        for j in range(columns):
            where[i, j] -= image.size * (least[few - 1, j] - least[0, j] > _FLYING)
    return found, where


@compiled
def cloud_blocks(
    points: FloatArray, view: View, shape: tuple[int, int], few: int, near: float, far: float
) -> tuple[FloatArray, IntArray]:
    """Return the same of points (N, 3) in the frame of the camera; a block with fewer points than `few` is 0."""
    height, width = shape
    rows, columns = height // view.block, width // view.block
    depths, pixels = np.full((rows, columns, few), inf), np.zeros((rows, columns, few), np.intp)
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        if near <= z < inf and abs(x) < inf and abs(y) < inf:
            u = floor(view.focal[0] * x / z + view.middle[0] + 0.5)
            v = floor(view.focal[1] * y / z + view.middle[1] + 0.5)
            i, j = v // view.block, u // view.block
            if min(u, v) >= 0 and i < rows and j < columns:
                _insert(depths[i, j], pixels[i, j], min(z, far), v * width + u)
    found, where = np.zeros((rows, columns)), pixels[:, :, few - 1].copy()
    for i in range(rows):
        for j in range(columns):
            if depths[i, j, few - 1] < inf:
                found[i, j] = depths[i, j, few - 1]
                where[i, j] -= height * width * (depths[i, j, few - 1] - depths[i, j, 0] > _FLYING)
    return found, where


@compiled
def pyramid(depths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return smallest and largest depths (L, H, W) of 1, 2 × 2, 4 × 4, … blocks, at the upper left."""
    rows, columns = depths.shape
    levels, side = 1, max(rows, columns)
    while side > 1:
        levels, side = levels + 1, (side + 1) // 2
    least, most = np.zeros((levels, rows, columns)), np.zeros((levels, rows, columns))
    least[0], most[0] = depths, depths
    for level in range(1, levels):
        before = rows, columns
        rows, columns = (rows + 1) // 2, (columns + 1) // 2
        for i in range(rows):
            for j in range(columns):
                low, high = inf, 0.0
                for v in range(2 * i, min(2 * i + 2, before[0])):
                    for u in range(2 * j, min(2 * j + 2, before[1])):
                        low, high = min(low, least[level - 1, v, u]), max(high, most[level - 1, v, u])
                least[level, i, j], most[level, i, j] = low, high
    return least, most


@part
def _span(focal: float, middle: float, x: float, radius: float, near: float, far: float) -> tuple[float, float]:
    """Return between which pixels a ball is seen whose depths are between near and far."""
    low, high = x - radius, x + radius
    return (
        focal * low / (near if low < 0.0 else far) + middle + 0.5,
        focal * high / (far if high < 0.0 else near) + middle + 0.5,
    )


@part
def _window(view: View, shape: tuple[int, int, int], x: float, y: float, z: float, radius: float) -> int:
    """Return in one number which blocks a ball in the frame of the camera covers.

    That is `_NONE`, `_ALL`, or their first row and column, their level, how many more rows and columns there are, 2,
    and 1 if the image holds all of them.
    """
    near, far = z - radius, z + radius
    if far <= 0.0:  # behind the camera
        return _NONE
    if near <= 0.1 * radius:
        return _ALL
    _, rows, columns = shape
    left, right = _span(view.focal[0], view.middle[0], x, radius, near, far)
    top, bottom = _span(view.focal[1], view.middle[1], y, radius, near, far)
    a, b, c, d = left / view.block, right / view.block, top / view.block, bottom / view.block
    if b < 0.0 or a >= columns or d < 0.0 or c >= rows:
        return _NONE
    whole = a >= 0.0 and b < columns and c >= 0.0 and d < rows
    j, k = int(max(a, 0.0)), int(min(b, columns - 1.0))
    h, i = int(max(c, 0.0)), int(min(d, rows - 1.0))
    level = 0
    while max(k - j, i - h) > _WIDE:
        j, k, h, i, level = j // 2, k // 2, h // 2, i // 2, level + 1
    return h << 40 | j << 20 | level << 8 | (i - h) << 5 | (k - j) << 2 | 2 | int(whole)


@compiled
def clear_seen(image: SeenImage, cells: Cells, radius: float, windows: IntArray, occupied: BoolArray) -> None:
    """Take the inner cells out of occupied ones (N, N, N) about whose middles a ball lies in front of all depths.

    Nodes of 4 x 4 x 4 cells are decided at once where all depths over them agree, the cells of others one by one; empty
    ones are skipped, and looks end where they can decide nothing more. At worst each cell is looked at with 25 depths,
    and each node with 50: 26 for each cell, 6.8 million for 64 x 64 x 64.

    `windows: (N^3 + (N/4)^3,)` remembers which blocks are over a cell or a node: give zeros if the camera has moved, or
    the radius has changed. Then these are found anew at 8 divisions each, which takes twice as long as all else.
    """
    view, least, most = image
    N, edge, R = cells.side, cells.edge, view.rotation
    side = N // NODE
    for node in range(side**3):
        first = NODE * (node // side**2), NODE * (node // side % side), NODE * (node % side)
        wanted = False
        for i in range(first[0], first[0] + NODE):
            for j in range(first[1], first[1] + NODE):
                for k in range(first[2], first[2] + NODE):
                    wanted |= occupied[i, j, k]
        whole = False
        for which in range(-1, NODE**3 if wanted else -1):
            i, j, k = first
            at, offset, ball = N**3 + node, 0.5 * NODE, radius + sqrt(0.75) * edge * (NODE - 1)
            if which >= 0:
                i, j, k = i + which // NODE**2, j + which // NODE % NODE, k + which % NODE
                at, offset, ball = (i * N + j) * N + k, 0.5, radius
                if not occupied[i, j, k] or min(i, j, k) == 0 or max(i, j, k) == N - 1:
                    continue
                if whole:
                    occupied[i, j, k] = False
                    continue
            if windows[at] < 0 or (which >= 0 and windows[at] & 3 == 2):
                if which < 0 and windows[at] == _NONE:
                    break
                continue
            a = cells.low[0] + (i + offset) * edge - view.origin[0]
            b = cells.low[1] + (j + offset) * edge - view.origin[1]
            c = cells.low[2] + (k + offset) * edge - view.origin[2]
            z = R[0, 2] * a + R[1, 2] * b + R[2, 2] * c
            if windows[at] == 0:
                x, y = R[0, 0] * a + R[1, 0] * b + R[2, 0] * c, R[0, 1] * a + R[1, 1] * b + R[2, 1] * c
                windows[at] = _window(view, least.shape, x, y, z, ball)
            window = windows[at]
            behind, front = which < 0 and window != _ALL, window > 0 and window & 1 == 1
            if window > 0:
                top, left, level = window >> 40, window >> 20 & 0xFFFFF, window >> 8 & 0xFFF
                bottom, right = top + (window >> 5 & 7) + 1, left + (window >> 2 & 7) + 1
                far, near = z + ball, z - ball
                if which < 0:
                    for v in range(top, bottom):
                        for u in range(left, right):
                            front = front and least[level, v, u] >= far
                            behind = behind and most[level, v, u] < near
                        if not (front or behind):
                            break
                else:
                    for v in range(top, bottom):
                        for u in range(left, right):
                            front = front & (least[level, v, u] >= far)
                        if not front:
                            break
            if which >= 0:
                occupied[i, j, k] = not front
            elif behind:
                break
            else:
                whole = front


@compiled
def spread(words: Any, within: Any, steps: int) -> None:
    """Add in so many steps to cells (N, N, N), 16 in a word, their neighbours, also across edges, that are within."""
    N, last = len(words), words.shape[2] - 1
    rows = np.zeros((N + 2, N + 2, last + 1), words.dtype)
    for _ in range(steps):
        for i in range(N):
            for j in range(N):
                for k in range(last + 1):
                    word = words[i, j, k]
                    word |= word << 1 | word >> 1
                    if k > 0:
                        word |= words[i, j, k - 1] >> 15
                    if k < last:
                        word |= words[i, j, k + 1] << 15
                    rows[i + 1, j + 1, k] = word
        for i in range(N):
            for j in range(N):
                for k in range(last + 1):
                    word = 0
                    for x in range(i, i + 3):
                        word |= rows[x, j, k] | rows[x, j + 1, k] | rows[x, j + 2, k]
                    words[i, j, k] = word & within[i, j, k]


@compiled
def place(shapes: Shapes, poses: Records, rotations: FloatArray, origins: FloatArray, moving: bool) -> None:
    """Write the poses of the bodies that joints with these frames carry, or of those that none does."""
    place_bodies(shapes.bodies, poses, rotations, origins, moving)


@part
def _apart(shapes: Shapes, poses: Records, body: int, other: int, wanted: float, memory: FloatArray) -> float:
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
def mark(shapes: Shapes, poses: Records, bodies: IntArray, cells: Cells, margin: float, marked: BoolArray) -> None:
    """Mark the cells that are proven to be within a margin [m] of one of some bodies; the last body is a cell."""
    last, edge, N = len(shapes.bodies) - 1, cells.edge, cells.side
    pose, memory = poses[last], np.empty((5, 3))
    first, end = np.empty(3, np.intp), np.empty(3, np.intp)
    for g in bodies:
        far = shapes.bodies[g].reach + margin + edge
        for x in range(3):
            at = poses[g].centre[x] - cells.low[x]
            first[x] = min(max(floor((at - far) / edge), 0), N)
            end[x] = min(max(floor((at + far) / edge) + 1, 0), N)
        for i in range(first[0], end[0]):
            for j in range(first[1], end[1]):
                for k in range(first[2], end[2]):
                    if not marked[i, j, k]:
                        for x, index in enumerate((i, j, k)):
                            pose.origin[x] = pose.centre[x] = cells.low[x] + (index + 0.5) * edge
                        marked[i, j, k] = _apart(shapes, poses, g, last, margin, memory) <= margin


class Known(NamedTuple):
    """Bodies that cameras may see: shapes and poses; those of the robot (G,), and those that stand still (S,).

    The last body but one is a point. `cells` hold a point of the robot or of these.
    """

    shapes: Shapes
    poses: Records
    robot: IntArray
    still: IntArray
    cells: BoolArray


@compiled
def unexplained(
    view: View,
    depths: FloatArray,
    where: IntArray,
    shape: tuple[int, int],
    known: Known,
    margins: FloatArray,
    explained: FloatArray,
    cells: Cells,
) -> tuple[IntArray, BoolArray]:
    """Return how many blocks show in each cell a point that is not within its margin of what is known, and the others.

    `explained: (H, W, 4)` remembers of each block a point near what stands still, and how far that is at most.
    """
    shapes, poses = known.shapes, known.poses
    N = cells.side
    hits, memory = np.zeros((N, N, N), np.intp), np.empty((5, 3))
    owns, width, size = np.zeros(depths.shape, np.bool_), shape[1], shape[0] * shape[1]
    R, point = view.rotation, len(shapes.bodies) - 2
    at, index = poses[point].centre, np.empty(3, np.intp)
    for i in range(depths.shape[0]):
        for j in range(depths.shape[1]):
            d = depths[i, j]
            if d <= 0.0:
                continue
            flying = where[i, j] < 0
            pixel = where[i, j] + (size if flying else 0)
            x = d * (pixel % width - view.middle[0]) / view.focal[0]
            y = d * (pixel // width - view.middle[1]) / view.focal[1]
            inside = True
            for c in range(3):
                at[c] = view.origin[c] + R[c, 0] * x + R[c, 1] * y + R[c, 2] * d
                poses[point].origin[c] = at[c]
                index[c] = floor((at[c] - cells.low[c]) / cells.edge)
                inside = inside and 0 <= index[c] < N
            if not inside:
                continue
            own, margin = False, margins[i, j]
            if known.cells[index[0], index[1], index[2]]:
                before = explained[i, j]
                away = sqrt((at[0] - before[0]) ** 2 + (at[1] - before[1]) ** 2 + (at[2] - before[2]) ** 2)
                own = before[3] + away <= margin
                for g in known.robot:
                    if own:
                        break
                    own = _apart(shapes, poses, g, point, margin, memory) <= margin
                for g in known.still:
                    if own:
                        break
                    upper = _apart(shapes, poses, g, point, margin, memory)
                    if upper <= margin:
                        own = True
                        before[0], before[1], before[2], before[3] = at[0], at[1], at[2], max(upper, 0.0)
            owns[i, j] = own
            hits[index[0], index[1], index[2]] += not (own or flying)
    return hits, owns


@compiled
def cover(front: Any, cells: Cells, known: Known, share: float, most: int) -> tuple[FloatArray, IntArray]:
    """Return at most so many balls (M, 4) that hold the cells whose mark is not 0, and the marks (M,) in each, or-ed.

    A node of cells is one ball if its radius is at most a share of its distance from the robot, and its cells
    are balls of their own if not. The share, and then the smallest node, grows until there are no more than `most`.
    """
    N, edge = cells.side, cells.edge
    marks = np.zeros((_LEVELS, N, N, N), np.uint8)
    marks[0] = front
    for level in range(1, _LEVELS):
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
                if not marks[level, i, j, k]:
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
                        kinds[count] = marks[level, i, j, k]
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
