"""Compiled proofs of motions, from bounds of the distances of pairs of bodies.

On the edge q(t) = q₁ + tΔ the bodies of pair p approach each other at the rate W_p = Σ_i R_pi·|Δ_i|, and must keep c_p.
If at t their distance is at least d_p, the pair keeps what it must in [t − s, t + s] for every s ≤ (d_p − c_p)/W_p.

A curve q(t) = Σ_k c_k t^k is Σ_k a_k x^k at t + x. It is within |x| v_i of q(t), v_i = Σ_k≥1 |a_k,i| h^(k−1),
while |x| ≤ h: v takes the place of |Δ| in W_p, for intervals of half-length h at most. An edge is a curve of degree 1.

Three bounds of d_p are tried in turn, each only where the one before would make s smaller: that of the balls about the
bodies, that of the ball about one and the box about the other, and that of the supports of the bodies themselves along
an axis n (`geometry.kernels`). At first the axis is the vector from the box to the ball. It is kept for the next place
on the edge, but not for the next edge, so that an edge is always decided alike. R_pi is a constant, or less at q(t): no
point of a body is farther from the axis of joint i than the centre of its ball is, plus the radius.

Where the supports leave a spare e, the slab across n is followed as well: bodies that move along it, or apart, come
nearer only by accelerations. From there on they keep what they must while e + s·r − s²K/2 ≥ 0 (Taylor). In the frame of
the joint that carries both, r is how fast the slab widens at t at least: n·v of the centres, less what rotation moves
the corners of their boxes along n, without balls. K = Σ_i R_i w_i (w_i + 2 Σ_j<i w_j) + R_i|q″_i| bounds accelerations,
w = |q′|, over the joints that move one of the two. So [t − s⁻, t + s⁺] is proven, with the least s⁻ and s⁺ of all
pairs. Rounding of e, 1e-14 m, is below the allowances in c_p, as that of d_p is; s is taken for less by 1e-12 of it.

Two points of the bodies bound d_p from above. Where that bound is no more than what the pair must keep without the
allowances in c_p, and the bodies themselves are convex, no proof can find the motion free: it is refused at once, and
coal need not be asked.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision.kernels.tables import LANES, EdgeTables, Pairs, Required, is_far, near_in_group
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller, compiled, part
from safe_ompl.geometry.kernels import Records, Shapes, are_apart, begin_axis, distance_bounds, from_box, place_bodies
from safe_ompl.robot.kernels import lay_edge, place_joints

_NEAR = 0.05  # [m] by which bodies approach at most while a slab is followed: else too many pairs would be near
_ROUNDING = 1e-12  # of the length of an interval, and of rates
_JOINT, _SPEED, _VELOCITY, _FASTEST, _BEND = range(5)  # rows of how joints move


class _Place(NamedTuple):
    """Where things are at one place of an edge: poses (G,) of bodies, origins (m, 3) and axes (m, 3) of joints."""

    poses: Records
    origins: FloatArray
    axes: FloatArray


class _Motion(NamedTuple):
    """How joints move about a place, (5, m), see `_curve_at`; rates W (P,); what is required, c (P,), and the most."""

    joints: FloatArray
    rates: FloatArray
    required: FloatArray
    most: float


class _Search(NamedTuple):
    """Separating axes (P + 1, 3), the last one for any pair, which are known (P,), and memory for a simplex (4, 3).

    Then bounds of the speeds that joints give to bodies, (m + 1, own), the last row their sums; the centres of the
    balls about these and their radii, (4, own), pairs that may be near, (P,), and hits, see `near_in_group`.
    """

    axes: FloatArray
    known: BoolArray
    simplex: FloatArray
    speeds: FloatArray
    balls: FloatArray
    near: IntArray
    hits: BoolArray


@part
def _bound_speeds(pairs: Pairs, place: _Place, joints: Any, rates: FloatArray, search: _Search) -> None:
    """Write bounds of the speeds that joints give to the robot's bodies from here on, and their sums.

    With radii no larger than the constant ones. Processors run the loops over bodies by lanes.
    """
    speeds, balls, own, m = search.speeds, search.balls, pairs.own, len(rates)
    for g in range(own):
        for x in range(3):
            balls[x, g] = place.poses[g].centre[x]
        speeds[m, g] = 0.0
    for i in range(m):
        if joints[i].slides or rates[i] == 0.0:
            for g in range(own):
                speeds[i, g] = pairs.reaches[i, g] * rates[i]
                speeds[m, g] += speeds[i, g]
            continue
        o0, o1, o2 = place.origins[i, 0], place.origins[i, 1], place.origins[i, 2]
        a, b, c, rate = place.axes[i, 0], place.axes[i, 1], place.axes[i, 2], rates[i]
        for g in range(own):
            x, y, z = balls[0, g] - o0, balls[1, g] - o1, balls[2, g] - o2
            u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
            far, reach = sqrt(u * u + v * v + w * w) + balls[3, g], pairs.reaches[i, g]
            speeds[i, g] = rate * (far if far < reach else reach)
            speeds[m, g] += speeds[i, g]


@part
def _rate_here(p: int, pairs: Pairs, rates: FloatArray, speeds: FloatArray) -> float:
    """Return W_p for motions that start here, with radii no larger than the constant ones."""
    rate, A, B = 0.0, pairs.bodies[p, 0], pairs.bodies[p, 1]
    for i in range(len(rates)):
        g = A if pairs.reaches[i, A] > 0.0 else B
        if g < pairs.own:
            rate += min(pairs.radii[i, p] * rates[i], speeds[i, g])
    return rate * (1.0 + _ROUNDING)


@part
def _rate_of(g: int, pairs: Pairs, moves: FloatArray) -> float:
    """Return a bound of the rates of all pairs of a body of the robot with obstacles."""
    rate = 0.0
    for i in range(len(pairs.reaches)):
        rate += pairs.reaches[i, g] * moves[_SPEED, i]
    return rate * (1.0 + _ROUNDING)


@part
def _write_rates(pairs: Pairs, moves: FloatArray, rates: FloatArray) -> float:
    """Write the rates W (P,) of pairs of two of the robot's own bodies; return the largest one of all pairs."""
    widest = 0.0
    for g in range(pairs.own):
        widest = max(widest, _rate_of(g, pairs, moves))
    for k in range(len(pairs.groups)):
        if not pairs.groups[k].radius < inf:
            begin, end = pairs.groups[k].begin, pairs.groups[k].end
            rates[begin:end] = 0.0
            for i in range(moves.shape[1]):
                for p in range(begin, end):
                    rates[p] += pairs.radii[i, p] * moves[_SPEED, i]
            for p in range(begin, end):
                widest = max(widest, rates[p])
    return widest


