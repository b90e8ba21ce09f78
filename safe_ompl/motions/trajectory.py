"""Timed trajectories: joint values, velocities and accelerations at any time, and points for export.

Controllers interpolate positions and velocities by cubics, and positions, velocities and accelerations by quintics, as
ROS 2's joint trajectory controller does. Points sampled evenly from a motion within its limits are not enough: where
the acceleration jumps between two points, a cubic reaches up to 5/3 of the acceleration, and a quintic more. Therefore
points are placed where needed at jumps of the acceleration, or of the jerk if it is limited, and evenly between them.
If a limit is still exceeded, the whole trajectory is slowed down.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from math import perm
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, float_array, notebook_html, number, polynomials
from safe_ompl.danger import KinetostaticField
from safe_ompl.motions.cells import CurvePoints, divided_edges
from safe_ompl.motions.danger import MotionDanger, motion_danger
from safe_ompl.motions.laws import drive
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.motions.time_law import SmoothLaw, TimeLaw
from safe_ompl.scene import People

RATE = 100.0  # [Hz]
# Knots closer than this are merged.
_EQUAL_TIMES = 1e-9  # [s]
# A speed limit counts as reached if the speed comes within this share of it.
_LIMIT_REACHED = 1e-6
# Points are added where limits are exceeded by more than this share. Slowing down removes a smaller excess.
_REFINED_EXCESS = 1e-3
_LEAST_POINT_DISTANCE = 1e-4  # [s] between points
# Least length of the first and the last interval between points, as a share of the other intervals.
_LEAST_END_INTERVAL = 0.2
# Times in ROS messages are whole nanoseconds.
_NANOSECOND = 1e-9  # [s]
# Limit of the number of slow-downs. Two are enough in most cases.
_MOST_SLOWDOWNS = 20


class State(NamedTuple):
    """Joint values, velocities and accelerations, (n,) or (T, n) [rad, rad/s, rad/s²; m for prismatic joints]."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray


@dataclass(frozen=True)
class VelocityLimit:
    """A limit of the path velocity that is proven over whole cells: the largest ṡ in each (N,) [rad/s]; inf: no limit.

    The name is "joint velocity", "separation", "contact", "danger", "tool speed", "link speed", …. Limits of the
    speed of tool or links have a `point_speed` [m/s].
    """

    name: str
    speeds: FloatArray
    point_speed: float | None = None

    @property
    def least(self) -> float:
        """The smallest value over all cells [rad/s]."""
        return float(self.speeds.min(initial=np.inf))


