"""Tubes about motions: widths by joint, and widths measured from a robot's tracking errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, finite_array, number
from safe_ompl.motions.motion import Motion
from safe_ompl.robot import Robot

FACTOR = 1.5
"""Factor by which a tube is wider than the largest measured error."""


def tube_of(given: ArrayLike | Mapping[str, float], robot: Robot, key: str = "tube") -> tuple[float, ...]:
    """Return the n widths of a tube [rad or m] from one number, n numbers, or a mapping by the names of all joints."""
    if isinstance(given, Mapping):
        given = robot.configuration(given, key)
    widths = np.full(robot.n, number(key, given)) if np.ndim(given) == 0 else given
    found = finite_array(widths, (robot.n,), key)
    if (found < 0).any():
        raise InputError(f"must be widths >= 0 [rad or m], got {found.tolist()}", key)
    return tuple(found.tolist())


@dataclass(frozen=True, eq=False)
class MeasuredTube:
    """Tracking errors of a robot's joints, from a log of commanded and measured positions at equal times.

    `errors: (n,)` [rad or m] are the largest at the instants of the log, which occur at `times: (n,)` [s]. Between two
    instants errors are larger by at most `between: (n,)`, |second difference quotient| Δt² / 8, if accelerations there
    do not exceed those of the neighbouring samples. The tube is wider than the errors by a factor.
    """

    joint_names: tuple[str, ...]
    errors: FloatArray
    times: FloatArray
    between: FloatArray
    samples: int
    factor: float

    @property
    def widths(self) -> FloatArray:
        """The tube (n,) [rad or m]: factor × (errors + between)."""
        return self.factor * (self.errors + self.between)


def measured_tube(
    commanded: Motion, measured: Motion, factor: float = FACTOR, continuous: ArrayLike | None = None
) -> MeasuredTube:
    """Return the tube of a log of commanded and measured positions. Samples are interpolated linearly.

    The motions are compared at the instants of both. Differences by whole turns of `continuous` joints (n,) are no
    errors. Raises InputError if a motion has no times or joint names, if joints differ, or if the time intervals do not
    overlap.
    """
    factor = number("factor", factor, at_least=1.0)
    for name, motion in (("commanded", commanded), ("measured", measured)):
        if not motion.timed or motion.joint_names is None:
            raise InputError("must have times, and name its joints", name)
    names, others = commanded.joint_names or (), measured.joint_names or ()
    if set(names) != set(others):
        raise InputError(f"must have the joints {', '.join(names)}, got {', '.join(others)}", "measured")
    order, turns = [others.index(name) for name in names], np.zeros(len(names), dtype=bool)
    turns |= False if continuous is None else np.asarray(continuous, dtype=bool)
    asked, found = _unwrapped(commanded, turns), _unwrapped(measured, turns[np.argsort(order)])
    begin, end = (choose(asked.times[k], found.times[k]) for choose, k in ((np.maximum, 0), (np.minimum, -1)))
    if not end > begin:
        spans = " and ".join(f"{motion.times[0]:g}–{motion.times[-1]:g} s" for motion in (asked, found))
        raise InputError(f"must have a time in common, got {spans}", "commanded and measured")
    times = np.union1d(asked.times, found.times)
    times = times[(times >= begin) & (times <= end)]
    apart = found.at(times)[:, order] - asked.at(times)
    apart[:, turns] = (apart[:, turns] + np.pi) % (2 * np.pi) - np.pi
    if asked.degree == found.degree == 1 and np.array_equal(asked.times, found.times):
        between = _between(times, apart)
    else:
        parts = ((asked, np.arange(len(names))), (found, order))
        between = np.sum([_between(m.times, m.knots[:, k]) for m, k in parts if m.degree == 1], axis=0)
    worst = np.abs(apart).argmax(axis=0)
    errors = np.abs(apart)[worst, range(len(names))]
    return MeasuredTube(names, errors, times[worst], between + 0.0 * errors, len(times), factor)


def _unwrapped(motion: Motion, continuous: ArrayLike) -> Motion:
    """Remove jumps by whole turns from samples. Other motions are returned unchanged."""
    if motion.degree != 1:
        return motion
    knots = np.where(continuous, np.unwrap(motion.knots, axis=0), motion.knots)
    return Motion.hermite(motion.times, knots, names=motion.joint_names)


def _between(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return how far (n,) a signal through values (T, n) may be from linear interpolation."""
    spans = np.diff(times)[:, None]
    if len(spans) < 2:
        return np.zeros(values.shape[1])
    curvatures = np.abs(np.diff(np.diff(values, axis=0) / spans, axis=0)) * 2 / (spans[1:] + spans[:-1])
    either = np.maximum(np.vstack([curvatures[:1], curvatures]), np.vstack([curvatures, curvatures[-1:]]))
    return np.asarray((either * spans**2).max(axis=0) / 8)
