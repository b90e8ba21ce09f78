"""Compiled loops over pairs of bodies: which may be near, bounds of distances, nearest points, hinge costs."""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np

from safe_ompl.collision.kernels.tables import LANES, is_far, near_in_group
from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.geometry.kernels import (
    POSE,
    Records,
    Shapes,
    begin_axis,
    distance_bounds,
    from_box,
    nearest_in_simplex,
    outer_bound,
    place_bodies,
)
from safe_ompl.robot.kernels import place_joints


@compiled
def near_pairs(
    joints: Any,
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    nodes: Records,
    pairs: IntArray,
    certain: FloatArray,
    groups: Records,
    own: int,
    balls: FloatArray,
    values: FloatArray,
    margins: FloatArray,
    largest: float,
    spare: float,
    near: IntArray,
    poses: Records,
) -> tuple[int, bool]:
    """Write which of the pairs (P, 2) may be nearer than their margins (P,) [m]; return how many they are.

    The search ends at a pair that certainly is, which `True` tells: its two bodies are known exactly, where `certain:
    (P,)` is finite. No margin is above the largest. A pair is apart if a lower bound of its distance is more than its
    margin by `spare` [m]. The joints are at `values: (m,)`; they are a table (`safe_ompl.robot.kernels`), the next four
    those of `Shapes`, then come those of `Pairs`: Python would take longer to hand over tuples. `near: (P,)` takes the
    indices, in order; `poses: (G,)` are those of bodies that do not move, and room for others.
    """
    m, shapes, number = len(values), Shapes(bodies, starts, vertices, nodes), 0
    simplex, axis = np.empty((4, 3)), np.empty(3)
    some, hits = np.empty(len(pairs), np.intp), np.empty(LANES, np.bool_)
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    place_joints(joints, values, rotations, origins, joint_axes)
    place_bodies(bodies[:own], poses, rotations, origins, True)
    most, g = largest + spare, 0
    while g < len(groups):
        group, A = groups[g], groups[g].body
        if group.on > 1 and is_far(group.around, group.wide, bodies[A], poses[A], most):
            g += group.on
            continue
        g += 1
        for k in range(near_in_group(group, balls, bodies[A], poses[A], most, hits, some)):
            p = np.uintp(some[k])
            A, B, enough = pairs[p, 0], pairs[p, 1], margins[p] + spare
            if bodies[A].reach < inf and bodies[B].reach < inf:
                if outer_bound(bodies, poses, A, B, enough, axis) >= enough:
                    continue
                lower, upper, _ = distance_bounds(shapes, poses, A, B, axis, simplex, enough, margins[p])
                if lower >= enough:
                    continue
                if certain[p] < inf and upper <= margins[p]:
                    near[number] = p
                    return number + 1, True
            near[number] = p
            number += 1
    return number, False


@compiled
def pair_bounds(
    joints: Any, shapes: Shapes, pairs: IntArray, values: FloatArray, enough: float, bounds: FloatArray
) -> None:
    """Write lower bounds (B, K) of the distances of pairs (K, 2) [m] at `values: (B, m)` of the joints.

    The bounds of the balls and boxes about both bodies come first, then that along an axis (`geometry.kernels`). What
    is `enough` [m] is not improved any more. The `joints: (m,)` are a table (`safe_ompl.robot.kernels`).
    """
    m, bodies = values.shape[1], shapes.bodies
    poses, simplex, axis = np.empty(len(bodies), POSE), np.empty((4, 3)), np.empty(3)
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for row in range(len(values)):
        place_joints(joints, values[row], rotations, origins, joint_axes)
        if row == 0:
            place_bodies(bodies, poses, rotations, origins, False)
        place_bodies(bodies, poses, rotations, origins, True)
        for p in range(len(pairs)):
            A, B = pairs[p, 0], pairs[p, 1]
            lower = outer_bound(bodies, poses, A, B, enough, axis)
            if lower < enough:
                found, _, _ = distance_bounds(shapes, poses, A, B, axis, simplex, enough, enough)
                lower = max(lower, found)
            bounds[row, p] = lower if lower == lower else -inf


_ROOM = 64  # rows; more are made room for when they come


@compiled
def pairs_within(
    joints: Any, shapes: Shapes, pairs: IntArray, exact: BoolArray, values: FloatArray, within: float, error: float,
    least: bool,
) -> FloatArray:  # fmt: skip
    """Return which of the pairs (K, 2) of bodies are nearer than `within` [m] at `values: (B, m)` of the joints.

    Of each there are (C, 10) row, pair, distance, nearest point of the first body in the frame of the joint that
    carries it [m], unit normal from the second body to the first one in the world, and offset, the abscissa of the
    second one's nearest point along it [m], row by row. The distance of bodies that overlap is −∞, and nothing else is
    written then. Of pairs that are not `exact: (K,)`, both of them convex, there is only a lower bound of the distance,
    less an `error` [m]. If only the `least` distance is wanted, pairs are left out that are farther apart than an exact
    one before them.
    """
    m, bodies, number = values.shape[1], shapes.bodies, 0
    poses, simplex, found = np.empty(len(bodies), POSE), np.empty((4, 6)), np.empty((_ROOM, 10))
    axes, known, shares = np.empty((len(pairs), 3)), np.zeros(len(pairs), np.bool_), np.empty(3)
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for row in range(len(values)):
        place_joints(joints, values[row], rotations, origins, joint_axes)
        if row == 0:
            place_bodies(bodies, poses, rotations, origins, False)
        place_bodies(bodies, poses, rotations, origins, True)
        for p in range(len(pairs)):
            A, B, enough = pairs[p, 0], pairs[p, 1], within if exact[p] else within + error
            a, b = poses[A].centre, poses[B].centre
            x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
            far = enough + bodies[A].reach + bodies[B].reach
            if x * x + y * y + z * z >= far * far:
                continue
            u, v, w = from_box(bodies[B], poses[B], a)
            distance = sqrt(u * u + v * v + w * w) - bodies[A].reach
            if distance >= enough:
                continue
            if not known[p]:
                begin_axis(axes[p], u, v, w, x, y, z)
                known[p] = True
            lower, upper, corners = distance_bounds(
                shapes, poses, A, B, axes[p], simplex, enough, -inf if exact[p] else enough
            )
            if lower >= enough:
                continue
            if number == len(found):
                wider = np.empty((2 * number, 10))
                wider[:number] = found
                found = wider
            found[number, 0], found[number, 1] = row, p
            found[number, 2] = max(distance, lower) - error
            if exact[p]:
                found[number, 2] = lower if upper > -inf else -inf
                if upper > -inf:
                    _write_witness(bodies[A], simplex, corners, upper, rotations, origins, shares, found[number, 3:])
                within = min(within, lower) if least else within
            number += 1
    return found[:number].copy()


