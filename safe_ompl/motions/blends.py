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
    path: FloatArray, robot: Robot, tolerance: float, prover: MotionProver | None, limits: RateLimits | None = None
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
    # With tolerance 0 no blend is tried.
    prover = prover if tolerance else None
    zero, spans, pieces, corners = np.zeros(robot.n), list[float](), list[FloatArray](), list[int]()
    # Length of the current edge that the previous blend uses.
    used = 0.0
    for k, (unit, length) in enumerate(zip(units, lengths.tolist(), strict=True)):
        blend, blend_lengths = list[FloatArray](), list[float]()
        last = k == len(units) - 1
        is_corner = not last and np.linalg.norm(units[k + 1] - unit) > _MIN_CORNER
        if is_corner and prover is not None:
            longest_half = min(length, lengths[k + 1]) / 2
            if _EQUAL_POINTS * length < length - used - longest_half < _MIN_LINE:
                longest_half -= min(_MIN_LINE, longest_half / 2)
            blend, blend_lengths = _blend(points[k + 1], unit, units[k + 1], longest_half, tolerance, prover, limits)
        half_length = sum(blend_lengths) / 2
        line = length - used - half_length
        if line > _EQUAL_POINTS * length:
            spans.append(line)
            pieces.append(np.array([points[k] + used * unit, line * unit, zero, zero]))
        pieces += blend
        spans += blend_lengths
        if is_corner and not blend:
            corners.append(len(pieces))
        used = half_length
    if corners:
        why = "no blend is proven there" if prover else "blends need a motion prover" if tolerance else "tolerance 0"
        _log.info("the robot stops at %d of %d corners: %s", len(corners), len(units) - 1, why)
    times = np.concatenate([[0.0], np.cumsum(spans)])
    return Motion(times, np.array(pieces), robot.joint_names, timed=False, corners=tuple(corners))


def _blend(
    corner: FloatArray,
    first: FloatArray,
    second: FloatArray,
    half_length: float,
    tolerance: float,
    prover: MotionProver,
    limits: RateLimits | None,
) -> tuple[list[FloatArray], list[float]]:
    """Return the pieces of a proven blend, coefficients (4, n), and their lengths.

    The blend uses at most `half_length` of each of the two edges, whose unit tangents are `first` and `second`. Without
    a proven blend, both lists are empty.
    """
    change = second - first
    longest_half = min(half_length, 4 * tolerance / float(np.linalg.norm(change)))
    for share in _BLEND_SHARES:
        half_blend = share * longest_half
        ramp = _ramp(np.abs(change), 2 * half_blend, limits)
        max_d2q_ds2 = change / (2 * half_blend * (1 - ramp))
        zero = np.zeros_like(change)
        d3q_ds3 = max_d2q_ds2 / (2 * half_blend * ramp) if ramp else zero
        # q″ rises, stays constant, and falls, each in one part of the blend.
        parts = ((zero, d3q_ds3, ramp), (max_d2q_ds2, zero, 1 - 2 * ramp), (max_d2q_ds2, -d3q_ds3, ramp))
        blend, blend_lengths = list[FloatArray](), list[float]()
        q, dq_ds = corner - half_blend * first, first
        for d2q_ds2, d3q_ds3, part in parts:
            if part > 0:
                length = 2 * half_blend * part
                blend.append(np.array([q, length * dq_ds, length**2 / 2 * d2q_ds2, length**3 / 6 * d3q_ds3]))
                blend_lengths.append(length)
                q, dq_ds = blend[-1].sum(axis=0), dq_ds + length * (d2q_ds2 + length * d3q_ds3 / 2)
        if all(is_free(piece, prover) for piece in blend):
            return blend, blend_lengths
    return [], []


def is_free(piece: FloatArray, prover: MotionProver) -> bool:
    """Return whether a polynomial piece (d + 1, n) is proven collision free. Straight pieces are checked as edges."""
    if not piece[2:].any():
        return prover.is_free(piece[0], piece[0] + piece[1])
    return prover.check_curve(piece).verdict is Verdict.FREE


def first_unproven(motion: Motion, prover: MotionProver) -> int | None:
    """Return the index of the first piece of a path that is not proven free, or None if all pieces are proven."""
    return next((k for k, piece in enumerate(motion.coefficients) if not is_free(piece, prover)), None)


def _ramp(change: FloatArray, length: float, limits: RateLimits | None) -> float:
    """Return the share of a blend of this length in which q″ rises; q″ falls in an equal share.

    The share is the smallest, but at most 0.5, with which the jerk stays within `CURVE_JERK_SHARE` of its limit at the
    speed at which the blend uses the full acceleration. `change: (n,)` are the absolute differences of the unit
    tangents. With the length L and the share r, q″ is at most change/(L (1 − r)), and q‴ at most
    change/(L² r (1 − r)). So the squared speed is acceleration·L (1 − r), and the jerk is within its limit if
    r² ≥ c² (1 − r), c = acceleration^1.5/(jerk·√L). Here `acceleration` and `jerk` are the smallest quotients of a
    limit and `change`.
    """
    if limits is None or limits.jerk is None:
        return 0.0
    with np.errstate(divide="ignore"):
        acceleration = float((limits.acceleration / change).min())
        jerk = float((CURVE_JERK_SHARE * limits.jerk / change).min())
    c = acceleration**1.5 / (jerk * length**0.5)
    return float(min(0.5, c * (np.sqrt(c * c + 4) - c) / 2))
