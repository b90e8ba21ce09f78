"""Compiled proofs of motions, from bounds of the distances of pairs of bodies.

On the edge q(t) = q₁ + tΔ no point of body g is faster than W_g = Σ_i R_gi·|Δ_i|. At t none is faster than
V_g = |v| + |ω| r, with the velocity v of the centre of the ball about it and the radius r of that, and no acceleration
is above K_g = Σ_i R_gi w_i (w_i + 2 Σ_j<i w_j), w = |q′|, over the joints that move it. While |x| ≤ h none moves from
where it is at t to t + x by more than D = min(h W_g, h V_g + h² K_g/2) (Taylor). Two of the robot's bodies, pair p,
approach each other by D = h W_p at most, R_pi in the place of R_gi. A pair that must keep c_p is proven for all of such
an interval where its distance d_p at t is at least c_p + D.

A curve q(t) = Σ_k c_k t^k is Σ_k a_k x^k at t + x. It is within |x| v_i of q(t), v_i = Σ_k≥1 |a_k,i| h^(k−1),
while |x| ≤ h: v takes the place of |Δ|, for intervals of half-length h at most, w is a bound of |q′| there, and
R_gi |q″_i| is added to K_g. An edge is a curve of degree 1.

In half of an interval bodies should not move far. At its middle three bounds of d_p are tried, each only for pairs that
those before do not prove: that of the balls about the bodies, that of the ball about one and the box about the other,
and that of the supports of the bodies themselves along an axis n (`geometry.kernels`), for pairs that are proven least
far first. The axis is the vector from the box to the ball until a better one is found. Where a bound along n leaves a
spare e more is proven, for bodies that move along the slab across n, or apart, come nearer only by accelerations: they
keep what they must while e + x r − x²K/2 ≥ 0. In the frame of the joint that carries both, r is how fast the slab
widens at t at least: n·v of the centres, less what rotation moves the corners of their boxes along n, without balls,
and K is the sum of theirs. So [t − s⁻, t + s⁺] is proven, with the least s⁻ and s⁺ of all pairs. What is left before
and after is looked at in the same way, but only pairs that are not proven for all of the interval. Rounding of e, r and
D, 1e-14 m, is below the allowances in c_p, as that of d_p is; s is taken for less, and D for more, by 1e-12 of it.

Two points of the bodies bound d_p from above. Where that bound is no more than what the pair must keep without the
allowances in c_p, and the bodies themselves are convex, no proof can find the motion free: it is refused at once, and
coal need not be asked.
"""

from __future__ import annotations

from math import ceil, inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision.kernels.tables import LANES, EdgeTables, Pairs, Required, is_far, near_in_group
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller, compiled, inlined, part
from safe_ompl.geometry.kernels import Records, Shapes, Vector, distance_bounds, outer_bound, place_bodies
from safe_ompl.robot.kernels import lay_edge, move_joints, place_joints

_FIRST_REACH = 0.45  # [m] by which bodies move at most in half of a first interval: less takes more of them,
_MOST_FIRST = 8  # intervals, and more makes more pairs near,
_CROWD = 25_000  # of which there are too many then, if there are more pairs in all: intervals are shorter
_ROUNDING = 1e-12  # of the length of an interval, and of how far bodies move
_JOINT, _SPEED, _VELOCITY, _FASTEST, _BEND, _TAYLOR = range(6)  # rows of how joints move
_LARGEST = 1e100  # of what joints do: nothing overflows
_FROM, _UNTIL, _AXIS = 0, 1, 2  # rows of what is known of pairs


class _Proof(NamedTuple):
    """What a proof is of; where bodies (G,) and joints are at a place; how they move; what is known of pairs; memory.

    The `twists: (m + 1, 6)` and `moves: (6 + d, m)` are those of `move_joints`, by Pinocchio's numbers of joints, and
    `_curve_at`. W, V and K (own,) are of bodies, `rates: (P,)` are W of pairs of two of the robot's own. Pairs are
    `known: (5, P)` to keep what is `required: (P,)` from where, until where, and along which axes; the first of those
    that are `listed: (P,)` are not yet proven. `near_in_group` writes `hits`.
    """

    joints: Any
    shapes: Shapes
    pairs: Pairs
    required: FloatArray
    most: float
    poses: Records
    rotations: FloatArray
    origins: FloatArray
    axes: FloatArray
    twists: FloatArray
    moves: FloatArray
    W: FloatArray
    V: FloatArray
    K: FloatArray
    rates: FloatArray
    known: FloatArray
    listed: IntArray
    simplex: FloatArray
    axis: FloatArray
    hits: BoolArray