@part
def _half_length(
    joints: Any, shapes: Shapes, pairs: Pairs, motion: _Motion, place: _Place, search: _Search, most: float, first: int
) -> tuple[float, float, int]:
    """Return how far before and after a place, at most `most`, is proven, and the pair that bounds that.

    Both are 0 if the bound of that pair's distance is not above what it must keep, and −1 if it is certain that the
    pair is too near. The pair `first` is looked at before the others, if it is not −1.
    """
    bodies, poses, required, rates = shapes.bodies, place.poses, motion.required, motion.joints[_SPEED]
    axes, known, near, speeds = search.axes, search.known, search.near, search.speeds
    _bound_speeds(pairs, place, joints, rates, search)
    before, after, bounding = most, most, first
    turn = 0
    while turn <= len(pairs.groups):
        near[0], number = first, 1 if first >= 0 else 0
        if turn > 0:
            group = pairs.groups[len(pairs.groups) - turn]  # the hand's first: the hand is nearest often
            A = group.body
            enough = motion.most + max(before, after) * speeds[len(rates), A] * (1.0 + _ROUNDING)
            if group.back > 1 and is_far(group.around, group.wide, bodies[A], poses[A], enough):
                turn += group.back
                continue
            number = near_in_group(group, pairs.balls, bodies[A], poses[A], enough, search.hits, near)
        turn += 1
        for candidate in range(number):
            if turn > 1 and near[candidate] == first:
                continue
            p: Any = np.uintp(near[candidate])
            A, B, half = pairs.bodies[p, 0], pairs.bodies[p, 1], max(before, after)
            a, b = poses[A].centre, poses[B].centre
            x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
            square, reaches = x * x + y * y + z * z, bodies[A].reach + bodies[B].reach
            if pairs.own > B:
                far = required[p] + half * motion.rates[p] + reaches
                if square >= far * far:
                    continue
            rate = _rate_here(p, pairs, rates, speeds)
            enough = required[p] + half * rate
            far = enough + reaches
            if square >= far * far:
                continue
            u, v, w = from_box(bodies[B], poses[B], a)
            square, far = u * u + v * v + w * w, enough + bodies[A].reach
            if square >= far * far:
                continue
            i, j, k = from_box(bodies[A], poses[A], b)
            other, far = i * i + j * j + k * k, enough + bodies[B].reach
            if other >= far * far:
                continue
            lower, other = sqrt(square) - bodies[A].reach, sqrt(other) - bodies[B].reach
            if other > lower:
                lower, u, v, w = other, -i, -j, -k
            if not known[p]:
                begin_axis(axes[p], u, v, w, x, y, z)
            least = required[p] - pairs.certain[p]
            found, most_apart, _ = distance_bounds(shapes, poses, A, B, axes[p], search.simplex, enough, least)
            known[p] = True
            lower = max(lower, found)
            if lower >= enough:
                continue
            if not lower > required[p]:
                # The upper bound is −∞ where hulls overlap, and so is the right side where bodies are within theirs.
                nothing = -1.0 if most_apart < least else 0.0
                return nothing, nothing, near[candidate]
            even, spare = (lower - required[p]) / rate, found - required[p]
            back, on = even, even
            if spare > 0.0 and bodies[B].levels == 0:
                back, on = _slab(p, pairs, bodies, place, joints, motion.joints, axes[p], spare)
                back, on = max(even, min(back, _NEAR / rate)), max(even, min(on, _NEAR / rate))
            if back < before or on < after:
                before, after, bounding = min(before, back), min(after, on), near[candidate]
    return before, after, bounding


