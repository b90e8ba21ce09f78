"""Proposed motions: curves that begin at the robot's state, and velocity limits along the curves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, finite_array, number, polynomials
from safe_ompl.live.replanning.bounded_path import REPLANNED_CURVE_JERK_SHARE, averaging_window
from safe_ompl.motions import BRAKING, Cells, Motion, RateLimits, State, bending_velocity_limit
from safe_ompl.robot import Robot

# Stops at full speed may use at least this share of the accelerations, and velocities are approached with this share.
_ACCELERATION_SHARE = 0.5
# Two positions are a jump if a joint needs more than this many times its velocity limit between them.
_JUMP = 2.0
# Largest time between positions that are sampled from a spline, and smallest time between positions that are used.
_BETWEEN = 0.05  # [s]
_DENSE = 0.01  # [s]
# Positions up to this long after the window shape the spline in the window.
_AFTER = 0.5  # [s]
# A proposal with less remaining time than this has ended.
_OVER = 1e-3  # [s]
# A change of velocity takes at least this long.
_LEAST_POINT_INTERVAL = 1e-3  # [s]
# Damping of the inverse of the Jacobian.
_DAMPING = 0.05  # [m/rad]
# This many of the next positions are left out if the robot cannot pass them in its direction of motion.
_LEFT_OUT = (0, 2)
_AT_REST = 1e-9  # [rad/s]
# Proposed velocities may be at most this many times the limits of the joints, as for positions.
_FASTEST = 2.0
# A curve may begin faster than the robot moves if the cosine of the angle between the robot's motion and the straight
# line to the next position is at least this. The curve leaves the line by at most 4/27 of the sine times the length of
# the line, 13 %.
_ALONG = 0.5
# Upper bound of the braking, for curves on which the joints hardly move.
HARDEST = 100.0  # [1/s²]
# Braking lines are lengthened by this share because of rounding errors.
_ROUNDED = 1e-9
# The degree of the pieces of a curve, and the duration of the cubics that approximate pieces of a higher degree.
_CUBIC = 3
_EXACT = 0.02  # [s]
# A velocity that jumps by more than this is a corner.
_CORNER = 1e-4  # [rad/s]
# With a jerk limit: the three q‴, each for a third of a unit of time, that change q″ from 1 to 0 without changing q and
# q′; the share of the jerk that they use; and candidates for half the duration of a change of velocity.
_BUMP: FloatArray = np.array([-5.5, 3.5, -1.0])
_BUMP_SHARE = 0.15
_RAMPS: FloatArray = np.geomspace(_LEAST_POINT_INTERVAL, 10.0, 100)  # [s]
# Knots closer than this are treated as equal.
_EQUAL_TIMES = 1e-9  # [s]


class Beginning(NamedTuple):
    """A curve that begins at the robot's configuration, with the path velocity and acceleration there."""

    curve: Motion
    speed: float  # ṡ
    acceleration: float = 0.0  # s̈


def cubics(knots: FloatArray, derivatives: FloatArray) -> Motion:
    """Return the path with knots (K + 1,) from the values (K, 4, n) of q, q′, q″ and q‴ at the begin of each piece."""
    t = np.diff(knots)[:, None]
    factors = np.stack([np.ones_like(t), t, t * t / 2, t * t * t / 6], axis=1)
    return Motion(knots, factors * derivatives, timed=False)


def _through(q: FloatArray, velocity: FloatArray, d2: FloatArray, d3: FloatArray, spans: FloatArray) -> Motion:
    """Return the path that begins with q and q′ (n,); its K pieces begin with q″ `d2` and have q‴ `d3`, each (K, n)."""
    t = spans[:, None]
    first = velocity + _sums_before(t * (d2 + t * d3 / 2))
    positions = q + _sums_before(t * (first + t * (d2 / 2 + t * d3 / 6)))
    return cubics(np.append(0.0, np.cumsum(spans)), np.stack([positions, first, d2, d3], axis=1))


def _sums_before(steps: FloatArray) -> FloatArray:
    """Return for each step (K, n) the sum of the steps before it."""
    return np.cumsum(np.vstack([np.zeros_like(steps[:1]), steps[:-1]]), axis=0)


def least_brake(limits: RateLimits) -> float:
    """Return the path deceleration [1/s²] that is reserved at full speed: a share of what every joint allows."""
    least = float(_ACCELERATION_SHARE * (limits.acceleration / limits.velocity).min())
    if limits.jerk is None:
        return least
    # The deceleration that plans may use (`SmoothLimits`) when the joints move at their velocity limits.
    curve_accelerations = 3 * BRAKING * limits.acceleration
    of_plan = (
        BRAKING
        * (1 - REPLANNED_CURVE_JERK_SHARE)
        * limits.jerk
        / (limits.velocity / averaging_window(limits) + curve_accelerations)
    )
    return min(least, float(of_plan.min()))