@part
def _write_rates(proof: _Proof) -> float:
    """Write W and K of bodies, and W of pairs of two of the robot's own; return the largest one of a body.

    Processors run the loops over bodies and pairs by lanes.
    """
    joints, pairs, moves, W, turning, K = proof.joints, proof.pairs, proof.moves, proof.W, proof.V, proof.K
    W[:], turning[:], K[:], widest = 0.0, 0.0, 0.0, 0.0
    for i in range(len(joints)):
        speed, fastest, bend = moves[_SPEED, i], moves[_FASTEST, i], moves[_BEND, i]
        turns = 0.0 if joints[i].slides else fastest
        for g in range(pairs.own):
            reach = pairs.reaches[i, g]
            W[g] += reach * speed
            K[g] += reach * (fastest * (fastest + 2.0 * turning[g]) + bend)
            turning[g] += turns if reach > 0.0 else 0.0
    for g in range(pairs.own):
        widest = max(widest, W[g])
    for k in range(len(pairs.groups)):
        if not pairs.groups[k].radius < inf:
            begin, end = pairs.groups[k].begin, pairs.groups[k].end
            rates = proof.rates[begin:end]
            rates[:] = 0.0
            for i in range(len(joints)):
                radii, speed = pairs.radii[i, begin:end], moves[_SPEED, i]
                for p in range(len(rates)):
                    rates[p] += radii[p] * speed
    return widest


@inlined
def _velocities(proof: _Proof, g: int, frame: int) -> tuple[Vector, Vector]:
    """Return angular velocity of a body, and velocity of its centre, relative to what a joint carries."""
    c, twist, base = proof.poses[g].centre, proof.twists[proof.shapes.bodies[g].joint], proof.twists[frame]
    x, y, z = twist[0] - base[0], twist[1] - base[1], twist[2] - base[2]
    u, v, w = twist[3] - base[3], twist[4] - base[4], twist[5] - base[5]
    return (x, y, z), (u + y * c[2] - z * c[1], v + z * c[0] - x * c[2], w + x * c[1] - y * c[0])


@inlined
def _moved(proof: _Proof, p: Any, half: float) -> float:
    """Return by how much the bodies of a pair approach each other at most while no farther than `half` from a place."""
    A, both = proof.pairs.bodies[p, 0], proof.pairs.own > proof.pairs.bodies[p, 1]
    rate: float = proof.rates[p] if both else min(proof.W[A], proof.V[A] + 0.5 * half * proof.K[A])
    return half * rate * (1.0 + _ROUNDING)


@inlined
def _kept(proof: _Proof, p: Any, spare: float) -> tuple[float, float]:
    """Return how far before and after a place a pair keeps what it must that has so much to `spare` along the axis."""
    if not spare > 0.0:
        return 0.0, 0.0
    joints, bodies, axis = proof.joints, proof.shapes.bodies, proof.axis
    A, B = proof.pairs.bodies[p, 0], proof.pairs.bodies[p, 1]
    both = proof.pairs.own > B
    even = spare / (proof.rates[p] if both else proof.W[A]) * (1.0 - _ROUNDING)
    if bodies[B].levels > 0:  # an obstacle, and the bound is along many axes
        even = max(even, _until(spare, -proof.V[A], proof.K[A]))
        return even, even
    frame, last = (bodies[A].joint, bodies[B].joint) if both else (0, 0)
    while frame != last:  # until it is that of what carries both: parents have lower numbers
        frame, last = joints[max(frame, last) - 1].parent, min(frame, last)
    length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    a, b, c = axis[0] / length, axis[1] / length, axis[2] / length
    along, spread, bend = 0.0, 0.0, 0.0 if both else proof.K[A]
    for side in range(2 if both else 1):
        g = proof.pairs.bodies[p, side]
        R, extent, turning = proof.poses[g].rotation, bodies[g].extent, 0.0
        (x, y, z), (u, v, w) = _velocities(proof, g, frame)
        along += (1 - 2 * side) * (a * u + b * v + c * w)
        x, y, z = b * z - c * y, c * x - a * z, a * y - b * x  # n × ω
        for k in range(3):
            spread += (extent[k] - bodies[g].ball) * abs(R[0, k] * x + R[1, k] * y + R[2, k] * z)
        for i in range(frame, bodies[g].joint if both else 0):
            reach, fastest = proof.pairs.reaches[i, g], proof.moves[_FASTEST, i]
            if reach > 0.0:
                bend += reach * (fastest * (fastest + 2.0 * turning) + proof.moves[_BEND, i])
                turning += 0.0 if joints[i].slides else fastest
    return max(even, _until(spare, -along - spread, bend)), max(even, _until(spare, along - spread, bend))


