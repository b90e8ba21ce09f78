"""Proposals of motions, as curves that begin where the robot is, and how fast the robot may follow a curve."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, InputError, finite_array, number, polynomials
from safe_ompl.live.replanning.bounded_path import BENDS, averaging_window
from safe_ompl.motions import BRAKING, Cells, Motion, RateLimits, State, bending_cap
from safe_ompl.robot import Robot

_SHARE = 0.5  # of the accelerations: what stops at full speed may take at least, and what velocities are approached by
_JUMP = 2.0  # times the velocity limit: what needs more from one position to the next is a jump
_BETWEEN = 0.05  # [s] between positions that are taken of a spline, at most
_DENSE = 0.01  # [s] of positions that are denser only some are taken
_AFTER = 0.5  # [s] Positions so long after the window shape the spline in it.
_OVER = 1e-3  # [s] with less than this left a proposal is over
_SHORTEST = 1e-3  # [s] of a change of velocity
_DAMPING = 0.05  # [m/rad] of the inverse of the Jacobian
_LEFT_OUT = (0, 2)  # of the next positions, where the robot cannot go through them in its direction
_AT_REST = 1e-9  # [rad/s]
# Velocities are proposed at most so many times as fast as the limits of the joints, as chunks of positions are.
_FASTEST = 2.0
# Cosine of the largest angle between how a robot moves and the way to the next position at which a curve may begin
# faster than the robot is. Such a curve leaves the straight way to that position by at most 4/27 of the sine times its
# length, 13 %.
_ALONG = 0.5
HARDEST = 100.0  # [1/s²] bound of the braking where the joints hardly move
_ROUNDED = 1e-9  # by which lines to brake on are longer than without rounding
_CUBIC = 3  # degree of the pieces of a curve
_EXACT = 0.02  # [s] between the ends of cubics that take the place of pieces of a higher degree
_CORNER = 1e-4  # [rad/s] a velocity that jumps by more is a corner
# With a limit of the jerk: what brings a q″ of 1 to 0 within a time of 1, each for a third of that, and leaves no
# velocity and no way; what share of the jerk that takes; and halves of the times that changes of velocity take [s].
_BUMP = (-5.5, 3.5, -1.0)
_BUMP_SHARE = 0.15
_RAMPS: FloatArray = np.geomspace(_SHORTEST, 10.0, 100)
_SAME = 1e-9  # [s]


class Piece(NamedTuple):
    """A cubic by q, q′, q″ and q‴ where it begins, (n,) each, and its length."""

    start: FloatArray
    slope: FloatArray
    bend: FloatArray
    swing: FloatArray
    length: float

    @property
    def powers(self) -> FloatArray:
        """Coefficients (4, n) of the powers of the share of its length, as a `Motion` has them."""
        t = self.length
        return np.array([self.start, t * self.slope, t * t / 2 * self.bend, t * t * t / 6 * self.swing])


Beginning: TypeAlias = tuple[list[Piece], float, float]  # of a curve, and ṡ and s̈ there


def curve_of(pieces: Sequence[Piece]) -> Motion:
    """Return the path along pieces, one after the other, by their lengths; nothing turns between them."""
    ends = np.cumsum([piece.length for piece in pieces])
    return Motion(np.append(0.0, ends), np.array([piece.powers for piece in pieces]), timed=False)


def least_brake(limits: RateLimits) -> float:
    """Return the braking along a curve [1/s²] that is kept free at full speed: a share of what stops any joint."""
    least = float(_SHARE * (limits.acceleration / limits.velocity).min())
    if limits.jerk is None:
        return least
    # Of what plans may brake with (`SmoothLimits`), where joints are as fast as they may be.
    bends = 3 * BRAKING * limits.acceleration
    of_plan = BRAKING * (1 - BENDS) * limits.jerk / (limits.velocity / averaging_window(limits) + bends)
    return min(least, float(of_plan.min()))


def proposed_cap(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ ≤ 1 (N,) at which the accelerations leave enough for a stop within the window.

    It is |q″|ṡ² ≤ a − b|q′|, b the least braking, or |q″|ṡ² ≤ a/2, whichever allows more: with the latter a/2|q′| is
    left, and that is no less than b where no joint is faster than its limit.
    """
    room = limits.acceleration - least_brake(limits) * cells.slopes
    squares = np.divide(room, cells.bends, out=np.full_like(room, np.inf), where=cells.bends > 0)
    fastest = np.sqrt(np.maximum(squares.min(axis=1), 0.0))
    return np.asarray(np.minimum(1.0, np.maximum(fastest, bending_cap(cells, limits))))


