"""Proofs of the pieces of a motion, and the reasons why a piece is not proven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import MotionProver, MotionVerdict, ToolLimit, ToolOrientation, Verdict
from safe_ompl.common import BoolArray, FloatArray, polynomials
from safe_ompl.danger import DangerLimit
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.rates import Violation

_OUT_OF_TIME = "out of time"
# The shortest stretch that is reported as unproven, as a share of a piece.
_LEAST_REPORTED_SHARE = 2.0**-7
# A smaller required distance only covers rounding, and is not called a clearance.
_LEAST_CLEARANCE = 1e-6  # [m]


class PieceProof(NamedTuple):
    """The proof of piece `number` of a motion, with coefficients (d + 1, n) and a time span [s], or of parts of it.

    The tube of `proof` includes the allowance of the piece.
    """

    number: int
    curve: FloatArray
    span: tuple[float, float]
    proof: MotionProver

    def place(self, u: float) -> FloatArray:
        """Return the joint values (n,) at a fraction of the piece."""
        return np.array(np.polynomial.polynomial.polyval(u, self.curve))

    def proven(self) -> bool:
        """Return whether the whole piece is proven."""
        return self.verdict().verdict is Verdict.FREE

    def time(self, u: float) -> float:
        """Return the time [s] at a fraction of the piece."""
        return self.span[0] + u * (self.span[1] - self.span[0])

    def verdict(self, low: float = 0.0, high: float = 1.0) -> MotionVerdict:
        """Return the verdict on the part of the piece between two fractions. Its `at` is a fraction of this part."""
        if self.proof.stop():
            return MotionVerdict(Verdict.UNDECIDED, 0.0)
        whole = (low, high) == (0.0, 1.0)
        return self.proof.check_curve(self.curve if whole else polynomials.restricted(self.curve, low, high))

    def unproven(self, low: float = 0.0, high: float = 1.0) -> Iterator[Violation]:
        """Yield short unproven stretches between two fractions of the piece, by time."""
        found = self.verdict(low, high)
        if found.verdict is Verdict.FREE:
            return
        if self.proof.stop():
            first, last = self.time(low), self.time(high)
            yield Violation(_OUT_OF_TIME, first, last, first, (), decided=False)
            return
        if high - low > _LEAST_REPORTED_SHARE:
            middle = 0.5 * (low + high)
            yield from self.unproven(low, middle)
            yield from self.unproven(middle, high)
            return
        u = low + (0.5 if found.at is None else found.at) * (high - low)
        stretch = Violation("collision", self.time(low), self.time(high), self.time(u), ())
        decided = found.verdict is Verdict.BLOCKED
        yield replace(stretch, decided=decided, **self._values(found, self.place(u)))

    def _values(self, found: MotionVerdict, q: FloatArray) -> dict[str, Any]:
        """Return kind, names, value and limit of a violation at `q: (n,)`."""
        (name, what), checker = found.pair or ("", ""), self.proof.checker
        robot = checker.robot
        if what == "its limits" and name in robot.joint_names:
            return {"kind": "position", "names": (name,), "value": float(q[robot.joint_names.index(name)])}
        for limit in self.proof.limits:
            if getattr(limit, "name", type(limit).__name__) == name:
                if isinstance(limit, DangerLimit):
                    return {"kind": "danger", "value": limit.danger(q), "limit": limit.limit}
                if isinstance(limit, ToolOrientation):
                    return {"kind": name, "value": limit.angle(q), "limit": limit.limit, "unit": "rad"}
                if isinstance(limit, ToolLimit):
                    return {"kind": name, "value": limit.excess(q), "unit": "m outside"}
                return {"kind": name}
        # The pairs that may touch come first among the required ones.
        distances = checker.pair_distances(q)
        if not len(distances):
            return {}
        needed = self.proof.required.least[: len(distances)]
        worst = int((distances - needed).argmin())
        distance, least = float(distances[worst]), float(needed[worst])
        given = {"names": checker.pair_names[worst], "value": distance}
        if distance <= 0.0 or least <= _LEAST_CLEARANCE:
            return given
        # The distances added by the tube and the allowance of the piece are not a limit set by the user.
        asked = float(replace(self.proof.separation, tube=()).required(checker).least[worst])
        return {**given, "kind": "clearance", "limit": asked or None, "nearer": least - asked}


def proven_by_bounds(pieces: Sequence[PieceProof]) -> BoolArray:
    """Return which pieces (K,) distance bounds prove in one pass. The other pieces are undecided."""
    proof = pieces[0].proof
    if proof.limits or any(piece.proof is not proof for piece in pieces):
        return np.zeros(len(pieces), dtype=bool)
    return proof.proven_by_bounds(np.array([piece.curve for piece in pieces]))


def piece_proofs(motion: Motion, proof: MotionProver) -> Iterator[PieceProof]:
    """Yield the proofs of the pieces of a motion, whose joints are in the robot's order."""
    separation, allowance = proof.separation, motion.allowance
    if motion.slack is None:
        # All pieces get the same allowance for rounding, so that they share a proof.
        allowance = np.broadcast_to(allowance.max(axis=0), allowance.shape)
    tube = np.array(separation.tube or np.zeros(motion.n))
    within = {tube.tobytes(): proof}
    for k, row in enumerate(tube + allowance):
        if row.tobytes() not in within:
            within[row.tobytes()] = replace(proof, separation=replace(separation, tube=tuple(row.tolist())))
        span = float(motion.times[k]), float(motion.times[k + 1])
        yield PieceProof(k, motion.coefficients[k], span, within[row.tobytes()])
