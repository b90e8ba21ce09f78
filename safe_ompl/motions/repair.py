"""Repair motions that are not proven: change as little as possible, keep the ends and the form, and prove the result.

The repaired motion is q(t) + Σ_j B_j(t) x_j, where q is the given motion and the B_j are B-splines of its degree with
the same smoothness at its knots. B-splines that move the ends are left out. Where a pair p is too near at t, its
distance must grow by the shortfall: ∇d_p · Σ_j B_j(t) x_j ≥ shortfall, to first order. The least Σ_j |x_j|² that
satisfies this at all points found so far is a small quadratic programme. The motion is then proven again, and new
points are added, until the motion is proven. If this fails, a planner finds a detour, and B-splines follow it. If only
velocities, accelerations or jerks exceed their limits, or stops are too late for people, the motion keeps its path and
takes longer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from safe_ompl.collision import MotionProver, Verdict
from safe_ompl.common import FloatArray, InputError, IntArray, notebook_html, polynomials
from safe_ompl.motions.checks import MotionCheck, check_of, check_with
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.pieces import PieceProofs
from safe_ompl.robot import Robot
from safe_ompl.scene import People

# For M distances and joint limits: the configuration's row (M,), gradients (M, n), and the shortfalls (M,).
Shortfalls = tuple[IntArray, FloatArray, FloatArray]
# Finds a proven path (N, n) from one configuration to another.
Connect = Callable[[FloatArray, FloatArray], "FloatArray | None"]

# Unproven pieces and their neighbours are divided into spans [rad or m]; the second number is the largest number of
# attempts. Short spans come first: they change less of the motion, but cannot move it as far.
_SPANS = ((0.06, 6), (0.2, 16))
# Fractions of an unproven piece at which distances are computed.
_GRADIENT_PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
# Distances to keep beyond the required ones. Each is tried `_ATTEMPTS` times.
_EXTRA_DISTANCES = (5e-4, 1e-3, 2e-3, 4e-3)  # [m]
_ATTEMPTS = 4
# Share of the previous moves that is kept: none in the first attempts, then more with each attempt, so that attempts do
# not alternate between two motions.
_KEPT_SHARE, _MOST_KEPT_SHARE = 0.25, 0.9
# Joint values should keep this distance from their limits.
_LIMIT_MARGIN = 1e-4  # [rad or m]
# Way points of planners in single precision, such as VAMP, are outside the limits by at most this much.
_SINGLE_PRECISION = 1e-6  # [rad or m]
# Derivatives that differ by less at a knot, relative to their size, are equal.
_EQUAL_DERIVATIVES = 1e-6
# A planner's path must end at most this far from its goal.
_EQUAL_ENDS = 1e-6  # [rad or m]
# Smaller moves are rounding errors.
_NEGLIGIBLE_MOVE = 1e-12  # [rad or m]
# Limits of the active-set method: the number of rounds, and the largest violation of a constraint.
_MOST_ACTIVE_SET_ROUNDS = 100
_CONSTRAINT_TOLERANCE = 1e-5  # [m or rad]
# Relative regularisation, for constraints that contradict each other.
_REGULARISATION = 1e-4
# Distances within this band above the wanted ones are constraints, too.
_CONSTRAINT_BAND = 0.01  # [m]
# A distance may grow by at most this in one attempt, because gradients hold only nearby.
_MOST_DISTANCE_GAIN = 0.03  # [m]
# Kinds of violations that a slower motion removes, with the power of time by which they decrease. Then the slow-down
# factors: the largest, the step of trials, and the precision of the bisection.
_POWERS_OF_TIME = {"velocity": 1, "acceleration": 2, "jerk": 3, "separation": 0}
_MOST_SLOWDOWN, _TRIAL_SLOWDOWN, _SLOWDOWN_PRECISION = 20.0, 1.3, 1.02
# No B-spline moves a joint by more in one attempt.
_MOST_JOINT_MOVE = 0.3  # [rad or m]


@dataclass(frozen=True)
class Repair:
    """The result of a repair. It is true if the motion is proven."""

    # The repaired motion. It is the given motion if no change was needed, or if no motion nearby can be proven.
    motion: Motion
    check: MotionCheck  # of the repaired motion
    # "unchanged"; "moved", by as little as possible; "planned", if it follows a planner's detour; "slowed", or "… and
    # slowed"; or the reason why no motion nearby could be proven.
    how: str
    # Largest deviation of any joint from the given motion at the sampled points [rad or m], and of the tip [mm].
    deviation: float = 0.0
    tool_deviation: float = 0.0
    # Time of the largest deviation, before the motion is slowed [s].
    at: float = 0.0
    # Time intervals in which the motion differs [s].
    changed: tuple[tuple[float, float], ...] = ()
    # Factor of the duration. All other values are those before the motion is slowed.
    slower: float = 1.0

    @property
    def path(self) -> FloatArray:
        """The way points (N, n) of a piecewise linear motion. Raises InputError if the motion is curved."""
        if self.motion.degree > 1:
            raise InputError("is curved: it has no path of straight lines", "motion")
        return self.motion.knots

    def __bool__(self) -> bool:
        return bool(self.check)

    def __str__(self) -> str:
        if not self or not self.changed:
            return f"{self.how}{f' by {self.slower:.3g}' * (self.slower > 1)}; {self.check}"
        stretches = ", ".join(f"{first:.4g}–{last:.4g} s" for first, last in self.changed)
        return (
            f"repaired ({self.how}): {self.deviation:.3g} rad and {self.tool_deviation:.3g} mm at the tip from "
            f"where it was, most at {self.at:.4g} s; changed {stretches}"
            f"{f'; {self.slower:.3g} times as long' * (self.slower > 1)}; {self.check}"
        )

    _repr_html_ = notebook_html


def repair_with(
    motion: Motion,
    proof: MotionProver,
    limits: RateLimits | None = None,
    connect: Connect | None = None,
    people: People | None = None,
) -> Repair:
    """Repair a motion with the smallest change that makes it proven, or return it unchanged with the reason.

    The ends, the degree, the smoothness at knots, and the times are kept. Way points of straight lines that are outside
    the joint limits by rounding errors of single precision are moved to the limits. Only if `limits` of velocity,
    acceleration or jerk are exceeded, or stops are too late for `people` (both as for `check`), all times are
    multiplied by one factor.
    If moving the pieces does not succeed, `connect` finds proven paths between two configurations.
    """
    given = Motion.of(motion, space=proof.checker.robot).for_robot(proof.checker.robot)
    motion = _rounded_to_limits(given, proof.checker.robot)
    displacement, how = Displacement(motion, proof), "moved"

    def proven(candidate: Motion) -> MotionCheck:
        return check_with(candidate, proof, limits, people=people)

    if not displacement.bad:
        check = check_of(displacement.given, [], proof, limits, people)
        same = motion is given
        return _slowed(
            Repair(motion, check, "unchanged") if same else _measured(given, motion, check, how, proof), proven
        )
    for name, piece, q in (("start", 0, motion.knots[0]), ("end", motion.pieces - 1, motion.knots[-1])):
        if piece in displacement.bad and proof.check(q, q).verdict is not Verdict.FREE:
            return Repair(motion, proven(motion), f"its {name} cannot be proven, and ends are kept")
    result = displacement.moved()
    if result is None and connect is not None:
        result, how = displacement.planned(connect), "planned"
    if result is None:
        how = "nothing near it could be proven" + ", and no way round was found" * (connect is not None)
        return Repair(motion, proven(motion), how)
    check = check_of(result, [], proof, limits, people)
    return _slowed(_measured(given, result.motion, check, how, proof), proven)


def _rounded_to_limits(motion: Motion, robot: Robot) -> Motion:
    """Return straight lines with the way points that single precision puts outside the joint limits moved to them."""
    knots = np.clip(motion.knots, robot.lower, robot.upper)
    moved = np.abs(knots - motion.knots).max()
    if motion.degree > 1 or moved > _SINGLE_PRECISION or all(map(robot.joint_limits.hold, motion.knots)):
        return motion
    return replace(Motion.through(knots, motion.times), joint_names=motion.joint_names, timed=motion.timed)


def _slowed(repair: Repair, proven: Callable[[Motion], MotionCheck]) -> Repair:
    """Return the repair with a slower motion, if slowing down makes it proven."""
    worst, motion = repair.check.violations, repair.motion
    kinds = {violation.kind for violation in worst}
    if not kinds:
        return repair
    if not kinds <= set(_POWERS_OF_TIME):
        return replace(repair, how=f"{repair.how}, but not proven: {worst[0]}")

    def slower(factor: float) -> tuple[Motion, MotionCheck]:
        begin = motion.times[0]
        found = replace(motion, times=begin + factor * (motion.times - begin))
        return found, proven(found)

    excess = [
        abs(violation.value / violation.limit) ** (1 / _POWERS_OF_TIME[violation.kind])
        for violation in worst
        if _POWERS_OF_TIME[violation.kind] and violation.value is not None and violation.limit
    ]
    low, high = 1.0, max([*excess, _TRIAL_SLOWDOWN if "separation" in kinds else 1.0])
    found, check = slower(high)
    while not check and high < _MOST_SLOWDOWN:
        low, high = high, _TRIAL_SLOWDOWN * high
        found, check = slower(high)
    if not check:
        return replace(repair, how=f"{repair.how}, but not proven at any pace: {worst[0]}")
    while "separation" in kinds and high > _SLOWDOWN_PRECISION * low:
        middle = (low * high) ** 0.5
        trial, verdict = slower(middle)
        if verdict:
            found, check, high = trial, verdict, middle
        else:
            low = middle
    how = "slowed" if repair.how == "unchanged" else f"{repair.how} and slowed"
    return replace(repair, motion=found, check=check, how=how, slower=high)


class Displacement:
    """Moves a motion by B-splines until it is proven.

    `given` are the proofs of its pieces, and `bad` the pieces that are not proven.
    """

    def __init__(self, motion: Motion, proof: MotionProver) -> None:
        self._proof, self.given = proof, PieceProofs(motion, proof)
        self.bad = [k for k in self.given.undecided() if not self.given[k].proven()]

    def moved(self) -> PieceProofs | None:
        """Return the motion moved away from obstacles that are too near, or None if no such motion is proven."""
        motion = self.given.motion
        near = {k + side for k in self.bad for side in (-1, 0, 1)} & set(range(motion.pieces))
        for span, attempts in _SPANS:
            divided, of = _divided(motion, near, span)
            waiting = {part for part, k in enumerate(of.tolist()) if k in self.bad}
            found = self._proven_near(divided, attempts, waiting)
            if found is not None:
                return found
        return None

    def planned(self, connect: Connect) -> PieceProofs | None:
        """Return the motion with a planner's detour around obstacles, or None if no such motion is proven."""
        motion = self.given.motion
        for reach in (0, 1, 3, motion.pieces):
            first, last = self._allowed_knots(min(self.bad) - reach, max(self.bad) + 1 + reach)
            path = connect(motion.knots[first], motion.knots[last])
            if path is None:
                continue
            path = self._proof.checker.robot.unrolled(np.vstack([motion.knots[first], path[1:]]))
            if np.abs(path[-1] - motion.knots[last]).max() > _EQUAL_ENDS:
                continue
            followed = _following(motion, path, first, last)
            every = set(range(0 if followed is None else followed.pieces))
            found = None if followed is None else self._proven_near(followed, _SPANS[-1][1], every)
            if found is not None:
                return found
        return None

    def _allowed_knots(self, first: int, last: int) -> tuple[int, int]:
        """Return the two given knots, moved outwards until the motion is proven free at both."""
        knots = self.given.motion.knots
        first, last = max(first, 0), min(last, len(knots) - 1)
        while first > 0 and self._proof.check(knots[first], knots[first]).verdict is not Verdict.FREE:
            first -= 1
        while last < len(knots) - 1 and self._proof.check(knots[last], knots[last]).verdict is not Verdict.FREE:
            last += 1
        return first, last

    def _proven_near(self, motion: Motion, attempts: int, waiting: set[int]) -> PieceProofs | None:
        """Return a motion near the given one that is proven, or None.

        All pieces but the waiting ones are probably proven, so they are proven last.
        """
        basis = _basis(motion)
        moves = np.zeros((basis.shape[2], motion.n))
        # Points (piece, fraction) at which a pair was too near, in the order of discovery.
        places: dict[tuple[int, float], None] = {}
        pieces, left = PieceProofs(motion, self._proof), set(range(motion.pieces))
        for attempt, spare in enumerate(np.repeat(_EXTRA_DISTANCES, _ATTEMPTS).tolist()[:attempts]):
            bad = _unproven(pieces, waiting) or _unproven(pieces, left - waiting)
            left -= waiting
            if not bad:
                return pieces
            asked = dict(places)
            for k, witness in bad.items():
                asked |= dict.fromkeys((k, u) for u in (*_GRADIENT_PLACES, 0.5 if witness is None else witness))
            values = _values(basis, list(asked))
            of, slopes, missing = self._missing(pieces, list(asked), spare * values.sum(axis=1))
            kept = np.array([place in places for place in asked])
            kept[of[missing > 0]] = True
            places = dict.fromkeys(compress(asked, kept))
            chosen = kept[of] & (values[of] != 0.0).any(axis=1)
            of, slopes, missing = of[chosen], slopes[chosen], missing[chosen]
            rows = values[of]
            kept_moves = np.clip(_KEPT_SHARE * (attempt - _ATTEMPTS), 0.0, _MOST_KEPT_SHARE) * moves
            undone = np.einsum("mi,mj,ji->m", slopes, rows, moves - kept_moves)
            wanted = np.minimum(missing, _MOST_DISTANCE_GAIN) + undone
            if not len(rows):
                # All sampled distances suffice, but the proof fails, so the next attempt demands larger distances.
                continue
            step = kept_moves + _least_moves(rows, slopes, wanted) - moves
            moves = moves + step * min(1.0, _MOST_JOINT_MOVE / max(float(np.abs(step).max()), _NEGLIGIBLE_MOVE))
            before, pieces = pieces, PieceProofs(_moved(motion, basis, moves), self._proof)
            differs = (pieces.motion.coefficients != before.motion.coefficients).any(axis=(1, 2))
            waiting = {*bad, *np.flatnonzero(differs).tolist()}
            if not np.array_equal(pieces.tubes, before.tubes):
                left = set(range(motion.pieces))
        return None

    def _missing(self, pieces: PieceProofs, places: list[tuple[int, float]], spare: FloatArray) -> Shortfalls:
        """Return the shortfalls of distances, including those to joint limits, at (piece, fraction) points."""
        robot = self._proof.checker.robot
        numbers, u = (np.array(column) for column in zip(*places, strict=True))
        Q = polynomials.values(pieces.motion.coefficients[numbers], u[:, None])
        found = []
        for sign, bound in ((1.0, robot.lower), (-1.0, robot.upper)):
            inside = np.where(robot.continuous, np.inf, sign * (Q - bound))
            of, joints = np.nonzero(inside < _LIMIT_MARGIN)
            room = inside[of, joints]
            found.append((of, sign * np.eye(robot.n)[joints], np.where(room < 0, _LIMIT_MARGIN - room, 0.0)))
        for proof, rows in pieces.by_prover(numbers):
            of, slopes, missing = _too_near(Q[rows], proof, spare[rows])
            found.append((rows[of], slopes, missing))
        of, slopes, missing = map(np.concatenate, zip(*found, strict=True))
        return of, slopes, missing


