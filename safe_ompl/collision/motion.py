"""Certified motions: proof that a whole edge is free, from a few queries (`math.md` §4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from math import ceil, isfinite
from typing import Protocol

import numpy as np

from safe_ompl.arrays import FloatArray, positive
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.errors import InputError
from safe_ompl.robot.joint_limits import JointLimits

# [m] Bodies move at most this far in half of a first interval. Larger intervals almost never pass: starting here
# instead of at the whole edge saves a third of the time of a free edge (bench/motion.py).
_FIRST_REACH = 0.15

# [m] Default floor. Smaller ones decide hardly more edges, as contact itself is known to 0.01 mm; larger ones save
# nothing while planning, where few edges pass so near to a contact.
FLOOR = 5e-6


class Verdict(Enum):
    """What is known of an edge. Only FREE edges may be driven."""

    FREE = "free"
    BLOCKED = "blocked"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class MotionVerdict:
    """Outcome of a certified check.

    Attributes
    ----------
    verdict : Verdict
        FREE: proven for every configuration of the edge. BLOCKED: `at` is in collision, nearer to something than it
        must keep, too dangerous, or outside the joint limits. UNDECIDED: near `at` there is less than the floor left.
    at : float or None
        Fraction of the edge in [0, 1] where it is blocked or undecided.
    pair : tuple of str or None
        Names of the pair in contact or too near, or of the joint and "its limits".
    """

    verdict: Verdict
    at: float | None = None
    pair: tuple[str, str] | None = None


class MotionLimit(Protocol):
    """Something else that can be proven of motions."""

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion between `start` and `end: (n,)`."""


