"""Proven extremes of positions, velocities, accelerations and jerks of a motion, violations, and stops for people."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError, polynomials
from safe_ompl.motions.cells import BodySpeeds, Cells, divided_edges
from safe_ompl.motions.limits import RATE_TOLERANCE, RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.separation import PeopleDistances
from safe_ompl.motions.stops import Stops, stops_beside
from safe_ompl.motions.timing import CELL_LENGTH, CELLS, within_tube
from safe_ompl.motions.velocity_limits import TimingLimits
from safe_ompl.robot import Robot
from safe_ompl.scene import People

_DERIVATIVES = ("position", "velocity", "acceleration", "jerk")
_DERIVATIVE_UNITS = ("", "/s", "/s²", "/s³")
DISTANCES = ("collision", "clearance", "separation")
# Tolerance of the position limits, as for `Robot.within_limits`.
_POSITION_TOLERANCE = 1e-9  # [rad or m]
# Smaller decreases of the distance, from rounding, are not mentioned in messages.
_NEGLIGIBLE_DISTANCE = 1e-6  # [m]


class Extremes(NamedTuple):
    """Bounds (K, n) of a derivative on every piece: all its values lie between `low` and `high`."""

    low: FloatArray
    high: FloatArray
    low_at: FloatArray
    high_at: FloatArray


@dataclass(frozen=True)
class Violation:
    """A stretch of a motion that is not proven."""

    # "collision", "clearance", "danger", "tool orientation", "tip position", the name of a user's check, "position",
    # "velocity", "acceleration" or "jerk"; "separation" if a stop that begins there ends too late.
    kind: str
    # The violation occurs between these two times [s].
    first: float
    last: float
    # Time of the worst violation among the computed times [s].
    at: float
    # The pair of bodies, or the joint. For a late stop these are the link and the person's limb.
    names: tuple[str, ...]
    # The value found, and the limit that it exceeds or falls below: distance [m], danger, or derivative of a joint
    # value. The limit is None if there is no explicit one. For stops: the remaining distance to people, negative if
    # they may have come farther, and their clearance.
    value: float | None = None
    limit: float | None = None
    # False if neither a violation nor a proof was found.
    decided: bool = True
    # Unit of `value` and `limit`, unless they are distances.
    unit: str = ""
    # Distance [m] by which the pair may come nearer than `value` within the tube and the uncertainty of the motion.
    nearer: float = 0.0

    @property
    def quantities(self) -> tuple[str, str]:
        """Value and limit with their units, distances in mm; empty if missing."""
        scale, unit = (1e3, "mm") if self.kind in DISTANCES else (1.0, self.unit)
        given = [None if number is None else scale * number for number in (self.value, self.limit)]
        # Numbers that would read alike get enough digits to differ.
        alike = None not in given and len({f"{number:.4g}" for number in given}) == 1
        value, limit = (
            "" if number is None else f"{number:.{12 if alike else 4}g}{' ' * bool(unit)}{unit}" for number in given
        )
        return value, limit

    def __str__(self) -> str:
        return self.in_words(f"{self.at:.4g} s")

    def in_words(self, at: str) -> str:
        """Return a one-line description. `at` is the place or time as text, with its unit."""
        value, limit = self.quantities
        names = " and ".join(map(repr, self.names))
        found = f", {value}" * bool(value)
        nearer = (
            f"{1e3 * self.nearer:.4g} mm nearer where the motion may be" if self.nearer > _NEGLIGIBLE_DISTANCE else ""
        )
        bounds = ", ".join(part for part in (limit and f"limit {limit}", nearer) if part)
        bound = f" ({bounds})" * bool(bounds)
        kind = self.kind if self.decided else f"{self.kind} undecided"
        return f"{kind} at {at}{': ' * bool(names)}{names}{found}{bound}"


def extremes(
    motion: Motion, order: int, low: FloatArray | float = np.inf, high: FloatArray | float = -np.inf
) -> Extremes:
    """Return proven bounds of the derivative of an order: 0 for positions, 1 for velocities.

    Bounds are tight only where they would exceed `high` or fall below `low`.
    """
    held = motion.derivative_coefficients(order)
    spans = np.diff(motion.times)[:, None]
    error = (held.shape[1] + 2) * polynomials.EPS * np.abs(held).sum(axis=1)
    error += motion.roughness(order) if order else motion.allowance
    points = polynomials.bernstein(held)
    top, top_at = _peaks(points, high - error)
    bottom, bottom_at = _peaks(-points, -low - error)
    times = motion.times[:-1, None]
    return Extremes(-bottom - error, top + error, times + spans * bottom_at, times + spans * top_at)


def _peaks(points: FloatArray, enough: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return upper bounds (K, n) of pieces, tight where they exceed `enough`, and their fractions in [0, 1]."""
    bound: FloatArray = points.max(axis=1)
    at: FloatArray = points.argmax(axis=1) / max(points.shape[1] - 1, 1)
    chosen = bound > enough
    if chosen.any():
        found = polynomials.peaks(np.moveaxis(points, 1, 2)[chosen])
        bound[chosen], at[chosen] = found.bound, found.at
    return bound, at