@part
def _is_too_near(p: int, shapes: Shapes, pairs: Pairs, motion: _Motion, place: _Place, search: _Search) -> bool:
    """Return whether it is certain that a pair is nearer at a place than it must be."""
    bodies, poses, required = shapes.bodies, place.poses, motion.required[p]
    A, B = pairs.bodies[p, 0], pairs.bodies[p, 1]
    axis = search.axes[len(pairs.bodies)]
    if are_apart(bodies, poses, A, B, required, axis):
        return False
    least = required - pairs.certain[p]
    lower, most_apart, _ = distance_bounds(shapes, poses, A, B, axis, search.simplex, required, least)
    return not lower > required and most_apart < least


@part
def _slab(
    p: int, pairs: Pairs, bodies: Records, place: _Place, joints: Any, moves: FloatArray, axis: FloatArray, spare: float
) -> tuple[float, float]:
    """Return how far before and after a place a slab across an axis, with so much to `spare`, keeps a pair apart."""
    origins, axes = place.origins, place.axes
    length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    nx, ny, nz = axis[0] / length, axis[1] / length, axis[2] / length
    along, spread, bend = 0.0, 0.0, 0.0
    for side in range(2):
        g, other = pairs.bodies[p, side], pairs.bodies[p, 1 - side]
        at, R, extent = place.poses[g].centre, place.poses[g].rotation, bodies[g].extent
        tx, ty, tz, turning, moved = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(joints)):
            reach = pairs.reaches[i, g]
            if reach == 0.0 or pairs.reaches[i, other] > 0.0:
                continue
            a, b, c, speed = axes[i, 0], axes[i, 1], axes[i, 2], moves[_VELOCITY, i]
            if joints[i].slides:
                moved += speed * (nx * a + ny * b + nz * c)
            else:
                x, y, z = at[0] - origins[i, 0], at[1] - origins[i, 1], at[2] - origins[i, 2]
                u, v, w = ny * c - nz * b, nz * a - nx * c, nx * b - ny * a  # n × z
                moved += speed * (u * x + v * y + w * z)
                tx, ty, tz = tx + speed * u, ty + speed * v, tz + speed * w
            fastest = moves[_FASTEST, i]
            bend += reach * (fastest * (fastest + 2.0 * turning) + moves[_BEND, i])
            turning += 0.0 if joints[i].slides else fastest
        along += moved if side == 0 else -moved
        for k in range(3):
            spread += (extent[k] - bodies[g].ball) * abs(R[0, k] * tx + R[1, k] * ty + R[2, k] * tz)
    return _until(spare, -along - spread, bend), _until(spare, along - spread, bend)


