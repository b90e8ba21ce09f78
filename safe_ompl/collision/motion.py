"""Certified motions: prove with a few queries that a whole edge is collision free (`docs/how-it-works.md` §4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from itertools import chain
from math import ceil
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.proofs import BoundsProof
from safe_ompl.collision.separation import TOUCHING_ONLY, RequiredDistances, Separation
from safe_ompl.common import (
    BoolArray,
    FloatArray,
    InputError,
    configuration_unchecked,
    configurations,
    finite_array,
    number,
    whole_number,
)
from safe_ompl.robot import JointLimits, plain

# [m] The first intervals are so short that bodies move at most this far in half an interval. Longer intervals almost
# never pass: starting with these intervals instead of the whole edge saves a third of the time of a free edge
# (bench/motion.py).
_FIRST_REACH = 0.15

# [m] Default floor. Smaller floors decide hardly more edges, because contact itself is known to 0.01 mm. Larger floors
# save no time while planning, where few edges pass so near to contact.
FLOOR = 5e-6


# Coefficients c_k (n,) of a motion q(t) = Σ_k c_k t^k, t in [0, 1]. For an edge they are its start and its difference.
Curve: TypeAlias = Sequence[FloatArray]
# The centre and the half-length of an interval, as fractions of a motion.
Interval: TypeAlias = tuple[float, float]


class Verdict(Enum):
    """Result of checking an edge. Only FREE edges may be executed.

    Examples
    --------
    >>> Verdict.FREE is Verdict("free")
    True
    """

    FREE = "free"
    BLOCKED = "blocked"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class MotionVerdict:
    """Outcome of a certified check.

    Attributes
    ----------
    verdict : Verdict
        FREE: proven for every configuration of the edge. BLOCKED: the configuration at `at` is in collision, nearer to
        an obstacle than allowed, too dangerous, or outside the joint limits. UNDECIDED: there is no proof near `at`,
        although no body moves by more than the floor of the prover in half of the interval.
    at : float or None
        Fraction of the edge in [0, 1] at which it is blocked or undecided.
    pair : tuple of str or None
        Names of the pair in contact or too near, or of the joint and "its limits".
    """

    verdict: Verdict
    at: float | None = None
    pair: tuple[str, str] | None = None


class MotionLimit(Protocol):
    """A further requirement that can be proven for motions.

    The optional method `holds_within(q, steps) -> bool` proves the requirement for all configurations whose joint
    values are within `steps: (n,)` of `q: (n,)`. With it, the method `allows(q) -> bool` for one configuration, and a
    `name`, the requirement can also be proven for curves and for tubes about motions.
    """

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion from `start` to `end: (n,)`."""


