"""Bounds of the distance of two convex bodies, from their supports along an axis, and of one from a solid of cells.

A body is the Minkowski sum of the convex hull of vertices, a box, a disc about its z axis and a ball, in a frame of its
own: so are boxes, spheres, capsules, cylinders and polytopes. Its support in a direction n is the sum of theirs,

    h(n) = max_k n·v_k + Σ_i |n_i| b_i + ρ √(n_x² + n_y²) + r.

For any unit axis n that points from body B to body A their distance is at least −h_A(−n) − h_B(n), the width of the
slab that separates them. A search only decides how good that bound is, never whether it holds.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, inlined, part
from safe_ompl.geometry.kernels.simplex import nearest_in_simplex
from safe_ompl.geometry.kernels.vertices import cell_of, extreme_vertices

__all__ = [
    "BODY",
    "NODE",
    "POSE",
    "Records",
    "Shapes",
    "Vector",
    "begin_axis",
    "distance_bound",
    "distance_bounds",
    "extreme_vertices",
    "farthest_from_axes",
    "from_box",
    "nearest_in_simplex",
    "outer_bound",
    "place_bodies",
    "place_still",
]

Records: TypeAlias = Any  # a structured array, or a row of one
Vector = tuple[float, float, float]

_NO_LENGTH = 1e-9  # [m]

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
        ("levels", np.intp),  # of a solid of cells: the body that is a cell of the lowest level; 0: it is no solid,
        ("root", np.intp),  # or its tree, which begins at this node, is not known
    ],
    align=True,
)


NODE = np.dtype(
    [
        ("centre", np.float64, (3,)),  # of a cell, in the frame of the solid
        ("level", np.intp),
        ("size", np.uintp),  # how many nodes it and those in it are, which follow it
    ],
    align=True,
)


class Shapes(NamedTuple):
    """Bodies (G,) of type `BODY`, and the lists of their vertices: starts (C + 1,) and vertices (E, 3).

    Of solids of cells there are trees of `nodes` of type `NODE`.
    """

    bodies: Records
    starts: IntArray
    vertices: FloatArray
    nodes: Records


POSE = np.dtype(
    [
        ("rotation", np.float64, (3, 3)),  # of a body in the world
        ("origin", np.float64, (3,)),
        ("centre", np.float64, (3,)),  # of the ball that holds it
    ],
    align=True,
)

_STEPS = 32  # of the search for an axis
_TIGHT = 0.9  # of the distance: a bound as good as this is not improved any more,
_EXACT = 1.0 - 1e-6  # and this where the nearest points are wanted
_OVERLAPPING = 1e-12  # [m] between bodies that count as overlapping


@part
def place_bodies(bodies: Records, poses: Records, rotations: FloatArray, origins: FloatArray, moving: bool) -> None:
    """Write the poses of the bodies that joints with these frames carry, or of those that none does."""
    for g in range(len(bodies)):
        joint = bodies[g].joint - 1
        if joint < 0:
            if not moving:
                place_still(bodies, poses, g)
            continue
        if not moving:
            continue
        R, o, c = poses[g].rotation, poses[g].origin, poses[g].centre
        own, t, centre = bodies[g].rotation, bodies[g].translation, bodies[g].centre
        for x in range(3):
            r, s, u = rotations[joint, x, 0], rotations[joint, x, 1], rotations[joint, x, 2]
            for y in range(3):
                R[x, y] = r * own[0, y] + s * own[1, y] + u * own[2, y]
            o[x] = origins[joint, x] + r * t[0] + s * t[1] + u * t[2]
            c[x] = o[x] + R[x, 0] * centre[0] + R[x, 1] * centre[1] + R[x, 2] * centre[2]


@part
def place_still(bodies: Records, poses: Records, g: int) -> None:
    """Write the pose of a body that no joint carries."""
    R, o, c = poses[g].rotation, poses[g].origin, poses[g].centre
    own, t, centre = bodies[g].rotation, bodies[g].translation, bodies[g].centre
    for x in range(3):
        for y in range(3):
            R[x, y] = own[x, y]
        o[x] = t[x]
        c[x] = o[x] + R[x, 0] * centre[0] + R[x, 1] * centre[1] + R[x, 2] * centre[2]


@part
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


@inlined
def _past_box(body: Records, pose: Records, point: FloatArray) -> Vector:
    """Return the way, in the frame of a body, from the box that holds it to a point (3,) of the world."""
    R, o, half = pose.rotation, pose.centre, body.extent
    x, y, z = point[0] - o[0], point[1] - o[1], point[2] - o[2]
    a = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    b = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    c = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    return (a - min(max(a, -half[0]), half[0]), b - min(max(b, -half[1]), half[1]), c - min(max(c, -half[2]), half[2]))


@part
def from_box(body: Records, pose: Records, point: FloatArray) -> Vector:
    """Return the way, in the world, from the box that holds a body to a point (3,)."""
    R, (a, b, c) = pose.rotation, _past_box(body, pose, point)
    return (
        R[0, 0] * a + R[0, 1] * b + R[0, 2] * c,
        R[1, 0] * a + R[1, 1] * b + R[1, 2] * c,
        R[2, 0] * a + R[2, 1] * b + R[2, 2] * c,
    )


@part
def begin_axis(axis: FloatArray, u: float, v: float, w: float, x: float, y: float, z: float) -> None:
    """Write a first separating axis (3,): the way (u, v, w) between box and ball, or else that between the centres."""
    if u * u + v * v + w * w < _NO_LENGTH**2:
        u, v, w = x, y, z + _NO_LENGTH
    axis[0], axis[1], axis[2] = u, v, w


@inlined
def outer_bound(bodies: Records, poses: Records, a: int, b: int, enough: float, axis: FloatArray) -> float:
    """Return a lower bound of the distance [m] of two bodies by balls and boxes about them; `enough` if it is that.

    Else the way from the box about one to the centre of the other is written as first separating `axis: (3,)`.
    """
    p, q, r, s = poses[a].centre, poses[b].centre, bodies[a].reach, bodies[b].reach
    x, y, z, far = p[0] - q[0], p[1] - q[1], p[2] - q[2], enough + r + s
    if x * x + y * y + z * z >= far * far:
        return enough
    (u, v, w), far = _past_box(bodies[b], poses[b], p), enough + r
    first = u * u + v * v + w * w
    if first >= far * far:
        return enough
    (u, v, w), far = _past_box(bodies[a], poses[a], q), enough + s
    second = u * u + v * v + w * w
    if second >= far * far:
        return enough
    lower: float = sqrt(first) - r
    if lower >= sqrt(second) - s:
        u, v, w = from_box(bodies[b], poses[b], p)
    else:
        lower, (u, v, w) = sqrt(second) - s, from_box(bodies[a], poses[a], q)
        u, v, w = -u, -v, -w
    begin_axis(axis, u, v, w, x, y, z)
    return lower


@part
def distance_bounds(
    shapes: Shapes, poses: Records, a: int, b: int, axis: FloatArray, simplex: FloatArray, enough: float, least: float
) -> tuple[float, float, int]:
    """Return a lower and an upper bound of the distance [m] of bodies a and b; −∞ as the upper one if they overlap.

    The algorithm of Gilbert, Johnson and Keerthi. It begins with an `axis: (3,)` from b to a, and ends as soon as the
    lower bound is `enough`, or tight and above `least`, or the upper one is not above `least`; the best axis is left in
    `axis`. `simplex: (4, 3)` is working memory. With six columns it has points of a − b, each beside the point of a,
    without its ball; the nearest point lies between so many of them as the last number says, and bounds are tight to
    a millionth then. Body b may be a solid of cells.
    """
    if shapes.bodies[b].levels > 0:
        return _cell_bounds(shapes, poses, a, b, axis, simplex, enough, least)
    return _convex_bounds(shapes, poses, a, b, axis, simplex, enough, least)


@part
def _convex_bounds(
    shapes: Shapes, poses: Records, a: int, b: int, axis: FloatArray, simplex: FloatArray, enough: float, least: float
) -> tuple[float, float, int]:
    """Return what `distance_bounds` does of two convex bodies."""
    body_a, pose_a, body_b, pose_b = shapes.bodies[a], poses[a], shapes.bodies[b], poses[b]
    starts, vertices = shapes.starts, shapes.vertices
    balls = body_a.ball + body_b.ball
    x, y, z = axis[0], axis[1], axis[2]
    lower, upper = -inf, inf
    corners, wide = 0, simplex.shape[1] == 6
    tight = _EXACT if wide else _TIGHT
    for _ in range(_STEPS):
        p = support(body_a, pose_a, starts, vertices, -x, -y, -z)
        q = support(body_b, pose_b, starts, vertices, x, y, z)
        u, v, w = p[0] - q[0], p[1] - q[1], p[2] - q[2]
        bound = (u * x + v * y + w * z) / sqrt(x * x + y * y + z * z) - balls
        if bound > lower:
            lower = bound
            axis[0], axis[1], axis[2] = x, y, z
        if lower >= enough or (lower > least and lower >= tight * upper):
            break
        simplex[corners, 0], simplex[corners, 1], simplex[corners, 2] = u, v, w
        if wide:
            simplex[corners, 3], simplex[corners, 4], simplex[corners, 5] = p
        x, y, z, corners = nearest_in_simplex(simplex, corners + 1)
        between = sqrt(x * x + y * y + z * z)
        if corners == 4 or between < _OVERLAPPING:
            return lower, -inf, corners
        upper = between - balls
        if upper <= least:
            break
    return lower, upper, corners


_GJK = 3  # the highest level at which more than balls and boxes are looked at
_FINE = 0.3  # of the distance beyond `least`: cells so small are not divided where bounds need not be tight


@part
def _place_cell(node: Records, solid: Records, pose: Records) -> None:
    """Write the pose of a cell of a solid at a pose, but for the rotation, which is the same."""
    c, R, o = node.centre, solid.rotation, solid.origin
    for x in range(3):
        pose.centre[x] = pose.origin[x] = o[x] + R[x, 0] * c[0] + R[x, 1] * c[1] + R[x, 2] * c[2]


@part
def _likely_cell(nodes: Records, root: int, solid: Records, point: FloatArray) -> Any:
    """Return a cell of the lowest level that may be near a point of the world: on each level the nearest one."""
    R, o = solid.rotation, solid.origin
    x, y, z = point[0] - o[0], point[1] - o[1], point[2] - o[2]
    a = R[0, 0] * x + R[1, 0] * y + R[2, 0] * z
    b = R[0, 1] * x + R[1, 1] * y + R[2, 1] * z
    c = R[0, 2] * x + R[1, 2] * y + R[2, 2] * z
    best: Any = root
    while nodes[best].level > 0:
        k, end, least = best + np.uintp(1), best + nodes[best].size, inf
        while k < end:
            middle = nodes[k].centre
            square = (middle[0] - a) ** 2 + (middle[1] - b) ** 2 + (middle[2] - c) ** 2
            if square < least:
                best, least = k, square
            k += nodes[k].size
    return best


@part
def _cell_bounds(
    shapes: Shapes, poses: Records, a: int, b: int, axis: FloatArray, simplex: FloatArray, enough: float, least: float
) -> tuple[float, float, int]:
    """Return what `distance_bounds` does of a convex body and a solid of cells.

    Cells that are not nearer than the nearest one so far are left out with all that are in them: by the balls about
    both, the ball about one and the box about the other, and by GJK. A likely one is looked at before all others.
    """
    body, pose, at, wide = shapes.bodies[a], poses[a], poses[a].centre, simplex.shape[1] == 6
    root: Any = np.uintp(shapes.bodies[b].root)
    nodes, first = shapes.nodes, shapes.bodies[b].levels
    end = root + nodes[root].size
    k = nearest = _likely_cell(nodes, root, poses[b], at)
    bound, upper, begun = enough, inf, False
    while k < end:
        here, k = k, k + nodes[k].size if begun else root
        begun, level = True, nodes[here].level
        cell, place = shapes.bodies[first + level], poses[first + level]
        _place_cell(nodes[here], poses[b], place)
        x, y, z = at[0] - place.centre[0], at[1] - place.centre[1], at[2] - place.centre[2]
        far = bound + cell.reach + body.reach
        if x * x + y * y + z * z >= far * far:
            continue
        u, v, w = from_box(body, pose, place.centre)
        far = bound + cell.reach
        if u * u + v * v + w * w >= far * far:
            continue
        u, v, w = from_box(cell, place, at)
        far = bound + body.reach
        if u * u + v * v + w * w >= far * far:
            continue
        lower, most = -inf, inf
        if level <= _GJK:
            begin_axis(axis, u, v, w, x, y, z)
            lower, most, _ = _convex_bounds(shapes, poses, a, first + level, axis, simplex, bound, least)
        if lower >= bound:
            continue
        if level > 0 and (wide or not 2.0 * cell.reach <= _FINE * (lower - max(least, 0.0))):
            k = here + np.uintp(1)
            continue
        bound, nearest = lower, here
        if level == 0:
            upper = min(upper, most)
            if upper <= least:
                break
    if not wide or not bound < enough:
        return bound, upper, 0
    place = poses[first]
    _place_cell(nodes[nearest], poses[b], place)
    begin_axis(axis, 0.0, 0.0, 0.0, at[0] - place.centre[0], at[1] - place.centre[1], at[2] - place.centre[2])
    return _convex_bounds(shapes, poses, a, first, axis, simplex, inf, least)


@part
def distance_bound(
    shapes: Shapes, poses: Records, a: int, b: int, axis: FloatArray, simplex: FloatArray, enough: float
) -> float:
    """Return a lower bound of the distance [m] of bodies a and b; −∞ for what is no number.

    The bound of the balls about both bodies comes first, then that of the box about b and the ball about a, then that
    of `distance_bounds`. What is `enough` [m], or cannot be, is not improved any more. The best `axis: (3,)` is kept
    for the next call; zeros: there is none yet.
    """
    p, q, reach = poses[a].centre, poses[b].centre, shapes.bodies[a].reach
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    lower = sqrt(x * x + y * y + z * z) - reach - shapes.bodies[b].reach
    if lower < enough:
        u, v, w = from_box(shapes.bodies[b], poses[b], p)
        lower = max(lower, sqrt(u * u + v * v + w * w) - reach)
        if lower < enough:
            if axis[0] == 0.0 and axis[1] == 0.0 and axis[2] == 0.0:
                begin_axis(axis, u, v, w, x, y, z)
            found, _, _ = distance_bounds(shapes, poses, a, b, axis, simplex, enough, enough)
            lower = max(lower, found)
    return lower if lower == lower else -inf


@compiled
def farthest_from_axes(
    shapes: Shapes, centers: FloatArray, axes: FloatArray, radii: FloatArray, half_lengths: FloatArray, far: FloatArray
) -> None:
    """Write how far (G, m) [m] bodies that no joint carries are from m axes at most, wherever these may be.

    Axes are somewhere on cylinders about unit `axes: (m, 3)` through `centers: (m, 3)`, of such `radii: (m,)` and half
    lengths [m], as the ends of their links are; of infinite length: at their centers.
    """
    for g in range(len(shapes.bodies)):
        body = shapes.bodies[g]
        R, t, box, disc = body.rotation, body.translation, body.box, body.disc
        first, last = body.first_cell, body.first_cell + max(1, 6 * body.grid * body.grid)
        corners = 8 if box[0] + box[1] + box[2] + disc > 0.0 else 1
        for k in range(corners * (shapes.starts[last] - shapes.starts[first])):
            v = shapes.vertices[shapes.starts[first] + k // corners]
            x = v[0] + (box[0] + disc) * (1.0 - 2.0 * (k & 1))
            y = v[1] + (box[1] + disc) * (1.0 - (k & 2))
            z = v[2] + box[2] * (1.0 - 0.5 * (k & 4))
            for i in range(len(axes)):
                a = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0] - centers[i, 0]
                b = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1] - centers[i, 1]
                c = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2] - centers[i, 2]
                along = a * axes[i, 0] + b * axes[i, 1] + c * axes[i, 2]
                a, b, c = a - along * axes[i, 0], b - along * axes[i, 1], c - along * axes[i, 2]
                away = sqrt(a * a + b * b + c * c)
                if half_lengths[i] < inf:
                    away = sqrt((away + radii[i]) ** 2 + (abs(along) + half_lengths[i]) ** 2)
                far[g, i] = max(away + body.ball, far[g, i] if k > 0 else 0.0)