@dataclass(frozen=True)
class Positions:
    """Positions (K, n) at times (K,) from its start on [s]; the start is None if it begins with the next command."""

    robot: Robot
    limits: RateLimits
    times: FloatArray
    positions: FloatArray
    start: float | None

    @classmethod
    def of(cls, motion: Any, rate: float | None, start: float | None, robot: Robot, limits: RateLimits) -> Positions:
        """Return those of a chunk or a motion; see `Shield.propose`."""
        if start is not None:
            start = number("start", start)
        if rate is not None:
            positions = finite_array(motion, (None, robot.n), "chunk")
            if len(positions) < 2:
                raise InputError(f"must have two positions at least, got {len(positions)}", "chunk")
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
        """How long it takes [s]."""
        return float(self.times[-1])

    def own_curve(self, motion: Motion) -> Motion:
        """Return the curve of the motion that these are positions of, from its start at rest on; corners are stops.

        Cubics are exact; of higher degrees the curve has positions and velocities every 0.02 s. Lines have no
        velocities: the curve is the spline through the positions, as where the jerk is limited.
        """
        motion = motion.for_robot(self.robot)
        if motion.degree <= 1 or self.limits.jerk is not None:
            still = np.zeros(motion.n)
            pieces, *_ = next(self.curves(0.0, State(self.positions[0], still, still), np.inf))
            return curve_of(pieces)
        if motion.degree > _CUBIC:
            counts = np.ceil(np.diff(motion.times) / _EXACT).astype(int).tolist()
            motion = motion.cut({k: np.arange(1, m) / m for k, m in enumerate(counts) if m > 1})
        powers = motion.coefficients
        begins, slopes = powers[:, 0], powers[:, 1]
        ways, after = powers.sum(axis=1) - begins, (powers * np.arange(motion.degree + 1)[:, None]).sum(axis=1)
        cubics = np.stack([begins, slopes, 3 * ways - 2 * slopes - after, slopes + after - 2 * ways], axis=1)
        spans = np.diff(motion.times)[:, None]
        jumps = np.abs(after[:-1] / spans[:-1] - slopes[1:] / spans[1:]).max(axis=1)
        corners = tuple((1 + np.flatnonzero(jumps > _CORNER)).tolist())
        return Motion(motion.times - motion.times[0], cubics, motion.joint_names, timed=False, corners=corners)

    def curves(self, begin: float, state: State, window: float) -> Iterator[Beginning]:
        """Yield curves from a state at `begin` of it on, with ṡ and s̈ where they begin, the nearest to it first.

        They are right for a window [s] at least. A negative `begin` is before its start.

        With ṡ = 1 it is in time, if the accelerations suffice. Otherwise, where the robot moves about as proposed, the
        curve begins as fast as proposed, in the direction in which the robot moves, and ṡ is as much less as the robot
        is slower. A robot that moves in another direction must brake: such a curve would swing out in that direction as
        far as proposed speeds take it, and would let the robot accelerate there. Where a curve bends too much, two
        positions are left out. The last curve is a line on which the robot brakes as hard as it may. A line cannot
        begin with any acceleration, so where the jerk is limited the robot follows the stop of its last command.

        With a limit of the jerk the curve begins with the robot's acceleration, too: at first it leaves the spline a
        little, and where the robot is slower than proposed s̈ has a part in it.
        """
        if self.duration - begin < _OVER:
            raise InputError(f"is too late: it was over {begin - self.duration:.3g} s ago", "proposal")
        first = int(np.searchsorted(self.times, begin, side="right"))
        spacing = float(np.diff(self.times)[max(first - 1, 0)])
        if first + 1 < len(self.times) and self.times[first] - begin < 0.5 * spacing:
            first += 1  # the next position is very near
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
            paces = [1.0]
            if speed < _AT_REST:
                paces.append(0.0)
            elif speed < fast and state.qd @ step >= _ALONG * speed * np.linalg.norm(step):
                paces.append(speed / fast)
            for pace in paces:
                slope = state.qd / pace if pace else None
                pieces = _spline(state.q, slope, at, through)
                for push in _pushes(state, pace, self.limits):
                    if slope is not None and self.limits.jerk is not None:
                        bend = (state.qdd - push * slope) / (pace * pace)
                        pieces = _bent(pieces, bend, pace, self.limits.jerk)
                    if _can_begin(pieces[0], pace, self.limits):
                        yield pieces, pace, push
        if speed >= _AT_REST and self.limits.jerk is None:
            hardest = min(HARDEST, float((self.limits.acceleration[moves] / np.abs(state.qd[moves])).min()))
            straight = Piece(state.q, state.qd, 0 * state.q, 0 * state.q, (1 + _ROUNDED) / (2 * hardest))
            if straight.length < self.duration - begin:
                yield [straight], 1.0, 0.0


def _pushes(state: State, pace: float, limits: RateLimits) -> list[float]:
    """Return the s̈ with which a curve may begin at ṡ = pace: what the robot has in its direction, and 0."""
    if limits.jerk is None:
        return [0.0]
    if pace == 0.0:
        return [0.0] if np.abs(state.qdd).max() < _AT_REST else []
    if pace == 1.0:
        return [0.0]
    most = 2 * pace / averaging_window(limits)  # that its plan moves forward
    along = float(state.qdd @ state.qd / (state.qd @ state.qd)) * pace
    return [float(np.clip(along, -most, most)), 0.0]