@dataclass(frozen=True, eq=False)
class MotionProver:
    """Proves that motions of the joints are collision free, by subdivision with security margins.

    While the joints move by Δ, the bodies of pair p approach each other by at most W_p = Σ_i R_pi·|Δ_i|. An interval of
    half-length s (a fraction of the edge) is therefore free if at its centre every pair keeps more than s·W_p, which
    takes one boolean query. An interval that fails is divided in three if its centre is free of contact; the middle
    third reuses the centre. (Halving would cost a sixth more.) Curves are proven in the same way (`check_curve`).
    Before any query, kernels prove most motions with distance bounds (`proofs.pyx`).

    Motions that leave the robot's limits are refused, because only pairs that may meet within the limits are checked.
    Queries from several threads are safe. Obstacles of the checker may move between two queries. To prove other
    requirements, copy the prover with `dataclasses.replace`. The attribute `required` holds the distances that pairs
    must keep.

    Parameters
    ----------
    checker : CollisionChecker
        Answers the collision queries.
    floor : float
        [m] > 0 An interval that is not proven is divided unless the distance of every pair changes by less than the
        floor in half of the interval. Then the edge stays undecided. Apart from `limits`, this happens only if a
        distance is less than the floor above the smallest one that can be proven (that of `separation`, plus the
        errors of the queries).
    separation : Separation
        Distances that the robot must keep from obstacles. Default: the robot must not touch them.
    limits : sequence of MotionLimit
        Further requirements that must be proven, such as a `DangerLimit`.
    stop : callable
        Returns whether to stop. Motions that are not proven by then stay undecided.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> prover = MotionProver(CollisionChecker(robot, Scene()))
    >>> prover.is_free([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
    True
    """

    checker: CollisionChecker
    floor: float = FLOOR
    separation: Separation = field(default=TOUCHING_ONLY, kw_only=True)
    limits: Sequence[MotionLimit] = field(default=(), kw_only=True)
    stop: Callable[[], bool] = field(default=lambda: False, kw_only=True)
    required: RequiredDistances = field(init=False)
    _widened: dict[float, RequiredDistances] = field(init=False, default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "floor", number("floor", self.floor, above=0.0, kind="length [m]"))
        object.__setattr__(self, "limits", tuple(self.limits))
        object.__setattr__(self, "required", self.separation.required(self.checker))

    def __reduce__(self) -> tuple[Any, ...]:
        # A pickled copy lacks only `stop`.
        kept = partial(MotionProver, separation=self.separation, limits=self.limits)
        return kept, (self.checker, self.floor)

    def __repr__(self) -> str:
        return f"MotionProver({self.checker!r}, floor={self.floor:g}, margin={self.separation.margin:g})"

    def is_free(self, start: ArrayLike, end: ArrayLike, margin: float = 0.0, limits: JointLimits | None = None) -> bool:
        """Return whether the straight motion between two configurations (n,) is proven free; errors as `check`.

        With a margin [m], bodies that may touch an obstacle must also keep this distance from it. Unlike a separation,
        the margin does not apply to other bodies, needs no preparation, and may differ in each call. With narrower
        `limits` than the robot's, motions that are not finite are not free.
        """
        start, end = self._edge(start, end)
        required, changes = self.required_with(margin), self.checker.changes
        done = changes.done
        table = (limits or self.checker.robot.joint_limits).table
        known = required.pairs.bounds.prove_edge(start, end, table, required.allowed_for, self.floor)
        if known is None:
            if limits is None:
                self._check_finite(start, end)
            return False
        if changes.begun != done or not (known.proven or known.blocked):
            curve = start, self.checker.robot.difference(start, end)
            if self._completed(known, done, curve, required)[0] is not Verdict.FREE:
                return False
        elif known.blocked:
            return False
        return all(self._keeps(limit, start, end).verdict is Verdict.FREE for limit in self.limits)

    def are_free(self, starts: ArrayLike, ends: ArrayLike, *, workers: int = 1) -> BoolArray:
        """Return which of the straight motions from `starts` to `ends: (E, n)` are proven free, (E,).

        The results equal those of `is_free`, take a fraction of the time, and all hold for one scene: moves of
        obstacles wait. One compiled loop, divided among `workers` threads, proves most motions. Motions that distance
        bounds do not decide, and further `limits`, are checked one after the other. Raises InputError if the shapes do
        not match, a value is not finite, or `workers` is less than 1.
        """
        n, required = self.checker.robot.n, self.required
        starts, ends = (configurations(Q, n, f"{of} of motions") for Q, of in ((starts, "starts"), (ends, "ends")))
        if len(starts) != len(ends):
            raise InputError(f"motions need as many starts as ends, got {len(starts)} and {len(ends)}")
        workers = whole_number("workers", workers, at_least=1)
        edges, free = self.checker.robot.joint_limits.table.edges(plain(starts), plain(ends))
        rows = np.flatnonzero(free)
        with self.checker.changes.read_lock():
            found = required.pairs.bounds.prove_many(edges[rows], required.allowed_for, self.floor, workers)
            free[rows] = found > 0
            for k in rows[found == 0] if not self.limits else rows[found >= 0]:
                free[k] = self.is_free(starts[k], ends[k])
        return free

    def proven_by_bounds(self, curves: FloatArray) -> BoolArray:
        """Return which motions, given as for `check_curve` and finite (E, d + 1, n), distance bounds prove free, (E,).

        The other motions are undecided. One call takes much less time than one `check_curve` for each motion.
        """
        held, required = self.checker.robot.joint_limits.hold_curves(curves) & (not self.limits), self.required
        coupling, (count, size, n) = self.checker.robot.coupling, curves.shape
        moved = np.empty((count, size, len(coupling.offsets)))
        moved[:, 0] = coupling.values(curves[:, 0])
        moved[:, 1:] = coupling.motions(curves[:, 1:].reshape(-1, n)).reshape(moved[:, 1:].shape)
        with self.checker.changes.read_lock():
            return held & (required.pairs.bounds.prove_many(moved, required.allowed_for, self.floor) > 0)

    def check(self, start: ArrayLike, end: ArrayLike) -> MotionVerdict:
        """Check the straight motion from `start` to `end: (n,)`.

        If it is not free, the verdict names the pair at fault. Raises InputError if a configuration has the wrong shape
        or is not finite.
        """
        start, end = self._edge(start, end)
        self._check_finite(start, end)
        robot = self.checker.robot
        for fraction, q in ((0.0, start), (1.0, end)):
            for i in np.flatnonzero(~robot.within_limits(q)):
                return MotionVerdict(Verdict.BLOCKED, fraction, (robot.joint_names[i], "its limits"))
        found = self._collision((start, robot.difference(start, end)))
        return _first_refusal(found, (self._keeps(limit, start, end) for limit in self.limits))

    def check_curve(self, coefficients: ArrayLike) -> MotionVerdict:
        """Check the motion q(t) = Σ_k c_k t^k, t in [0, 1], with coefficients (d + 1, n) [rad or m], d ≥ 1.

        Joint values are not wrapped: a continuous joint moves exactly as its values say. The proof covers the curve
        itself, not a polygon near it (`docs/how-it-works.md` §4). If the verdict is not FREE, `at` is t. Limits without
        `holds_within` give UNDECIDED. Raises InputError if the coefficients have another shape or are not finite.
        """
        curve: Curve = tuple(finite_array(coefficients, (None, self.checker.robot.n), "coefficients of a motion"))
        if len(curve) < 2:
            raise InputError("a motion must have at least two coefficients, got one")
        outside = self.checker.robot.joint_limits.left_by(curve)
        if outside is not None:
            joint, at = outside
            return MotionVerdict(Verdict.BLOCKED, at, (self.checker.robot.joint_names[joint], "its limits"))
        return _first_refusal(self._collision(curve), (self._curve_keeps(limit, curve) for limit in self.limits))

    def required_with(self, margin: float) -> RequiredDistances:
        """Return the required distances with an additional margin [m] from obstacles. The last result is cached."""
        if not margin:
            return self.required
        widened = self._widened.get(margin)
        if widened is None:
            pairs = self.required.pairs
            widened = RequiredDistances(pairs, np.maximum(self.required.least, pairs.margins(margin)))
            self._widened.clear()
            self._widened[margin] = widened
        return widened

    def _edge(self, start: ArrayLike, end: ArrayLike) -> tuple[FloatArray, FloatArray]:
        n = self.checker.robot.n
        first = configuration_unchecked(start, n, "start of a motion")
        return first, configuration_unchecked(end, n, "end of a motion")

    def _check_finite(self, start: FloatArray, end: FloatArray) -> None:
        if not (np.isfinite(start).all() and np.isfinite(end).all()):
            raise InputError(f"motion between {start.tolist()} and {end.tolist()} is not finite")

    def _collision(self, curve: Curve) -> MotionVerdict:
        """Return the verdict on collisions, with the pair that is too near."""
        required, done = self.required, self.checker.changes.done
        verdict, at = self._completed(self._by_bounds(curve, required), done, curve, required)
        if verdict is not Verdict.BLOCKED or at is None:
            return MotionVerdict(verdict, at)
        q = place(curve, at)
        return MotionVerdict(verdict, at, self.checker.colliding_pair(q) or required.violating_pair(q))

    def _keeps(self, limit: MotionLimit, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Return the verdict of a limit on an edge, and on the tube about the edge if there is one."""
        if self.separation.tube:
            return self._curve_keeps(limit, (start, self.checker.robot.difference(start, end)))
        return limit.check(start, end)

    def _curve_keeps(self, limit: MotionLimit, curve: Curve) -> MotionVerdict:
        """Return the verdict of a limit on a curve and the tube about the curve, by bisection."""
        name = getattr(limit, "name", type(limit).__name__)
        witness = (name, "its limit")
        holds: Callable[[FloatArray, FloatArray], bool] | None = getattr(limit, "holds_within", None)
        if holds is None:
            return MotionVerdict(Verdict.UNDECIDED, 0.0, witness)
        allows: Callable[[FloatArray], bool] = limit.allows  # type: ignore[attr-defined]
        tube = np.array(self.separation.tube or 0.0)
        radii = self.checker.robot.bounds.displacement_radii
        intervals = [(0.5, 0.5)]
        for q, at in ((place(curve, 0.0), 0.0), (place(curve, 1.0), 1.0)):
            if not allows(q):
                return MotionVerdict(Verdict.BLOCKED, at, witness)
        while intervals:
            t, half = intervals.pop()
            if self.stop():
                return MotionVerdict(Verdict.UNDECIDED, t, witness)
            q, steps = place(curve, t), half * speeds_about(curve, t, half)
            if holds(q, steps + tube):
                continue
            if not allows(q):
                return MotionVerdict(Verdict.BLOCKED, t, witness)
            if (radii @ steps).max(initial=0.0) < self.floor:
                return MotionVerdict(Verdict.UNDECIDED, t, witness)
            half /= 2
            intervals += [(t + half, half), (t - half, half)]
        return MotionVerdict(Verdict.FREE)

    def _completed(
        self, known: BoundsProof, done: int, curve: Curve, required: RequiredDistances
    ) -> tuple[Verdict, float | None]:
        """Finish a proof by bounds and return the verdict and its fraction of the motion.

        `done` is the number of obstacle moves that were complete when the proof began. If another thread moves
        obstacles during the proof, the proof is repeated.
        """
        changes = self.checker.changes
        found = self._subdivide(known, curve, required)
        if changes.begun == done:
            return found
        with changes.read_lock():
            return self._subdivide(self._by_bounds(curve, required), curve, required)

    def _by_bounds(self, curve: Curve, required: RequiredDistances) -> BoundsProof:
        return required.pairs.bounds.prove(curve, required.allowed_for, self.floor)

    def _subdivide(self, known: BoundsProof, curve: Curve, required: RequiredDistances) -> tuple[Verdict, float | None]:
        checker, pairs = self.checker, required.pairs
        if known.proven:
            return Verdict.FREE, None
        if known.blocked:
            return Verdict.BLOCKED, known.at
        if known.at >= 0:
            q = place(curve, known.at)
            if checker.touches(q) or required.violated(q):
                return Verdict.BLOCKED, known.at
        curved, approach, margins, asked = len(curve) > 2, np.empty(0), np.empty(0), -1.0
        intervals = self._first_intervals(curve, required, known)
        unproven: list[Interval] = []
        while True:
            known_free, unproven = {t for t, _ in unproven}, []
            for t, half in intervals:
                if self.stop():
                    return Verdict.UNDECIDED, t
                if curved or half != asked:
                    approach = pairs.radii @ speeds_about(curve, t, half)
                    margins, asked = half * approach + required.provable, half
                    # The queries cache results for read-only margins.
                    margins.setflags(write=False)
                q = place(curve, t)
                if pairs.within_margins(q, margins):
                    if t not in known_free and checker.touches(q):
                        return Verdict.BLOCKED, t
                    unproven.append((t, half))
            if not unproven:
                return Verdict.FREE, None
            intervals = []
            for t, half in unproven:
                q = place(curve, t)
                if t not in known_free and pairs.within_margins(q, required.provable):
                    return Verdict.BLOCKED if required.violated(q) else Verdict.UNDECIDED, t
                if curved:
                    approach = pairs.radii @ speeds_about(curve, t, half)
                if half * approach.max(initial=0.0) < self.floor:
                    return Verdict.UNDECIDED, t
                third = half / 3
                intervals += _unknown([(t + side, third) for side in (-2 * third, 0.0, 2 * third)], known)

    def _first_intervals(self, curve: Curve, required: RequiredDistances, known: BoundsProof) -> list[Interval]:
        """Return intervals that cover all of the curve that is not known to be free.

        No pair approaches by more than 0.3 m in any. The speed bound over a whole curve may be far too large, so
        intervals of a curve are halved and bounded again. An edge has constant speed and is divided evenly.
        """
        waiting, found = [(0.5, 0.5)], list[Interval]()
        while waiting:
            if self.stop():
                return [*found, *waiting]
            t, half = waiting.pop()
            if not _unknown([(t, half)], known):
                continue
            widest = half * (required.pairs.radii @ speeds_about(curve, t, half)).max(initial=0.0)
            if widest <= _FIRST_REACH:
                found.append((t, half))
            elif len(curve) > 2:
                waiting += [(t + half / 2, half / 2), (t - half / 2, half / 2)]
            else:
                count = ceil(widest / _FIRST_REACH)
                found += [((2 * k + 1) * half / count, half / count) for k in range(count)]
        return _unknown(found, known)


def _first_refusal(found: MotionVerdict, others: Iterable[MotionVerdict]) -> MotionVerdict:
    """Return the first verdict that is not FREE, or `found` if all verdicts are FREE."""
    return next((verdict for verdict in chain([found], others) if verdict.verdict is not Verdict.FREE), found)


def place(curve: Curve, t: float) -> FloatArray:
    """Return the joint values (n,) of a curve at t."""
    q = curve[-1]
    for coefficient in curve[-2::-1]:
        q = coefficient + t * q
    return q


def speeds_about(curve: Curve, t: float, half: float) -> FloatArray:
    """Return speeds v (n,) ≥ 0 with |q(t + x) − q(t)| ≤ |x| v for |x| ≤ half, by Taylor expansion at t."""
    taylor = list(curve)
    for k in range(len(taylor) - 1):
        for j in range(len(taylor) - 2, k - 1, -1):
            taylor[j] = taylor[j] + t * taylor[j + 1]
    speeds = np.abs(taylor[-1])
    for coefficient in taylor[-2:0:-1]:
        speeds = np.abs(coefficient) + half * speeds
    return speeds


def _unknown(intervals: list[Interval], known: BoundsProof) -> list[Interval]:
    """Return the intervals that are not known to be free."""
    return [(t, half) for t, half in intervals if not known.covers(t - half, t + half)]
