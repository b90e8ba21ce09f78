"""Support functions of convex bodies, and lower bounds of the distance of two of them along an axis.

A body is the Minkowski sum of the convex hull of its vertices, a box, a disc about its z axis and a ball, all in a frame
of its own: box, sphere, capsule, cylinder and polytope are exact. Its support in a direction n is the sum

    h(n) = max_k n·v_k + Σ_i |n_i| b_i + ρ √(n_x² + n_y²) + r.

For a unit axis n that points from body B to body A their distance is at least −h_A(−n) − h_B(n): the width of the slab
between them. Whatever axis is chosen, the bound holds.

Which vertex is extreme. A cube about the origin is divided into cells, g × g on each side. The directions through a cell
are the cone spanned by its corners c_1 … c_4; a vertex v that another one w beats in all of them, c_j·w ≥ c_j·v, is not
needed there. The few that remain are kept cell by cell, so that no vertex outside the list of its cell is ever extreme.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from safe_ompl.arrays import FloatArray, IntArray

Vector = tuple[float, float, float]

_STEPS = 12  # of the search for an axis
_TIGHT = 0.9  # of the distance: a bound as good as this is not improved any more
_TINY = 1e-24  # [m²] bodies nearer than its root overlap


class Bodies(NamedTuple):
    """Convex bodies; see the module.

    Attributes
    ----------
    joints : (G,)
        Number of the joint that carries each body; 0 is the world.
    rotations, translations : (G, 3, 3), (G, 3)
        Frame of each body in that of its joint.
    centres, reaches, extents : (G, 3), (G,), (G, 3)
        Centre, radius of the ball and half sides of the box about it that hold the body, in its own frame.
    boxes, discs, balls : (G, 3), (G,), (G,)
        Half sides b of the box, radius ρ of the disc and r of the ball.
    grids, first_cells : (G,), (G,)
        Cells g along a side of the cube, 0: a single cell for all directions; and where a body's cells begin.
    starts : (C + 1,)
        Where the vertices of each of the C cells begin.
    vertices : (E, 3)
        Vertices, cell by cell.
    """

    joints: IntArray
    rotations: FloatArray
    translations: FloatArray
    centres: FloatArray
    reaches: FloatArray
    extents: FloatArray
    boxes: FloatArray
    discs: FloatArray
    balls: FloatArray
    grids: IntArray
    first_cells: IntArray
    starts: IntArray
    vertices: FloatArray


class Poses(NamedTuple):
    """Bodies in the world: rotations (G, 3, 3), origins (G, 3) and centres (G, 3)."""

    rotations: FloatArray
    origins: FloatArray
    centres: FloatArray


# ------------------------------------------------------------------------------------------- extreme vertices


@njit(cache=True)
def cell_of(x: float, y: float, z: float, grid: int) -> int:
    """Return the cell of a direction: of six sides (±x, ±y, ±z) with grid × grid cells each."""
    if grid == 0:
        return 0
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        side, major, u, v = (0 if x > 0 else 1), ax, y, z
    elif ay >= az:
        side, major, u, v = (2 if y > 0 else 3), ay, z, x
    else:
        side, major, u, v = (4 if z > 0 else 5), az, x, y
    if major == 0.0:
        return 0
    half = 0.5 * grid
    column = min(int((u / major + 1.0) * half), grid - 1)
    row = min(int((v / major + 1.0) * half), grid - 1)
    return (side * grid + row) * grid + column


@njit(cache=True)
def _corner(side: int, u: float, v: float) -> Vector:
    sign = 1.0 if side % 2 == 0 else -1.0
    if side < 2:
        return sign, u, v
    if side < 4:
        return v, sign, u
    return u, v, sign


@njit(cache=True)
def extreme_vertices(vertices: FloatArray, grid: int) -> tuple[IntArray, IntArray]:
    """Return which of `vertices: (V, 3)` may be extreme in each cell: where the cells begin (6g² + 1,), and the indices.

    A rounding margin makes cells overlap: a direction on their border may be looked up in either.
    """
    V, cells = len(vertices), 6 * grid * grid
    starts, found = np.empty(cells + 1, np.intp), np.empty(16 * cells + V, np.intp)
    heights, total, kept = np.empty((V, 4)), np.empty(V), np.empty(V, np.intp)
    number, margin = 0, 1e-9
    for cell in range(cells):
        starts[cell] = number
        side, row, column = cell // (grid * grid), cell // grid % grid, cell % grid
        low_u, low_v = 2.0 * column / grid - 1.0 - margin, 2.0 * row / grid - 1.0 - margin
        width = 2.0 / grid + 2 * margin
        for j in range(4):
            x, y, z = _corner(side, low_u + width * (j % 2), low_v + width * (j // 2))
            for k in range(V):
                heights[k, j] = x * vertices[k, 0] + y * vertices[k, 1] + z * vertices[k, 2]
        for k in range(V):
            total[k] = -(heights[k, 0] + heights[k, 1] + heights[k, 2] + heights[k, 3])
        count = 0
        for k in np.argsort(total):  # what beats a vertex comes before it
            beaten = False
            for other in kept[:count]:
                if (
                    heights[other, 0] >= heights[k, 0]
                    and heights[other, 1] >= heights[k, 1]
                    and heights[other, 2] >= heights[k, 2]
                    and heights[other, 3] >= heights[k, 3]
                ):
                    beaten = True
                    break
            if not beaten:
                kept[count] = k
                count += 1
        if number + count > len(found):
            longer = np.empty(2 * (number + count), np.intp)
            longer[:number] = found[:number]
            found = longer
        found[number : number + count] = kept[:count]
        number += count
    starts[cells] = number
    return starts, found[:number].copy()


# ----------------------------------------------------------------------------------------------------- bounds


@njit(cache=True)
def support(bodies: Bodies, poses: Poses, g: int, x: float, y: float, z: float) -> Vector:
    """Return the point of body g, without its ball, that is farthest in the direction (x, y, z) of the world."""
    R = poses.rotations[g]
    a = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    b = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    c = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    cell = bodies.first_cells[g] + cell_of(a, b, c, bodies.grids[g])
    V = bodies.vertices
    best = bodies.starts[cell]
    most = a * V[best, 0] + b * V[best, 1] + c * V[best, 2]
    for k in range(best + 1, bodies.starts[cell + 1]):
        height = a * V[k, 0] + b * V[k, 1] + c * V[k, 2]
        if height > most:
            best, most = k, height
    u, v, w = V[best, 0], V[best, 1], V[best, 2]
    box, disc = bodies.boxes[g], bodies.discs[g]
    u += box[0] if a >= 0 else -box[0]
    v += box[1] if b >= 0 else -box[1]
    w += box[2] if c >= 0 else -box[2]
    if disc > 0:
        across = sqrt(a * a + b * b)
        if across > 0:
            u += disc * a / across
            v += disc * b / across
    o = poses.origins[g]
    return (
        R[0, 0] * u + R[0, 1] * v + R[0, 2] * w + o[0],
        R[1, 0] * u + R[1, 1] * v + R[1, 2] * w + o[1],
        R[2, 0] * u + R[2, 1] * v + R[2, 2] * w + o[2],
    )


@njit(cache=True)
def from_box(bodies: Bodies, poses: Poses, g: int, x: float, y: float, z: float) -> Vector:
    """Return the way from the box that holds body g to a point (x, y, z), in the world."""
    R, o, half = poses.rotations[g], poses.centres[g], bodies.extents[g]
    x, y, z = x - o[0], y - o[1], z - o[2]
    a = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    b = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    c = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    a -= min(max(a, -half[0]), half[0])
    b -= min(max(b, -half[1]), half[1])
    c -= min(max(c, -half[2]), half[2])
    return (
        R[0, 0] * a + R[0, 1] * b + R[0, 2] * c,
        R[1, 0] * a + R[1, 1] * b + R[1, 2] * c,
        R[2, 0] * a + R[2, 1] * b + R[2, 2] * c,
    )


@njit(cache=True)
def _nearest_on_segment(p: Vector, q: Vector) -> Vector:
    """Return the point of the segment p → q that is nearest to the origin."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    square = dx * dx + dy * dy + dz * dz
    if square <= 0.0:
        return p
    t = min(max(-(p[0] * dx + p[1] * dy + p[2] * dz) / square, 0.0), 1.0)
    return p[0] + t * dx, p[1] + t * dy, p[2] + t * dz