@dataclass(frozen=True)
class Trajectory:
    """A timed motion along a curve, as made by `time_path`.

    Attributes
    ----------
    curve : Motion
        The path with blended corners, over arc length.
    law : TimeLaw
        The time law: the position on the curve at each time.
    limits : RateLimits
        Limits that joint velocities, accelerations and, if limited, jerks keep at every instant.
    velocity_limits : tuple of VelocityLimit
        Limits of the path velocity.
    brakes : ndarray, shape (N,), or None
        Path deceleration of a stop in each cell [rad/s²], with which the limits for people are computed. If the jerk is
        limited, it is the deceleration of the plan before smoothing.
    people : People or None
        People before whom the robot stops in time.
    tool_speed, link_speed : float or None
        Largest speed of the tip, and of all points of all links [m/s].
    danger_field, max_danger : KinetostaticField and float, or None
        Danger field of the moving robot, and the limit of the danger.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> trajectory = time_path([[0.0] * 6, [0.5] * 6], robot, RateLimits.of(robot, acceleration=8.0))
    >>> round(trajectory.duration, 2)
    0.5
    >>> position, velocity, acceleration = trajectory.at(0.25)
    """

    curve: Motion
    law: TimeLaw
    limits: RateLimits
    velocity_limits: tuple[VelocityLimit, ...] = ()
    brakes: FloatArray | None = None
    people: People | None = None
    tool_speed: float | None = None
    link_speed: float | None = None
    danger_field: KinetostaticField | None = None
    max_danger: float | None = None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the n joints."""
        return self.limits.joint_names

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.law.duration

    def __repr__(self) -> str:
        names = ", ".join(limit.name for limit in self.velocity_limits)
        limited = f", velocity limits: {names}" if names else ""
        return f"Trajectory({self.duration:.3f} s, {self.curve.length:.3g} rad{limited})"

    def __str__(self) -> str:
        """Return duration, length of the curve, and names of the velocity limits, one per line."""
        names = ", ".join(limit.name for limit in self.velocity_limits) or "none"
        return f"duration: {self.duration:.3f} s\nlength: {self.curve.length:.3g} rad\nvelocity limits: {names}"

    _repr_html_ = notebook_html

    def at(self, time: float | ArrayLike) -> State:
        """Return the state at a time [s], or at times (T,). The robot rests before the start and after the end.

        Where the acceleration jumps between two cells, the value of the later cell is returned. Raises InputError if a
        time is NaN.
        """
        _, place, rate, acceleration = self._places(time)
        state = State(place.q, place.dq_ds * rate, place.dq_ds * acceleration + place.d2q_ds2 * (rate * rate))
        return state if np.ndim(time) else State(*(values[0] for values in state))

    def jerks_at(self, time: float | ArrayLike) -> FloatArray:
        """Return the jerk of the joints, (n,) or (T, n) [rad/s³ or m/s³], at a time or at times (T,) [s].

        Raises InputError as `at`, or if the jerk was not limited, because the acceleration then jumps.
        """
        if not isinstance(self.law, SmoothLaw):
            raise InputError("the jerk of the trajectory is not limited: give RateLimits a jerk")
        times, place, rate, acceleration = self._places(time)
        jerk = self.law.jerks(times)[:, None]
        jerks: FloatArray = place.d3q_ds3 * rate**3 + 3 * place.d2q_ds2 * rate * acceleration + place.dq_ds * jerk
        return jerks if np.ndim(time) else jerks[0]

    def _places(self, time: float | ArrayLike) -> tuple[FloatArray, CurvePoints, FloatArray, FloatArray]:
        """Return times (T,), the points on the curve at these times, and ṡ and s̈ (T, 1)."""
        times = np.atleast_1d(float_array(time, (None,) if np.ndim(time) else (), "time"))
        if np.isnan(times).any():
            raise InputError("time must be a number of seconds, got nan")
        cell, s, rate, acceleration = self.law.at(times)
        edges = self.law.edges
        place = self.curve.places(s, self.curve.piece_at((edges[cell] + edges[cell + 1]) / 2))
        return times, place, rate[:, None], acceleration[:, None]

    def points(self, rate: float = RATE) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return times (T,) [s] and positions and velocities (T, n) for a controller.

        If the jerk is limited, accelerations are returned, too. The cubics (or quintics) through these points are
        proven to keep all joint limits (`safe_ompl.motions.trajectory`). Therefore the points are not quite even, and
        may be reached later than by `at`, by 0.1 % in most cases. There are at least `rate` points per second [Hz].
        Raises InputError if `rate` is not positive.
        """
        number("rate", rate, above=0.0, kind="number of points per second")
        smooth = isinstance(self.law, SmoothLaw)
        edges, knots = self.law.edges, self.law.knots
        # The jerk also jumps between pieces of the curve.
        pieces = np.searchsorted((edges[1:] + edges[:-1]) / 2, self.curve.times[:-1])
        knots = np.unique(np.append(knots, self.law.times[pieces]))
        knots = knots[(np.diff(knots, prepend=0.0) > _EQUAL_TIMES) & (knots < self.duration - _EQUAL_TIMES)]
        knots = np.concatenate([[0.0], knots, [self.duration]])
        middles = (knots[1:] + knots[:-1]) / 2
        highest = self.jerks_at(middles) if smooth else self.at(middles).qdd
        steps = np.diff(highest / getattr(self.limits, self.limits.kinds[-1]), axis=0)
        jumps = np.concatenate([[0.0], np.abs(steps).max(axis=1), [0.0]])
        kinds = ("positions", "velocities", "accelerations")[: 2 + smooth]
        times, states = points_within(lambda t: self.at(t)[: len(kinds)], knots, jumps, self.limits, rate)
        return times, dict(zip(kinds, states, strict=True))

    def stop_from(self, time: float) -> Trajectory:
        """Return the stop on the path that begins at a time [s] and is proven to end before a person is reached.

        At each position the deceleration is the least of `brakes` from the beginning of the stop. If the jerk is
        limited, this holds for the plan, whose moving average is the motion (`safe_ompl.motions.time_law`), and the
        jerk keeps its limits. Raises InputError if the trajectory was made without people, or if the time is not in [0,
        duration].
        """
        if self.brakes is None:
            raise InputError("the trajectory was computed without people, so it has no stops")
        begin = number("time", time, at_least=0.0, at_most=self.duration)
        cell, at, rate = self.law.planned(begin)
        brakes = np.minimum.accumulate(self.brakes[cell:])
        free = np.full(len(brakes) + 1, np.inf)
        # An empty first tick makes the robot brake fully from the beginning.
        _, edges, squared_speeds, _ = drive(self.law.edges[cell:], free[1:], brakes, free, at, rate * rate, -1.0, 0.0)
        # The robot is at rest.
        if len(edges) == 1:
            edges, squared_speeds = edges.repeat(2), np.zeros(2)
        law = self.law.stopped(begin, edges, squared_speeds)
        return Trajectory(self.curve, law, self.limits)

    def binding(self) -> tuple[str | None, ...]:
        """Return for each cell the name of the limit that the speed reaches, or None where acceleration limits bind."""
        squared_speeds = self.law.plan_squared_speeds if isinstance(self.law, SmoothLaw) else self.law.squared_speeds
        fastest = np.sqrt(np.maximum(squared_speeds[1:], squared_speeds[:-1]))
        names: list[str | None] = [None] * len(fastest)
        least = np.min([limit.speeds for limit in self.velocity_limits], axis=0, initial=np.inf)
        for limit in self.velocity_limits:
            for k in np.flatnonzero((limit.speeds <= least) & (fastest >= limit.speeds * (1 - _LIMIT_REACHED))):
                names[int(k)] = limit.name
        return tuple(names)

    def danger(self, field: KinetostaticField) -> MotionDanger:
        """Return the danger of the moving robot over time, with mean, peak, and a proven bound of the peak."""
        return motion_danger(self.curve, self.law, field)

    def as_dict(self, rate: float = RATE) -> dict[str, Any]:
        """Return the trajectory in the format of ROS's `JointTrajectory`, with additional keys.

        Parameters
        ----------
        rate : float
            Minimum number of points per second [Hz]; see `points`.

        Returns
        -------
        dict
            ``joint_names``; ``points``, each with ``time_from_start`` [s], ``positions`` and ``velocities``, and
            ``accelerations`` if the jerk is limited; ``duration``; ``limits`` with ``velocity`` and ``acceleration`` by
            joint; ``velocity_limits``, each with its ``name`` and ``least``, the smallest allowed path velocity
            (None: no limit).
        """
        times, states = self.points(rate)
        rows = zip(*(values.tolist() for values in states.values()), strict=True)
        return {
            "joint_names": list(self.joint_names),
            "points": [
                {"time_from_start": t, **dict(zip(states, row, strict=True))}
                for t, row in zip(times.tolist(), rows, strict=True)
            ],
            "duration": float(times[-1]),
            "limits": self.limits.as_dict(),
            "velocity_limits": [
                {"name": limit.name, "least": limit.least if np.isfinite(limit.least) else None}
                for limit in self.velocity_limits
            ],
        }

    def to_json(self, rate: float = RATE) -> str:
        """Return `as_dict` as JSON."""
        return json.dumps(self.as_dict(rate), allow_nan=False)


