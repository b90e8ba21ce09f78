"""Proofs of straight joint motions by lower bounds of distances (`docs/mathematics.md` §4).

On the edge q(t) = q₁ + tΔ the bodies of pair p approach each other at the rate W_p = Σ_i R_pi·|Δ_i|, and must keep
c_p + t·g_p, g_p ≥ 0. If at t their distance is at least d_p, the pair keeps what it must in [t − s, t + s] for every

    s ≤ (d_p − c_p − t·g_p)/(W_p + g_p).

The smallest s of all pairs is proven. Three bounds of d_p are tried in turn, each only where the one before would make s
smaller: that of the balls about the bodies, that of the ball about one and the box about the other, and that of the
supports of the bodies themselves along an axis (`convex`). This begins with the way from the box to the ball, and is kept
for the next place on the edge; nothing is kept from one edge to the next, so that an edge is always decided alike.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.maths.kernels.convex import POSE, Records, distance_bounds, from_box
from safe_ompl.maths.kernels.joints import joint_frames

_WAITING = 64  # intervals at most, besides those of the beginning
_ROUNDING = 1e-12  # of the length of an interval
_NO_LENGTH = 1e-9  # [m]


class Chain(NamedTuple):
    """A tree of m joints, as `joint_frames` takes it."""

    parents: IntArray
    rotations: FloatArray
    translations: FloatArray
    axes: FloatArray
    prismatic: BoolArray


@njit(cache=True)
def place(chain: Chain, bodies: Records, values: FloatArray, poses: Records, moving: bool) -> None:
    """Write the poses of the bodies that joints carry, while these have `values: (m,)`, or of those that none does."""
    rotation, origin, _ = joint_frames(
        chain.parents, chain.rotations, chain.translations, chain.axes, chain.prismatic, values.reshape((1, -1))
    )
    for g in range(len(bodies)):
        joint = bodies[g].joint - 1
        if (joint >= 0) != moving:
            continue
        R, o, c = poses[g].rotation, poses[g].origin, poses[g].centre
        own, t, centre = bodies[g].rotation, bodies[g].translation, bodies[g].centre
        for x in range(3):
            if moving:
                r, s, u = rotation[0, joint, x, 0], rotation[0, joint, x, 1], rotation[0, joint, x, 2]
                for y in range(3):
                    R[x, y] = r * own[0, y] + s * own[1, y] + u * own[2, y]
                o[x] = origin[0, joint, x] + r * t[0] + s * t[1] + u * t[2]
            else:
                for y in range(3):
                    R[x, y] = own[x, y]
                o[x] = t[x]
            c[x] = o[x] + R[x, 0] * centre[0] + R[x, 1] * centre[1] + R[x, 2] * centre[2]


@njit(cache=True)
def _bounds(
    body_a: Records,
    pose_a: Records,
    body_b: Records,
    pose_b: Records,
    starts: IntArray,
    vertices: FloatArray,
    axis: FloatArray,
    simplex: FloatArray,
    known: bool,
    enough: float,
    least: float,
) -> tuple[float, float]:
    """Return bounds of the distance of two bodies, the lower one `enough` at the least cost; see the module."""
    u, v, w = from_box(body_b, pose_b, pose_a.centre)
    lower = sqrt(u * u + v * v + w * w) - body_a.reach
    if lower >= enough:
        return lower, inf
    i, j, k = from_box(body_a, pose_a, pose_b.centre)
    other = sqrt(i * i + j * j + k * k) - body_b.reach
    if other >= enough:
        return other, inf
    if not known:
        if other > lower:
            u, v, w = -i, -j, -k
        if u * u + v * v + w * w < _NO_LENGTH**2:
            a, b = pose_a.centre, pose_b.centre
            u, v, w = a[0] - b[0], a[1] - b[1], a[2] - b[2] + _NO_LENGTH
        axis[0], axis[1], axis[2] = u, v, w
    found, upper = distance_bounds(
        body_a, pose_a, body_b, pose_b, starts, vertices, axis, simplex, enough, least
    )
    return max(lower, other, found), upper


@njit(cache=True)
def _half_length(
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    pairs: IntArray,
    rates: FloatArray,
    required: FloatArray,
    poses: Records,
    axes: FloatArray,
    simplex: FloatArray,
    known: BoolArray,
    most: float,
    first: int,
) -> tuple[float, int]:
    """Return the half-length ≤ `most` that is proven about a place, and the pair that bounds it.

    The half-length is 0 where that pair cannot be told from one that is too near, and −1 where it is too near. The pair
    `first` is looked at before the others.
    """
    half, bounding = most, first
    for n in range(len(pairs)):
        p = first if n == 0 else (n - 1 if n <= first else n)
        A, B = pairs[p, 0], pairs[p, 1]
        enough = required[p] + half * rates[p]
        a, b = poses[A].centre, poses[B].centre
        x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
        far = enough + bodies[A].reach + bodies[B].reach
        if x * x + y * y + z * z >= far * far:
            continue
        lower, upper = _bounds(
            bodies[A],
            poses[A],
            bodies[B],
            poses[B],
            starts,
            vertices,
            axes[p],
            simplex,
            known[p],
            enough,
            required[p],
        )
        if lower >= enough:
            continue
        known[p], bounding = True, p
        if not lower > required[p]:
            return -1.0 if upper <= required[p] else 0.0, p
        half = (lower - required[p]) / rates[p]
    return half, bounding


@njit(cache=True)
def prove_edge(
    chain: Chain,
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    pairs: IntArray,
    values: FloatArray,
    motion: FloatArray,
    rates: FloatArray,
    required: FloatArray,
    growth: FloatArray,
    least: float,
) -> tuple[bool, float, int, FloatArray]:
    """Try to prove an edge, and stop where that fails.

    Parameters
    ----------
    chain : Chain
        The joints.
    bodies, starts, vertices : (G,), (C + 1,), (E, 3)
        The bodies (`BODY`), and the lists of their vertices.
    pairs : (P, 2)
        The pairs.
    values, motion : (m,)
        Values of the joints at the start, and how they change.
    rates : (P,)
        W_p + g_p.
    required, growth : (P,)
        c_p with all allowances, and g_p; `growth` is empty where nothing grows.
    least : float
        Half-length below which an interval is given up.

    Returns
    -------
    proven : bool
        Whether all of the edge is.
    at : float
        Where a pair is nearer than it must be, or −1.
    places : int
        At how many places of the edge the bounds were looked at.
    left : (K, 2)
        Intervals that are not proven.
    """
    P = len(pairs)
    poses = np.empty(len(bodies), POSE)
    axes, simplex, known = np.empty((P, 3)), np.empty((4, 3)), np.zeros(P, np.bool_)
    there, now = values.copy(), required.copy()
    place(chain, bodies, there, poses, False)
    waiting = np.empty((_WAITING, 2))
    waiting[0, 0], waiting[0, 1] = 0.0, 1.0
    number, places, first = 1, 0, 0
    while number > 0:
        low, high = waiting[number - 1]
        t, most = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + _ROUNDING)
        for i in range(len(values)):
            there[i] = values[i] + t * motion[i]
            if not isfinite(there[i]):
                return False, -1.0, places, waiting[:number].copy()
        for p in range(len(growth)):
            now[p] = required[p] + t * growth[p]
        place(chain, bodies, there, poses, True)
        half, first = _half_length(
            bodies, starts, vertices, pairs, rates, now, poses, axes, simplex, known, most, first
        )
        places += 1
        if half >= most:
            number -= 1
        elif half < least or number + 1 > _WAITING:
            return False, -1.0 if half > 0.0 else t, places, waiting[:number].copy()
        else:
            waiting[number - 1, 0], waiting[number - 1, 1] = t + half, high
            waiting[number, 0], waiting[number, 1] = low, t - half
            number += 1
    return True, -1.0, places, waiting[:0].copy()