def rate_violations(motion: Motion, robot: Robot, limits: RateLimits | None = None) -> list[Violation]:
    """Return where a motion exceeds joint limits. An empty list proves that the motion exceeds none.

    Violations are sorted by time. For each joint and each run of pieces with a violation, the worst is returned.
    Positions of non-continuous joints may be 1e-9 rad or m outside, other values `RATE_TOLERANCE` above their limit.
    Velocities, accelerations and jerks are checked if `limits` are given and the motion is timed, without slack.
    Velocities must not jump between pieces; with a limit of the jerk, accelerations must not jump either.

    Raises InputError if the motion or the limits are of another robot.
    """
    motion = motion.for_robot(robot)
    low, high, low_at, high_at = extremes(motion, 0, robot.lower, robot.upper)
    free = np.where(robot.continuous, np.inf, _POSITION_TOLERANCE)
    found = list(_worst(robot, 0, "position", low_at, low, robot.lower - free - low, robot.lower))
    found += _worst(robot, 0, "position", high_at, high, high - robot.upper - free, robot.upper)
    if limits is not None and motion.rated:
        if limits.joint_names != robot.joint_names:
            raise InputError(f"are of other joints than the robot's: {', '.join(limits.joint_names)}", "limits")
        for order, kind in enumerate(limits.kinds, start=1):
            most: FloatArray = getattr(limits, kind)
            bounds = extremes(motion, order, -most, most)
            is_low = -bounds.low > bounds.high
            values = np.where(is_low, bounds.low, bounds.high)
            times = np.where(is_low, bounds.low_at, bounds.high_at)
            excess = np.abs(values) - most - RATE_TOLERANCE[order]
            found += _worst(robot, order, kind, times, values, excess, most)
            if order > 1:
                jumps = motion.jumps(order - 1)
                times = np.broadcast_to(motion.times[1:-1, None], jumps.shape)
                excess = np.abs(jumps) - RATE_TOLERANCE[order - 1]
                none = np.zeros(robot.n)
                found += _worst(robot, order - 1, f"{_DERIVATIVES[order - 1]} jump", times, jumps, excess, none)
    return sorted(found, key=lambda violation: (violation.at, violation.names, violation.kind))


def _worst(
    robot: Robot, order: int, kind: str, times: FloatArray, values: FloatArray, excess: FloatArray, limits: FloatArray
) -> Iterator[Violation]:
    """Yield the largest excess > 0 of each joint in each run of rows; arrays are (K, n)."""
    if (excess <= 0.0).all():
        return
    excess = np.where(np.isnan(excess), np.inf, excess)
    for joint in np.flatnonzero((excess > 0).any(axis=0)).tolist():
        rows = np.flatnonzero(excess[:, joint] > 0)
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            high = excess[run, joint].max() - 1e-9 * np.abs(values[run, joint]).max()
            worst = run[(excess[run, joint] >= high).argmax()]  # the first of equals
            unit = ("m" if robot.prismatic[joint] else "rad") + _DERIVATIVE_UNITS[order]
            at, name = float(times[worst, joint]), robot.joint_names[joint]
            value, limit = float(values[worst, joint]), float(limits[joint])
            yield Violation(kind, at, at, at, (name,), value, limit, True, unit)


# -------------------------------------------------------------------------------------- stops beside people


def stops_of(motion: Motion, proof: MotionProver, limits: RateLimits | None, people: People) -> Stops:
    """Return the stops of a motion for people, within the tube of a proof. Joints must be in the robot's order."""
    if not motion.rated:
        why = "bare samples have no rates" if motion.timed else "it has no times"
        raise InputError(f"stops beside people cannot be proven: {why}", "motion")
    if limits is None:
        raise InputError("give limits: stops beside people need to know how hard the robot may brake", "limits")
    if limits.jerk is not None:
        raise InputError(
            "stops with a jerk limit are proven only for trajectories of safe-ompl; without it, stops are "
            "proven within the limits of velocity and acceleration",
            "limits",
        )
    checker = proof.checker
    people = within_tube(TimingLimits(people), proof).people or people
    # Jumps count too, because distances are kept from one piece to the next.
    off = motion.allowance.sum(axis=0)
    nearer = float((checker.robot.bounds.displacement_radii @ off).max(initial=0.0))
    distances = PeopleDistances(checker.robot, checker.scene, replace(people, clearance=people.clearance + nearer))
    last = motion.end_rates[1, -1]
    if (last > RATE_TOLERANCE[1]).any():
        joint = int((last / limits.velocity).argmax())
        raise InputError(
            f"must end at rest where it is to stop before people, and {limits.joint_names[joint]!r} ends at "
            f"{last[joint]:.3g} rad/s or m/s: let it end at rest, or check it without people "
            "(`people=None`, `--no-people`)",
            "motion",
        )
    return stops_beside(motion, _stop_cells(motion), BodySpeeds(checker.robot), limits, distances)


def _stop_cells(motion: Motion) -> Cells:
    """Return cells of a timed motion in which the joints move little.

    They are at least as fine as those of a trajectory.
    """
    rates = polynomials.bernstein(motion.derivative_coefficients(1))
    lengths = np.linalg.norm(np.abs(rates).max(axis=1), axis=1) * np.diff(motion.times)
    step = min(CELL_LENGTH, float(lengths.sum()) / CELLS)
    parts = np.ceil(lengths / step) if step > 0 else np.ones(motion.pieces)
    return motion.between(divided_edges(motion.times, np.maximum(parts, 1).astype(np.intp)))
