"""The largest kinetostatic danger of many points, found without closed forms at most of them; exact.

Points lie in groups, and these in blocks, as in `safe_ompl.danger.kernels.groups`. Of a ball of radius r whose centre c
is D > r from a link, whose points are no faster than V, every point p is D − r = R away at least: with U = φ(c)D/R

    φ(p) ≤ U,    φ̇(p) ≤ φ̇(c) + 2rVU/R²,    I(p) ≤ I(c) + 2rVU/R²,

as the ray's change moves 1/ρ² by no more than 2/ρ³. And as ‖v(t)‖ ≤ (1−t)‖v_a‖ + t‖v_b‖ and 1/ρ² ≤ 1/(Dρ)

    I(c) ≤ [‖v_a‖ φ + (‖v_b‖ − ‖v_a‖)((d_b − d_a)/ℓ² + sφ)]/D,    s = (c − a)·w/ℓ²,

d_a and d_b the distances from the link's ends. A point is a ball of radius 0: what is left of its bound then is I.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.danger.kernels.field import ZERO, potentials
from safe_ompl.danger.kernels.kinetostatic import link_parts
from safe_ompl.robot.kernels import move_joints, move_keypoints, place_joints, place_keypoints

_SLACK = 1 + 1e-7  # of rounding in the bounds
_LOST = 1e-7  # (S² − ℓ²)/S² below which too many digits of it are lost: then the bound is infinite
_SHORT = 1e-6  # [m] links that are as good as a point
_RIGID = 1e-9  # relative: links that become no longer than this do not


@part
def _bound(
    places: FloatArray,
    velocities: FloatArray,
    links: IntArray,
    points: FloatArray,
    offset: int,
    radii: FloatArray,
    tops: FloatArray,
    begin: int,
    end: int,
    ahead: float,
    spread: float,
    by_length: bool,
    room: FloatArray,
    bounds: FloatArray,
) -> None:
    """Write for each of a run of balls, or of points where `radii` is empty, a level that it does not exceed.

    Their centres are columns of `points: (3, ·)`, that of ball 0 the one at `offset`. `room: (L + 2K, ·)` is for the
    work: fields of the links; distances of the key points, and ρ·v/‖ρ‖ there.
    """
    fields, K = room[: len(links)], len(places)
    distances, heading = room[len(links) : len(links) + K], room[len(links) + K :]
    first_column = offset + begin
    potentials(places, links, points, first_column, offset + end, by_length, fields)
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
def _level(
    places: FloatArray,
    velocities: FloatArray,
    links: IntArray,
    points: FloatArray,
    m: int,
    ahead: float,
    spread: float,
    by_length: bool,
) -> float:
    """Return Σ φ + ahead·φ̇ + spread·I over the links at p_m."""
    w, D, u, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    total = 0.0
    for k in range(len(links)):
        i, j = links[k, 0], links[k, 1]
        for x in range(3):
            w[x] = places[j, x] - places[i, x]
            D[x] = velocities[j, x] - velocities[i, x]
            u[x] = points[x, m] - places[i, x]
            v[x] = points[x, m] - places[j, x]
        phi, rate, iso = link_parts(u, v, w, velocities[i], velocities[j], D, spread > 0)
        scale = sqrt(max(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], ZERO)) if by_length else 1.0
        total += inf if phi == inf else scale * (phi + ahead * rate + spread * iso)
    return total


@part
def _highest(bounds: FloatArray, begin: int, end: int) -> int:
    best = begin
    for g in range(begin, end):
        if bounds[g] > bounds[best]:
            best = g
    return best


@compiled
def highest(
    joints: Any,
    keys: Any,
    links: IntArray,
    values: FloatArray,
    rates: FloatArray,
    points: FloatArray,
    charges: FloatArray,
    balls: Any,
    by_length: bool,
    ahead: float,
    spread: float,
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the largest level charge·Σ(φ + ahead·φ̇ + spread·I) (B,), of which point, and key points (2, B, K, 3).

    Parameters
    ----------
    joints, keys, links
        The skeleton, as for `safe_ompl.danger.kernels.danger.dangers`.
    values, rates : ndarray, shape (B, m)
        Values of the joints and their rates; the key points have places and velocities.
    points, charges, balls
        Of `PointGroups`: columns (1, 3, ·), (1, M), and the balls that hold the points.
    by_length, ahead, spread
        Weighting of the links, and factors [s].
    """
    B, m = values.shape
    out, chosen, motions = np.empty(B), np.empty(B, dtype=np.int64), np.empty((2, B, len(keys), 3))
    own, charge, blocks = points[0], charges[0], balls[0].begin
    M, N = len(charge), len(balls)
    radii, tops, bounds = np.empty(N), np.empty(N), np.empty(N)
    levels, alone, most = np.empty(M), np.empty(0), max(blocks, N - blocks)
    for g in range(N):
        radii[g], tops[g] = balls[g].radius, balls[g].heaviest
        most = max(most, balls[g].end - balls[g].begin)
    room = np.empty((len(links) + 2 * len(keys), most))
    rotation, origin, axis, twists = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 6))
    for b in range(B):
        places, velocities = motions[0, b], motions[1, b]
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        move_joints(joints, rates[b], origin, axis, twists)
        move_keypoints(keys, twists, places, velocities)
        best, peak = 0, -inf
        if blocks == 1:
            bounds[0] = inf
        else:
            _bound(
                places,
                velocities,
                links,
                own,
                M,
                radii,
                tops,
                0,
                blocks,
                ahead,
                spread,
                by_length,
                room,
                bounds,
            )
        while True:
            block = _highest(bounds, 0, blocks)
            if bounds[block] <= peak:
                break
            begin, end = balls[block].begin, balls[block].end
            _bound(
                places,
                velocities,
                links,
                own,
                M,
                radii,
                tops,
                begin,
                end,
                ahead,
                spread,
                by_length,
                room,
                bounds,
            )
            bounds[block] = -inf
            while True:
                group = _highest(bounds, begin, end)
                if bounds[group] <= peak:
                    break
                bounds[group] = -inf
                first, last = balls[group].begin, balls[group].end
                _bound(
                    places,
                    velocities,
                    links,
                    own,
                    0,
                    alone,
                    charge,
                    first,
                    last,
                    ahead,
                    spread,
                    by_length,
                    room,
                    levels,
                )
                while True:
                    point = _highest(levels, first, last)
                    if levels[point] <= peak:
                        break
                    levels[point] = -inf
                    level = charge[point] * _level(
                        places, velocities, links, own, point, ahead, spread, by_length
                    )
                    if level > peak:
                        best, peak = point, level
        out[b], chosen[b] = peak, best
    return out, chosen, motions