def _too_near(Q: FloatArray, proof: MotionProver, spare: FloatArray) -> Shortfalls:
    """Return the shortfalls of distances at `Q: (B, n)`.

    They are negative for distances that may become too small.
    """
    required = proof.required
    near = required.least + spare[:, None] + _CONSTRAINT_BAND
    table = required.pairs.near(Q, float(near.max(initial=0.0)))
    rows, pairs = table[:, :2].T.astype(np.intp)
    table = table[table[:, 2] < near[rows, pairs]]
    rows, pairs = table[:, :2].T.astype(np.intp)
    slopes = required.pairs.gradients(Q, table)
    moving = slopes.any(axis=1)
    return rows[moving], slopes[moving], (near[rows, pairs] - _CONSTRAINT_BAND - table[:, 2])[moving]


# ------------------------------------------------------------------------------------------------------ B-splines


def _unproven(pieces: PieceProofs, numbers: set[int]) -> dict[int, float | None]:
    """Return which of some pieces are not proven, with a fraction of each at which it is not."""
    verdicts = {k: pieces[k].verdict() for k in pieces.undecided(sorted(numbers))}
    return {k: found.at for k, found in verdicts.items() if found.verdict is not Verdict.FREE}


def _divided(motion: Motion, pieces: set[int], span: float) -> tuple[Motion, IntArray]:
    """Return the motion with some pieces divided into parts about as long as `span` at most, and the piece of each."""
    cuts, counts = {}, np.ones(motion.pieces, dtype=np.intp)
    for k in pieces:
        at = np.polynomial.polynomial.polyval(np.array(_GRADIENT_PLACES), motion.coefficients[k]).T
        parts = int(np.ceil(np.linalg.norm(np.diff(at, axis=0), axis=1).sum() / span))
        if parts > 1:
            cuts[k], counts[k] = np.linspace(0.0, 1.0, parts + 1)[1:-1], parts
    return motion.cut(cuts), np.repeat(np.arange(motion.pieces), counts)