@part
def _until(spare: float, rate: float, bend: float) -> float:
    """Return the largest s for which spare + rate s − bend s²/2 is no less than 0."""
    root = sqrt(rate * rate + 2.0 * bend * spare)
    return ((rate + root) / bend if rate > 0.0 else 2.0 * spare / (root - rate)) * (1.0 - _ROUNDING)


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


@part
def _curve_at(curve: FloatArray, t: float, half: float, taylor: FloatArray, moves: FloatArray) -> None:
    """Write where the joints are at t, and how they move while no farther than `half` from t; `taylor: (d + 1,)`.

    The rows of `moves: (5, m)` are the joints, v, q′ at t, and bounds of |q′| and |q″|.
    """
    degree = len(curve) - 1
    for i in range(curve.shape[1]):
        for k in range(degree + 1):
            taylor[k] = curve[k, i]
        for k in range(degree):
            for j in range(degree - 1, k - 1, -1):
                taylor[j] += t * taylor[j + 1]
        speed, fastest, bend = 0.0, 0.0, 0.0
        for k in range(degree, 0, -1):
            rise = abs(taylor[k])
            speed, fastest = rise + half * speed, k * rise + half * fastest
            if k > 1:
                bend = k * (k - 1) * rise + half * bend
        moves[_JOINT, i], moves[_SPEED, i], moves[_VELOCITY, i] = taylor[0], speed, taylor[1]
        moves[_FASTEST, i], moves[_BEND, i] = fastest, bend