def _bent(pieces: list[Piece], bend: FloatArray, pace: float, jerk: FloatArray) -> list[Piece]:
    """Return a spline that begins with another q″, and so is elsewhere for a while, as the jerk (n,) allows.

    The difference has three pieces of constant q‴, at the end of which it, its q′ and its q″ are 0.
    """
    spline, still = curve_of(pieces), np.zeros_like(bend)
    change = bend - pieces[0].bend
    length = pace**3 * max(map(abs, _BUMP)) * float((np.abs(change) / jerk).max()) / _BUMP_SHARE
    length = float(np.clip(length, _SHORTEST, 0.5 * spline.length))
    q, slope, rest, bump = still, still, change, list[Piece]()
    for swing in _BUMP:
        bump.append(Piece(q, slope, rest, swing / length * change, length / len(_BUMP)))
        q, slope, rest = _end(bump)
    difference = curve_of([*bump, Piece(still, still, still, still, spline.length - length)])
    at = np.union1d(spline.times[:-1], difference.times[:-1])
    at = at[np.diff(at, append=spline.length) > _SAME]
    rows = (one + other for one, other in zip(spline.places(at), difference.places(at), strict=True))
    return [Piece(*row) for row in zip(*rows, np.diff(at, append=spline.length).tolist(), strict=True)]


def _can_begin(piece: Piece, pace: float, limits: RateLimits) -> bool:
    """Return whether `proposed_cap` allows a ṡ where a piece begins."""
    most = limits.acceleration
    room = np.maximum(most - least_brake(limits) * np.abs(piece.slope), _SHARE * most)
    return bool((np.abs(piece.bend) * pace * pace <= room).all())


def _spline(q: FloatArray, slope: FloatArray | None, times: FloatArray, points: FloatArray) -> list[Piece]:
    """Return the cubic spline from `q` at 0 through points (K, n) at times (K,); q″ is 0 at ends without a slope."""
    knots = np.append(0.0, times)
    powers = polynomials.cubic_spline(knots, np.vstack([q, points]), slope) * np.array([1.0, 1.0, 2.0, 6.0])[:, None]
    return [Piece(*row) for row in zip(*np.swapaxes(powers, 0, 1), np.diff(knots).tolist(), strict=True)]


@dataclass(frozen=True)
class Velocity:
    """A velocity of the joints (n,), or a twist of the tip (6,), held for some time [s]."""

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
        # direction leads the same way, and the robot drives neither faster than its limits.
        fastest = float((np.abs(target) / self.limits.velocity).max())
        target = target * (_FASTEST / max(fastest, _FASTEST))
        limits, still = self.limits, np.zeros_like(target)
        if limits.jerk is None:
            pushes = _SHARE * limits.acceleration
            up = float((np.abs(target - state.qd) / pushes).max())
            down = max(float((np.abs(target) / pushes).max()), _SHORTEST)
            up = max(up, _SHORTEST) if up > 0 else 0.0
            q, pieces = state.q, []
            for slope, last, span in ((state.qd, target, up), (target, target, self.held - up), (target, still, down)):
                if span > 0:
                    pieces.append(Piece(q, slope, (last - slope) / span, still, span))
                    q = q + span * (slope + last) / 2
        else:
            pieces = _ramp(state, target, limits)
            up = sum(piece.length for piece in pieces)
            if up < self.held:
                pieces.append(Piece(_end(pieces).q, target, still, still, self.held - up))
            pieces += _ramp(_end(pieces), still, limits)
        yield pieces, 1.0, 0.0


def _ramp(state: State, target: FloatArray, limits: RateLimits) -> list[Piece]:
    """Return the shortest change to a velocity (n,), by Δ, within shares of jerk and acceleration.

    In the first half h of its time it has the jerk (Δ − 1.5 h q̈)/h², in the other −q̈/h less that.
    """
    assert limits.jerk is not None
    half = _RAMPS[:, None]
    change = target - state.qd
    first = (change - 1.5 * half * state.qdd) / half**2
    second = -state.qdd / half - first
    slow = np.maximum(np.abs(first), np.abs(second)) <= _BUMP_SHARE * limits.jerk
    slow &= np.abs(state.qdd + half * first) <= _SHARE * limits.acceleration
    k = int(slow.all(axis=1).argmax())
    one = Piece(state.q, state.qd, state.qdd, first[k], float(_RAMPS[k]))
    return [one, Piece(*_end([one]), second[k], one.length)]


def _end(pieces: list[Piece]) -> State:
    """Return where pieces end: q, q′ and q″."""
    q, rate, bend, swing, t = pieces[-1]
    return State(q + t * (rate + t * (bend / 2 + t * swing / 6)), rate + t * (bend + t * swing / 2), bend + t * swing)
