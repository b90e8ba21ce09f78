"""A motion of polynomials that a certificate claims, checked by plain means.

A piece is a Bézier curve. Its control points are found exactly, in rational numbers, and those of its parts by halving;
a part is in the box of its control points. No joint is farther from the centre of that box than half its width and what
the piece allows for: slack, rounding, the jump before it, and the tube. A part holds if every pair is farther apart
there than the two can approach each other then; pairs that are not are looked at again in both halves. Derivatives are
no larger than their own control points. A jump J between pieces counts as motion of the piece behind it: of the i-th
derivative above, as i! J / Δtⁱ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from itertools import pairwise
from math import comb, factorial, perm

import numpy as np

from safe_ompl.certificates.claims import ClaimedMotion, ClaimedStretch
from safe_ompl.certificates.verifier.bodies import GJK, PlainCurve, Separations, plain_name
from safe_ompl.certificates.verifier.danger import check_danger_and_tool
from safe_ompl.common import CertificateError, FloatArray
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_FARTHEST = 1e4  # [rad] a joint that turns on and on farther than this has no exact angle any more
_WITHIN = 2e-9  # [rad or m] by which a joint may be outside its limits
# [rad or m, s] What velocities, accelerations and jerks may be above their limits; positions and what else must be
# continuous may jump so far. Rates are issued with half of that.
_ABOVE = (1e-6, 2e-6, 2e-6, 2e-3)
_SMALLEST = 1e-8  # [rad or m] parts in which no joint moves more are not divided any more
_HALVINGS = 50
_ROUNDING = 1e-13  # relative, of fifty halvings


class RecordedMotion:
    """The polynomials of a motion by their control points, and where the motion before it, if there is one, ends."""

    def __init__(self, claim: ClaimedMotion, before: RecordedMotion | None = None) -> None:
        spans = [Fraction(end) - Fraction(start) for start, end in pairwise(claim.times.tolist())]
        self.claim, self.before = claim, before
        self.pieces = [derivatives(*piece) for piece in zip(claim.coefficients, spans, strict=True)]
        self.begin = [rows[0] for rows in self.pieces[0]]
        self.end = [rows[-1] for rows in self.pieces[-1]]

    def jumps(self, order: int) -> FloatArray:
        """Return by how much (K, n) a derivative of some order jumps where pieces begin."""
        ends = [piece[order][-1] for piece in self.pieces[:-1]]
        first = self.begin[order]
        comparable = self.before is not None and (order == 0 or (self.claim.timed and self.before.claim.timed))
        last = self.before.end[order] if self.before is not None and comparable else first
        return np.array([np.abs(piece[order][0] - end) for piece, end in zip(self.pieces, [last, *ends], strict=True)])

    def check_joined(self) -> None:
        """Raise CertificateError unless it goes on as the motion before ends: at its velocity, or both at rest."""
        before, claim = self.before, self.claim
        if before is None:
            return
        apart = self.jumps(0)[0].max()
        if apart > _ABOVE[0]:
            raise CertificateError(f"it begins {apart:.3g} rad or m from where the one before ends")
        for one, velocity in ((self, self.begin[1]), (before, before.end[1])):
            if before.claim.timed != claim.timed and one.claim.timed and np.abs(velocity).max() > _ABOVE[1]:
                raise CertificateError("it meets the one before, of which one is not in time, but does not rest there")
        limited = claim.jerk is not None or before.claim.jerk is not None
        for order, kind, unit in ((1, "velocity", "rad/s or m/s"), (2, "acceleration", "rad/s² or m/s²"))[
            : 1 + limited
        ]:
            jump = self.jumps(order)[0].max()
            if jump > _ABOVE[order]:
                raise CertificateError(f"its {kind} begins {jump:.3g} {unit} from that with which the one before ends")


def check_polynomials(
    claims: ClaimedStretch, robot: Robot, scene: Scene, separations: Separations, motion: RecordedMotion
) -> tuple[int, int]:
    """Return the number of parts and distances that it took; a CertificateError unless all that is claimed holds."""
    allowed = _allowed(motion)
    exact = [PlainCurve(f"piece {k} of the motion", piece[0], allowed[k]) for k, piece in enumerate(motion.pieces)]
    check_limits(robot, exact)
    _check_rates(motion, robot)
    tube = 0.0 if claims.tube is None else claims.tube
    stretches = [piece._replace(width=piece.width + tube + rounded(piece.points)) for piece in exact]
    check_danger_and_tool(claims, robot, scene, stretches, separations.budget)
    return check_free(stretches, separations)


def check_free(
    stretches: Sequence[PlainCurve],
    separations: Separations,
    more: Callable[[str, int, float, float], float] | None = None,
) -> tuple[int, int]:
    """Raise CertificateError unless all pairs keep apart on all stretches; return the number of parts and distances.

    `more` says what must be kept from a body besides what is claimed, by the number of the stretch and from which t to
    which.
    """
    parts = distances = 0
    for k, stretch in enumerate(stretches):
        waiting = [(stretch.points, 0.0, 1.0, set(separations.names))]
        while waiting:
            part, first, last, pairs = waiting.pop()
            separations.budget.where = f"{first:.6f} of {stretch.name}"
            low, high = part.min(axis=0), part.max(axis=0)
            half, near = (high - low) / 2, set()
            for pair, distance, approach, kept in separations.examined((low + high) / 2, half + stretch.width, pairs):
                distances += 1
                wanted = approach + kept + (0.0 if more is None else more(pair[1], k, first, last))
                if distance - GJK > wanted:
                    continue
                if half.max() < _SMALLEST:
                    between = " and ".join(repr(plain_name(name)) for name in pair)
                    raise CertificateError(
                        f"{between} are {1e3 * distance:.3f} mm apart near {first:.6f} of {stretch.name}, "
                        f"{1e3 * wanted:.3f} mm are needed"
                    )
                near.add(pair)
            parts += 1
            if near:
                middle, (before, after) = (first + last) / 2, _halves(part)
                waiting += [(before, first, middle, near), (after, middle, last, near)]
    return parts, distances


def rounded(points: FloatArray) -> FloatArray:
    """Return what halving control points adds to where joints (n,) are."""
    return np.asarray(_ROUNDING * np.abs(points).max(axis=0))


def derivatives(coefficients: FloatArray, span: Fraction) -> list[FloatArray]:
    """Return the control points (d − k + 1, n), at least one, of the k-th derivative by time, for k = 0 … 3."""
    degree, powers = len(coefficients) - 1, [list(map(Fraction, row)) for row in coefficients.tolist()]
    rows = [
        [sum(Fraction(comb(i, k), comb(degree, k)) * c[k] for k in range(i + 1)) for c in zip(*powers, strict=True)]
        for i in range(degree + 1)
    ]
    found = []
    for left in range(degree, degree - 4, -1):
        found.append(np.array(rows, dtype=np.float64))
        rows = [[left * (b - a) / span for a, b in zip(*both, strict=True)] for both in pairwise(rows)] or [
            [Fraction(0)] * len(rows[0])
        ]
    return found


def _halves(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the control points of both halves of a curve, from the means of neighbours, of these, and so on."""
    before, after = [], []
    while len(points):
        before.append(points[0])
        after.append(points[-1])
        points = (points[:-1] + points[1:]) / 2
    return np.array(before), np.array(after[::-1])