@part
def _until(spare: float, rate: float, bend: float) -> float:
    """Return the largest s for which spare + rate s − bend s²/2 is no less than 0."""
    root = sqrt(rate * rate + 2.0 * bend * spare)
    return ((rate + root) / bend if rate > 0.0 else 2.0 * spare / (root - rate)) * (1.0 - _ROUNDING)


@inlined
def _list_near(proof: _Proof, half: float) -> int:
    """List pairs that the balls about bodies, and about groups of them, do not prove; return how many they are."""
    pairs, bodies, poses, number, turn = proof.pairs, proof.shapes.bodies, proof.poses, 0, 0
    while turn < len(pairs.groups):
        group = pairs.groups[len(pairs.groups) - 1 - turn]
        A = group.body
        turn += 1
        if group.radius < inf:
            enough = proof.most + _moved(proof, np.uintp(group.begin), half)
            if group.back > 1 and is_far(group.around, group.wide, bodies[A], poses[A], enough):
                turn += group.back - 1
                continue
            number += near_in_group(group, pairs.balls, bodies[A], poses[A], enough, proof.hits, proof.listed[number:])
            continue
        for k in range(group.begin, group.end):
            p: Any = np.uintp(k)
            a, b = pairs.bodies[p, 0], pairs.bodies[p, 1]
            enough = proof.required[p] + half * proof.rates[p] * (1.0 + _ROUNDING)
            proof.listed[number] = k
            number += 0 if is_far(poses[b].centre, bodies[b].reach, bodies[a], poses[a], enough) else 1
    return number


@inlined
def _half_length(proof: _Proof, t: float, half: float, number: int, fresh: bool) -> tuple[float, float, int, int]:
    """Return how far before and after t, at most `half`, is proven; a pair that is too near; how many are listed.

    Of the first so many pairs of the list those that are not proven for all of the interval come to the front. Of
    `fresh` ones nothing is known. Both lengths are 0 if the bound of that pair's distance is not above what it must
    keep, and −1 if it is certain that the pair is too near.
    """
    shapes, pairs, poses, axis = proof.shapes, proof.pairs, proof.poses, proof.axis
    known, listed, left, done = proof.known, proof.listed, 0, 0
    for k in range(number):
        p: Any = np.uintp(listed[k])
        if not fresh and known[_FROM, p] <= t - half and t + half <= known[_UNTIL, p]:
            continue
        enough = proof.required[p] + _moved(proof, p, half)
        lower = outer_bound(shapes.bodies, poses, pairs.bodies[p, 0], pairs.bodies[p, 1], enough, axis)
        if lower >= enough:
            continue
        back, on = _kept(proof, p, lower - proof.required[p])
        if back >= half and on >= half:
            continue
        known[_FROM, p], known[_UNTIL, p] = t - back, t + on
        known[_AXIS, p], known[_AXIS + 1, p], known[_AXIS + 2, p] = axis[0], axis[1], axis[2]
        listed[left], listed[k] = listed[k], listed[left]
        left += 1
    before, after = half, half
    while True:
        worst, shortest = -1, inf
        for k in range(done, left):
            p = np.uintp(listed[k])
            back, on = t - known[_FROM, p], known[_UNTIL, p] - t
            if (back < before or on < after) and min(back, on) < shortest:
                worst, shortest = k, min(back, on)
        if worst < 0:
            return before, after, -1, left
        p = np.uintp(listed[worst])
        axis[0], axis[1], axis[2] = known[_AXIS, p], known[_AXIS + 1, p], known[_AXIS + 2, p]
        back, on, required, longer = t - known[_FROM, p], known[_UNTIL, p] - t, proof.required[p], max(before, after)
        enough, least = required + _moved(proof, p, longer), required - pairs.certain[p]
        A, B = pairs.bodies[p, 0], pairs.bodies[p, 1]
        found, most_apart, _ = distance_bounds(shapes, poses, A, B, axis, proof.simplex, enough, least)
        if not (back > 0.0 or found > required):
            # The upper bound is −∞ where hulls overlap, and so is the right side where bodies are within theirs.
            nothing = -1.0 if most_apart < least else 0.0
            return nothing, nothing, listed[worst], left
        earlier, later = _kept(proof, p, found - required)
        even = longer if found >= enough else 0.0  # whatever rounding makes of it
        back, on = max(back, earlier, even), max(on, later, even)
        known[_FROM, p], known[_UNTIL, p] = t - back, t + on
        before, after = min(before, back), min(after, on)
        listed[worst], listed[done] = listed[done], listed[worst]
        done += 1


