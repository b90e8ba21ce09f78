"""Compiled proofs of motions, from bounds of the distances of pairs of bodies.

On the edge q(t) = q₁ + tΔ the bodies of pair p approach each other at the rate W_p = Σ_i R_pi·|Δ_i|, and must keep c_p.
If at t their distance is at least d_p, the pair keeps what it must in [t − s, t + s] for every s ≤ (d_p − c_p)/W_p.

A curve q(t) = Σ_k c_k t^k is Σ_k a_k x^k at t + x. It is within |x| v_i of q(t), v_i = Σ_k≥1 |a_k,i| h^(k−1),
while |x| ≤ h: v takes the place of |Δ| in W_p, for intervals of half-length h at most. An edge is a curve of degree 1.

The smallest s of all pairs is proven. Three bounds of d_p are tried in turn, each only where the one before would make
s smaller: that of the balls about the bodies, that of the ball about one and the box about the other, and that of the
supports of the bodies themselves along an axis (`geometry.kernels`). At first the axis is the vector from the
box to the ball. It is kept for the next place on the edge, but not for the next edge, so that an edge is always decided
alike.

Two points of the bodies bound d_p from above. Where that bound is no more than what the pair must keep without the
allowances in c_p, and the bodies themselves are convex, no proof can find the motion free: it is refused at once, and
coal need not be asked.

R_pi is a constant at first. Where that would make s smaller it is also bounded at q(t): no point of a body is farther
from the axis of joint i than the centre of its ball is, plus the radius.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, caller, compiled, maker, part
from safe_ompl.geometry.kernels import POSE, Records, Shapes, begin_axis, distance_bounds, from_box, place_bodies
from safe_ompl.robot.kernels import place_joints

_ROUNDING = 1e-12  # of the length of an interval, and of rates


class Pairs(NamedTuple):
    """Pairs of bodies: `bodies` (P, 2), their constant radii R (m, P), and which joints move each body, (G, m).

    Where an upper bound of the distance is `certain` (P,) [m] below what is required, a pair is too near: by as much as
    the allowances in that, where both bodies are known exactly, else never, +∞.
    """

    bodies: IntArray
    radii: FloatArray  # joint by joint, so that processors compute the rates of pairs by lanes
    moved: BoolArray
    certain: FloatArray


class _Place(NamedTuple):
    """Where things are at one place of an edge: poses (G,) of bodies, origins (m, 3) and axes (m, 3) of joints."""

    poses: Records
    origins: FloatArray
    axes: FloatArray


class _Motion(NamedTuple):
    """Speeds v (m,) of the joints about a place, rates W (P,), and what is required, c (P,)."""

    speeds: FloatArray
    rates: FloatArray
    required: FloatArray


class _Axes(NamedTuple):
    """Separating axes (P + 1, 3), the last one for any pair, which are known (P,), and memory for a simplex (4, 3)."""

    axes: FloatArray
    known: BoolArray
    simplex: FloatArray


@part
def _rate_here(p: int, pairs: Pairs, bodies: Records, place: _Place, joints: Any, speeds: FloatArray) -> float:
    """Return W_p for motions that start here, with radii no larger than the constant ones."""
    rate, origins, axes = 0.0, place.origins, place.axes
    for i in range(len(speeds)):
        radius = pairs.radii[i, p]
        if radius == 0.0 or speeds[i] == 0.0:
            continue
        if not joints[i].slides:
            g = pairs.bodies[p, 0] if pairs.moved[pairs.bodies[p, 0], i] else pairs.bodies[p, 1]
            at = place.poses[g].centre
            x, y, z = at[0] - origins[i, 0], at[1] - origins[i, 1], at[2] - origins[i, 2]
            a, b, c = axes[i, 0], axes[i, 1], axes[i, 2]
            u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
            radius = min(radius, sqrt(u * u + v * v + w * w) + bodies[g].reach)
        rate += radius * speeds[i]
    return rate * (1.0 + _ROUNDING)


@part
def _half_length(
    joints: Any, shapes: Shapes, pairs: Pairs, motion: _Motion, place: _Place, search: _Axes, most: float, first: int
) -> tuple[float, int]:
    """Return the half-length ≤ `most` that is proven about a place, and the pair that bounds it.

    The half-length is 0 if the bound of that pair's distance is not above what it must keep, and −1 if it is certain
    that the pair is too near. The pair `first` is looked at before the others.
    """
    bodies, poses, required = shapes.bodies, place.poses, motion.required
    axes, known = search.axes, search.known
    half, bounding = most, first
    for n in range(len(motion.rates)):
        p = first if n == 0 else (n - 1 if n <= first else n)
        A, B = pairs.bodies[p, 0], pairs.bodies[p, 1]
        enough = required[p] + half * motion.rates[p]
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
        rate = _rate_here(p, pairs, bodies, place, joints, motion.speeds)
        enough = required[p] + half * rate
        if other > lower:
            lower, u, v, w = other, -i, -j, -k
        if lower >= enough:
            continue
        if not known[p]:
            begin_axis(axes[p], u, v, w, x, y, z)
        least = required[p] - pairs.certain[p]
        found, most_apart, _ = distance_bounds(shapes, poses, A, B, axes[p], search.simplex, enough, least)
        known[p] = True
        lower = max(lower, found)
        if lower >= enough:
            continue
        bounding = p
        if not lower > required[p]:
            # The upper bound is −∞ where the hulls overlap, and so is the right side where bodies are within theirs.
            return -1.0 if most_apart < least else 0.0, p
        half = (lower - required[p]) / rate
    return half, bounding


@part
def _is_too_near(p: int, shapes: Shapes, pairs: Pairs, motion: _Motion, place: _Place, search: _Axes) -> bool:
    """Return whether it is certain that a pair is nearer at a place than it must be."""
    bodies, poses, required = shapes.bodies, place.poses, motion.required[p]
    A, B = pairs.bodies[p, 0], pairs.bodies[p, 1]
    a, b = poses[A].centre, poses[B].centre
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    far = required + bodies[A].reach + bodies[B].reach
    if not x * x + y * y + z * z < far * far:
        return False
    u, v, w = from_box(bodies[B], poses[B], a)
    axis = search.axes[len(pairs.bodies)]
    begin_axis(axis, u, v, w, x, y, z)
    least = required - pairs.certain[p]
    lower, most_apart, _ = distance_bounds(shapes, poses, A, B, axis, search.simplex, required, least)
    return not lower > required and most_apart < least


@part
def _comes_nearer(
    p: int, pairs: Pairs, curve: FloatArray, t: float, place: _Place, joints: Any, axis: FloatArray
) -> bool:
    """Return whether the centres of a pair of bodies approach each other at t, along an axis from second to first."""
    rate, origins, axes = 0.0, place.origins, place.axes
    for i in range(len(joints)):
        if pairs.radii[i, p] == 0.0:
            continue
        speed = 0.0
        for k in range(len(curve) - 1, 0, -1):
            speed = k * curve[k, i] + t * speed
        first = pairs.moved[pairs.bodies[p, 0], i]
        at = place.poses[pairs.bodies[p, 0] if first else pairs.bodies[p, 1]].centre
        x, y, z = at[0] - origins[i, 0], at[1] - origins[i, 1], at[2] - origins[i, 2]
        a, b, c = axes[i, 0], axes[i, 1], axes[i, 2]
        if joints[i].slides:
            along = axis[0] * a + axis[1] * b + axis[2] * c
        else:
            along = axis[0] * (b * z - c * y) + axis[1] * (c * x - a * z) + axis[2] * (a * y - b * x)
        rate += along * speed if first else -along * speed
    return rate < 0.0


@part
def _suspect(suspects: IntArray, pair: int) -> None:
    """Put a pair before all others that are suspected; the last of these is dropped if it is a new one."""
    place = 0
    while place < len(suspects) - 1 and suspects[place] != pair:
        place += 1
    for k in range(place, 0, -1):
        suspects[k] = suspects[k - 1]
    if len(suspects) > 0:
        suspects[0] = pair


@maker
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
    pair_bodies: IntArray,
    radii: FloatArray,
    moved: BoolArray,
    certain: FloatArray,
    curve: FloatArray,
    required: FloatArray,
    least: float,
    left: FloatArray,
    suspects: IntArray,
) -> tuple[int, float, int]:
    """Try to prove a motion with the coefficients c_k, `curve: (d + 1, m)`, t in [0, 1]; stop where that fails.

    The `joints: (m,)` are a table (`safe_ompl.robot.kernels`). `bodies`, `starts` and `vertices` are those of `Shapes`,
    and the next four those of `Pairs`: as tuples each would take Python a microsecond more to hand over. Pair p must
    keep c_p, `required: (P,)`, with all allowances in it. The proof stops at an interval in whose halves no two bodies
    approach each other by more than `least` [m], and where more than M intervals would wait. Intervals that are not
    proven are written to `left: (M, 2)`. (An array that is returned would be made by Python code, where a Ctrl-C
    becomes a SystemError.) `suspects` are pairs that blocked motions before; those that block this one are kept there.
    Where a suspect is certainly too near the others are not looked at: no proof could find the motion free, so whether
    it is never depends on what is suspected.

    Returns
    -------
    number : int
        How many intervals are not proven; 0: the motion is proven; −1: some pair is certainly too near at `at`.
    at : float
        Where the bound of some pair's distance is not above what it must keep, or −1.
    places : int
        At how many places of the motion the bounds were looked at.
    """
    m, P = radii.shape
    shapes, pairs = Shapes(bodies, starts, vertices), Pairs(pair_bodies, radii, moved, certain)
    speeds, rates, widest = np.empty(m), np.empty(P), 0.0
    there, rotations = np.empty(m), np.empty((m, 3, 3))
    here = _Motion(speeds, rates, required)
    place = _Place(np.empty(len(bodies), POSE), np.empty((m, 3)), np.empty((m, 3)))
    search = _Axes(np.empty((P + 1, 3)), np.zeros(P, np.bool_), np.empty((4, 3)))
    left[0, 0], left[0, 1] = 0.0, 1.0
    number, places, first = 1, 0, 0
    while number > 0:
        low, high = left[number - 1, 0], left[number - 1, 1]
        t, most = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + _ROUNDING)
        _curve_at(curve, t, most, there, speeds)
        for i in range(m):
            if not isfinite(there[i]):
                return number, -1.0, places
        place_joints(joints, there, rotations, place.origins, place.axes)
        if places == 0:
            place_bodies(bodies, place.poses, rotations, place.origins, False)
        place_bodies(bodies, place.poses, rotations, place.origins, True)
        for k in range(len(suspects)):
            if _is_too_near(suspects[k], shapes, pairs, here, place, search):
                _suspect(suspects, suspects[k])
                return -1, t, places + 1
        if places == 0 or len(curve) > 2:
            rates[:] = 0.0
            for i in range(m):
                for p in range(P):
                    rates[p] += radii[i, p] * speeds[i]
            widest = 0.0
            for p in range(P):
                widest = max(widest, rates[p])
        half, first = _half_length(joints, shapes, pairs, here, place, search, most, first)
        places += 1
        if half >= most:
            number -= 1
        elif half < 0.0:
            _suspect(suspects, first)
            return -1, t, places
        elif half * widest < least or number == len(left):
            return number, -1.0 if half > 0.0 else t, places
        else:
            # The part in which these bodies come nearer is looked at next: there the motion is blocked, if it is.
            later = 1 if _comes_nearer(first, pairs, curve, t, place, joints, search.axes[first]) else 0
            left[number - later, 0], left[number - later, 1] = low, t - half
            left[number - 1 + later, 0], left[number - 1 + later, 1] = t + half, high
            number += 1
    return 0, -1.0, places


@caller
def prove_curves(
    joints: Any,
    shapes: Shapes,
    pairs: Pairs,
    curves: FloatArray,
    required: FloatArray,
    least: float,
    left: FloatArray,
    suspects: IntArray,
    found: IntArray,
) -> int:
    """Write what `prove_curve` says of E motions, `curves: (E, d + 1, m)`; return how many places it took.

    To `found: (E,)` a 1 is written for those that are proven, −1 for those in which some pair is certainly too near,
    and 0 for others, as those that are not finite.
    """
    places, bodies, starts, vertices = 0, shapes.bodies, shapes.starts, shapes.vertices
    for k in range(len(curves)):
        number, _, looked = prove_curve(
            joints, bodies, starts, vertices, pairs.bodies, pairs.radii, pairs.moved, pairs.certain, curves[k],
            required, least, left, suspects,
        )  # fmt: skip
        found[k] = 1 if number == 0 else min(number, 0)
        places += looked
    return places
