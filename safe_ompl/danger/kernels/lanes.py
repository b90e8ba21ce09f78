"""Skeletons at configurations side by side: kinematics, the field at a point of each, its gradient by the joints.

A processor works on several numbers at once where the same is done to each. So the last axis of all arrays here is
that of the lanes, `LANES` of them, of which loops run over whole groups of `GROUP`; a last one that is not full is
filled up with copies. The formulas are those of `robot.kernels` and of `field.py`, number for number.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, expanded, inlined, stack_array
from safe_ompl.danger.kernels.field import NEAR, ROUNDING, SERIES, ZERO, log1p_each

LANES, GROUP = 16, 4
_LARGEST = 1e300


class Frames(NamedTuple):
    """Of each joint, and of the base before them, R (m + 1, 9, W), o and z (m + 1, 3, W); key points (K, 3, W).

    Lengths of links (L, W) [m], and the largest coordinate of key points (W,). And room: what turns a joint, how far it
    slides, and where its parent is.
    """

    rotation: FloatArray
    origin: FloatArray
    axis: FloatArray
    places: FloatArray
    lengths: FloatArray
    reach: FloatArray
    turn: FloatArray
    slide: FloatArray
    above: FloatArray


class Sights(NamedTuple):
    """Points, one in each lane, seen from skeletons: which lane's skeleton, and which of the points it is, (W,).

    Fields there (W,); key points of the skeletons (K, 3, W) and lengths of links (L, W); rays from key points to the
    points (K, 3, W), and distances (K, W); and room.
    """

    seen_from: IntArray
    which: IntArray
    field: FloatArray
    places: FloatArray
    ray: FloatArray
    distance: FloatArray
    point: FloatArray
    lengths: FloatArray
    theta: FloatArray
    mantissa: FloatArray
    bits: IntArray
    power: FloatArray


class Pulls(NamedTuple):
    """Forces (K, 3, W) at key points, gradients by the joints (m, W), and room, wrenches (m + 1, 6, W) among it."""

    forces: FloatArray
    gradient: FloatArray
    wrench: FloatArray
    gap: FloatArray
    alive: FloatArray
    ends: FloatArray


@expanded
def new_frames(joints: int, keypoints: int, links: int) -> Frames:
    """Return room for so many joints, key points and links; the base has its place."""
    rotation, origin = stack_array((joints + 1, 9, LANES)), stack_array((joints + 1, 3, LANES))
    rotation[0], origin[0] = 0.0, 0.0
    for x in range(3):
        rotation[0, 4 * x] = 1.0
    return Frames(
        rotation, origin, stack_array((joints + 1, 3, LANES)), stack_array((keypoints, 3, LANES)),
        stack_array((links, LANES)), stack_array((LANES,)), stack_array((9, LANES)), stack_array((LANES,)),
        stack_array((12, LANES)),
    )  # fmt: skip


@expanded
def new_sights(keypoints: int, links: int) -> Sights:
    """Return room for points seen from skeletons of so many key points and links."""
    mantissa = stack_array((LANES,))
    return Sights(
        stack_array((LANES,)).view(np.intp), stack_array((LANES,)).view(np.intp), stack_array((LANES,)),
        stack_array((keypoints, 3, LANES)), stack_array((keypoints, 3, LANES)), stack_array((keypoints, LANES)),
        stack_array((3, LANES)), stack_array((links, LANES)), stack_array((LANES,)), mantissa, mantissa.view(np.int64),
        stack_array((LANES,)),
    )  # fmt: skip


@expanded
def new_pulls(joints: int, keypoints: int) -> Pulls:
    """Return room for the pulls at so many key points on so many joints."""
    return Pulls(
        stack_array((keypoints, 3, LANES)), stack_array((joints, LANES)), stack_array((joints + 1, 6, LANES)),
        stack_array((LANES,)), stack_array((LANES,)), stack_array((6, LANES)),
    )  # fmt: skip


@inlined
def place_lanes(joints: Any, keys: Any, links: IntArray, values: FloatArray, frames: Frames) -> int:
    """Write where joints and key points are at `values: (B ≤ W, m)`; return how many lanes are filled."""
    rotation, origin, axis, places, turn, slide, above = (
        frames.rotation, frames.origin, frames.axis, frames.places, frames.turn, frames.slide, frames.above
    )  # fmt: skip
    lanes = (len(values) + GROUP - 1) // GROUP * GROUP
    for i in range(len(joints)):
        joint, count = joints[i], len(values)
        a0, a1, a2 = joint.axis[0], joint.axis[1], joint.axis[2]
        t0, t1, t2 = joint.translation[0], joint.translation[1], joint.translation[2]
        own, up, here = joint.rotation, np.uintp(joint.parent), np.uintp(i + 1)
        m00, m01, m02 = own[0, 0], own[0, 1], own[0, 2]
        m10, m11, m12 = own[1, 0], own[1, 1], own[1, 2]
        m20, m21, m22 = own[2, 0], own[2, 1], own[2, 2]
        for b in range(count):
            q = values[b, i]
            slide[b] = q if joint.slides else 0.0
            turn[0, b], turn[1, b] = (1.0, 0.0) if joint.slides else (cos(q), sin(q))
        for b in range(count, lanes):
            slide[b], turn[0, b], turn[1, b] = slide[count - 1], turn[0, count - 1], turn[1, count - 1]
        for b in range(lanes):
            c, s = turn[0, b], turn[1, b]
            d = 1.0 - c
            turn[0, b], turn[1, b], turn[2, b] = d * a0 * a0 + c, d * a0 * a1 - s * a2, d * a0 * a2 + s * a1
            turn[3, b], turn[4, b], turn[5, b] = d * a1 * a0 + s * a2, d * a1 * a1 + c, d * a1 * a2 - s * a0
            turn[6, b], turn[7, b], turn[8, b] = d * a2 * a0 - s * a1, d * a2 * a1 + s * a0, d * a2 * a2 + c
        for x in range(9):
            for b in range(lanes):
                above[x, b] = rotation[up, x, b]
        for x in range(3):
            for b in range(lanes):
                above[9 + x, b] = origin[up, x, b]
        for x in range(3):
            for b in range(lanes):
                f0, f1, f2 = above[3 * x, b], above[3 * x + 1, b], above[3 * x + 2, b]
                r0 = f0 * m00 + f1 * m10 + f2 * m20
                r1 = f0 * m01 + f1 * m11 + f2 * m21
                r2 = f0 * m02 + f1 * m12 + f2 * m22
                along = r0 * a0 + r1 * a1 + r2 * a2
                axis[here, x, b] = along
                origin[here, x, b] = above[9 + x, b] + f0 * t0 + f1 * t1 + f2 * t2 + along * slide[b]
                rotation[here, 3 * x, b] = r0 * turn[0, b] + r1 * turn[3, b] + r2 * turn[6, b]
                rotation[here, 3 * x + 1, b] = r0 * turn[1, b] + r1 * turn[4, b] + r2 * turn[7, b]
                rotation[here, 3 * x + 2, b] = r0 * turn[2, b] + r1 * turn[5, b] + r2 * turn[8, b]
    for k in range(len(keys)):
        o0, o1, o2, on = keys[k].offset[0], keys[k].offset[1], keys[k].offset[2], np.uintp(keys[k].joint)
        for x in range(3):
            for b in range(lanes):
                f0, f1, f2 = rotation[on, 3 * x, b], rotation[on, 3 * x + 1, b], rotation[on, 3 * x + 2, b]
                places[k, x, b] = origin[on, x, b] + f0 * o0 + f1 * o1 + f2 * o2
    frames.reach[:] = 0.0
    for k in range(len(keys)):
        for b in range(lanes):
            farthest = max(abs(places[k, 0, b]), abs(places[k, 1, b]), abs(places[k, 2, b]))
            frames.reach[b] = max(frames.reach[b], farthest)
    for link in range(len(links)):
        first, last = np.uintp(links[link, 0]), np.uintp(links[link, 1])
        for b in range(lanes):
            x, y = places[last, 0, b] - places[first, 0, b], places[last, 1, b] - places[first, 1, b]
            z = places[last, 2, b] - places[first, 2, b]
            frames.lengths[link, b] = max(sqrt(x * x + y * y + z * z), ZERO)
    return lanes


@inlined
def see(frames: Frames, columns: FloatArray, count: int, sights: Sights) -> int:
    """Write what is seen from skeletons to so many points; return how many lanes are filled."""
    places = frames.places
    seen_from, which, ray, distance, point = sights.seen_from, sights.which, sights.ray, sights.distance, sights.point
    lanes = (count + GROUP - 1) // GROUP * GROUP
    for b in range(count, lanes):
        seen_from[b], which[b] = seen_from[count - 1], which[count - 1]
    for x in range(3):
        for b in range(lanes):
            point[x, b] = columns[x, np.uintp(which[b])]
        for k in range(len(places)):
            for b in range(lanes):
                sights.places[k, x, b] = places[k, x, np.uintp(seen_from[b])]
            for b in range(lanes):
                ray[k, x, b] = point[x, b] - sights.places[k, x, b]
    for k in range(len(places)):
        for b in range(lanes):
            x, y, z = ray[k, 0, b], ray[k, 1, b], ray[k, 2, b]
            distance[k, b] = sqrt(x * x + y * y + z * z)
    for link in range(len(sights.lengths)):
        for b in range(lanes):
            sights.lengths[link, b] = frames.lengths[link, np.uintp(seen_from[b])]
    return lanes


@inlined
def write_fields(links: IntArray, by_length: bool, lanes: int, sights: Sights) -> bool:
    """Write the fields at the points; return False if one of them is too near for that, as in `potentials`."""
    distance, lengths, theta, near = sights.distance, sights.lengths, sights.theta, 0
    sights.field[:] = 0.0
    for link in range(len(links)):
        first, last = np.uintp(links[link, 0]), np.uintp(links[link, 1])
        for b in range(lanes):
            theta[b] = 2.0 * lengths[link, b] / (distance[first, b] + distance[last, b] - lengths[link, b])
            near += 0 if 0.0 <= theta[b] <= NEAR else 1
        log1p_each(theta, sights.mantissa, sights.bits, sights.power, lanes)
        for b in range(lanes):
            sights.field[b] += theta[b] if by_length else 1.0 / lengths[link, b] * theta[b]
    return near == 0


@inlined
def write_pulls(
    links: IntArray, by_length: bool, weights: FloatArray, lanes: int, sights: Sights, pulls: Pulls
) -> None:
    """Write forces, the gradients of weights (W,) times the fields by the key points; none of a point on a segment.

    ∂φ/∂a = c e₁ − κ (b − a),  ∂φ/∂b = c e₂ + κ (b − a); by arc length ℓ times that, and ∓φ (b − a)/ℓ.
    """
    places, ray, distance, lengths, theta = sights.places, sights.ray, sights.distance, sights.lengths, sights.theta
    forces, gap, alive, ends = pulls.forces, pulls.gap, pulls.alive, pulls.ends
    forces[:], alive[:] = 0.0, 1.0
    for link in range(len(links)):
        first, last = np.uintp(links[link, 0]), np.uintp(links[link, 1])
        for b in range(lanes):
            for x in range(3):
                ends[x, b] = places[last, x, b] - places[first, x, b]
        for b in range(lanes):  # `half_gap`
            u0, u1, u2 = ray[first, 0, b], ray[first, 1, b], ray[first, 2, b]
            v0, v1, v2 = ray[last, 0, b], ray[last, 1, b], ray[last, 2, b]
            w0, w1, w2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
            d1, d2, along = distance[first, b], distance[last, b], u0 * v0 + u1 * v1 + u2 * v2
            product, area = d1 * d2, sqrt(w0 * w0 + w1 * w1 + w2 * w2)
            half = area * area / (product - along) if along < 0.0 else product + along
            touching = min(d1, d2) <= ROUNDING * max(d1, d2) or (along < 0.0 and area <= ROUNDING * product)
            alive[b] = 0.0 if touching or half <= 0.0 else alive[b]
            gap[b] = 1.0 if touching or half <= 0.0 else half
            theta[b] = min(lengths[link, b] * (d1 + d2 + lengths[link, b]) / gap[b], _LARGEST)
        log1p_each(theta, sights.mantissa, sights.bits, sights.power, lanes)
        for b in range(lanes):  # `slopes`
            S, c, square = distance[first, b] + distance[last, b], 1.0 / gap[b], lengths[link, b] * lengths[link, b]
            phi, y = theta[b] / lengths[link, b], (lengths[link, b] / S) ** 2
            total = 0.0
            for k in range(9, 0, -1):
                total = total * y + 2.0 * k / (2 * k + 1)
            kappa = (c * S - phi) / square if y > SERIES else 2.0 * total / (S * S * S)
            weight = weights[b] * (lengths[link, b] if by_length else 1.0)
            kappa += phi / square if by_length else 0.0
            near, far = weight * c / distance[first, b], weight * c / distance[last, b]
            for x in range(3):
                stretch = weight * kappa * ends[x, b]
                ends[x, b] = near * ray[first, x, b] - stretch
                ends[3 + x, b] = far * ray[last, x, b] + stretch
        for x in range(3):
            for b in range(lanes):
                forces[first, x, b] += ends[x, b]
            for b in range(lanes):
                forces[last, x, b] += ends[3 + x, b]
    for k in range(len(forces)):
        for x in range(3):
            for b in range(lanes):
                forces[k, x, b] = forces[k, x, b] if alive[b] > 0.0 else 0.0


@inlined
def pull_back_lanes(joints: Any, keys: Any, lanes: int, frames: Frames, forces: FloatArray, pulls: Pulls) -> None:
    """Write gradients by the joints of forces (K, 3, W) at the key points, as `robot.kernels.pull`."""
    origin, axis, places, wrench, gradient = frames.origin, frames.axis, frames.places, pulls.wrench, pulls.gradient
    wrench[:] = 0.0
    for k in range(len(keys)):
        on = np.uintp(keys[k].joint)
        for x in range(3):
            y, z = (x + 1) % 3, (x + 2) % 3
            for b in range(lanes):
                wrench[on, x, b] += forces[k, x, b]
            for b in range(lanes):
                wrench[on, 3 + x, b] += places[k, y, b] * forces[k, z, b] - places[k, z, b] * forces[k, y, b]
    for i in range(len(joints) - 1, -1, -1):
        up, here, slides = np.uintp(joints[i].parent), np.uintp(i + 1), joints[i].slides != 0
        for b in range(lanes):
            total = 0.0
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                turned = origin[here, y, b] * wrench[here, z, b] - origin[here, z, b] * wrench[here, y, b]
                total += axis[here, x, b] * (wrench[here, x, b] if slides else wrench[here, 3 + x, b] - turned)
            gradient[i, b] = total
        for x in range(6):
            for b in range(lanes):
                wrench[up, x, b] += wrench[here, x, b]


_FINE = 2.0**-24  # half a unit in the last place of float32


@inlined
def ceilings(
    frames: Frames, lane: int, links: IntArray, by_length: bool, points: Any, reach: float, distances: Any, out: Any
) -> None:
    """Write upper bounds (M,) of CDF(p) at points (3, M) in single precision, an eighth of the work of `potentials`.

    As log(1 + r) ≤ r (6 + r)/(6 + 4r), and r = 2ℓ/g with the gap g = S − ℓ, the field of a link is no larger than
    2 (3g + ℓ)/(g (3g + 4ℓ)); it falls with g. No coordinate of a point or key point is larger than R, those of points
    no larger than `reach`. So each difference of two coordinates is off by 3uR at most, u = 2⁻²⁴, the distance of two
    points by √3·3uR + 4u·√12 R < 20uR, and S − ℓ by less than 64uR, by which the gap is taken too small. What comes
    after that has relative errors of less than 16u, and u more for each link. The `distances: (K, M)` are room.
    """
    places, M, single, here = frames.places, points.shape[1], np.float32, np.uintp(lane)
    for k in range(len(places)):
        x, y, z = single(places[k, 0, here]), single(places[k, 1, here]), single(places[k, 2, here])
        for m in range(M):
            dx, dy, dz = points[0, m] - x, points[1, m] - y, points[2, m] - z
            distances[k, m] = np.sqrt(dx * dx + dy * dy + dz * dz)
    for m in range(M):
        out[m] = single(0.0)
    two, three = single(2.0 * (1.0 + (32.0 + len(links)) * _FINE)), single(3.0)
    least, infinite = single(1e-18), single(inf)
    error = single(64.0 * _FINE * max(reach, frames.reach[here]))
    for link in range(len(links)):
        a, b, length = np.uintp(links[link, 0]), np.uintp(links[link, 1]), single(frames.lengths[link, here])
        taken = length + error
        weight = two * (length if by_length else single(1.0))
        for m in range(M):
            gap = distances[a, m] + distances[b, m] - taken
            wide = three * gap + length
            bound = weight * wide / (gap * (wide + three * length))
            out[m] += bound if gap > least else infinite
