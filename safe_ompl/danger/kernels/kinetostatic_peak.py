"""The largest kinetostatic danger of many points, found without closed forms at most of them; exact.

Points lie in groups of neighbours. Of a ball of radius r whose centre c is D > r from a link, whose points are no
faster than V, every point p is D − r = R away at least: with U = φ(c)D/R

    φ(p) ≤ U,    φ̇(p) ≤ φ̇(c) + 2rVU/R²,    I(p) ≤ I(c) + 2rVU/R²,

as the ray's change moves 1/ρ² by no more than 2/ρ³. And as ‖v(t)‖ ≤ (1−t)‖v_a‖ + t‖v_b‖ and 1/ρ² ≤ 1/(Dρ)

    I(c) ≤ [‖v_a‖ φ + (‖v_b‖ − ‖v_a‖)((d_b − d_a)/ℓ² + sφ)]/D,    s = (c − a)·w/ℓ²,

d_a and d_b the distances from the link's ends. A point is a ball of radius 0: what is left of its bound then is I.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.danger.kernels.danger import Groups, Tables
from safe_ompl.danger.kernels.field import ZERO, Skeleton, new_block, potentials
from safe_ompl.danger.kernels.kinetostatic import link_sums
from safe_ompl.robot.kernels import move_joints, move_keypoints, place_joints, place_keypoints

_SLACK = 1 + 1e-7  # of rounding in the bounds
_LOST = 1e-7  # (S² − ℓ²)/S² below which too many digits of it are lost: then the bound is infinite
_SHORT = 1e-6  # [m] links that are as good as a point
_RIGID = 1e-9  # relative: links that become no longer than this do not


class SkeletonMotion(NamedTuple):
    """A skeleton whose key points have velocities (K, 3), and the factors of φ̇ and of I [s]."""

    skeleton: Skeleton
    velocities: FloatArray
    ahead: float
    spread: float


class _Balls(NamedTuple):
    """Balls whose centres are columns (3, ·), that of ball 0 the one at `offset`; none of `radii`: points.

    `tops` is the largest charge of each, and `bounds` takes levels that they do not exceed.
    """

    columns: FloatArray
    offset: int
    radii: FloatArray
    tops: FloatArray
    bounds: FloatArray


@part
def _bound(motion: SkeletonMotion, balls: _Balls, begin: int, end: int, room: FloatArray) -> None:
    """Write for each of a run of balls, or of points, a level that it does not exceed.

    `room: (L + 2K, ·)` is for the work: fields of the links; distances of the key points, and ρ·v/‖ρ‖ there.
    """
    skeleton, velocities, ahead, spread = motion.skeleton, motion.velocities, motion.ahead, motion.spread
    places, links, by_length = skeleton.places, skeleton.links, skeleton.by_length
    points, radii, tops, bounds = balls.columns, balls.radii, balls.tops, balls.bounds
    fields, K = room[: len(links)], len(places)
    distances, heading = room[len(links) : len(links) + K], room[len(links) + K :]
    first_column = balls.offset + begin
    potentials(skeleton, points, first_column, balls.offset + end, fields)
    for k in range(K):
        x, y, z = places[k, 0], places[k, 1], places[k, 2]
        vx, vy, vz = velocities[k, 0], velocities[k, 1], velocities[k, 2]
        for g in range(end - begin):
            c = first_column + g
            ux, uy, uz = points[0, c] - x, points[1, c] - y, points[2, c] - z
            distance = sqrt(ux * ux + uy * uy + uz * uz)
            distances[k, g] = distance
            heading[k, g] = (ux * vx + uy * vy + uz * vz) / distance
    bounds[begin:end] = 0.0
    for k in range(len(links)):
        i, j = links[k, 0], links[k, 1]
        squared = growth = first = last = 0.0
        for x in range(3):
            w = places[j, x] - places[i, x]
            squared += w * w
            growth += w * (velocities[j, x] - velocities[i, x])
            first += velocities[i, x] * velocities[i, x]
            last += velocities[j, x] * velocities[j, x]
        first, last, length = sqrt(first), sqrt(last), sqrt(max(squared, ZERO))
        swift, per_square = max(first, last), 1.0 / max(squared, ZERO)
        if length < _SHORT:
            first, last, growth, per_square = swift, swift, 0.0, 0.0
        stretches = abs(growth) > _RIGID * length * swift
        scale, faster = length if by_length else 1.0, last - first
        for g in range(end - begin):
            d1, d2 = distances[i, g], distances[j, g]
            phi, S = fields[k, g] / scale, d1 + d2
            half = 0.5 * (S - length) * (S + length)
            level = phi + ahead * (heading[i, g] + heading[j, g]) / half
            if stretches:
                level += ahead * growth * (S / half - phi) * per_square
            bounds[begin + g] += scale * level if half > _LOST * S * S else inf
        if not len(radii) and spread == 0.0:
            continue
        for g in range(end - begin):
            d1, d2, phi = distances[i, g], distances[j, g], fields[k, g] / scale
            along = 0.5 * (d1 * d1 + squared - d2 * d2)
            s = along * per_square
            t = min(max(s, 0.0), 1.0)
            distance = sqrt(max(d1 * d1 - t * (2.0 * along - t * squared), 0.0))
            level = spread * (first * phi + faster * ((d2 - d1) * per_square + s * phi)) / distance
            if len(radii):
                radius = radii[begin + g]
                near = distance - radius
                far = radius / near
                level += phi * far + 2.0 * (ahead + spread) * swift * phi * distance * far / (near * near)
                level = level if near > 0.0 else inf
            bounds[begin + g] += scale * level
    for g in range(begin, end):
        level = max(bounds[g], 0.0) * tops[g] * _SLACK
        bounds[g] = level if level == level else inf  # ∞ − ∞ or 0·∞ where a point may be on a link


@part
def _highest(bounds: FloatArray, begin: int, end: int) -> int:
    best = begin
    for g in range(begin, end):
        if bounds[g] > bounds[best]:
            best = g
    return best


@compiled
def highest(
    tables: Tables, values: FloatArray, rates: FloatArray, points: Groups, ahead: float, spread: float
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    """Return the largest level charge·Σ(φ + ahead·φ̇ + spread·I) (B,), and of which point.

    Besides them places and velocities of the key points (B, K, 3). Joints have `values` and `rates` (B, m); `ahead` and
    `spread` are in seconds.
    """
    B, m = values.shape
    joints, keys, links = tables.joints, tables.keys, tables.links
    out, chosen, motions = np.empty(B), np.empty(B, dtype=np.int64), np.empty((2, B, len(keys), 3))
    columns, charges, begins = points.columns, points.charges, points.begins
    M, G = len(charges), len(points.radii)
    groups = _Balls(columns, M, points.radii, points.heaviest, np.empty(G))
    alone = _Balls(columns, 0, np.empty(0), charges, np.empty(M))
    most = G
    for g in range(G):
        most = max(most, begins[g + 1] - begins[g])
    room, place, memory = np.empty((len(links) + 2 * len(keys), most)), np.empty(3), new_block(len(keys))
    rotation, origin, axis, twists = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 6))
    for b in range(B):
        places, velocities = motions[0, b], motions[1, b]
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        move_joints(joints, rates[b], origin, axis, twists)
        move_keypoints(keys, twists, places, velocities)
        motion = SkeletonMotion(Skeleton(places, links, tables.by_length, memory), velocities, ahead, spread)
        best, peak = 0, -inf
        _bound(motion, groups, 0, G, room)
        while True:
            group = _highest(groups.bounds, 0, G)
            if groups.bounds[group] <= peak:
                break
            groups.bounds[group] = -inf
            first, last = begins[group], begins[group + 1]
            _bound(motion, alone, first, last, room)
            while True:
                point = _highest(alone.bounds, first, last)
                if alone.bounds[point] <= peak:
                    break
                alone.bounds[point] = -inf
                for x in range(3):
                    place[x] = columns[x, point]
                phi, rate, iso = link_sums(places, velocities, links, tables.by_length, place, spread > 0)
                level = inf if phi == inf else charges[point] * (phi + ahead * rate + spread * iso)
                if level > peak:
                    best, peak = point, level
        out[b], chosen[b] = peak, best
    return out, chosen, motions[0], motions[1]