@compiled
def prove_curve(
    joints: Any,
    bodies: Records,
    starts: IntArray,
    vertices: FloatArray,
    nodes: Records,
    pair_bodies: IntArray,
    radii: FloatArray,
    reaches: FloatArray,
    certain: FloatArray,
    groups: Records,
    own: int,
    balls: FloatArray,
    curve: FloatArray,
    distances: FloatArray,
    largest: FloatArray,
    least: float,
    left: FloatArray,
    suspects: IntArray,
    poses: Records,
) -> tuple[int, float, int]:
    """Try to prove a motion with the coefficients c_k, `curve: (d + 1, m)`, t in [0, 1]; stop where that fails.

    The `joints: (m,)` are a table (`safe_ompl.robot.kernels`). The next four are those of `Shapes`, and the next seven
    those of `Pairs`: as tuples each would take Python a microsecond more to hand over. Pair p must keep c_p,
    `distances: (P,)`, with all allowances in it, none of them above the `largest: (1,)`. The proof stops at an interval
    in whose halves no two bodies approach each other by more than `least` [m], and where more than M intervals would
    wait. Intervals that are not proven are written to `left: (M, 2)`. (An array that is returned would
    be made by Python code, where a Ctrl-C becomes a SystemError.) The `poses: (G,)` are those of bodies that do not
    move, and room for others. `suspects` are pairs that blocked motions before; those that block this one are kept
    there. Where a suspect is certainly too near the others are not looked at: no proof could find the motion free, so
    whether it is never depends on what is suspected.

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
    shapes = Shapes(bodies, starts, vertices, nodes)
    pairs = Pairs(pair_bodies, radii, reaches, certain, groups, own, balls)
    moves, rates, widest = np.empty((5, m)), np.empty(P), 0.0
    taylor, rotations = np.empty(len(curve)), np.empty((m, 3, 3))
    here, place = _Motion(moves, rates, distances, largest[0]), _Place(poses, np.empty((m, 3)), np.empty((m, 3)))
    search = _Search(
        np.empty((P + 1, 3)), np.zeros(P, np.bool_), np.empty((4, 3)), np.empty((m + 1, own)), np.empty((4, own)),
        np.empty(P + 1, np.intp), np.empty(LANES, np.bool_),
    )  # fmt: skip
    for g in range(own):
        search.balls[3, g] = bodies[g].reach
    left[0, 0], left[0, 1] = 0.0, 1.0
    number, places, first = 1, 0, -1
    while number > 0:
        low, high = left[number - 1, 0], left[number - 1, 1]
        t, most = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + _ROUNDING)
        _curve_at(curve, t, most, taylor, moves)
        for i in range(m):
            if not isfinite(moves[_JOINT, i]):
                return number, -1.0, places
        place_joints(joints, moves[_JOINT], rotations, place.origins, place.axes)
        place_bodies(bodies[:own], poses, rotations, place.origins, True)
        for k in range(len(suspects)):
            if _is_too_near(suspects[k], shapes, pairs, here, place, search):
                _suspect(suspects, suspects[k])
                return -1, t, places + 1
        if places == 0 or len(curve) > 2:
            widest = _write_rates(pairs, moves, rates)
        before, after, first = _half_length(joints, shapes, pairs, here, place, search, most, first)
        places += 1
        half = min(before, after)
        if half < 0.0:
            _suspect(suspects, first)
            return -1, t, places
        if half < most and (half * widest < least or number == len(left)):
            return number, -1.0 if half > 0.0 else t, places
        number -= 1
        # The part in which these bodies come nearer is looked at next: there the motion is blocked, if it is.
        for turn in range(2):
            earlier = (turn == 0) == (after <= before)
            if (before if earlier else after) < most:
                left[number, 0], left[number, 1] = (low, t - before) if earlier else (t + after, high)
                number += 1
    return 0, -1.0, places


@part
def prove_edge(start: FloatArray, end: FloatArray, tables: EdgeTables) -> tuple[int, int]:
    """Return what `prove_curve` says of the straight motion between two configurations (n,): number, and places.

    −1 is also said where one of them is not within the limits.
    """
    if not lay_edge(start, end, tables.coupling, tables.limits, tables.edge):
        return -1, 0
    shapes, pairs, required = tables.shapes, tables.pairs, tables.required
    number, _, places = prove_curve(
        tables.joints, shapes.bodies, shapes.starts, shapes.vertices, shapes.nodes, pairs.bodies, pairs.radii,
        pairs.reaches, pairs.certain, pairs.groups, pairs.own, pairs.balls, tables.edge, required.distances,
        required.most, tables.floor, tables.left, tables.suspects, tables.poses,
    )  # fmt: skip
    return number, places


@caller
def prove_curves(
    joints: Any,
    shapes: Shapes,
    pairs: Pairs,
    curves: FloatArray,
    required: Required,
    least: float,
    left: FloatArray,
    suspects: IntArray,
    poses: Records,
    found: IntArray,
) -> int:
    """Write what `prove_curve` says of E motions, `curves: (E, d + 1, m)`; return how many places it took.

    To `found: (E,)` a 1 is written for those that are proven, −1 for those in which some pair is certainly too near,
    and 0 for others, as those that are not finite.
    """
    places, (bodies, starts, vertices, nodes) = 0, shapes
    for k in range(len(curves)):
        number, _, looked = prove_curve(
            joints, bodies, starts, vertices, nodes, pairs.bodies, pairs.radii, pairs.reaches, pairs.certain,
            pairs.groups, pairs.own, pairs.balls, curves[k], required.distances, required.most, least, left, suspects,
            poses,
        )  # fmt: skip
        found[k] = 1 if number == 0 else min(number, 0)
        places += looked
    return places
