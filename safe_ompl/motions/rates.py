"""Proven extremes of positions, velocities, accelerations and jerks of a motion; what violates limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import factorial, perm
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, UnknownNameError, polynomials
from safe_ompl.motions.motion import Motion
from safe_ompl.robot import Robot
from safe_ompl.trajectories import RATE_TOLERANCE, RateLimits

_KINDS = ("position", "velocity", "acceleration", "jerk")
_UNITS = ("", "/s", "/s²", "/s³")
DISTANCES = ("collision", "clearance", "separation")
_WITHIN = 1e-9  # [rad or m] by which a position may be outside its limits, as for `Robot.within_limits`


class Extremes(NamedTuple):
    """Bounds of a derivative on every piece, each (K, n): no value is below `low` or above `high`.

    Both are within 1e-9 of what is taken, relative to the largest control point, but for slack and rounding; it is
    taken at the times `low_at` and `high_at` [s].
    """

    low: FloatArray
    high: FloatArray
    low_at: FloatArray
    high_at: FloatArray


@dataclass(frozen=True)
class Violation:
    """A stretch of a motion that is not proven.

    Attributes
    ----------
    kind : str
        "collision", "clearance", "danger", "tool orientation", "tip position", the name of a check of the user's own,
        "position", "velocity", "acceleration" or "jerk"; "separation": a stop that begins there is too late.
    first, last : float
        [s] All of the stretch is between them.
    at : float
        [s] Where it is worst, of the places looked at.
    names : tuple of str
        The pair that touches or is too near, or the joint; the link and who comes to it.
    value, limit : float or None
        What is found there, and the bound that it exceeds or falls below: distance [m] and the distance required,
        danger, or the rate of a joint. Of stops the distance that is left to people, negative by how much farther they
        may have come, and their clearance.
    decided : bool
        False: no violation is found, but no proof either.
    unit : str
        Of value and limit, other than of distances.
    """

    kind: str
    first: float
    last: float
    at: float
    names: tuple[str, ...]
    value: float | None = None
    limit: float | None = None
    decided: bool = True
    unit: str = ""

    @property
    def quantities(self) -> tuple[str, str]:
        """Value and limit with their unit, distances in mm; empty where there is none."""
        scale, unit = (1e3, "mm") if self.kind in DISTANCES else (1.0, self.unit)
        value, limit = (
            "" if given is None else f"{scale * given:.4g}{' ' * bool(unit)}{unit}"
            for given in (self.value, self.limit)
        )
        return value, limit

    def __str__(self) -> str:
        value, limit = self.quantities
        names = " and ".join(map(repr, self.names))
        found, bound = f", {value}" * bool(value), f" (limit {limit})" * bool(limit)
        kind = self.kind if self.decided else f"{self.kind} undecided"
        return f"{kind} at {self.at:.4g} s{': ' * bool(names)}{names}{found}{bound}"


def extremes(
    motion: Motion, order: int, low: FloatArray | float = np.inf, high: FloatArray | float = -np.inf
) -> Extremes:
    """Return proven bounds of the derivative of an order: 0 for positions, 1 for velocities.

    Bounds that are not below `low`, or not above `high`, numbers or (n,), need not be near to what is taken; by default
    all are.
    """
    held = motion.derivative_coefficients(order)
    spans = np.diff(motion.times)[:, None]
    error = (held.shape[1] + 2) * polynomials.EPS * np.abs(held).sum(axis=1)
    error += roughness(motion, order) if order else motion.allowance
    points = polynomials.bernstein(held)
    top, top_at = _peaks(points, high - error)
    bottom, bottom_at = _peaks(-points, -low - error)
    times = motion.times[:-1, None]
    return Extremes(-bottom - error, top + error, times + spans * bottom_at, times + spans * top_at)


def roughness(motion: Motion, order: int) -> FloatArray:
    """Return what rounding, and jumps between pieces, add (K, n) to the derivative of an order ≥ 1.

    One of rounded coefficients Σ|δc_k| ≤ ρ errs by d!/(d − order)! ρ / Δtᵒ. What jumps moves: a jump J of a lower
    derivative, i orders below, counts as i! J/Δtⁱ on the piece behind it. Jumps too far are violations of their own.
    """
    spans = np.diff(motion.times)[:, None]
    found = np.zeros((motion.pieces, motion.n))
    for lower in range(order):
        jumps = np.minimum(np.abs(_jumps(motion, lower)), RATE_TOLERANCE[lower])
        found[1:] += factorial(order - lower) * jumps / spans[1:] ** (order - lower)
    if motion.rounding is None:
        return found
    rounded: FloatArray = perm(motion.degree, order) * motion.rounding / spans**order
    return np.maximum(found, rounded)  # jumps within the rounding need be none


def _jumps(motion: Motion, order: int) -> FloatArray:
    """Return how far (K − 1, n) a derivative jumps between pieces."""
    held = motion.derivative_coefficients(order)
    jumps: FloatArray = held[1:, 0] - held[:-1].sum(axis=1)
    return jumps


def _peaks(points: FloatArray, enough: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return upper bounds (K, n) of pieces, near where they are above `enough`, and where in [0, 1] they are taken."""
    bound: FloatArray = points.max(axis=1)
    at: FloatArray = points.argmax(axis=1) / max(points.shape[1] - 1, 1)
    chosen = bound > enough
    if chosen.any():
        found = polynomials.peaks(np.moveaxis(points, 1, 2)[chosen])
        bound[chosen], at[chosen] = found.bound, found.at
    return bound, at


