"""Blend the corners of joint-space paths. Blends are proven collision free, as edges are."""

from __future__ import annotations

import logging

import numpy as np

from safe_ompl.collision import MotionProver, Verdict
from safe_ompl.common import FloatArray, InputError
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.robot import Robot

_log = logging.getLogger(__name__)

# A smaller change of direction (norm of the difference of the unit tangents) is not a corner.
_MIN_CORNER = 1e-9
# Lengths of the blends that are tried, as shares of the longest blend that is allowed.
_BLEND_SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)
# Share of the jerk limit that q‴ṡ³ may use. The rest is left for accelerating along the curve.
CURVE_JERK_SHARE = 0.9
# Way points closer than this are treated as equal.
_EQUAL_POINTS = 1e-12  # [rad]
# Shorter lines between blends are avoided: rounding errors divided by such a length are large jumps of the velocity.
_MIN_LINE = 1e-5  # [rad]


def blended(
    path: FloatArray, robot: Robot, tolerance: float, motion: MotionProver | None, limits: RateLimits | None = None
) -> Motion:
    """Round the corners of a path (N, n) within a tolerance [rad]. With tolerance 0 the robot stops at every corner.

    Each corner gets the largest blend (`docs/how-it-works.md` §9) that keeps the tolerance, uses at most half of each
    edge, and is proven free. Without such a blend, or without a prover, the robot stops at the corner. The parameter is
    the arc length on lines and approximately the arc length on blends. Raises InputError if all way points are equal.
    """
    steps = robot.difference(path[:-1], path[1:])
    moves = np.linalg.norm(steps, axis=1) > _EQUAL_POINTS
    if not moves.any():
        raise InputError("all way points are equal: give at least two different ones")
    steps = steps[moves]
    points = path[0] + np.vstack([np.zeros((1, robot.n)), np.cumsum(steps, axis=0)])  # continuous joints unrolled
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    proof = motion if tolerance else None
    zero, spans, pieces, corners = np.zeros(robot.n), list[float](), list[FloatArray](), list[int]()
    # Length of the current edge that the previous blend uses.
    used = 0.0
    for k, (unit, length) in enumerate(zip(units, lengths.tolist(), strict=True)):
        blend, parts = list[FloatArray](), list[float]()
        last = k == len(units) - 1
        is_corner = not last and np.linalg.norm(units[k + 1] - unit) > _MIN_CORNER
        if is_corner and proof is not None:
            longest = min(length, lengths[k + 1]) / 2
            if _EQUAL_POINTS * length < length - used - longest < _MIN_LINE:
                longest -= min(_MIN_LINE, longest / 2)
            blend, parts = _blend(points[k + 1], unit, units[k + 1], longest, tolerance, proof, limits)
        half_length = sum(parts) / 2
        line = length - used - half_length
        if line > _EQUAL_POINTS * length:
            spans.append(line)
            pieces.append(np.array([points[k] + used * unit, line * unit, zero, zero]))
        pieces += blend
        spans += parts
        if is_corner and not blend:
            corners.append(len(pieces))
        used = half_length
    if corners:
        why = "no blend is proven there" if proof else "blends need a motion prover" if tolerance else "tolerance 0"
        _log.info("the robot stops at %d of %d corners: %s", len(corners), len(units) - 1, why)
    times = np.concatenate([[0.0], np.cumsum(spans)])
    return Motion(times, np.array(pieces), robot.joint_names, timed=False, corners=tuple(corners))


def _blend(
    corner: FloatArray,
    first: FloatArray,
    second: FloatArray,
    half_length: float,
    tolerance: float,
    proof: MotionProver,
    limits: RateLimits | None,
) -> tuple[list[FloatArray], list[float]]:
    """Return the pieces of a proven blend, coefficients (4, n), and their lengths.

    Without one, both lists are empty.
    """
    change = second - first
    longest = min(half_length, 4 * tolerance / float(np.linalg.norm(change)))
    for share in _BLEND_SHARES:
        half = share * longest
        ramp = _ramp(np.abs(change), 2 * half, limits)
        max_d2q_ds2 = change / (2 * half * (1 - ramp))
        zero = np.zeros_like(change)
        d3q_ds3 = max_d2q_ds2 / (2 * half * ramp) if ramp else zero
        # q″ rises, stays constant, and falls, each in one part of the blend.
        parts = ((zero, d3q_ds3, ramp), (max_d2q_ds2, zero, 1 - 2 * ramp), (max_d2q_ds2, -d3q_ds3, ramp))
        blend, spans = list[FloatArray](), list[float]()
        q, dq_ds = corner - half * first, first
        for d2q_ds2, d3q_ds3, part in parts:
            if part > 0:
                span = 2 * half * part
                blend.append(np.array([q, span * dq_ds, span**2 / 2 * d2q_ds2, span**3 / 6 * d3q_ds3]))
                spans.append(span)
                q, dq_ds = blend[-1].sum(axis=0), dq_ds + span * (d2q_ds2 + span * d3q_ds3 / 2)
        if all(is_free(piece, proof) for piece in blend):
            return blend, spans
    return [], []


def is_free(piece: FloatArray, proof: MotionProver) -> bool:
    """Return whether a polynomial piece (d + 1, n) is proven collision free. Straight pieces are checked as edges."""
    if not piece[2:].any():
        return proof.is_free(piece[0], piece[0] + piece[1])
    return proof.check_curve(piece).verdict is Verdict.FREE


def first_unproven(motion: Motion, proof: MotionProver) -> int | None:
    """Return the index of the first piece of a path that is not proven free, or None if all pieces are proven."""
    return next((k for k, piece in enumerate(motion.coefficients) if not is_free(piece, proof)), None)


def _ramp(change: FloatArray, length: float, limits: RateLimits | None) -> float:
    """Return the share of a blend in which q″ rises.

    At the speed at which the blend uses the full acceleration limit, the jerk stays within its limit.
    """
    if limits is None or limits.jerk is None:
        return 0.0
    with np.errstate(divide="ignore"):
        acceleration = float((limits.acceleration / change).min())
        jerk = float((CURVE_JERK_SHARE * limits.jerk / change).min())
    c = acceleration**1.5 / (jerk * length**0.5)
    return float(min(0.5, c * (np.sqrt(c * c + 4) - c) / 2))