@inlined
def _is_too_near(proof: _Proof, p: int) -> bool:
    """Return whether it is certain that a pair is nearer at a place than it must be."""
    shapes, poses, axis, required = proof.shapes, proof.poses, proof.axis, proof.required[p]
    A, B, least = proof.pairs.bodies[p, 0], proof.pairs.bodies[p, 1], required - proof.pairs.certain[p]
    if outer_bound(shapes.bodies, poses, A, B, required, axis) >= required:
        return False
    lower, most_apart, _ = distance_bounds(shapes, poses, A, B, axis, proof.simplex, required, least)
    return not lower > required and most_apart < least


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
def _curve_at(curve: FloatArray, t: float, half: float, moves: FloatArray) -> None:
    """Write where the joints are at t, and how they move while no farther than `half` from t.

    The rows of `moves: (6 + d, m)` are the joints, v, q′ at t, bounds of |q′| and |q″|, and a_0 … a_d.
    """
    degree, taylor = len(curve) - 1, moves[_TAYLOR:]
    for i in range(curve.shape[1]):
        for k in range(degree + 1):
            taylor[k, i] = curve[k, i]
        for k in range(degree):
            for j in range(degree - 1, k - 1, -1):
                taylor[j, i] += t * taylor[j + 1, i]
        speed, fastest, bend = 0.0, 0.0, 0.0
        for k in range(degree, 0, -1):
            rise = abs(taylor[k, i])
            speed, fastest = rise + half * speed, k * rise + half * fastest
            if k > 1:
                bend = k * (k - 1) * rise + half * bend
        moves[_JOINT, i], moves[_SPEED, i], moves[_VELOCITY, i] = taylor[0, i], speed, taylor[1, i]
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
    in whose halves no body moves by more than `least` [m], and where more than M intervals would
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
    rows, about_bodies, about_joints = np.empty((6, P)), np.empty((3, own)), np.empty((2 * m + 5, 3))
    moves, twists, listed = np.empty((_TAYLOR + len(curve), m)), np.zeros((m + 1, 6)), np.empty(P, np.intp)
    proof = _Proof(
        joints, shapes, pairs, distances, largest[0], poses, np.empty((m, 3, 3)), about_joints[:m],
        about_joints[m : 2 * m], twists, moves, about_bodies[0], about_bodies[1], about_bodies[2], rows[5], rows,
        listed, about_joints[2 * m + 1 :], about_joints[2 * m], np.empty(LANES, np.bool_),
    )  # fmt: skip
    _curve_at(curve, 0.5, 0.5, moves)
    widest = _write_rates(proof)
    crowd = max(1.0, P / _CROWD)
    number = int(max(1.0, min(ceil(0.5 * crowd * widest / _FIRST_REACH), crowd * _MOST_FIRST, len(left) // 2)))
    counts, places, pair = np.full(len(left), -1), 0, -1  # of listed pairs; −1: none are listed yet
    for k in range(number):
        left[k, 0], left[k, 1] = k / number, (k + 1) / number
    while number > 0:
        low, high, count = left[number - 1, 0], left[number - 1, 1], counts[number - 1]
        t, most, fresh = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + _ROUNDING), count < 0
        _curve_at(curve, t, most, moves)
        for i in range(m):
            if not abs(moves[_JOINT, i]) + moves[_FASTEST, i] + moves[_BEND, i] < _LARGEST:
                return number, -1.0, places
        place_joints(joints, moves[_JOINT], proof.rotations, proof.origins, proof.axes)
        place_bodies(bodies[:own], poses, proof.rotations, proof.origins, True)
        if len(curve) > 2:
            widest = _write_rates(proof)
        move_joints(joints, moves[_VELOCITY], proof.origins, proof.axes, twists[1:])
        for g in range(own):
            (x, y, z), (u, v, w) = _velocities(proof, g, 0)
            proof.V[g] = sqrt(u * u + v * v + w * w) + bodies[g].reach * sqrt(x * x + y * y + z * z)
        places += 1
        if fresh:
            for k in range(len(suspects)):
                if _is_too_near(proof, suspects[k]):
                    _suspect(suspects, suspects[k])
                    return -1, t, places
            count = _list_near(proof, most)
        before, after, pair, count = _half_length(proof, t, most, count, fresh)
        half = min(before, after)
        if half < 0.0:
            _suspect(suspects, pair)
            return -1, t, places
        if half < most and (half * widest < least or number == len(left)):
            return number, -1.0 if half > 0.0 else t, places
        number -= 1
        # The part in which these bodies come nearer is looked at next: there the motion is blocked, if it is.
        for turn in range(2):
            earlier = (turn == 0) == (after <= before)
            if (before if earlier else after) < most:
                left[number, 0], left[number, 1] = (low, t - before) if earlier else (t + after, high)
                counts[number] = count
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
