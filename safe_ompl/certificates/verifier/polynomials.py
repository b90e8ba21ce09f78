"""Check a motion of a certificate by simple methods: every claim holds at every point of the motion.

A joint is within half the width of the box of a part's control points from its centre, plus the allowance of the piece:
slack, rounding, the preceding jump, and the tube. A part is proven if the distance of every pair exceeds the largest
approach of the pair within the part. Other pairs are checked again in both halves. Derivatives are bounded by their
control points. A jump J between pieces counts as motion of the later piece: for the i-th derivative above, as i! J /
Δtⁱ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import factorial, perm
from typing import TypeAlias

import numpy as np

from safe_ompl.certificates.claims import ClaimedStretch
from safe_ompl.certificates.verifier.bodies import GJK, Separations, plain_name
from safe_ompl.certificates.verifier.danger import check_danger_and_tool
from safe_ompl.certificates.verifier.motion import ABOVE, RecordedMotion, RecordedPiece, halves
from safe_ompl.common import CertificateError, FloatArray, IntArray
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

# Limit of continuous joints. Beyond it, the angle loses too many digits.
_MOST_ANGLE = 1e4  # [rad]
# Tolerance of joint limits.
_LIMIT_TOLERANCE = 2e-9  # [rad or m]
# Parts in which no joint moves more are not divided.
_LEAST_JOINT_MOTION = 1e-8  # [rad or m]
_MOST_SPLITS = 50
# Relative rounding error of fifty halvings.
_SPLIT_ROUNDING = 1e-13

Required: TypeAlias = Callable[[str, int, float, float], float]
"""Distance [m] to keep from a body besides the claims, by the index of a piece and two shares of the piece."""


def check_motion(
    claims: ClaimedStretch,
    robot: Robot,
    scene: Scene,
    separations: Separations,
    motion: RecordedMotion,
    more: Required | None = None,
) -> IntArray:
    """Check the claims about a motion; return the numbers of pieces, parts and distances.

    Raises CertificateError if a claim does not hold. `check_trajectory` checks the claims about a time law, and returns
    the distances `more` that must be kept from people.
    """
    allowed = motion.jumps(0)
    for k in np.flatnonzero((allowed > ABOVE[0]).any(axis=1)).tolist():
        raise CertificateError(f"{motion.kind}: piece {k} does not begin where the one before ends")
    for widths in (motion.claim.slack, motion.claim.rounding):
        allowed += 0.0 if widths is None else widths
    exact = [piece._replace(width=width) for piece, width in zip(motion.pieces, allowed, strict=True)]
    _check_limits(robot, exact)
    if motion.claim.timed:
        _check_rates(motion, robot)
    tube = 0.0 if claims.tube is None else claims.tube
    pieces = [piece._replace(width=piece.width + tube + _rounded(piece.points)) for piece in exact]
    check_danger_and_tool(claims, robot, scene, pieces, separations.budget)
    return np.array([len(pieces), *_check_free(pieces, separations, more)])


def _check_free(pieces: Sequence[RecordedPiece], separations: Separations, more: Required | None) -> tuple[int, int]:
    """Raise CertificateError unless all pairs keep apart on all pieces; return the numbers of parts and distances."""
    parts = distances = 0
    for k, piece in enumerate(pieces):
        waiting = [(piece.points, 0.0, 1.0, set(separations.names))]
        while waiting:
            part, first, last, pairs = waiting.pop()
            separations.budget.where = f"{first:.6f} of {piece.name}"
            low, high = part.min(axis=0), part.max(axis=0)
            half, near = (high - low) / 2, set()
            for pair, distance, approach, kept in separations.examined((low + high) / 2, half + piece.width, pairs):
                distances += 1
                wanted = approach + kept + (0.0 if more is None else more(pair[1], k, first, last))
                if distance - GJK > wanted:
                    continue
                if half.max() < _LEAST_JOINT_MOTION:
                    between = " and ".join(repr(plain_name(name)) for name in pair)
                    raise CertificateError(
                        f"{between} are {1e3 * distance:.3f} mm apart near {first:.6f} of {piece.name}, "
                        f"{1e3 * wanted:.3f} mm are needed"
                    )
                near.add(pair)
            parts += 1
            if near:
                middle, (before, after) = (first + last) / 2, halves(part)
                waiting += [(before, first, middle, near), (after, middle, last, near)]
    return parts, distances


def _rounded(points: FloatArray) -> FloatArray:
    """Return the rounding error (n,) of joints from halving control points."""
    return np.asarray(_SPLIT_ROUNDING * np.abs(points).max(axis=0))


def _above(points: FloatArray, limit: FloatArray) -> int | None:
    """Return the index of a polynomial that is not proven to stay below its limit, or None."""
    waiting = [(points, 0)]
    while waiting:
        part, depth = waiting.pop()
        above = ~(part <= limit)
        if not above.any():
            continue
        if above[[0, -1]].any() or depth == _MOST_SPLITS:
            return int(above.any(axis=0).argmax())
        waiting += [(half, depth + 1) for half in halves(part)]
    return None


def _check_limits(robot: Robot, pieces: Iterable[RecordedPiece]) -> None:
    """Raise CertificateError unless joints keep their limits on all pieces."""
    low = np.where(robot.continuous, -_MOST_ANGLE, robot.lower - _LIMIT_TOLERANCE)
    high = np.where(robot.continuous, _MOST_ANGLE, robot.upper + _LIMIT_TOLERANCE)
    for piece in pieces:
        for curve, limit in ((piece.points, high), (-piece.points, -low)):
            joint = _above(curve, limit - piece.width)
            if joint is not None:
                raise CertificateError(f"{piece.name} leaves the limits of joint {robot.joint_names[joint]!r}")


def _check_rates(motion: RecordedMotion, robot: Robot) -> None:
    """Raise CertificateError unless velocities, accelerations and jerks keep their limits.

    The derivative below each limited one must not jump.
    """
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
        most = limit + ABOVE[order] - np.maximum(rough, moved)
        for k, piece in enumerate(pieces):
            for points in (piece.rows[order], -piece.rows[order]):
                joint = _above(points, most[k])
                if joint is not None:
                    name = robot.joint_names[joint]
                    raise CertificateError(f"motion: {kinds[order]} of joint {name!r} above its limit in piece {k}")
        if order < 3 and limits[order + 1] is not None:
            for k in np.flatnonzero((jumps[order] > ABOVE[order]).any(axis=1)).tolist():
                raise CertificateError(f"motion: the {kinds[order]} jumps where piece {k} begins")