def proposed_velocity_limit(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ ≤ 1 (N,) at which the accelerations leave enough for a stop within the window.

    The condition is |q″|ṡ² ≤ a − b|q′|, with the reserved deceleration b, or |q″|ṡ² ≤ a/2, whichever allows more. The
    second one leaves a/2|q′|, which is at least b if all joints keep their velocity limits.
    """
    room = limits.acceleration - least_brake(limits) * cells.dq_ds
    squares = np.divide(room, cells.d2q_ds2, out=np.full_like(room, np.inf), where=cells.d2q_ds2 > 0)
    fastest = np.sqrt(np.maximum(squares.min(axis=1), 0.0))
    return np.asarray(np.minimum(1.0, np.maximum(fastest, bending_velocity_limit(cells, limits))))


@dataclass(frozen=True)
class Positions:
    """Positions (K, n) at times (K,) [s] since the start; the start is None if they begin with the next command."""

    robot: Robot
    limits: RateLimits
    times: FloatArray
    positions: FloatArray
    start: float | None

    @classmethod
    def of(cls, motion: Any, rate: float | None, start: float | None, robot: Robot, limits: RateLimits) -> Positions:
        """Return the positions of a chunk or a motion; see `Shield.propose`."""
        if start is not None:
            start = number("start", start)
        if rate is not None:
            positions = finite_array(motion, (None, robot.n), "chunk")
            if len(positions) < 2:
                raise InputError(f"must have at least two positions, got {len(positions)}", "chunk")
            times = np.arange(float(len(positions))) / number("rate", rate, above=0.0)
        else:
            given = Motion.of(motion, space=robot).for_robot(robot)
            if not given.timed:
                raise InputError("has no times: give the rate of a chunk", "motion")
            parts = [
                np.linspace(a, b, int(np.ceil((b - a) / _BETWEEN)), endpoint=False)
                for a, b in zip(given.times[:-1].tolist(), given.times[1:].tolist(), strict=True)
            ]
            at = np.append(np.concatenate(parts), given.times[-1])
            times, positions = at - at[0], given.at(at)
        found = cls(robot, limits, times, positions, start)
        found.check_jumps(robot.difference(positions[:-1], positions[1:]), times, "at {:.3g} s of it")
        dense = max(_DENSE, averaging_window(limits))
        _, firsts = np.unique(np.floor(times / dense + 1e-6), return_index=True)
        kept = np.union1d(firsts, len(times) - 1)
        return replace(found, times=times[kept], positions=positions[kept])

    def check_jumps(self, steps: FloatArray, times: FloatArray, where: str) -> None:
        """Raise InputError if joints cannot move by steps (K, n) between times (K + 1,) [s]."""
        spans = np.diff(times)
        for k, i in np.argwhere(np.abs(steps) > _JUMP * self.limits.velocity * spans[:, None]):
            what = f"joint {self.limits.joint_names[i]!r} by {steps[k, i]:.3g} within {spans[k]:.3g} s"
            raise InputError(f"jumps {where.format(times[k])}: {what}", "proposal")

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])

    def own_curve(self, motion: Motion) -> Motion:
        """Return the curve of the motion through the positions, which begins at rest. The robot stops at corners.

        Cubic motions are reproduced exactly. Motions of a higher degree are sampled every 0.02 s, with velocities. For
        straight lines, or with a jerk limit, the curve is the spline through the positions.
        """
        motion = motion.for_robot(self.robot)
        if motion.degree <= 1 or self.limits.jerk is not None:
            still = np.zeros(motion.n)
            return next(self.curves(0.0, State(self.positions[0], still, still), np.inf)).curve
        if motion.degree > _CUBIC:
            counts = np.ceil(np.diff(motion.times) / _EXACT).astype(int).tolist()
            motion = motion.cut({k: np.arange(1, m) / m for k, m in enumerate(counts) if m > 1})
        powers = motion.coefficients
        begins, first = powers[:, 0], powers[:, 1]
        ways, last = powers.sum(axis=1) - begins, (powers * np.arange(motion.degree + 1)[:, None]).sum(axis=1)
        coefficients = np.stack([begins, first, 3 * ways - 2 * first - last, first + last - 2 * ways], axis=1)
        spans = np.diff(motion.times)[:, None]
        jumps = np.abs(last[:-1] / spans[:-1] - first[1:] / spans[1:]).max(axis=1)
        corners = tuple((1 + np.flatnonzero(jumps > _CORNER)).tolist())
        return Motion(motion.times - motion.times[0], coefficients, motion.joint_names, timed=False, corners=corners)

    def curves(self, begin: float, state: State, window: float) -> Iterator[Beginning]:
        """Yield curves that begin at a state, at the time `begin` of the proposal; the closest to the proposal first.

        The curves are valid for at least a window [s]. A negative `begin` is before the start of the proposal.

        With ṡ = 1 the robot follows the proposal in time, if its accelerations suffice. Otherwise, if the robot moves
        approximately in the proposed direction, the curve begins with the proposed speed in the robot's direction, and
        ṡ is reduced to the robot's speed. If the robot moves in another direction, it must brake, because such a curve
        would go far in this direction and accelerate the robot there. If the curvature is too large, two positions are
        left out. The last curve is a straight line with the hardest braking. A line cannot begin with an acceleration,
        so with a jerk limit the robot follows the stop of its last command instead.

        With a jerk limit the curve also begins with the robot's acceleration: it leaves the spline at first, and s̈ has
        a part in the acceleration if the robot is slower than proposed.
        """
        if self.duration - begin < _OVER:
            raise InputError(f"is too late: it ended {begin - self.duration:.3g} s ago", "proposal")
        first = int(np.searchsorted(self.times, begin, side="right"))
        spacing = float(np.diff(self.times)[max(first - 1, 0)])
        if first + 1 < len(self.times) and self.times[first] - begin < 0.5 * spacing:
            first += 1  # very near positions
        last = int(np.searchsorted(self.times, begin + window + _AFTER)) + 1
        times = self.times[first:last] - begin
        given, robot = self.positions[first:last], self.robot
        steps = [robot.difference(state.q, given[0])[None], robot.difference(given[:-1], given[1:])]
        points = state.q + np.cumsum(np.concatenate(steps), axis=0)
        self.check_jumps(points[:1] - state.q, np.array([0.0, times[0]]), "from where the robot is")
        speed, moves = float(np.linalg.norm(state.qd)), state.qd != 0
        for left_out in _LEFT_OUT:
            at, through = times[left_out:], points[left_out:]
            if not len(at):
                break
            step = through[0] - state.q
            fast = float(np.linalg.norm(step) / at[0])
            begins = [1.0]
            if speed < _AT_REST:
                begins.append(0.0)
            elif speed < fast and state.qd @ step >= _ALONG * speed * np.linalg.norm(step):
                begins.append(speed / fast)
            for rate in begins:
                velocity = state.qd / rate if rate else None
                curve = _spline(state.q, velocity, at, through)
                for acceleration in _accelerations(state, rate, self.limits):
                    if velocity is not None and self.limits.jerk is not None:
                        d2 = (state.qdd - acceleration * velocity) / (rate * rate)
                        curve = _bent(curve, d2, rate, self.limits.jerk)
                    if _can_begin(curve, rate, self.limits):
                        yield Beginning(curve, rate, acceleration)
        if speed >= _AT_REST and self.limits.jerk is None:
            hardest = min(HARDEST, float((self.limits.acceleration[moves] / np.abs(state.qd[moves])).min()))
            length, none = (1 + _ROUNDED) / (2 * hardest), np.zeros((1, robot.n))
            if length < self.duration - begin:
                yield Beginning(_through(state.q, state.qd, none, none, np.array([length])), 1.0)


def _accelerations(state: State, rate: float, limits: RateLimits) -> list[float]:
    """Return candidates of s̈ at the begin of a curve with ṡ = rate: the robot's along the curve, and 0."""
    if limits.jerk is None:
        return [0.0]
    if rate == 0.0:
        return [0.0] if np.abs(state.qdd).max() < _AT_REST else []
    if rate == 1.0:
        return [0.0]
    # The largest speed of the time law before the average.
    most = 2 * rate / averaging_window(limits)
    along = float(state.qdd @ state.qd / (state.qd @ state.qd)) * rate
    return [float(np.clip(along, -most, most)), 0.0]


def _bent(spline: Motion, d2: FloatArray, rate: float, jerk: FloatArray) -> Motion:
    """Return a spline that is changed so that it begins with another q″, within the jerk limits (n,).

    The difference has three pieces of constant q‴, at the end of which the difference, its q′ and its q″ are 0.
    """
    change = d2 - spline.places(np.zeros(1)).d2q_ds2[0]
    length = rate**3 * np.abs(_BUMP).max() * float((np.abs(change) / jerk).max()) / _BUMP_SHARE
    length = float(np.clip(length, _LEAST_POINT_INTERVAL, 0.5 * spline.length))
    still, spans = np.zeros_like(change), np.append(np.full(3, length / 3), spline.length - length)
    third = np.append(_BUMP, 0.0)[:, None] / length * change
    second = change + _sums_before(spans[:, None] * third)
    second[-1] = 0.0
    difference = _through(still, still, second, third, spans)
    at = np.union1d(spline.times[:-1], difference.times[:-1])
    at = at[np.diff(at, append=spline.length) > _EQUAL_TIMES]
    parts = zip(spline.places(at), difference.places(at), strict=True)
    return cubics(np.append(at, spline.length), np.stack([one + other for one, other in parts], axis=1))


def _can_begin(curve: Motion, rate: float, limits: RateLimits) -> bool:
    """Return whether `proposed_velocity_limit` allows ṡ at the begin of a curve."""
    begin, most = curve.places(np.zeros(1)), limits.acceleration
    room = np.maximum(most - least_brake(limits) * np.abs(begin.dq_ds[0]), _ACCELERATION_SHARE * most)
    return bool((np.abs(begin.d2q_ds2[0]) * rate * rate <= room).all())


def _spline(q: FloatArray, velocity: FloatArray | None, times: FloatArray, points: FloatArray) -> Motion:
    """Return the cubic spline from `q` at 0 through points (K, n) at times (K,); q″ is 0 at ends without a velocity."""
    knots = np.append(0.0, times)
    powers = polynomials.cubic_spline(knots, np.vstack([q, points]), velocity)
    return cubics(knots, powers * np.array([1.0, 1.0, 2.0, 6.0])[:, None])


@dataclass(frozen=True)
class Velocity:
    """A constant joint velocity (n,) or twist of the tip (6,), for a duration [s]."""

    robot: Robot
    limits: RateLimits
    target: FloatArray
    held: float
    of_tip: bool = False
    start: float | None = None
    duration: float = np.inf

    def curves(self, begin: float, state: State, window: float) -> Iterator[Beginning]:
        """Yield the curve from a state on; see `Positions.curves`."""
        target = self.target
        if self.of_tip:
            jacobian = self.robot.tip_jacobian(state.q)
            damped = jacobian @ jacobian.T + _DAMPING**2 * np.eye(6)
            target = jacobian.T @ np.linalg.solve(damped, target)
        # The curve of a velocity that no joint can have is long, and has cells without end. A slower one in the same
        # direction leads the same way, and the robot follows neither faster than its limits.
        fastest = float((np.abs(target) / self.limits.velocity).max())
        target = target * (_FASTEST / max(fastest, _FASTEST))
        limits, still = self.limits, np.zeros_like(target)
        if limits.jerk is None:
            most = _ACCELERATION_SHARE * limits.acceleration
            up = float((np.abs(target - state.qd) / most).max())
            down = max(float((np.abs(target) / most).max()), _LEAST_POINT_INTERVAL)
            up = max(up, _LEAST_POINT_INTERVAL) if up > 0 else 0.0
            spans = np.array([up, self.held - up, down])
            changes = np.stack([target - state.qd, still, -target])
            kept = spans > 0
            second = changes[kept] / spans[kept, None]
            third, spans = np.zeros_like(second), spans[kept]
        else:
            first, last = _ramp(state.qd, state.qdd, target, limits), _ramp(target, still, still, limits)
            held = max(0.0, self.held - float(first.spans.sum()))
            hold = _Ramp(still[None], still[None], np.array([held]))
            ramps = [first, hold, last] if held > 0 else [first, last]
            second, third, spans = (np.concatenate(parts) for parts in zip(*ramps, strict=True))
        yield Beginning(_through(state.q, state.qd, second, third, spans), 1.0)


class _Ramp(NamedTuple):
    """A change of velocity: q″ at the begin of its pieces and their q‴, each (K, n), and their durations (K,) [s]."""

    second: FloatArray
    third: FloatArray
    spans: FloatArray


def _ramp(velocity: FloatArray, acceleration: FloatArray, target: FloatArray, limits: RateLimits) -> _Ramp:
    """Return the shortest change of velocities (n,), by Δ, within shares of jerk and acceleration.

    In the first half h of its time it has the jerk (Δ − 1.5 h q̈)/h², in the other −q̈/h less that.
    """
    assert limits.jerk is not None
    half = _RAMPS[:, None]
    change = target - velocity
    first = (change - 1.5 * half * acceleration) / half**2
    last = -acceleration / half - first
    slow = np.maximum(np.abs(first), np.abs(last)) <= _BUMP_SHARE * limits.jerk
    slow &= np.abs(acceleration + half * first) <= _ACCELERATION_SHARE * limits.acceleration
    k = int(slow.all(axis=1).argmax())
    second = np.stack([acceleration, acceleration + _RAMPS[k] * first[k]])
    return _Ramp(second, np.stack([first[k], last[k]]), np.full(2, _RAMPS[k]))