def _basis(motion: Motion) -> FloatArray:
    """Return coefficients (K, d + 1, N) of the B-splines that are as smooth as the motion and keep its ends."""
    degree = motion.degree
    smoothness = np.zeros(motion.pieces - 1, dtype=np.intp)
    equal = np.ones(motion.pieces - 1, dtype=bool)
    for order in range(1, degree):
        size = np.abs(motion.derivative_coefficients(order)).sum(axis=1).max(axis=1)
        jump = np.abs(motion.jumps(order)).max(axis=1)
        equal = equal & (jump <= _EQUAL_DERIVATIVES * np.maximum(np.maximum(size[:-1], size[1:]), 1e-12))
        smoothness += equal
    inner = np.repeat(motion.times[1:-1], degree - smoothness)
    first, last = motion.times[[0, -1]]
    knots = np.concatenate([np.full(degree + 1, first), inner, np.full(degree + 1, last)])
    number = len(knots) - degree - 1
    # Number of derivatives kept at the ends, including the position.
    kept = min(degree, 3 if motion.timed else 1)
    # On each piece d + 1 B-splines that follow each other are not 0, so as many columns tell them apart.
    _, coefficients, _ = polynomials.spline(knots, np.eye(degree + 1)[np.arange(number) % (degree + 1)], degree)
    last = np.arange(degree, number)
    last = last[knots[last + 1] > knots[last]]
    of, pieces = last[:, None] + np.arange(-degree, 1), np.arange(motion.pieces)[:, None]
    basis = np.zeros((motion.pieces, degree + 1, number))
    basis[pieces, :, of] = coefficients[pieces, :, of % (degree + 1)]
    return basis[:, :, kept : number - kept]