def rate_violations(
    motion: Motion, robot: Robot, limits: RateLimits | None = None, kinds: Sequence[str] | None = None
) -> list[Violation]:
    """Return where a motion exceeds limits of joints; none are proven not to be exceeded anywhere.

    They come by time; of each joint and each run of pieces on which it exceeds a limit the worst is named. Positions,
    those of continuous joints aside, may be 1e-9 rad or m outside, rates `RATE_TOLERANCE` above their limit. Rates are
    looked at where there are `limits`, and the motion is a function of time and no bare samples; `kinds` are which of
    them: "velocity", "acceleration", "jerk", by default all that are limited. With accelerations, velocities must not
    jump between pieces, and with jerks, neither must accelerations.

    Raises InputError if the motion or the limits are not this robot's, or have no limit of a kind.
    """
    motion = motion.for_robot(robot)
    found = list(_outside(motion, robot))
    if limits is not None and motion.rated:
        if limits.joint_names != robot.joint_names:
            raise InputError(f"are of other joints than the robot's: {', '.join(limits.joint_names)}", "limits")
        for kind in limits.kinds if kinds is None else kinds:
            if kind not in limits.kinds:
                raise UnknownNameError("limit", kind, limits.kinds)
            order = _KINDS.index(kind)
            most: FloatArray = getattr(limits, kind)
            bounds = extremes(motion, order, -most, most)
            is_low = -bounds.low > bounds.high
            values = np.where(is_low, bounds.low, bounds.high)
            times = np.where(is_low, bounds.low_at, bounds.high_at)
            excess = np.abs(values) - most - RATE_TOLERANCE[order]
            found += _worst(robot, order, kind, times, values, excess, most)
            if order > 1:
                found += _jumping(motion, robot, order - 1)
    return sorted(found, key=lambda violation: (violation.at, violation.names, violation.kind))


def _outside(motion: Motion, robot: Robot) -> Iterator[Violation]:
    """Yield where positions are outside limits."""
    low, high, low_at, high_at = extremes(motion, 0, robot.lower, robot.upper)
    free = np.where(robot.continuous, np.inf, _WITHIN)
    yield from _worst(robot, 0, "position", low_at, low, robot.lower - free - low, robot.lower)
    yield from _worst(robot, 0, "position", high_at, high, high - robot.upper - free, robot.upper)


def _jumping(motion: Motion, robot: Robot, order: int) -> Iterator[Violation]:
    """Yield where a derivative jumps too far between pieces."""
    jumps = _jumps(motion, order)
    times = np.broadcast_to(motion.times[1:-1, None], jumps.shape)
    excess = np.abs(jumps) - RATE_TOLERANCE[order]
    yield from _worst(robot, order, f"{_KINDS[order]} jump", times, jumps, excess, np.zeros(robot.n))


def _worst(
    robot: Robot, order: int, kind: str, times: FloatArray, values: FloatArray, excess: FloatArray, limits: FloatArray
) -> Iterator[Violation]:
    """Yield of each joint and each run of rows with an excess > 0 the one of the largest; arrays are (K, n)."""
    excess = np.where(np.isnan(excess), np.inf, excess)
    for joint in np.flatnonzero((excess > 0).any(axis=0)).tolist():
        rows = np.flatnonzero(excess[:, joint] > 0)
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            high = excess[run, joint].max() - 1e-9 * np.abs(values[run, joint]).max()
            worst = run[(excess[run, joint] >= high).argmax()]  # the first of equals
            unit = ("m" if robot.prismatic[joint] else "rad") + _UNITS[order]
            at, name = float(times[worst, joint]), robot.joint_names[joint]
            value, limit = float(values[worst, joint]), float(limits[joint])
            yield Violation(kind, at, at, at, (name,), value, limit, True, unit)
