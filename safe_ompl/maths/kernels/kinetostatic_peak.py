"""The largest kinetostatic danger of many points, found without closed forms at most of them; exact.

Points lie in groups, and these in blocks, as in `safe_ompl.maths.kernels.groups`. Of a ball of radius r whose centre c
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

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled, part
from safe_ompl.maths.kernels.field import potentials
from safe_ompl.maths.kernels.joint_motions import move_joints, move_keypoints
from safe_ompl.maths.kernels.joints import place_joints, place_keypoints
from safe_ompl.maths.kernels.kinetostatic import link_parts
from safe_ompl.maths.kernels.link import ZERO

_SLACK = 1 + 1e-7  # of rounding in the bounds
_LOST = 1e-7  # (S² − ℓ²)/S² below which too many digits of it are lost: then the bound is infinite
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
    fields: FloatArray,
    bounds: FloatArray,
) -> None:
    """Write for each of a run of balls a level that none of its points exceeds; `fields` is room for the work.

    Their centres are columns of `points: (3, ·)`, that of ball 0 the one at `offset`.
    """
    potentials(places, links, points, offset + begin, offset + end, by_length, fields)
    bounds[begin:end] = 0.0
    for k in range(len(links)):
        i, j = links[k, 0], links[k, 1]
        ax, ay, az = places[i, 0], places[i, 1], places[i, 2]
        wx, wy, wz = places[j, 0] - ax, places[j, 1] - ay, places[j, 2] - az
        px, py, pz = velocities[i, 0], velocities[i, 1], velocities[i, 2]
        qx, qy, qz = velocities[j, 0], velocities[j, 1], velocities[j, 2]
        squared = max(wx * wx + wy * wy + wz * wz, ZERO)
        length = sqrt(squared)
        first, last = sqrt(px * px + py * py + pz * pz), sqrt(qx * qx + qy * qy + qz * qz)
        swift = max(first, last)
        growth = wx * (qx - px) + wy * (qy - py) + wz * (qz - pz)
        growth = growth / squared if abs(growth) > _RIGID * length * swift else 0.0
        scale = length if by_length else 1.0
        per_length, per_square, faster = 1.0 / scale, 1.0 / squared, last - first
        for g in range(begin, end):
            c = offset + g
            ux, uy, uz = points[0, c] - ax, points[1, c] - ay, points[2, c] - az
            vx, vy, vz = ux - wx, uy - wy, uz - wz
            along, square = ux * wx + uy * wy + uz * wz, ux * ux + uy * uy + uz * uz
            d1, d2 = sqrt(square), sqrt(vx * vx + vy * vy + vz * vz)
            s = along * per_square
            t = min(max(s, 0.0), 1.0)
            nx, ny, nz = ux - t * wx, uy - t * wy, uz - t * wz
            distance = sqrt(nx * nx + ny * ny + nz * nz)
            room = distance - radii[g]
            S, product = d1 + d2, d1 * d2
            half = product + square - along
            phi = fields[k, g - begin] * per_length
            towards = (ux * px + uy * py + uz * pz) * d2 + (vx * qx + vy * qy + vz * qz) * d1
            away = 1.0 / (room * distance)
            level = phi * distance * distance * away
            rate = towards / (product * half)
            isotropic = (first * phi + faster * ((d2 - d1) * per_square + s * phi)) * (room * away)
            turned = 2.0 * radii[g] * swift * level * (distance * away) ** 2
            if growth != 0.0:
                rate += growth * (S / half - phi)
            level += ahead * (rate + turned) + spread * (isotropic + turned)
            sure = room > 0.0 and half > _LOST * S * S
            bounds[g] += scale * level if sure else inf
    for g in range(begin, end):
        bounds[g] = max(bounds[g], 0.0) * tops[g] * _SLACK


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
        The skeleton, as for `safe_ompl.maths.kernels.danger.dangers`.
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
    for g in range(N):
        radii[g], tops[g] = balls[g].radius, balls[g].heaviest
    levels, alone, fields = np.empty(M), np.zeros(M), np.empty((len(links), max(M, N)))
    rotation, origin, axis, twists = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 6))
    for b in range(B):
        places, velocities = motions[0, b], motions[1, b]
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        move_joints(joints, rates[b], origin, axis, twists)
        move_keypoints(keys, twists, places, velocities)
        best, peak = 0, -inf
        for stage in range(-1, blocks):
            # first the balls of all blocks, then block by block: their groups, and the points of these
            begin, end, block = 0, blocks, stage
            if stage >= 0:
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
                fields,
                bounds,
            )
            if stage < 0:
                continue
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
                    fields,
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