def _values(basis: FloatArray, places: list[tuple[int, float]]) -> FloatArray:
    """Return the values (M, N) of B-splines at (piece, fraction) points."""
    of, u = (np.array(column) for column in zip(*places, strict=True))
    powers = u[:, None] ** np.arange(basis.shape[1])
    return np.asarray(np.einsum("md,mdN->mN", powers, basis[of]))


def _moved(motion: Motion, basis: FloatArray, moves: FloatArray) -> Motion:
    """Return the motion with the B-splines, weighted by `moves`, added."""
    change = np.tensordot(basis, moves, axes=1)
    change[np.abs(change).max(axis=(1, 2)) <= _NEGLIGIBLE_MOVE] = 0.0
    size = np.abs(motion.coefficients).sum(axis=1) + np.abs(change).sum(axis=1)
    rounding = (0.0 if motion.rounding is None else motion.rounding) + 8 * polynomials.EPS * size
    return motion.derived(coefficients=motion.coefficients + change, rounding=rounding)


def _following(motion: Motion, path: FloatArray, first: int, last: int) -> Motion | None:
    """Return the motion displaced between two knots to follow a path (N, n), by a least-squares fit of B-splines."""
    begin, end = motion.times[first], motion.times[last]
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    if not travelled[-1] > 0.0:
        return None
    # Times at which the motion reaches the way points of the path.
    at = begin + (end - begin) * travelled / travelled[-1]
    cuts = {}
    for k in range(first, last):
        low, high = motion.times[k], motion.times[k + 1]
        here = (at[(at > low) & (at < high)] - low) / (high - low)
        if motion.degree > 1:
            length = travelled[-1] * (high - low) / (end - begin)
            even = np.linspace(0.0, 1.0, 1 + int(np.ceil(2 * length / _SPANS[-1][0])))[1:-1]
            here = even if not len(here) else np.union1d(even, here)
        here = here[np.diff(here, prepend=0.0, append=1.0)[:-1] > 1e-3]
        cuts[k] = here[here < 1.0 - 1e-3]
    fine = motion.cut({k: here for k, here in cuts.items() if len(here)})
    basis = _basis(fine)
    inside = (fine.times[:-1] >= begin) & (fine.times[1:] <= end)
    free = ~(np.abs(basis[~inside]).max(axis=(0, 1), initial=0.0) > 0.0)
    if not free.any():
        return None
    u = np.linspace(0.0, 1.0, 5)
    powers = u[:, None] ** np.arange(motion.degree + 1)
    times = (fine.times[:-1, None] + u * np.diff(fine.times)[:, None])[inside].ravel()
    goal = np.stack([np.interp(times, at, path[:, i]) for i in range(motion.n)], axis=1)
    now = (powers @ fine.coefficients[inside]).reshape(-1, motion.n)
    rows = (powers @ basis[inside]).reshape(len(times), -1)[:, free]
    moves = np.zeros((basis.shape[2], motion.n))
    moves[free] = np.linalg.lstsq(rows, goal - now, rcond=1e-9)[0]
    return _moved(fine, basis, moves)