class CertifiedMotion:
    """Proves straight joint motions free of collision by subdivision with security margins.

    While the joints move by Δ, the bodies of pair p approach each other by at most W_p = Σ_i R_pi·|Δ_i|. So if at
    the centre of an interval of half-length s (a fraction of the edge) every pair keeps more than s·W_p, the
    whole interval is free: one boolean query. An interval that fails is divided in three, if its centre is free of
    contact; the middle one keeps the centre. (Halves would cost a sixth more.)

    Parameters
    ----------
    checker : CollisionChecker
        Answers the queries.
    floor : float
        [m] Give up on an interval in which the bodies move less than this: an edge with less clearance than
        about half the floor stays undecided.
    margin : float
        [m] Prove that the robot keeps more than this from every obstacle; 0 proves that it is free. What the checker
        requires by its `setMinClearance` is proven in any case.
    limits : sequence of MotionLimit
        What else must be proven of a motion that is free, such as a `DangerLimit`.

    Raises
    ------
    InputError
        If the floor is not positive, or the margin negative.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        floor: float = FLOOR,
        *,
        margin: float = 0.0,
        limits: Sequence[MotionLimit] = (),
    ) -> None:
        self.checker = checker
        self.limits = tuple(limits)
        self._joint_limits = JointLimits(checker.robot)
        self.floor = floor
        if not (np.isfinite(margin) and margin >= 0):
            raise InputError(f"margin must be a length >= 0 [m], got {margin!r}")
        self.margin = float(margin)
        checker.cover(self.margin)
        self._moving: tuple[dict[str, float], float] = {}, 0.0  # speeds, and for how long
        self._required: tuple[FloatArray, _Required] | None = None  # made for which `checker.required`

    @property
    def floor(self) -> float:
        """Displacement [m] below which an interval is not divided any more."""
        return self._floor

    @floor.setter
    def floor(self, value: float) -> None:
        self._floor = positive(value, "floor", "length [m]")

    def __repr__(self) -> str:
        return f"CertifiedMotion({self.checker!r}, floor={self.floor:g}, margin={self.margin:g})"

    def with_margin(self, margin: float) -> CertifiedMotion:
        """Return the same with another margin [m]."""
        other = CertifiedMotion(self.checker, self.floor, margin=margin, limits=self.limits)
        other.setMovingObstacles(*self._moving)
        return other

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Prove that a distance is kept, too; see `CollisionChecker.setMinClearance`, where it is set."""
        self.checker.setMinClearance(distance, obstacles, exempt)

    def is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the straight motion between two configurations (n,) is within limits and proven free."""
        if not (self._joint_limits.hold(start) and self._joint_limits.hold(end)):
            _check_finite(start, end)
            return False  # outside them nothing is proven: pairs that never meet within are not looked at
        if self._subdivide(start, end, self._still)[0] is not Verdict.FREE:
            return False
        return all(limit.check(start, end).verdict is Verdict.FREE for limit in self.limits)

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion between `start` and `end: (n,)`; name the witness where it is not free."""
        found = self._check(start, end, self._still)
        for limit in self.limits if found.verdict is Verdict.FREE else ():
            found = limit.check(start, end)
            if found.verdict is not Verdict.FREE:
                break
        return found

    def check_moving(
        self,
        start: FloatArray,
        end: FloatArray,
        speeds: Mapping[str, float],
        span: tuple[float, float],
    ) -> MotionVerdict:
        """Check a motion among obstacles that move, however they do, no faster than their speeds (`math.md` §3).

        At time 0 obstacles are where the scene has them; at time t an obstacle has moved by no more than speed·t.

        Parameters
        ----------
        start, end : ndarray, shape (n,)
            Joint values at the first and the last instant; joints move evenly in between.
        speeds : mapping of str to float
            Bound of the speed [m/s] of the obstacles that move, by name. The others stand still.
        span : (float, float)
            First and last instant [s], 0 ≤ first ≤ last.

        Returns
        -------
        MotionVerdict
            FREE: proven whatever the obstacles do. BLOCKED: at `at` an obstacle may have come to the robot.

        Raises
        ------
        UnknownNameError
            If the scene has no obstacle of such a name.
        InputError
            If a speed is negative or not finite, or the span is not one.
        """
        first, last = _checked_span(span)
        self._check_speeds(speeds)
        self._cover(max(speeds.values(), default=0.0) * last)
        rates = self._rates(speeds)
        found = self._check(
            start, end, _Required(self._still.at_start + first * rates, (last - first) * rates)
        )
        for limit in self.limits if found.verdict is Verdict.FREE else ():
            found = limit.check(start, end)
        return found

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Prove from now on that motions stay free among obstacles that move, whenever within a time they are driven.

        At any instant an obstacle may have moved by speed·time: this holds for whole paths, whatever their timing.
        `check_moving` is sharper where the timing of a motion is known.

        Parameters
        ----------
        speeds : mapping of str to float
            Bound of the speed [m/s] of the obstacles that move, by name; none: all stand still.
        time : float
            [s] from the moment of the scene to the end of the last motion.

        Raises
        ------
        UnknownNameError
            If the scene has no obstacle of such a name.
        InputError
            If a speed or the time is negative or not finite.
        """
        _, last = _checked_span((0.0, time))
        self._check_speeds(speeds)
        self._moving = dict(speeds), last
        self._required = None

    def getMovingObstacles(self) -> tuple[dict[str, float], float]:
        """Return the speeds [m/s] by name and the time [s] that `setMovingObstacles` has set."""
        return dict(self._moving[0]), self._moving[1]

    def _check_speeds(self, speeds: Mapping[str, float]) -> None:
        for name, speed in speeds.items():
            if not (self.checker.scene[name] and isfinite(speed) and speed >= 0):
                raise InputError(f"speed of {name!r} must be a number >= 0 [m/s], got {speed!r}")

    def _cover(self, further: float = 0.0) -> None:
        """Have the checker look at all pairs that must keep a distance, and this much more [m]."""
        wanted, (speeds, time) = self.checker.getMinClearance(), self._moving
        least = max(self.margin, 0.0 if wanted is None else wanted.distance)
        self.checker.cover(least + max(speeds.values(), default=0.0) * time + further)

    def _rates(self, speeds: Mapping[str, float]) -> FloatArray:
        """Return how fast (P,) obstacles may come nearer to the bodies of their pairs [m/s]."""
        rates = np.array([speeds.get(obstacle, 0.0) for _, obstacle in self.checker.pair_names])
        return rates * self.checker.meets_obstacle

    @property
    def _still(self) -> _Required:
        """What pairs must keep from obstacles where the scene has them."""
        if self._required is None or self._required[0] is not self.checker.required:
            self._cover()
            required, (speeds, time) = self.checker.required, self._moving
            wanted = np.maximum(required, self.margin * self.checker.meets_obstacle) + time * self._rates(
                speeds
            )
            self._required = required, _Required(wanted)
        return self._required[1]

    def _check(self, start: FloatArray, end: FloatArray, required: _Required) -> MotionVerdict:
        robot, checker = self.checker.robot, self.checker
        verdict, at = self._subdivide(start, end, required)
        for fraction, q in ((0.0, start), (1.0, end)):
            for i in np.flatnonzero(~robot.within_limits(q)):
                return MotionVerdict(Verdict.BLOCKED, fraction, (robot.joint_names[i], "its limits"))
        if verdict is not Verdict.BLOCKED or at is None:
            return MotionVerdict(verdict, at)
        q = start + at * robot.difference(start, end)
        pair = checker.colliding_pair(q)
        if pair is None:
            checker.set_margins(required.at(at))
            pair = checker.pair_within_margins(q)
        return MotionVerdict(verdict, at, pair)

    def _subdivide(
        self, start: FloatArray, end: FloatArray, required: _Required
    ) -> tuple[Verdict, float | None]:
        checker = self.checker
        delta = checker.robot.difference(start, end)
        _check_finite(start, end)
        approach = checker.pair_radii @ np.abs(delta)
        if required.growth is not None:
            approach = approach + required.growth
        widest = float(approach.max(initial=0.0))
        count = max(1, ceil(0.5 * widest / _FIRST_REACH))
        half = 0.5 / count
        centres = [(2 * k + 1) * half for k in range(count)]
        unproven: list[float] = []
        while True:
            known_free, unproven = set(unproven), []
            checker.set_margins(half * approach + required.at_start)
            for t in centres:
                if required.growth is not None:
                    checker.set_margins(half * approach + required.at(t))
                q = start + t * delta
                if checker.within_margins(q):
                    if t not in known_free and checker.in_collision(q):
                        return Verdict.BLOCKED, t
                    unproven.append(t)
            if not unproven:
                return Verdict.FREE, None
            if required.any:
                unknown = [t for t in unproven if t not in known_free]
                blocked = self._first_too_near(start, delta, unknown, required)
                if blocked is not None:
                    return Verdict.BLOCKED, blocked
            if half * widest < self._floor:
                return Verdict.UNDECIDED, unproven[0]
            half /= 3
            centres = [t + side for t in unproven for side in (-2 * half, 0.0, 2 * half)]

    def _first_too_near(
        self, start: FloatArray, delta: FloatArray, places: list[float], required: _Required
    ) -> float | None:
        """Return the first of the places on an edge where a pair is nearer than it must be, or None."""
        self.checker.set_margins(required.at_start)
        for t in places:
            if required.growth is not None:
                self.checker.set_margins(required.at(t))
            if self.checker.within_margins(start + t * delta):
                return t
        return None


def _check_finite(start: FloatArray, end: FloatArray) -> None:
    if not isfinite(sum(start.tolist()) + sum(end.tolist())):
        raise InputError(f"motion between {start.tolist()} and {end.tolist()} is not finite")


class _Required:
    """Distances (P,) [m] that pairs must keep: at the start of an edge, and how much more at its end."""

    def __init__(self, at_start: FloatArray, growth: FloatArray | None = None) -> None:
        self.at_start = at_start
        self.growth = growth if growth is not None and growth.any() else None
        self.any = self.growth is not None or bool(at_start.any())

    def at(self, t: float) -> FloatArray:
        return self.at_start if self.growth is None else self.at_start + t * self.growth


def _checked_span(span: tuple[float, float]) -> tuple[float, float]:
    first, last = span
    if not (isfinite(first) and isfinite(last) and 0 <= first <= last):
        raise InputError(f"span must be two instants [s], 0 <= first <= last, got {span!r}")
    return float(first), float(last)