@njit(cache=True)
def _square(p: Vector) -> float:
    return p[0] * p[0] + p[1] * p[1] + p[2] * p[2]


@njit(cache=True)
def _nearest_on_triangle(p: Vector, q: Vector, r: Vector) -> Vector:
    """Return the point of the triangle p, q, r that is nearest to the origin."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu, pv = p[0] * ux + p[1] * uy + p[2] * uz, p[0] * vx + p[1] * vy + p[2] * vz
    area = uu * vv - uv * uv
    if area > 1e-12 * uu * vv:
        s, t = (uv * pv - vv * pu) / area, (uv * pu - uu * pv) / area
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            return p[0] + s * ux + t * vx, p[1] + s * uy + t * vy, p[2] + s * uz + t * vz
    best = _nearest_on_segment(p, r)
    for other in (_nearest_on_segment(q, r), _nearest_on_segment(p, q)):
        if _square(other) < _square(best):
            best = other
    return best


@njit(cache=True)
def distance_bound(
    bodies: Bodies, poses: Poses, A: int, B: int, axis: FloatArray, enough: float, least: float
) -> tuple[float, float]:
    """Return a lower and an upper bound of the distance [m] of bodies A and B, the lower one negative if they overlap.

    Gilbert's algorithm on the difference of the two, with the support point before the last one as a third corner. It
    begins with an axis from B to A, and ends as soon as the lower bound is `enough`, or tight, or the upper one shows
    that `least` cannot be reached; `axis: (3,)` is then the axis of the lower bound.
    """
    round_part = bodies.balls[A] + bodies.balls[B]
    x, y, z = axis[0], axis[1], axis[2]
    lower, upper = -np.inf, np.inf
    v = last = (0.0, 0.0, 0.0)
    for step in range(_STEPS):
        a = support(bodies, poses, A, -x, -y, -z)
        b = support(bodies, poses, B, x, y, z)
        w = a[0] - b[0], a[1] - b[1], a[2] - b[2]
        bound = (w[0] * x + w[1] * y + w[2] * z) / sqrt(x * x + y * y + z * z) - round_part
        if bound > lower:
            lower = bound
            axis[0], axis[1], axis[2] = x, y, z
        if lower >= enough or lower >= _TIGHT * upper:
            break
        if step == 0:
            v = w
        elif step == 1:
            v = _nearest_on_segment(v, w)
        else:
            v = _nearest_on_triangle(v, last, w)
        last = w
        square = _square(v)
        upper = sqrt(square) - round_part
        if upper <= least or square < _TINY:
            break
        x, y, z = v
    return lower, upper