def points_within(
    at: Callable[[FloatArray], tuple[FloatArray, ...]],
    knots: FloatArray,
    jumps: FloatArray,
    limits: RateLimits,
    rate: float,
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return times (T,) [s] and states of points whose interpolation is proven to keep the limits.

    Times are whole nanoseconds. `at` returns positions and velocities, and accelerations for quintics, each (S, n), at
    times (S,) of the motion. At `knots: (K,)`, which include its ends, the acceleration (or jerk) jumps by `jumps`, as
    shares of the limits. There are at least `rate` points per second. Raises ArithmeticError if rounding exceeds the
    limits, which happens for points less than nanoseconds apart.
    """
    fixed = knots[[0, -1]]
    inside = np.abs(knots - fixed.mean()) < np.ptp(fixed) / 2 - _LEAST_END_INTERVAL / rate
    while True:
        parts = np.ceil(np.diff(fixed) * rate * (1 - 1e-9)).astype(np.intp)
        places = divided_edges(fixed, np.maximum(parts, 1))
        times, states = _slower(at, places, 1.0)
        after = np.clip(np.searchsorted(fixed, knots), 1, len(fixed) - 1)
        apart = np.minimum(knots - fixed[after - 1], fixed[after] - knots)
        worth = np.where((apart > _LEAST_POINT_DISTANCE) & inside, jumps, 0.0)
        new = []
        for k in np.flatnonzero(_excess(times, states, limits) > 1 + _REFINED_EXCESS):
            first, last = np.searchsorted(knots, places[k : k + 2])
            best = first + int(worth[first:last].argmax()) if first < last else first
            if worth[best] > _REFINED_EXCESS:
                new.append(knots[best])
        if not new:
            break
        fixed = np.union1d(fixed, new)
    factor = 1.0
    for _ in range(_MOST_SLOWDOWNS):
        excess = float(_excess(times, states, limits).max())
        if excess <= 1:
            return times, states
        factor *= excess + _NANOSECOND
        times, states = _slower(at, places, factor)
    raise ArithmeticError("no slowed points keep the limits")


def _slower(
    at: Callable[[FloatArray], tuple[FloatArray, ...]], places: FloatArray, factor: float
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return times (T,) [s] of the points if the motion is slowed down by a factor, and the states then."""
    times = np.round(factor * places / _NANOSECOND) * _NANOSECOND
    # The last query is after the end of the motion, where the robot is at rest.
    asked = np.append(times[:-1] / factor, places[-1] + 1.0)
    return times, tuple(values / factor**order for order, values in enumerate(at(asked)))


def _excess(times: FloatArray, states: tuple[FloatArray, ...], limits: RateLimits) -> FloatArray:
    """Return the factors (T − 1,) by which the pieces between points must be slowed down to keep the limits."""
    spans = np.diff(times)[:, None]
    ends = [np.stack([values[:-1], values[1:]], axis=1) for values in states]
    held, rounding = polynomials.hermite(spans[:, 0], *ends, *[None] * (3 - len(ends)))
    degree, factor = held.shape[1] - 1, np.zeros(len(spans))
    for order, kind in enumerate(limits.kinds, start=1):
        held = held[:, 1:] * np.arange(1.0, held.shape[1])[:, None] / spans[..., None]
        error = (degree + 3) * polynomials.EPS * np.abs(held).sum(axis=1)
        error += perm(degree, order) * rounding / spans**order
        rows, most = np.moveaxis(polynomials.bernstein(held), 1, 2), getattr(limits, kind)
        bound = np.abs(rows).max(axis=2)
        over = bound + error > most
        if over.any():
            bound[over] = np.maximum(polynomials.peaks(rows[over]).bound, polynomials.peaks(-rows[over]).bound)
        factor = np.maximum(factor, ((bound + error) / most).max(axis=1) ** (1 / order))
    return factor
