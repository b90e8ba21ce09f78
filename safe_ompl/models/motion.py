"""Certified motions: proof that a whole edge is free, from a few queries (`math.md` §4)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import ceil, isfinite

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError
from safe_ompl.models.collision import CollisionChecker

# [m] Bodies move at most this far in half of a first interval. Larger intervals almost never pass: starting here
# instead of at the whole edge saves a third of the time of a free edge (bench/motion.py).
_FIRST_REACH = 0.2


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
        FREE: proven for every configuration of the edge. BLOCKED: `at` is in collision, or outside the joint
        limits. UNDECIDED: near `at` the clearance is below the floor.
    at : float or None
        Fraction of the edge in [0, 1] where it is blocked or undecided.
    pair : tuple of str or None
        Names of the pair in contact, or of the joint and "its limits".
    """

    verdict: Verdict
    at: float | None = None
    pair: tuple[str, str] | None = None


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

    Raises
    ------
    InputError
        If the floor is not positive.
    """

    def __init__(self, checker: CollisionChecker, floor: float = 1e-4) -> None:
        self.checker = checker
        self.floor = floor

    @property
    def floor(self) -> float:
        """Displacement [m] below which an interval is not divided any more."""
        return self._floor

    @floor.setter
    def floor(self, value: float) -> None:
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"floor must be a positive length [m], got {value!r}")
        self._floor = float(value)

    def __repr__(self) -> str:
        return f"CertifiedMotion({self.checker!r}, floor={self.floor:g})"

    def is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the straight motion between two configurations (n,) within limits is proven free."""
        return self._subdivide(start, end)[0] is Verdict.FREE

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion between `start` and `end: (n,)`; name the witness where it is not free."""
        robot = self.checker.robot
        verdict, at = self._subdivide(start, end)
        for fraction, q in ((0.0, start), (1.0, end)):
            for i in np.flatnonzero(~robot.within_limits(q)):
                return MotionVerdict(Verdict.BLOCKED, fraction, (robot.joint_names[i], "its limits"))
        if verdict is not Verdict.BLOCKED or at is None:
            return MotionVerdict(verdict, at)
        delta = robot.difference(start, end)
        return MotionVerdict(verdict, at, self.checker.colliding_pair(start + at * delta))

    def _subdivide(self, start: FloatArray, end: FloatArray) -> tuple[Verdict, float | None]:
        checker = self.checker
        delta = checker.robot.difference(start, end)
        if not isfinite(sum(delta.tolist())):
            raise InputError(f"motion between {start.tolist()} and {end.tolist()} is not finite")
        approach = checker.pair_radii @ np.abs(delta)
        widest = float(approach.max(initial=0.0))
        count = max(1, ceil(0.5 * widest / _FIRST_REACH))
        half = 0.5 / count
        centres = [(2 * k + 1) * half for k in range(count)]
        unproven: list[float] = []
        while True:
            checker.set_margins(half * approach)
            known_free, unproven = set(unproven), []
            for t in centres:
                q = start + t * delta
                if checker.within_margins(q):
                    if t not in known_free and checker.in_collision(q):
                        return Verdict.BLOCKED, t
                    unproven.append(t)
            if not unproven:
                return Verdict.FREE, None
            if half * widest < self._floor:
                return Verdict.UNDECIDED, unproven[0]
            half /= 3
            centres = [t + side for t in unproven for side in (-2 * half, 0.0, 2 * half)]
