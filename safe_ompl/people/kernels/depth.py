"""Depth images against a grid of cells: which are seen to be free, which hold what is not known, balls about them.

A pixel of depth d says that its ray is free up to d. Pixels come in square blocks; the `few`-th smallest depth of each
counts, and what is no depth counts as 0: nothing is seen there. A cell is free if the ball about it lies in front of
all blocks that it covers in the image. Smallest and largest depths of 2 × 2, 4 × 4, … blocks (a hierarchical depth
buffer: Greene, Kass & Miller, SIGGRAPH 1993) decide that for 64 cells at once where they agree. Those of all squares of
2 × 2 and 4 × 4 are kept besides (a sparse table: Bender & Farach-Colton, LATIN 2000), so that a look at up to 5 × 5
takes 6 of them at most: an image costs at most 65/64 looks at each cell of the grid.
"""

from __future__ import annotations

from math import floor, inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.people.kernels.cells import Cells, Known, apart

_WIDE = 4  # blocks on a side of what is looked at, before larger ones are taken
NODE = 4  # cells on a side of a node that is decided at once
_NONE, _ALL = -1, -2  # of the blocks of an image: what is beside it, and what is around the camera
_FLYING = 0.05  # [m]
_CHUNK = 1024  # points
_PIXEL, _INFINITE = 0xFFFFFF, 0x7FF0000000000000  # of keys of depths: bits of the pixel, and what none reaches


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
    line, first = np.empty(block * columns, np.float32), np.empty(columns, np.int32)
    for i in range(rows):  # all blocks of a row at once, in plain loops, which compilers turn into vector instructions
        least[:] = np.float32(inf)
        for v in range(block):
            row = image[i * block + v]
            for j in range(block * columns):
                line[j] = min(row[j], distant) if close <= row[j] < np.float32(inf) else np.float32(0.0)
            for u in range(block):
                k = v * block + u
                for j in range(columns):
                    rest[j] = depths[k, j] = line[j * block + u]
                for m in range(few):
                    for j in range(columns):
                        before, depth = least[m, j], rest[j]
                        least[m, j], rest[j] = min(before, depth), max(before, depth)
        for k in range(block * block - 1, -1, -1):
            for j in range(columns):
                first[j] = np.int32(k) if depths[k, j] == least[few - 1, j] else first[j]
        for j in range(columns):
            found[i, j], k = least[few - 1, j], first[j]
            where[i, j] = (i * block + k // block) * image.shape[1] + k % block + j * block
            where[i, j] -= image.size * (least[few - 1, j] - least[0, j] > _FLYING)
    return found, where


@compiled
def cloud_blocks(
    points: FloatArray, view: View, shape: tuple[int, int], few: int, near: float, far: float
) -> tuple[FloatArray, IntArray]:
    """Return the same of points (N, 3) in the frame of the camera; a block with fewer points than `few` is 0.

    Depths are kept in whole numbers that have the same order, the last 24 bits of which are the pixel within the block:
    they are less than what they were by up to 2⁻²⁸ of it.
    """
    block, height, width = view.block, shape[0], shape[1]
    rows, columns = height // block, width // block
    depths, pixels, blocks = np.empty(_CHUNK), np.empty(_CHUNK, np.int32), np.empty(_CHUNK, np.int32)
    bits, least = depths.view(np.int64), np.full((rows * columns, few), _INFINITE)
    for start in range(0, len(points), _CHUNK):
        count = min(_CHUNK, len(points) - start)
        for k in range(count):  # a plain loop, which compilers turn into vector instructions
            x, y, z = points[start + k, 0], points[start + k, 1], points[start + k, 2]
            u = np.floor(view.focal[0] * x / z + view.middle[0] + 0.5)
            v = np.floor(view.focal[1] * y / z + view.middle[1] + 0.5)
            good = (near <= z) & (z < inf) & (u >= 0.0) & (u < columns * block) & (v >= 0.0) & (v < rows * block)
            i, j = np.floor(v / block), np.floor(u / block)
            blocks[k] = np.int32(i * columns + j) if good else np.int32(-1)
            pixels[k] = np.int32((v - i * block) * block + u - j * block) if good else np.int32(0)
            depths[k] = min(z, far)
        for k in range(count):
            key = bits[k] & ~_PIXEL | pixels[k]
            for m in range(few if blocks[k] >= 0 else 0):
                before = least[blocks[k], m]
                least[blocks[k], m], key = min(before, key), max(before, key)
    found, where = np.zeros((rows, columns)), np.zeros((rows, columns), np.intp)
    for i in range(rows):
        for j in range(columns):
            bits[0], bits[1] = least[i * columns + j, few - 1] & ~_PIXEL, least[i * columns + j, 0] & ~_PIXEL
            if depths[0] < inf:
                k = least[i * columns + j, few - 1] & _PIXEL
                found[i, j], where[i, j] = depths[0], (i * block + k // block) * width + j * block + k % block
                where[i, j] -= height * width * (depths[0] - depths[1] > _FLYING)
    return found, where


@compiled
def pyramid(depths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return smallest and largest depths (L, 3, H, W) of 1, 2 × 2, 4 × 4, … blocks, at the upper left.

    At 0 they are those of each, at 1 and 2 those of the square of 2 × 2 or 4 × 4 of them that begins there.
    """
    rows, columns = depths.shape
    levels, side = 1, max(rows, columns)
    while side > 1:
        levels, side = levels + 1, (side + 1) // 2
    least, most = np.empty((levels, 3, rows, columns)), np.empty((levels, 3, rows, columns))
    least[0, 0], most[0, 0] = depths, depths
    for level in range(levels):
        if level:
            before = rows, columns
            rows, columns = (rows + 1) // 2, (columns + 1) // 2
            for i in range(rows):
                for j in range(columns):
                    low, high = inf, 0.0
                    for v in range(2 * i, min(2 * i + 2, before[0])):
                        for u in range(2 * j, min(2 * j + 2, before[1])):
                            low, high = min(low, least[level - 1, 0, v, u]), max(high, most[level - 1, 0, v, u])
                    least[level, 0, i, j], most[level, 0, i, j] = low, high
        for s in range(1, 3):
            for i in range(rows - (1 << s) + 1):
                low, under = least[level, s - 1, i], least[level, s - 1, i + s]
                high, over = most[level, s - 1, i], most[level, s - 1, i + s]
                for j in range(columns - (1 << s) + 1):
                    least[level, s, i, j] = min(min(low[j], low[j + s]), min(under[j], under[j + s]))
                    most[level, s, i, j] = max(max(high[j], high[j + s]), max(over[j], over[j + s]))
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

    That is `_NONE`, `_ALL`, or their first row and column, their level, the size of squares that cover them, how many
    more rows and columns there are, 2, and 1 if the image holds all of them.
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
    square = 2 if min(k - j, i - h) > 2 else int(min(k - j, i - h) > 0)
    return h << 40 | j << 20 | level << 12 | square << 8 | (i - h) << 5 | (k - j) << 2 | 2 | int(whole)


@part
def _beside(depths: FloatArray, window: int, depth: float, farther: bool) -> bool:
    """Return whether all depths in a window are at least a depth, or, if not `farther`, less."""
    top, left, square = window >> 40, window >> 20 & 0xFFFFF, window >> 8 & 0xF
    there, last = depths[window >> 12 & 0xFF, square], 1 << square
    bottom, right = top + (window >> 5 & 7) + 1 - last, left + (window >> 2 & 7) + 1 - last
    v = top
    while True:
        u = left
        while True:
            if (there[v, u] >= depth) != farther:
                return False
            if u == right:
                break
            u = min(u + last, right)
        if v == bottom:
            return True
        v = min(v + last, bottom)


@compiled
def clear_seen(image: SeenImage, cells: Cells, radius: float, windows: IntArray, words: IntArray) -> None:
    """Take the inner cells out of occupied ones (N, N, W) about whose middles a ball lies in front of all depths.

    Nodes of 4 x 4 x 4 cells are decided at once where all depths over them agree, the cells of others one by one; empty
    ones are skipped, and looks end where they can decide nothing more. At worst each cell is looked at with 6 depths,
    and each node with 12: 1.6 million for 64 x 64 x 64.

    `windows: (N^3 + (N/4)^3,)` remembers which blocks are over a cell or a node: give zeros if the camera has moved, or
    the radius has changed. Then these are found anew at 8 divisions each, which takes twice as long as all else.
    """
    view, least, most = image
    N, edge, R = cells.side, cells.edge, view.rotation
    side, size = N // NODE, (least.shape[0], least.shape[2], least.shape[3])
    ball = radius + sqrt(0.75) * edge * (NODE - 1)
    for node in range(side**3):
        first = NODE * (node // side**2), NODE * (node // side % side), NODE * (node % side)
        word, shift = first[2] >> 6, first[2] & 63
        wanted = 0
        for i in range(first[0], first[0] + NODE):
            for j in range(first[1], first[1] + NODE):
                wanted |= words[i, j, word]
        if not wanted >> shift & 15:
            continue
        a = cells.low[0] + (first[0] + 0.5 * NODE) * edge - view.origin[0]
        b = cells.low[1] + (first[1] + 0.5 * NODE) * edge - view.origin[1]
        c = cells.low[2] + (first[2] + 0.5 * NODE) * edge - view.origin[2]
        z = R[0, 2] * a + R[1, 2] * b + R[2, 2] * c
        at = N**3 + node
        if windows[at] == 0:
            x, y = R[0, 0] * a + R[1, 0] * b + R[2, 0] * c, R[0, 1] * a + R[1, 1] * b + R[2, 1] * c
            windows[at] = _window(view, size, x, y, z, ball)
        window, whole = windows[at], False
        if window == _NONE or (window > 0 and _beside(most, window, z - ball, False)):
            continue
        if window > 0 and window & 1 == 1:
            whole = _beside(least, window, z + ball, True)
        inner = 15 & ~(int(first[2] == 0) | int(first[2] == N - NODE) << NODE - 1)
        for i in range(max(first[0], 1), min(first[0] + NODE, N - 1)):
            for j in range(max(first[1], 1), min(first[1] + NODE, N - 1)):
                bits = words[i, j, word] >> shift & inner
                cleared, base = bits if whole else 0, NODE**3 * node + NODE * (NODE * (i % NODE) + j % NODE)
                while bits and not whole:
                    k = 0 if bits & 1 else 1 if bits & 2 else 2 if bits & 4 else 3
                    bits &= bits - 1
                    at = base + k
                    if windows[at] < 0 or windows[at] & 3 == 2:
                        continue
                    a = cells.low[0] + (i + 0.5) * edge - view.origin[0]
                    b = cells.low[1] + (j + 0.5) * edge - view.origin[1]
                    c = cells.low[2] + (first[2] + k + 0.5) * edge - view.origin[2]
                    z = R[0, 2] * a + R[1, 2] * b + R[2, 2] * c
                    if windows[at] == 0:
                        x, y = R[0, 0] * a + R[1, 0] * b + R[2, 0] * c, R[0, 1] * a + R[1, 1] * b + R[2, 1] * c
                        windows[at] = _window(view, size, x, y, z, radius)
                    window = windows[at]
                    if window > 0 and window & 1 == 1 and _beside(least, window, z + radius, True):
                        cleared |= 1 << k
                words[i, j, word] &= ~(cleared << shift)


class Errors(NamedTuple):
    """How far points may be off [m]: whatever their depth d, and by noise[0] + noise[1] d²."""

    margin: float
    noise: tuple[float, float]


@compiled
def unexplained(
    view: View,
    depths: FloatArray,
    where: IntArray,
    shape: tuple[int, int],
    known: Known,
    errors: Errors,
    explained: FloatArray,
    cells: Cells,
    possible: IntArray,
) -> tuple[IntArray, int, FloatArray]:
    """Return the cells (N, N, W) in which blocks show a point that is not within the errors of what is known.

    Then come how many of these blocks show it in cells that are not `possible`, and up to which depths (H, W) less
    noise blocks show nothing: that is a cell farther where they show what is known. `shape` is that of the image,
    `explained: (H, W, 4)` remembers of each block a point near what stands still, and how far that is at most.
    """
    shapes, poses = known.shapes, known.poses
    N, columns = cells.side, depths.shape[1]
    hits, strange, memory, last = np.zeros(possible.shape, np.int64), 0, np.empty((5, 3)), 0
    clear, farther, size = np.empty(depths.shape), sqrt(3.0) * cells.edge, shape[0] * shape[1]
    R, point = view.rotation, len(shapes.bodies) - 2
    at, line, index = poses[point].centre, np.empty((3, columns)), np.empty((3, columns))
    for i in range(depths.shape[0]):
        for j in range(columns):
            d, pixel = depths[i, j], float(where[i, j] + (size if where[i, j] < 0 else 0))
            row = floor(pixel / shape[1])
            x = d * (pixel - row * shape[1] - view.middle[0]) / view.focal[0]
            y = d * (row - view.middle[1]) / view.focal[1]
            for c in range(3):
                line[c, j] = view.origin[c] + R[c, 0] * x + R[c, 1] * y + R[c, 2] * d
                index[c, j] = np.floor((line[c, j] - cells.low[c]) / cells.edge)
        for j in range(columns):
            noise = errors.noise[0] + errors.noise[1] * (depths[i, j] * depths[i, j])
            clear[i, j] = max(depths[i, j] - noise, 0.0)
            least, most = min(index[0, j], index[1, j], index[2, j]), max(index[0, j], index[1, j], index[2, j])
            if depths[i, j] <= 0.0 or least < 0.0 or most >= N:
                continue
            a, b, c = int(index[0, j]), int(index[1, j]), int(index[2, j])
            word, bit, own, margin = c >> 6, c & 63, False, errors.margin + noise
            if known.cells[a, b, word] >> bit & 1:
                for x in range(3):
                    at[x] = poses[point].origin[x] = line[x, j]
                before = explained[i, j]
                away = sqrt((at[0] - before[0]) ** 2 + (at[1] - before[1]) ** 2 + (at[2] - before[2]) ** 2)
                own = before[3] + away <= margin
                for k in range(len(known.robot)):  # the body that explained the block before comes first
                    if own:
                        break
                    k = (k + last) % len(known.robot)
                    own = apart(shapes, poses, known.robot[k], point, margin, memory) <= margin
                    last = k if own else last
                for g in known.still:
                    if own:
                        break
                    upper = apart(shapes, poses, g, point, margin, memory)
                    if upper <= margin:
                        own = True
                        before[0], before[1], before[2], before[3] = at[0], at[1], at[2], max(upper, 0.0)
            if own:
                clear[i, j] = max(depths[i, j] - noise + farther, 0.0)
            elif where[i, j] >= 0:  # not flying
                hits[a, b, word] |= 1 << bit
                strange += 1 - (possible[a, b, word] >> bit & 1)
    return hits, strange, clear
