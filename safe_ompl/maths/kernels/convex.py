"""Bounds of the distance of two convex bodies, from their supports along an axis.

A body is the Minkowski sum of the convex hull of vertices, a box, a disc about its z axis and a ball, in a frame of its
own: so are boxes, spheres, capsules, cylinders and polytopes. Its support in a direction n is the sum of theirs,

    h(n) = max_k n·v_k + Σ_i |n_i| b_i + ρ √(n_x² + n_y²) + r.

For any unit axis n that points from body B to body A their distance is at least −h_A(−n) − h_B(n), the width of the slab
that separates them. A search only decides how good that bound is, never whether it holds.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, TypeAlias

import numpy as np
from numba import njit

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.extreme_vertices import cell_of

Records: TypeAlias = Any  # a structured array, or a row of one
Vector = tuple[float, float, float]

BODY = np.dtype(
    [
        ("joint", np.intp),  # number of the joint that carries it; 0: the world
        ("rotation", np.float64, (3, 3)),  # of its frame in that of the joint
        ("translation", np.float64, (3,)),
        ("centre", np.float64, (3,)),  # in its frame, of a ball that holds it,
        ("reach", np.float64),  # of this radius,
        ("extent", np.float64, (3,)),  # and of a box that holds it, of these half sides
        ("box", np.float64, (3,)),  # b
        ("disc", np.float64),  # ρ
        ("ball", np.float64),  # r
        ("grid", np.intp),  # of the lists of its vertices: see `extreme_vertices`
        ("first_cell", np.intp),  # its first list
    ],
    align=True,
)
POSE = np.dtype(
    [
        ("rotation", np.float64, (3, 3)),  # of a body in the world
        ("origin", np.float64, (3,)),
        ("centre", np.float64, (3,)),  # of the ball that holds it
    ],
    align=True,
)

_STEPS = 12  # of the search for an axis
_TIGHT = 0.9  # of the distance: a bound as good as this is not improved any more
_FLAT = 1e-12  # squared sine of an angle of triangles that count as segments
_OVERLAPPING = 1e-12  # [m] between bodies that count as overlapping


@njit(cache=True, inline="always")
def support(
    body: Records, pose: Records, starts: IntArray, vertices: FloatArray, x: float, y: float, z: float
) -> Vector:
    """Return the point of a body, without its ball, that is farthest in the direction (x, y, z) of the world."""
    R = pose.rotation
    a = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    b = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    c = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    cell = body.first_cell + cell_of(a, b, c, body.grid)
    best = starts[cell]
    most = a * vertices[best, 0] + b * vertices[best, 1] + c * vertices[best, 2]
    for k in range(best + 1, starts[cell + 1]):
        height = a * vertices[k, 0] + b * vertices[k, 1] + c * vertices[k, 2]
        if height > most:
            best, most = k, height
    box, disc = body.box, body.disc
    u = vertices[best, 0] + (box[0] if a >= 0 else -box[0])
    v = vertices[best, 1] + (box[1] if b >= 0 else -box[1])
    w = vertices[best, 2] + (box[2] if c >= 0 else -box[2])
    if disc > 0:
        across = sqrt(a * a + b * b)
        if across > 0:
            u += disc * a / across
            v += disc * b / across
    o = pose.origin
    return (
        R[0, 0] * u + R[0, 1] * v + R[0, 2] * w + o[0],
        R[1, 0] * u + R[1, 1] * v + R[1, 2] * w + o[1],
        R[2, 0] * u + R[2, 1] * v + R[2, 2] * w + o[2],
    )


@njit(cache=True)
def from_box(body: Records, pose: Records, point: FloatArray) -> Vector:
    """Return the way, in the world, from the box that holds a body to a point (3,)."""
    R, o, half = pose.rotation, pose.centre, body.extent
    x, y, z = point[0] - o[0], point[1] - o[1], point[2] - o[2]
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
def _square(p: Vector) -> float:
    return p[0] * p[0] + p[1] * p[1] + p[2] * p[2]


@njit(cache=True)
def _nearest_on_segment(p: Vector, q: Vector) -> Vector:
    """Return the point of the segment p → q that is nearest to the origin."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    square = dx * dx + dy * dy + dz * dz
    if not square > 0.0:
        return p
    t = min(max(-(p[0] * dx + p[1] * dy + p[2] * dz) / square, 0.0), 1.0)
    return p[0] + t * dx, p[1] + t * dy, p[2] + t * dz


@njit(cache=True)
def _nearest_on_triangle(p: Vector, q: Vector, r: Vector) -> Vector:
    """Return the point of the triangle p, q, r that is nearest to the origin."""
    ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu, pv = p[0] * ux + p[1] * uy + p[2] * uz, p[0] * vx + p[1] * vy + p[2] * vz
    area = uu * vv - uv * uv
    if area > _FLAT * uu * vv:
        s, t = (uv * pv - vv * pu) / area, (uv * pu - uu * pv) / area
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            return p[0] + s * ux + t * vx, p[1] + s * uy + t * vy, p[2] + s * uz + t * vz
    best = _nearest_on_segment(p, r)
    for other in (_nearest_on_segment(q, r), _nearest_on_segment(p, q)):
        if _square(other) < _square(best):
            best = other
    return best


@njit(cache=True)
def distance_bounds(
    body_a: Records,
    pose_a: Records,
    body_b: Records,
    pose_b: Records,
    starts: IntArray,
    vertices: FloatArray,
    axis: FloatArray,
    enough: float,
    least: float,
) -> tuple[float, float]:
    """Return a lower and an upper bound of the distance [m] of bodies a and b; both are ≤ 0 only if they overlap.

    Gilbert's algorithm on the difference of the two, with the support point before the last one as a third corner. It
    begins with an `axis: (3,)` from b to a, and ends as soon as the lower bound is `enough`, or tight, or the upper one
    shows that `least` cannot be reached; the best axis is left in `axis`.
    """
    balls = body_a.ball + body_b.ball
    x, y, z = axis[0], axis[1], axis[2]
    lower, upper = -inf, inf
    nearest = last = (0.0, 0.0, 0.0)
    for step in range(_STEPS):
        p = support(body_a, pose_a, starts, vertices, -x, -y, -z)
        q = support(body_b, pose_b, starts, vertices, x, y, z)
        new = p[0] - q[0], p[1] - q[1], p[2] - q[2]
        bound = (new[0] * x + new[1] * y + new[2] * z) / sqrt(x * x + y * y + z * z) - balls
        if bound > lower:
            lower = bound
            axis[0], axis[1], axis[2] = x, y, z
        if lower >= enough or lower >= _TIGHT * upper:
            break
        if step == 0:
            nearest = new
        elif step == 1:
            nearest = _nearest_on_segment(nearest, new)
        else:
            nearest = _nearest_on_triangle(nearest, last, new)
        last = new
        between = sqrt(_square(nearest))
        upper = between - balls
        if upper <= least or between < _OVERLAPPING:
            break
        x, y, z = nearest
    return lower, upper