def _least_moves(rows: FloatArray, slopes: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return the least x (N, n) with slopes_m · Σ_j rows_mj x_j ≥ wanted_m, approximately if there is none.

    Multipliers λ ≥ 0 with x = Σ_m λ_m rows_m slopes_mᵀ minimise ½ λᵀ Q λ − wantedᵀ λ. The active-set method of Lawson
    and Hanson (Solving Least Squares Problems, 1974, ch. 23) adds the most violated constraint and drops constraints
    whose multiplier would become negative.
    """
    products = (rows @ rows.T) * (slopes @ slopes.T)
    products.flat[:: len(products) + 1] *= 1.0 + _REGULARISATION
    weights, active = np.zeros(len(wanted)), np.zeros(len(wanted), dtype=bool)
    for _ in range(_MOST_ACTIVE_SET_ROUNDS):
        violated = np.where(active, 0.0, wanted - products[:, active] @ weights[active])
        entering = int(violated.argmax())
        if violated[entering] <= _CONSTRAINT_TOLERANCE:
            break
        active[entering] = True
        while active.any():
            chosen = np.flatnonzero(active)
            best = np.linalg.solve(products[np.ix_(chosen, chosen)], wanted[chosen])
            pulls = best <= 0.0
            if not pulls.any():
                weights[chosen] = best
                break
            now = weights[chosen]
            share = float((now[pulls] / (now[pulls] - best[pulls])).min())
            weights[chosen] = now + share * (best - now)
            dropped = chosen[pulls & (weights[chosen] <= _NEGLIGIBLE_MOVE)]
            weights[dropped], active[dropped] = 0.0, False
    return np.asarray(np.einsum("m,mj,mi->ji", weights, rows, slopes))


def _measured(given: Motion, found: Motion, check: MotionCheck, how: str, proof: MotionProver) -> Repair:
    """Return the repair with its measured deviations from the given motion."""
    places = np.linspace(found.times[:-1], found.times[1:], len(_GRADIENT_PLACES), axis=1)
    flat = places.ravel()
    Q, P = found.at(flat), given.at(flat)
    apart = np.abs(Q - P).max(axis=1)
    robot = proof.checker.robot
    worst = int(apart.argmax())
    differs = np.flatnonzero(apart > _NEGLIGIBLE_MOVE)
    tips = robot.tip_positions(Q[differs]) - robot.tip_positions(P[differs])
    tool = float(np.linalg.norm(tips, axis=1).max(initial=0.0))
    pieces = (apart > _NEGLIGIBLE_MOVE).reshape(places.shape).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], pieces, [0]])))
    changed = tuple((float(found.times[a]), float(found.times[b])) for a, b in edges.reshape(-1, 2))
    return Repair(found, check, how, float(apart[worst]), 1e3 * tool, float(flat[worst]), changed)
