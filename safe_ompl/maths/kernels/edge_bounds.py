"""Proofs of straight joint motions by lower bounds of distances (`docs/mathematics.md` §4).

On the edge q(t) = q₁ + tΔ the bodies of pair p approach each other at the rate W_p = Σ_i R_pi·|Δ_i|, and must keep
c_p + t·g_p, g_p ≥ 0. If at t their distance is at least d_p, the pair keeps what it must in [t − s, t + s] for every

    s ≤ (d_p − c_p − t·g_p)/(W_p + g_p).

The smallest s of all pairs is proven. Three bounds of d_p are tried in turn, each only where the one before would make s
smaller: that of the balls about the bodies, that of the ball about one and the box about the other, and that of the
supports of the bodies themselves along an axis (`support`), which begins with the way from the box to the ball and is
kept for the next place on the edge.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.maths.kernels.joints import joint_frames
from safe_ompl.maths.kernels.support import Bodies, Poses, distance_bound, from_box

_DEEPEST = 64  # intervals that wait


class Chain(NamedTuple):
    """A tree of joints, as `joint_frames` takes it."""

    parents: IntArray
    rotations: FloatArray
    translations: FloatArray
    axes: FloatArray
    prismatic: BoolArray


@njit(cache=True)
def place(chain: Chain, bodies: Bodies, values: FloatArray, poses: Poses) -> None:
    """Write the poses of the bodies while the joints have `values: (m,)`."""
    rotation, origin, _ = joint_frames(
        chain.parents,
        chain.rotations,
        chain.translations,
        chain.axes,
        chain.prismatic,
        values.reshape((1, len(values))),
    )
    for g in range(len(bodies.joints)):
        joint = bodies.joints[g] - 1
        R, o, c = poses.rotations[g], poses.origins[g], poses.centres[g]
        t, centre, own = bodies.translations[g], bodies.centres[g], bodies.rotations[g]
        for x in range(3):
            if joint < 0:
                for y in range(3):
                    R[x, y] = own[x, y]
                o[x] = t[x]
            else:
                F = rotation[0, joint]
                for y in range(3):
                    R[x, y] = F[x, 0] * own[0, y] + F[x, 1] * own[1, y] + F[x, 2] * own[2, y]
                o[x] = origin[0, joint, x] + F[x, 0] * t[0] + F[x, 1] * t[1] + F[x, 2] * t[2]
            c[x] = o[x] + R[x, 0] * centre[0] + R[x, 1] * centre[1] + R[x, 2] * centre[2]


@njit(cache=True)
def _pair_bound(
    bodies: Bodies, poses: Poses, A: int, B: int, axis: FloatArray, known: bool, enough: float, least: float
) -> tuple[float, float]:
    """Return bounds of the distance of two bodies, the lower one `enough` at the least cost; see the module."""
    a, b = poses.centres[A], poses.centres[B]
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    between = sqrt(x * x + y * y + z * z)
    lower = between - bodies.reaches[A] - bodies.reaches[B]
    if lower >= enough:
        return lower, inf
    u, v, w = from_box(bodies, poses, B, a[0], a[1], a[2])
    to_a = sqrt(u * u + v * v + w * w)
    lower = max(lower, to_a - bodies.reaches[A])
    if lower >= enough:
        return lower, inf
    p, q, r = from_box(bodies, poses, A, b[0], b[1], b[2])
    to_b = sqrt(p * p + q * q + r * r)
    lower = max(lower, to_b - bodies.reaches[B])
    if lower >= enough:
        return lower, inf
    if not known:
        if to_a - bodies.reaches[A] >= to_b - bodies.reaches[B] and to_a > 1e-9:
            x, y, z = u, v, w
        elif to_b > 1e-9:
            x, y, z = -p, -q, -r
        elif between <= 1e-9:
            x, y, z = 1.0, 0.0, 0.0
        axis[0], axis[1], axis[2] = x, y, z
    found, upper = distance_bound(bodies, poses, A, B, axis, enough, least)
    return max(lower, found), upper


@njit(cache=True)
def _proven_at(
    chain: Chain,
    bodies: Bodies,
    pairs: IntArray,
    values: FloatArray,
    rates: FloatArray,
    required: FloatArray,
    poses: Poses,
    axes: FloatArray,
    known: BoolArray,
    most: float,
    first: int,
) -> tuple[float, int]:
    """Return the half-length ≤ `most` that is proven about a place, and the pair that bounds it.

    The half-length is negative if that pair is nearer than it must be. The pair `first` is looked at before the others.
    """
    place(chain, bodies, values, poses)
    half, bounding = most, first
    for n in range(-1, len(pairs)):
        p = first if n < 0 else n
        if n == first:
            continue
        enough = required[p] + half * rates[p]
        lower, upper = _pair_bound(
            bodies, poses, pairs[p, 0], pairs[p, 1], axes[p], known[p], enough, required[p]
        )
        if lower >= enough:
            continue
        known[p] = True
        bounding = p
        if not lower > required[p]:
            return -1.0 if upper <= required[p] else 0.0, p
        half = (lower - required[p]) / rates[p]
    return half, bounding


@njit(cache=True)
def prove_edge(
    chain: Chain,
    bodies: Bodies,
    pairs: IntArray,
    values: FloatArray,
    motion: FloatArray,
    rates: FloatArray,
    required: FloatArray,
    growth: FloatArray,
    parts: int,
    least: float,
) -> tuple[bool, float, int, FloatArray]:
    """Try to prove an edge, and stop where that fails.

    Parameters
    ----------
    chain, bodies : Chain, Bodies
        The robot and what it may meet.
    pairs : (P, 2)
        The pairs.
    values, motion : (m,)
        Values of the joints at the start, and how they change.
    rates : (P,)
        W_p + g_p.
    required, growth : (P,)
        c_p with all allowances, and g_p; `growth` may be empty where nothing grows.
    parts : int
        In how many parts the edge is looked at first.
    least : float
        Half-length below which an interval is given up.

    Returns
    -------
    proven : bool
        Whether all of the edge is.
    at : float
        Where a pair is nearer than it must be, or −1.
    looked : int
        At how many places of the edge the bounds were looked at.
    left : (K, 2)
        Intervals that are not proven.
    """
    G, P = len(bodies.joints), len(pairs)
    poses = Poses(np.empty((G, 3, 3)), np.empty((G, 3)), np.empty((G, 3)))
    axes, known = np.empty((P, 3)), np.zeros(P, np.bool_)
    waiting = np.empty((max(_DEEPEST, 2 * parts), 2))
    for k in range(parts):
        waiting[parts - 1 - k, 0], waiting[parts - 1 - k, 1] = k / parts, (k + 1) / parts
    number, looked, first = parts, 0, 0
    there, now = np.empty_like(values), required
    if len(growth):
        now = np.empty(P)
    while number > 0:
        low, high = waiting[number - 1]
        t, most = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 1e-12)
        for i in range(len(values)):
            there[i] = values[i] + t * motion[i]
        if len(growth):
            for p in range(P):
                now[p] = required[p] + t * growth[p]
        half, first = _proven_at(chain, bodies, pairs, there, rates, now, poses, axes, known, most, first)
        looked += 1
        if half < most and (half < least or number + 1 > len(waiting)):
            return False, t if half < 0.0 else -1.0, looked, waiting[:number].copy()
        number -= 1
        if half < most:
            waiting[number, 0], waiting[number, 1] = t + half, high
            waiting[number + 1, 0], waiting[number + 1, 1] = low, t - half
            number += 2
    return True, -1.0, looked, waiting[:0].copy()