@part
def _write_witness(
    body: Any, simplex: FloatArray, corners: int, distance: float, rotations: FloatArray, origins: FloatArray,
    shares: FloatArray, found: FloatArray,
) -> None:  # fmt: skip
    """Write (7,) nearest point of the first body, normal and offset, by the simplex of its distance from the second."""
    x, y, z, corners = nearest_in_simplex(simplex, corners)
    length, joint = sqrt(x * x + y * y + z * z), body.joint - 1
    found[3], found[4], found[5], found[6] = x / length, y / length, z / length, -distance
    _shares_of_corners(simplex, corners, x, y, z, shares)
    for k in range(3):
        found[k] = -body.ball * found[3 + k]
        for corner in range(corners):
            found[k] += shares[corner] * simplex[corner, 3 + k]
        found[6] += found[3 + k] * found[k]
    if joint >= 0:
        x, y, z = found[0] - origins[joint, 0], found[1] - origins[joint, 1], found[2] - origins[joint, 2]
        for k in range(3):
            found[k] = rotations[joint, 0, k] * x + rotations[joint, 1, k] * y + rotations[joint, 2, k] * z


@part
def _shares_of_corners(S: FloatArray, corners: int, x: float, y: float, z: float, shares: FloatArray) -> None:
    """Write the shares (3,) with which up to three corners of a simplex make a point that lies between them."""
    shares[0], shares[1], shares[2] = 1.0, 0.0, 0.0
    ux, uy, uz = S[1, 0] - S[0, 0], S[1, 1] - S[0, 1], S[1, 2] - S[0, 2]
    px, py, pz = x - S[0, 0], y - S[0, 1], z - S[0, 2]
    uu, up = ux * ux + uy * uy + uz * uz, ux * px + uy * py + uz * pz
    if corners == 2:
        shares[1] = up / uu
    elif corners == 3:
        vx, vy, vz = S[2, 0] - S[0, 0], S[2, 1] - S[0, 1], S[2, 2] - S[0, 2]
        uv, vv, vp = ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz, vx * px + vy * py + vz * pz
        area = uu * vv - uv * uv
        shares[1], shares[2] = (vv * up - uv * vp) / area, (uu * vp - uv * up) / area
    shares[0] = 1.0 - shares[1] - shares[2]


@compiled
def hinge_costs(
    joints: Any, values: FloatArray, carriers: IntArray, near: FloatArray, hinges: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² (B,), its gradients (B, m), and vectors v (C, m) of Gauss-Newton.

    Σ vvᵀ approximates the Hessian. d_c = x·n_c − b_c is the distance of each of C points of bodies from a plane, at
    the row of `values: (B, m)` for which it was found; `near: (C, 10)` is what `pairs_within` returns, of pairs whose
    first bodies are carried by joints with Pinocchio's numbers, `carriers: (K,)`. Pairs in contact do not count.

    The `joints: (m,)` are a table (`safe_ompl.robot.kernels`), `hinges: (H, 2)` D > 0 and w. As in CHOMP and TrajOpt.
    """
    costs, gradients, m = np.zeros(len(values)), np.zeros(values.shape), len(joints)
    bends, place, placed = np.zeros((len(near), m)), np.empty(3), -1
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for c in range(len(near)):
        b, i, p, normal = int(near[c, 0]), carriers[int(near[c, 1])] - 1, near[c, 3:6], near[c, 6:9]
        if not near[c, 2] > 0.0:
            continue
        if b != placed:
            place_joints(joints, values[b], rotation, origin, axis)
            placed = b
        distance = -near[c, 9]
        for x in range(3):
            place[x] = p[x]
            if i >= 0:
                frame = rotation[i]
                place[x] = origin[i, x] + frame[x, 0] * p[0] + frame[x, 1] * p[1] + frame[x, 2] * p[2]
            distance += place[x] * normal[x]
        rate, bend = 0.0, 0.0
        for h in range(len(hinges)):
            reach, weight = hinges[h, 0], hinges[h, 1]
            lack = 1.0 - distance / reach
            if lack > 0.0:
                costs[b] += weight * lack * lack
                rate -= 2.0 * weight / reach * lack
                bend += 2.0 * weight / (reach * reach)
        while i >= 0 and bend > 0.0:
            slope = 0.0
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                turning = axis[i, y] * (place[z] - origin[i, z]) - axis[i, z] * (place[y] - origin[i, y])
                slope += normal[x] * (axis[i, x] if joints[i].slides else turning)
            gradients[b, i] += rate * slope
            bends[c, i] = sqrt(bend) * slope
            i = joints[i].parent - 1
    return costs, gradients, bends
