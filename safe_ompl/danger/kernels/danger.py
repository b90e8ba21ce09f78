"""The danger of configurations and its gradient in one loop: kinematics, field, aggregate, pull-back (paper §3).

With levels x_m = k₁ w_m Σ_l φ_l(p_m) the danger is their maximum, their mean, or (1/β) log Σ_m exp(β x_m).
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.danger.kernels.field import Skeleton, add_pull, new_block, potentials
from safe_ompl.danger.kernels.groups import (
    MAXIMUM,
    MEAN,
    Aggregate,
    Points,
    Room,
    highest_level,
    most_points,
    total_level,
)
from safe_ompl.robot.kernels import place_joints, place_keypoints, pull


class Tables(NamedTuple):
    """A robot's tables of joints (m,) and key points (K,) (`robot.kernels.kinematics`), links (L, 2), and weighting."""

    joints: Any
    keys: Any
    links: IntArray
    by_length: bool


@part
def _aggregate(levels: FloatArray, kind: int, sharpness: float) -> float:
    """Return the danger of `levels: (M ≥ 1,)`."""
    if kind == MEAN:
        total = 0.0
        for level in levels:
            total += level
        return total / len(levels)
    peak = levels[_highest(levels)]
    if kind == MAXIMUM:
        return float(peak)
    total = 0.0
    for level in levels:
        total += 1.0 if level == peak else exp(sharpness * (level - peak))
    return float(peak + log(total) / sharpness)


@part
def _highest(levels: FloatArray) -> int:
    """Return where the largest of `levels: (M ≥ 1,)` is, or the first that is no number."""
    best = 0
    for m in range(len(levels)):
        if levels[m] != levels[m]:
            return m
        if levels[m] > levels[best]:
            best = m
    return best


@part
def _shares(levels: FloatArray, kind: int, sharpness: float, out: FloatArray) -> None:
    """Write the derivatives (M,) of the danger by the levels."""
    if kind == MEAN:
        out[:] = 1.0 / len(levels)
        return
    best = _highest(levels)
    if kind == MAXIMUM:
        out[:] = 0.0
        out[best] = 1.0
        return
    peak, total = levels[best], 0.0
    for m in range(len(levels)):
        out[m] = 1.0 if levels[m] == peak else exp(sharpness * (levels[m] - peak))
        total += out[m]
    for m in range(len(levels)):
        out[m] /= total


@compiled
def dangers(
    tables: Tables, values: FloatArray, points: Points, aggregate: Aggregate, gradients: FloatArray
) -> FloatArray:
    """Return the danger (B,) at `values: (B, m)` of the joints, and write its gradients (B or 0, m).

    Points have columns (1 or B, 3, M ≥ 1) and charges (1 or B, M), the same or others for every configuration; without
    balls every point is looked at. Gradients are not written where there is no room; points on a link have none.
    """
    B, m = values.shape
    joints, keys, links, balls, kind = tables.joints, tables.keys, tables.links, points.balls, aggregate.kind
    M = points.charges.shape[1] if len(balls) == 0 else 0
    out, levels, share = np.empty(B), np.empty(M), np.empty(M)
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    places, forces = np.empty((len(keys), 3)), np.empty((len(keys), 3))
    skeleton = Skeleton(places, links, tables.by_length, new_block(len(keys)))
    known = np.empty((3, len(balls)))
    room = Room(np.empty((len(links), len(balls))), known, np.empty((1, most_points(balls))))
    sloped = len(gradients) > 0
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        own = points.columns[b if len(points.columns) > 1 else 0]
        charge = points.charges[b if len(points.charges) > 1 else 0]
        forces[:] = 0.0
        if len(balls) > 0:
            base, here = 0.0, Points(own, charge, balls)
            if kind != MEAN:
                base = highest_level(skeleton, here, room, forces, sloped and kind == MAXIMUM)
            out[b] = base
            if kind != MAXIMUM:
                out[b] = total_level(skeleton, here, aggregate, base, room, forces, sloped)
        else:
            potentials(skeleton, own, 0, M, levels.reshape(1, M))
            for k in range(M):
                levels[k] *= charge[k]
            out[b] = _aggregate(levels, kind, aggregate.sharpness)
            if sloped:
                _shares(levels, kind, aggregate.sharpness, share)
                for k in range(M):
                    if share[k] != 0.0:
                        add_pull(skeleton, own, k, charge[k] * share[k], forces)
        if sloped:
            pull(joints, keys, origin, axis, places, forces, gradients[b])
    return out


@compiled
def aggregates(levels: FloatArray, kind: int, sharpness: float) -> FloatArray:
    """Return the danger (B,) of levels (B, M ≥ 1)."""
    out = np.empty(len(levels))
    for b in range(len(levels)):
        out[b] = _aggregate(levels[b], kind, sharpness)
    return out


@compiled
def all_shares(levels: FloatArray, kind: int, sharpness: float) -> FloatArray:
    """Return the derivatives (B, M) of the danger by levels (B, M ≥ 1)."""
    out = np.empty(levels.shape)
    for b in range(len(levels)):
        _shares(levels[b], kind, sharpness, out[b])
    return out


class Ends(NamedTuple):
    """What is known of segments at one end of an interval: fields and distances, (L, M)."""

    fields: FloatArray
    distances: FloatArray


@compiled
def chords(
    first: Ends, last: Ends, h: float, speed: FloatArray, acceleration: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Return the ends (2, M) of straight lines that lie above Σ_l length_l·u_l(t) throughout an interval.

    Segments l whose points move smoothly for a time h, none faster than V (L,) or with more acceleration than A (L,),
    have the unit-weighted fields u = ∫₀¹ dτ/ρ_τ at a point p. They are multiplied by 1, or at least by their lengths
    (L,). Of two bounds of each u the lower one is taken. Seen from the nearer end no point moves farther than δ = Vh/2,
    so u ≤ U = max u·D/(D − δ) over both ends (`segment_bounds`): a level line. And along a curve 1/ρ has the second
    derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³ − a/ρ², for ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls
    below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥ −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak it needs a fifth of the intervals. The
    lines are infinite where a segment may reach the point.
    """
    L, M = first.fields.shape
    out = np.zeros((2, M))
    for k in range(L):
        half, weight = speed[k] * h / 2, lengths[k]
        for m in range(M):
            u1, u2, d1, d2 = (
                first.fields[k, m],
                last.fields[k, m],
                first.distances[k, m],
                last.distances[k, m],
            )
            left, right = d1 - half, d2 - half
            if left > 0 and right > 0:
                level = max(u1 * (d1 / left), u2 * (d2 / right))
                nearest = (left + right) / 2
                rise = level * ((speed[k] / nearest) ** 2 + acceleration[k] / nearest) * (h * h / 8)
                bent = max(u1, u2) + rise < level
                out[0, m] += weight * (u1 + rise if bent else level)
                out[1, m] += weight * (u2 + rise if bent else level)
            else:
                out[0, m] = out[1, m] = inf
    return out
