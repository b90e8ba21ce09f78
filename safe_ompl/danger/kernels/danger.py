"""The danger of configurations and its gradient in one loop: kinematics, field, aggregate, pull-back (paper §3).

With levels x_m = k₁ w_m Σ_l φ_l(p_m) the danger is their maximum, their mean, or (1/β) log Σ_m exp(β x_m).
"""

from __future__ import annotations

from math import exp, inf, log
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.danger.kernels.field import add_pull, potentials
from safe_ompl.danger.kernels.groups import MAXIMUM, MEAN, highest_level, most_points, total_level
from safe_ompl.robot.kernels import place_joints, place_keypoints, pull


@part
def aggregate(levels: FloatArray, kind: int, sharpness: float) -> float:
    """Return the danger of `levels: (M ≥ 1,)`."""
    if kind == MEAN:
        total = 0.0
        for level in levels:
            total += level
        return total / len(levels)
    peak = levels[highest(levels)]
    if kind == MAXIMUM:
        return float(peak)
    total = 0.0
    for level in levels:
        total += 1.0 if level == peak else exp(sharpness * (level - peak))
    return float(peak + log(total) / sharpness)


@part
def highest(levels: FloatArray) -> int:
    """Return where the largest of `levels: (M ≥ 1,)` is, or the first that is no number."""
    best = 0
    for m in range(len(levels)):
        if levels[m] != levels[m]:
            return m
        if levels[m] > levels[best]:
            best = m
    return best


@part
def shares(levels: FloatArray, kind: int, sharpness: float, out: FloatArray) -> None:
    """Write the derivatives (M,) of the danger by the levels."""
    if kind == MEAN:
        out[:] = 1.0 / len(levels)
        return
    best = highest(levels)
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
    joints: Any,
    keys: Any,
    links: IntArray,
    values: FloatArray,
    points: FloatArray,
    charges: FloatArray,
    balls: Any,
    by_length: bool,
    kind: int,
    sharpness: float,
    tolerance: float,
    gradients: FloatArray,
) -> FloatArray:
    """Return the danger (B,) at configurations, and write its gradients.

    Parameters
    ----------
    joints, keys, links
        The skeleton: tables (m,) and (K,), see `safe_ompl.robot.kernels.kinematics`, and pairs (L, 2) of key points.
    values : ndarray, shape (B, m)
        Values of the joints.
    points : ndarray, shape (1 or B, 3, M ≥ 1)
        Danger points, the same or others for every configuration; after them the centres of the balls.
    charges : ndarray, shape (1 or B, M)
        k₁w of each point.
    balls : ndarray, shape (N,)
        Those that hold the points, see `safe_ompl.danger.kernels.groups`; none: every point is looked at.
    by_length, kind, sharpness
        Weighting of the links; `MAXIMUM`, `MEAN` or `SOFTMAX`; β.
    tolerance : float
        Relative error that a mean or a softmax over points in balls may have.
    gradients : ndarray, shape (B, m) or (0, m)
        Where ∂danger/∂q is written, unless there is no room; points on a link have none.
    """
    B, m = values.shape
    M = charges.shape[1] if len(balls) == 0 else 0
    out, levels, share = np.empty(B), np.empty(M), np.empty(M)
    rotation, origin, axis = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    places, forces = np.empty((len(keys), 3)), np.empty((len(keys), 3))
    fields, known = np.empty((len(links), len(balls))), np.empty((3, len(balls)))
    some = np.empty((1, most_points(balls)))
    sloped = len(gradients) > 0
    for b in range(B):
        place_joints(joints, values[b], rotation, origin, axis)
        place_keypoints(keys, rotation, origin, places)
        own, charge = points[b if len(points) > 1 else 0], charges[b if len(charges) > 1 else 0]
        forces[:] = 0.0
        if len(balls) > 0:
            base = 0.0
            if kind != MEAN:
                base = highest_level(
                    places, links, own, charge, balls, by_length, fields, known, some, forces,
                    sloped and kind == MAXIMUM,
                )  # fmt: skip
            out[b] = base
            if kind != MAXIMUM:
                out[b] = total_level(
                    places, links, own, charge, balls, by_length, kind, sharpness, tolerance, base, fields, known,
                    some, forces, sloped,
                )  # fmt: skip
        else:
            potentials(places, links, own, 0, M, by_length, levels.reshape(1, M))
            for k in range(M):
                levels[k] *= charge[k]
            out[b] = aggregate(levels, kind, sharpness)
            if sloped:
                shares(levels, kind, sharpness, share)
                for k in range(M):
                    if share[k] != 0.0:
                        add_pull(places, links, own, k, charge[k] * share[k], by_length, forces)
        if sloped:
            pull(joints, keys, origin, axis, places, forces, gradients[b])
    return out


@compiled
def aggregates(levels: FloatArray, kind: int, sharpness: float) -> FloatArray:
    """Return the danger (B,) of levels (B, M ≥ 1)."""
    out = np.empty(len(levels))
    for b in range(len(levels)):
        out[b] = aggregate(levels[b], kind, sharpness)
    return out


@compiled
def all_shares(levels: FloatArray, kind: int, sharpness: float) -> FloatArray:
    """Return the derivatives (B, M) of the danger by levels (B, M ≥ 1)."""
    out = np.empty(levels.shape)
    for b in range(len(levels)):
        shares(levels[b], kind, sharpness, out[b])
    return out


@compiled
def chords(
    first_fields: FloatArray,
    first_distances: FloatArray,
    last_fields: FloatArray,
    last_distances: FloatArray,
    h: float,
    speed: FloatArray,
    acceleration: FloatArray,
    lengths: FloatArray,
) -> FloatArray:
    """Return the ends (2, M) of lines above Σ_l length_l·u_l(t): fields and distances (L, M), bounds of motion (L,).

    Of each link the lower of U = max u·D/(D − δ) at both ends, δ = Vh/2, and the chord raised by
    U (V²/D̲² + A/D̲) h²/8, D̲ = (D₁ + D₂ − Vh)/2.
    """
    L, M = first_fields.shape
    out = np.zeros((2, M))
    for k in range(L):
        half, weight = speed[k] * h / 2, lengths[k]
        for m in range(M):
            u1, u2 = first_fields[k, m], last_fields[k, m]
            left, right = first_distances[k, m] - half, last_distances[k, m] - half
            if left > 0 and right > 0:
                level = max(u1 * (first_distances[k, m] / left), u2 * (last_distances[k, m] / right))
                nearest = (left + right) / 2
                rise = level * ((speed[k] / nearest) ** 2 + acceleration[k] / nearest) * (h * h / 8)
                bent = max(u1, u2) + rise < level
                out[0, m] += weight * (u1 + rise if bent else level)
                out[1, m] += weight * (u2 + rise if bent else level)
            else:
                out[0, m] = out[1, m] = inf
    return out
