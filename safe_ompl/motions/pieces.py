"""Proofs of the pieces of a motion, and the reasons why a piece is not proven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import MotionProver, MotionVerdict, ToolLimit, ToolOrientation, Verdict
from safe_ompl.common import FloatArray, IntArray, polynomials
from safe_ompl.danger import DangerLimit
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.rates import Violation
from safe_ompl.robot import plain

_OUT_OF_TIME = "out of time"
# The shortest stretch that is reported as unproven, as a share of a piece.
_LEAST_REPORTED_SHARE = 2.0**-7
# A smaller required distance only covers rounding, and is not called a clearance.
_LEAST_CLEARANCE = 1e-6  # [m]
# Where no proof succeeds, some pair is nearer than this beyond the distance that it must keep.
_NEAR = 1e-3  # [m]


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

    def unproven(self) -> Iterator[Violation]:
        """Yield short unproven stretches of the piece, by time."""
        stretches = np.array([[0.0, 1.0]])
        while len(stretches) and stretches[0, 1] - stretches[0, 0] > _LEAST_REPORTED_SHARE:
            # Most halves are proven by bounds, all halves of one length at once.
            middles = stretches.mean(axis=1)
            stretches = np.stack([stretches[:, 0], middles, middles, stretches[:, 1]], axis=1).reshape(-1, 2)
            if not self.proof.limits:
                curves = np.broadcast_to(self.curve, (len(stretches), *self.curve.shape))
                halves = plain(polynomials.restricted(curves, *stretches.T))
                stretches = stretches[~self.proof.proven_by_bounds(halves)]
            else:
                proven = [self.verdict(low, high).verdict is Verdict.FREE for low, high in stretches.tolist()]
                stretches = stretches[~np.array(proven)]
        for low, high in stretches.tolist():
            found = self.verdict(low, high)
            if found.verdict is Verdict.FREE:
                continue
            first, last = self.time(low), self.time(high)
            if self.proof.stop():
                yield Violation(_OUT_OF_TIME, first, last, first, (), decided=False)
                continue
            u = low + (0.5 if found.at is None else found.at) * (high - low)
            stretch = Violation("collision", first, last, self.time(u), ())
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
        required = self.proof.required
        pairs, distances = required.pairs.near(q[None], float(required.least.max(initial=0.0)) + _NEAR)[:, 1:3].T
        if not len(pairs):
            return {}
        missing = required.least[pairs.astype(np.intp)] - distances
        worst = int(pairs[missing.argmax()])
        distance, least = float(distances[missing.argmax()]), float(required.least[worst])
        given = {"names": required.pairs.names[worst], "value": distance}
        if distance <= 0.0 or least <= _LEAST_CLEARANCE:
            return given
        # The distances added by the tube and the allowance of the piece are not a limit set by the user.
        wanted = replace(self.proof.separation, tube=()).required(checker)
        same = (wanted.pairs.bodies == required.pairs.bodies[worst]).all(axis=1)
        asked = float(wanted.least[same].max(initial=0.0))
        return {**given, "kind": "clearance", "limit": asked or None, "nearer": least - asked}


class PieceProofs:
    """The proofs of the K pieces of a motion, whose joints are in the robot's order.

    `tubes: (1, n)` is the tube in which all pieces are proven, or `tubes: (K, n)` are those of the pieces: the tube of
    the prover with the allowances of the motion.
    """

    def __init__(self, motion: Motion, proof: MotionProver) -> None:
        separation, allowance = proof.separation, motion.allowance
        if motion.slack is None:
            # All pieces get the same allowance for rounding, so that they share a prover.
            allowance = allowance.max(axis=0, keepdims=True)
        tube = np.array(separation.tube or np.zeros(motion.n))
        self.motion, self.tubes = motion, tube + allowance
        within = {tube.tobytes(): proof}
        for row in self.tubes:
            if row.tobytes() not in within:
                within[row.tobytes()] = replace(proof, separation=replace(separation, tube=tuple(row.tolist())))
        self._provers = [within[row.tobytes()] for row in self.tubes]

    def __len__(self) -> int:
        return self.motion.pieces

    def __getitem__(self, k: int) -> PieceProof:
        begin, end = self.motion.times[k : k + 2].tolist()
        prover = self._provers[k] if len(self._provers) > 1 else self._provers[0]
        return PieceProof(k, self.motion.coefficients[k], (begin, end), prover)

    def by_prover(self, numbers: IntArray) -> Iterator[tuple[MotionProver, IntArray]]:
        """Yield provers with the indices of those among the numbers (M,) of pieces that they prove."""
        if len(self._provers) == 1:
            yield self._provers[0], np.arange(len(numbers))
            return
        for prover in dict.fromkeys(self._provers[k] for k in numbers.tolist()):
            yield prover, np.flatnonzero([self._provers[k] is prover for k in numbers.tolist()])

    def undecided(self, numbers: Sequence[int] | None = None) -> list[int]:
        """Return which of some pieces, by default of all, distance bounds do not prove, in one pass."""
        chosen = list(range(len(self)) if numbers is None else numbers)
        first = self._provers[0]
        if not chosen or first.limits or any(prover is not first for prover in self._provers):
            return chosen
        curves = self.motion.coefficients if numbers is None else self.motion.coefficients[chosen]
        return list(compress(chosen, ~first.proven_by_bounds(curves)))