def _above(points: FloatArray, limit: FloatArray) -> int | None:
    """Return which of some polynomials is not proven to be below its limit everywhere; else None."""
    waiting = [(points, 0)]
    while waiting:
        part, depth = waiting.pop()
        above = ~(part <= limit)
        if not above.any():
            continue
        if above[[0, -1]].any() or depth == _HALVINGS:
            return int(above.any(axis=0).argmax())
        waiting += [(half, depth + 1) for half in _halves(part)]
    return None


def _allowed(motion: RecordedMotion) -> FloatArray:
    """Return how far (K, n) the motion may be from each polynomial; CertificateError if they are not one motion."""
    jumps = motion.jumps(0)
    for k in np.flatnonzero((jumps > _ABOVE[0]).any(axis=1)).tolist():
        raise CertificateError(f"motion: piece {k} does not begin where the one before ends")
    for widths in (motion.claim.slack, motion.claim.rounding):
        jumps += 0.0 if widths is None else widths
    return jumps


def check_limits(robot: Robot, stretches: Iterable[PlainCurve]) -> None:
    """Raise CertificateError unless joints keep to their limits on all stretches."""
    low = np.where(robot.continuous, -_FARTHEST, robot.lower - _WITHIN)
    high = np.where(robot.continuous, _FARTHEST, robot.upper + _WITHIN)
    for name, points, width in stretches:
        for curve, limit in ((points, high), (-points, -low)):
            joint = _above(curve, limit - width)
            if joint is not None:
                raise CertificateError(f"{name} leaves the limits of joint {robot.joint_names[joint]!r}")


def _check_rates(motion: RecordedMotion, robot: Robot) -> None:
    """Raise CertificateError unless rates keep to their limits; what is limited must not jump before."""
    claim, pieces = motion.claim, motion.pieces
    limits = [None, claim.velocity, claim.acceleration, claim.jerk]
    kinds = ("position", "velocity", "acceleration", "jerk")
    spans = np.diff(claim.times)[:, None]
    error = np.zeros((len(pieces), robot.n)) if claim.rounding is None else claim.rounding
    jumps = np.array([motion.jumps(order) for order in range(3)])
    degrees = np.array([len(piece) - 1 for piece in claim.coefficients])
    for order, limit in enumerate(limits):
        if limit is None:
            continue
        rough = np.array([[perm(degree, order)] for degree in degrees.tolist()]) * error / spans**order
        moved = sum(factorial(order - low) * jumps[low] / spans ** (order - low) for low in range(order))
        most = limit + _ABOVE[order] - np.maximum(rough, moved)
        for k, piece in enumerate(pieces):
            for points in (piece[order], -piece[order]):
                joint = _above(points, most[k])
                if joint is not None:
                    name = robot.joint_names[joint]
                    raise CertificateError(f"motion: {kinds[order]} of joint {name!r} above its limit in piece {k}")
        if order < 3 and limits[order + 1] is not None:
            for k in np.flatnonzero((jumps[order] > _ABOVE[order]).any(axis=1)).tolist():
                raise CertificateError(f"motion: the {kinds[order]} jumps where piece {k} begins")
