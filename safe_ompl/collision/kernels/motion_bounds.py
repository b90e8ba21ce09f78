"""Lower bounds of the distances of many pairs of convex bodies, and proofs of joint motions by them.

On the edge q(t) = q₁ + tΔ the bodies of pair p approach each other at the rate W_p = Σ_i R_pi·|Δ_i|, and must keep
c_p + t·g_p, g_p ≥ 0. If at t their distance is at least d_p, the pair keeps what it must in [t − s, t + s] for every

    s ≤ (d_p − c_p − t·g_p)/(W_p + g_p).

A curve q(t) = Σ_k c_k t^k is Σ_k a_k x^k at t + x. It is within |x| v_i of q(t), v_i = Σ_k≥1 |a_k,i| h^(k−1),
while |x| ≤ h: v takes the place of |Δ| in W_p, for intervals of half-length h at most. An edge is a curve of degree 1.

The smallest s of all pairs is proven. Three bounds of d_p are tried in turn, each only where the one before would make
s smaller: that of the balls about the bodies, that of the ball about one and the box about the other, and that of the
supports of the bodies themselves along an axis (`convex`). The axis is at first the way from the box to the ball, and
is kept for the next place on the edge; nothing is kept from one edge to the next, so that an edge is always decided
alike.

R_pi is a constant at first. Where that would make s smaller it is also bounded at q(t): no point of a body is farther
from the axis of joint i than the centre of its ball is, plus the radius.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.geometry.kernels import POSE, Records, begin_axis, distance_bounds, from_box, place_bodies
from safe_ompl.robot.kernels import place_joints


@compiled
def pair_bounds(
    joints: Any,
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    pairs: IntArray,
    values: FloatArray,
    enough: float,
    bounds: FloatArray,
) -> None:
    """Write lower bounds of the distances of pairs at configurations; no bound is better than it need be.

    The bound of the balls about both bodies comes first, then that of the box about one and the ball about the other,
    then that along an axis (`convex`), which is kept for the next configuration.

    Parameters
    ----------
    joints : (m,)
        The joints (`safe_ompl.robot.kernels.kinematics`).
    bodies, starts, vertices : (G,), (C + 1,), (E, 3)
        The bodies (`BODY`), and the lists of their vertices.
    pairs : (K, 2)
        The pairs.
    values : (B, m)
        Values of the joints.
    enough : float
        [m] A bound as good as this is not improved any more.
    bounds : (B, K)
        Where they are written [m].
    """
    m = values.shape[1]
    poses, simplex = np.empty(len(bodies), POSE), np.empty((4, 3))
    axes, known = np.empty((len(pairs), 3)), np.zeros(len(pairs), np.bool_)
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for row in range(len(values)):
        place_joints(joints, values[row], rotations, origins, joint_axes)
        if row == 0:
            place_bodies(bodies, poses, rotations, origins, False)
        place_bodies(bodies, poses, rotations, origins, True)
        for p in range(len(pairs)):
            A, B = pairs[p, 0], pairs[p, 1]
            a, b = poses[A].centre, poses[B].centre
            x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
            lower = sqrt(x * x + y * y + z * z) - bodies[A].reach - bodies[B].reach
            if lower < enough:
                u, v, w = from_box(bodies[B], poses[B], a)
                lower = max(lower, sqrt(u * u + v * v + w * w) - bodies[A].reach)
                if lower < enough:
                    if not known[p]:
                        begin_axis(axes[p], u, v, w, x, y, z)
                        known[p] = True
                    found, _ = distance_bounds(
                        bodies[A],
                        poses[A],
                        bodies[B],
                        poses[B],
                        starts,
                        vertices,
                        axes[p],
                        simplex,
                        enough,
                        enough,
                    )
                    lower = max(lower, found)
            bounds[row, p] = lower if lower == lower else -inf


_ROUNDING = 1e-12  # of the length of an interval, and of rates


class Pairs(NamedTuple):
    """Pairs of bodies: `bodies` (P, 2), their constant radii R (P, m), and which joints move each body, (G, m)."""

    bodies: IntArray
    radii: FloatArray
    moved: BoolArray


@part
def _rate_here(
    p: int,
    pairs: Pairs,
    bodies: Records,
    poses: Records,
    joints: Any,
    origins: FloatArray,
    axes: FloatArray,
    speeds: FloatArray,
) -> float:
    """Return W_p for motions that start here, with radii no larger than the constant ones."""
    rate = 0.0
    for i in range(len(speeds)):
        radius = pairs.radii[p, i]
        if radius == 0.0 or speeds[i] == 0.0:
            continue
        if not joints[i].slides:
            g = pairs.bodies[p, 0] if pairs.moved[pairs.bodies[p, 0], i] else pairs.bodies[p, 1]
            at = poses[g].centre
            x, y, z = at[0] - origins[i, 0], at[1] - origins[i, 1], at[2] - origins[i, 2]
            a, b, c = axes[i, 0], axes[i, 1], axes[i, 2]
            u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
            radius = min(radius, sqrt(u * u + v * v + w * w) + bodies[g].reach)
        rate += radius * speeds[i]
    return rate * (1.0 + _ROUNDING)


@part
def _half_length(
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    pairs: Pairs,
    joints: Any,
    origins: FloatArray,
    joint_axes: FloatArray,
    speeds: FloatArray,
    rates: FloatArray,
    growth: FloatArray,
    required: FloatArray,
    poses: Records,
    axes: FloatArray,
    simplex: FloatArray,
    known: BoolArray,
    most: float,
    first: int,
) -> tuple[float, int]:
    """Return the half-length ≤ `most` that is proven about a place, and the pair that bounds it.

    The half-length is 0 where that pair cannot be told from one that is too near. The pair `first` is looked at before
    the others.
    """
    half, bounding = most, first
    for n in range(len(rates)):
        p = first if n == 0 else (n - 1 if n <= first else n)
        A, B = pairs.bodies[p, 0], pairs.bodies[p, 1]
        enough = required[p] + half * rates[p]
        a, b = poses[A].centre, poses[B].centre
        x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
        far = enough + bodies[A].reach + bodies[B].reach
        if x * x + y * y + z * z >= far * far:
            continue
        u, v, w = from_box(bodies[B], poses[B], a)
        lower = sqrt(u * u + v * v + w * w) - bodies[A].reach
        if lower >= enough:
            continue
        i, j, k = from_box(bodies[A], poses[A], b)
        other = sqrt(i * i + j * j + k * k) - bodies[B].reach
        if other >= enough:
            continue
        rate = _rate_here(p, pairs, bodies, poses, joints, origins, joint_axes, speeds)
        if len(growth):
            rate += growth[p]
        enough = required[p] + half * rate
        if other > lower:
            lower, u, v, w = other, -i, -j, -k
        if lower >= enough:
            continue
        if not known[p]:
            begin_axis(axes[p], u, v, w, x, y, z)
        found, _ = distance_bounds(
            bodies[A],
            poses[A],
            bodies[B],
            poses[B],
            starts,
            vertices,
            axes[p],
            simplex,
            enough,
            required[p],
        )
        known[p] = True
        lower = max(lower, found)
        if lower >= enough:
            continue
        bounding = p
        if not lower > required[p]:
            return 0.0, p
        half = (lower - required[p]) / rate
    return half, bounding


@part
def _curve_at(curve: FloatArray, t: float, half: float, there: FloatArray, speeds: FloatArray) -> None:
    """Write the joints at t, and bounds of how fast they leave them while no farther than `half` from t."""
    degree = len(curve) - 1
    taylor = np.empty(degree + 1)
    for i in range(curve.shape[1]):
        for k in range(degree + 1):
            taylor[k] = curve[k, i]
        for k in range(degree):
            for j in range(degree - 1, k - 1, -1):
                taylor[j] += t * taylor[j + 1]
        there[i] = taylor[0]
        speed = 0.0
        for k in range(degree, 0, -1):
            speed = abs(taylor[k]) + half * speed
        speeds[i] = speed


@compiled
def prove_curve(
    joints: Any,
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    pairs: Pairs,
    curve: FloatArray,
    required: FloatArray,
    growth: FloatArray,
    least: float,
    left: FloatArray,
) -> tuple[int, float, int]:
    """Try to prove a motion, and stop where that fails.

    Parameters
    ----------
    joints : (m,)
        The joints (`safe_ompl.robot.kernels.kinematics`).
    bodies, starts, vertices : (G,), (C + 1,), (E, 3)
        The bodies (`BODY`), and the lists of their vertices.
    pairs : Pairs
        The pairs.
    curve : (d + 1, m)
        Coefficients c_k of the values of the joints, t in [0, 1]; of an edge its start, and how the joints change.
    required, growth : (P,)
        c_p with all allowances, and g_p; `growth` is empty where nothing grows.
    least : float
        [m] Intervals in whose halves no two bodies approach each other by more are given up.
    left : (M, 2)
        Intervals that are not proven are written here; more than M cannot wait. (An array that is returned would be
        made by Python code, where a Ctrl-C becomes a SystemError.)

    Returns
    -------
    number : int
        How many these are; none: the edge is proven.
    at : float
        Where some pair cannot be told from one that is too near, or −1.
    places : int
        At how many places of the motion the bounds were looked at.
    """
    P, m = pairs.radii.shape
    rates, widest = np.empty(P), 0.0
    poses = np.empty(len(bodies), POSE)
    axes, simplex, known = np.empty((P, 3)), np.empty((4, 3)), np.zeros(P, np.bool_)
    there, speeds, now = np.empty(m), np.empty(m), required.copy()
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    left[0, 0], left[0, 1] = 0.0, 1.0
    number, places, first = 1, 0, 0
    while number > 0:
        low, high = left[number - 1, 0], left[number - 1, 1]
        t, most = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + _ROUNDING)
        _curve_at(curve, t, most, there, speeds)
        for i in range(m):
            if not isfinite(there[i]):
                return number, -1.0, places
        if places == 0 or len(curve) > 2:
            widest = 0.0
            for p in range(P):
                rates[p] = 0.0
                for i in range(m):
                    rates[p] += pairs.radii[p, i] * speeds[i]
                rates[p] += growth[p] if len(growth) else 0.0
                widest = max(widest, rates[p])
        for p in range(len(growth)):
            now[p] = required[p] + t * growth[p]
        place_joints(joints, there, rotations, origins, joint_axes)
        if places == 0:
            place_bodies(bodies, poses, rotations, origins, False)
        place_bodies(bodies, poses, rotations, origins, True)
        half, first = _half_length(
            bodies,
            starts,
            vertices,
            pairs,
            joints,
            origins,
            joint_axes,
            speeds,
            rates,
            growth,
            now,
            poses,
            axes,
            simplex,
            known,
            most,
            first,
        )
        places += 1
        if half >= most:
            number -= 1
        elif half * widest < least or number == len(left):
            return number, -1.0 if half > 0.0 else t, places
        else:
            left[number - 1, 0], left[number - 1, 1] = t + half, high
            left[number, 0], left[number, 1] = low, t - half
            number += 1
    return 0, -1.0, places
