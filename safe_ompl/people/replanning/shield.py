"""The shield: whatever proposes motions, what is driven is proven at every tick, with its stop on the proposed path.

A proposal becomes a curve q(s) whose parameter s is the proposed time. It begins in the robot's present position and
velocity, q(0) = q and q′(0)·ṡ = q̇: positions are joined by the cubic spline through them, with continuous
accelerations; a velocity is approached, held and left with half of the joints' accelerations. The robot follows the
curve with ṡ ≤ 1: never faster than proposed, and at ṡ = 1 in the proposed timing.

What is executed is always the motion until the next tick and a stop on the same curve, both proven:

* The curve is proven free of what stands still piece by piece (`CertifiedMotion.check_curve`), in a window that holds
  every stop, and it is cut where the proof ends. ṡ is 0 there, so that no motion leaves what is proven.
* In each cell of the curve |q′|b + |q″|ṡ² is within the accelerations, with b the braking along the curve. ṡ is below
  1 where else less than the window would be left for a stop: accelerations that are too large cost time, not proof.
* Motion and stop are held against everybody who moves as in the `Replanner`, by the same code.

If a proposal cannot be used, or no motion on it is proven, the robot follows the stop of the command before. Its proof
covers all that people may do until the robot stands, and does not depend on the proposal.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CertifiedMotion, MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, SafeOmplError, finite_array, number
from safe_ompl.motions import Motion
from safe_ompl.people import Tracker, Violation
from safe_ompl.people.replanning.guarded_path import Command, Doing, GuardedPath, PathLimits
from safe_ompl.people.replanning.replanner import Guard, ReplanningOptions
from safe_ompl.planning.ompl import joint_space
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories import BlendedCurve, Cells, Piece, RateLimits, State, bending_cap

_log = logging.getLogger(__name__)

_CELL = 0.02  # [s] largest cell of a curve
_SHARE = 0.5  # of the accelerations: what stops at full speed may take at least, and what velocities are approached by
_HARDEST = 100.0  # [1/s²] bound of the braking where the joints hardly move
_JUMP = 2.0  # times the velocity limit: what needs more from one position to the next is a jump
_BETWEEN = 0.05  # [s] between positions that are taken of a spline, at most
_AFTER = 0.5  # [s] Positions so long after the window shape the spline in it.
_OVER = 1e-3  # [s] with less than this left a proposal is over
_SHORTEST = 1e-3  # [s] of a change of velocity
_CUTS = 4  # halvings of a piece that is not proven
_DAMPING = 0.05  # [m/rad] of the inverse of the Jacobian
_LEFT_OUT = (0, 2)  # of the next positions, where the robot cannot go through them in its direction
_AT_REST = 1e-9  # [rad/s]
_SAME = 1e-6  # [s]


@dataclass(frozen=True)
class ShieldCommand(Command):
    """A `Command`, and what the shield changed of the proposal; `reason` says why.

    Attributes
    ----------
    follows : bool
        Whether it follows the newest proposal. If not it is the rest of an earlier stop, or the robot stands.
    delay : float
        How far the robot will be behind the timing of the newest proposal when the tick is over [s].
    """

    follows: bool = True
    delay: float = 0.0


class Shield:
    """Lets a robot follow what a policy, a teleoperator or another planner proposes, as far as that is proven.

    At every tick: `update` with what sensors saw, one of `propose`, `propose_velocity` and `propose_twist`, and
    `command`. The robot stays on the proposed path and is as near to the proposed timing as limits and proofs allow.
    Without a new proposal it goes on with the last one. Without a new command it ends in the stop of the last one.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        What is around it. Obstacles that are named in `trackers` or `objects` move; the others stand still.
    trackers : mapping of str to Tracker
        The people that are tracked, and how.
    objects : mapping of str to float, optional
        Obstacles of the scene that move, and bounds of their speeds [m/s].
    people : People, optional
        How fast limbs may move, and the clearance that must be left; as for the `Replanner`.
    options : ReplanningOptions, optional
        Reach model, time between commands, when somebody is lost.
    limits : PathLimits, optional
        Of joints, tool and links. Default: those of the robot's joints.
    motion : CertifiedMotion, optional
        Proves motions among still obstacles, as for the `Replanner`. If it has a tube (`Separation.tube`), all that is
        said holds for every robot whose joints are that near to the command at any time, beside people, too.

    Raises
    ------
    UnknownNameError
        If the scene has no obstacle of a name in `objects`.
    InputError
        If a number is out of its range; if the motion is of another robot or of another scene; if the speed of tool or
        links is limited within a tube, which bounds positions only.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        trackers: Mapping[str, Tracker],
        objects: Mapping[str, float] | None = None,
        *,
        people: People | None = None,
        options: ReplanningOptions | None = None,
        limits: PathLimits | None = None,
        motion: CertifiedMotion | None = None,
    ) -> None:
        options = ReplanningOptions() if options is None else options
        self._guard = guard = Guard(robot, scene, trackers, objects, people, options, motion)
        self.robot, self.tick, self.motion = robot, guard.tick, guard.motion
        self.surroundings = guard.surroundings
        self.limits = PathLimits(RateLimits.of(robot)) if limits is None else limits
        if self.motion.separation.tube and (self.limits.tool_speed or self.limits.link_speed):
            raise InputError("bounds positions: speeds of tool and links cannot be proven within it", "tube")
        self._window = self.tick + 0.5 / _least_brake(self.limits.joints) + 2 * _CELL
        self._rest: GuardedPath | None = None
        self._proposal: _Positions | _Velocity | None = None
        self._refused = "nothing was proposed"
        self._way: _Way | None = None  # that the last command follows
        self._clock = self._begin = (
            np.nan
        )  # when the newest proposal began [s], and where in it the robot joins

    def __repr__(self) -> str:
        return f"Shield({self.robot.name!r}, {self.surroundings!r}, tick={self.tick:g})"

    # ----------------------------------------------------------------------------------------------- what is called

    def start(self, q: ArrayLike) -> None:
        """Take where the robot stands (n,) [rad or m]; what was proposed before is forgotten.

        Raises
        ------
        InputError
            If the robot moves, or `q` is no configuration within the joint limits.
        """
        last = self._guard.last
        if last is not None and last.doing not in (Doing.DONE, Doing.STANDING):
            raise InputError("the robot still moves: start when it stands or is done")
        here = self.robot.configuration(q)
        for i in np.flatnonzero(~self.robot.within_limits(here)):
            raise InputError(
                f"joint {self.robot.joint_names[i]!r} = {here[i]:g} is outside its limits", "start"
            )
        still = np.zeros(self.robot.n)
        self._rest = self._path([Piece(here, still, still, still, 1.0)])
        self._guard.last, self._way = None, None
        self._proposal, self._refused = None, "nothing was proposed"

    def update(
        self, people: Mapping[str, ArrayLike | None], objects: Mapping[str, Any], time: float
    ) -> list[Violation]:
        """Take what sensors saw, and return who moved farther than promised; see `Replanner.update`."""
        return self._guard.update(people, objects, time)

    def propose(self, motion: Any, rate: float | None = None, start: float | None = None) -> bool:
        """Propose a chunk of positions, or a spline; return whether it can be used.

        If not, the robot follows its stop, and the next commands and the log say why. The chunk must not jump: no joint
        may need more than twice its velocity limit from one position to the next.

        Parameters
        ----------
        motion : array_like of shape (K, n), Motion, or what `Motion.of` takes
            A chunk of positions [rad or m], position k at k / rate; or a spline in time, of which the positions at its
            knots are taken, and between them at every 0.05 s.
        rate : float, optional
            Of the chunk [Hz]; without it `motion` must be a motion in time.
        start : float, optional
            When it begins [s]; what is past by the next command is left out. Default: then.
        """
        return self._take(lambda: _Positions.of(motion, rate, start, self.robot, self.limits.joints))

    def propose_velocity(self, velocity: ArrayLike) -> bool:
        """Propose a velocity of the joints (n,) [rad/s or m/s], held until the next tick; returns as `propose`.

        Joints approach it with half of their accelerations. If no other proposal comes the robot stops.
        """
        return self._take(lambda: _Velocity(finite_array(velocity, (self.robot.n,), "velocity"), self.tick))

    def propose_twist(self, twist: ArrayLike) -> bool:
        """Propose a twist of the tip, as `propose_velocity`.

        Parameters
        ----------
        twist : array_like, shape (6,)
            Linear velocity [m/s], then angular velocity [rad/s], in world-aligned axes.

        Notes
        -----
        The joints get q̇ = Jᵀ(JJᵀ + λ²)⁻¹v with λ = 0.05: near a singularity the tip is slower than v, and q̇ stays
        below ‖v‖/2λ. Where a joint would be too fast the robot is slower in the same direction.
        """
        return self._take(lambda: _Velocity(finite_array(twist, (6,), "twist"), self.tick, of_tip=True))

    def command(self, time: float) -> ShieldCommand:
        """Return what the robot does from a time [s] on.

        Raises
        ------
        InputError
            If `start` was not called, or the time is before the last command or the last measurement.
        """
        if self._rest is None:
            raise InputError("start where the robot stands first")
        guard, last = self._guard, self._guard.last
        s, speed = guard.place(time)
        path = self._rest if last is None else last.path
        found, why, progress = None, self._refused, 0.0
        if self._proposal is not None:
            way, s0, speed0, why = self._next_way(time, s, speed)
            progress = self._begin
            if way is not None:
                found = guard.next(way.path, s0, speed0, time)
                if found is not None:
                    self._way = way
                    progress = way.begin + found.motion.at(self.tick)[0]
                    found = _explained(found, way, s0, self.tick)
        follows = found is not None
        if found is None:
            found = guard.kept(path, s, speed, time)
            found = replace(found, reason=why) if why else found
        delay = 0.0
        if not follows and isinstance(self._proposal, _Velocity):  # whoever gives velocities gives a new one
            self._proposal, self._refused = None, "no new velocity was proposed"
        if self._proposal is not None:
            delay = max(0.0, min(time + self.tick - self._clock, self._proposal.duration) - progress)
        return guard.given(ShieldCommand(**vars(found), follows=follows, delay=delay), time)

    # ------------------------------------------------------------------------------------------------------- ways

    def _take(self, make: Callable[[], _Positions | _Velocity]) -> bool:
        """Keep a proposal as the newest one, or the reason why it is none."""
        self._proposal, self._clock = None, np.nan
        try:
            self._proposal, self._refused = make(), ""
        except SafeOmplError as error:
            self._refused = str(error)
            _log.warning("the proposal is refused: %s", error)
        return self._proposal is not None

    def _next_way(self, time: float, s: float, speed: float) -> tuple[_Way | None, float, float, str]:
        """Return on which way the robot goes on, from which s and ṡ on; if there is none, why."""
        proposal, way, last = self._proposal, self._way, self._guard.last
        assert proposal is not None
        assert self._rest is not None
        if np.isnan(self._clock):
            self._clock = time if proposal.start is None else proposal.start
            self._begin = max(0.0, time - self._clock)
        begin = self._begin
        if way is not None and way.proposal is proposal:
            if way.whole or way.blocked or s + self._window <= way.path.length:
                return way, s, speed, ""
            begin = way.begin + s
        else:
            way = None
        q = self._rest.curve.pieces[0].start
        state = State(q, np.zeros_like(q), np.zeros_like(q)) if last is None else last.at(time)
        why = "its joints would have to accelerate too much to join it"
        try:
            for pieces, pace in proposal.curves(begin, state, self):
                joined, blocked = self._joined(proposal, pieces, begin, pace)
                if joined is not None:
                    return joined, 0.0, pace, ""
                why = blocked or why
        except InputError as error:
            why = str(error)
        return way, s, speed, why

    def _joined(
        self, proposal: _Positions | _Velocity, pieces: list[Piece], begin: float, pace: float
    ) -> tuple[_Way | None, str]:
        """Return the way along pieces as far as they are proven; none if the robot cannot join it, and perhaps why."""
        ends = np.cumsum([piece.length for piece in pieces])
        length = float(ends[-1]) if isinstance(proposal, _Velocity) else min(float(ends[-1]), self._window)
        whole = begin + length >= proposal.duration - _SAME or isinstance(proposal, _Velocity)
        proven: list[Piece] = []
        blocked = ""
        for piece, end in zip(pieces, ends.tolist(), strict=True):
            piece = piece._replace(length=piece.length - max(0.0, end - length))
            if piece.length <= 0:
                break
            verdict = self._verdict(piece)
            if verdict.verdict is not Verdict.FREE:
                blocked = _blocked(verdict, begin + end)
                for _ in range(_CUTS):
                    piece = piece._replace(length=0.5 * piece.length)
                    if self._verdict(piece).verdict is Verdict.FREE:
                        proven.append(piece)
                        break
                break
            proven.append(piece)
        if not proven:
            return None, blocked
        path = self._path(proven)
        if path.ceiling[0] < pace * pace * (1 - 1e-9):
            return None, ""
        return _Way(proposal, path, begin, whole and not blocked, blocked), ""

    def _verdict(self, piece: Piece) -> MotionVerdict:
        """Return the verdict on a piece among what stands still."""
        t = piece.length
        powers = np.array([piece.start, t * piece.slope, t * t / 2 * piece.bend, t * t * t / 6 * piece.swing])
        return self.motion.check_curve(powers)

    def _path(self, pieces: list[Piece]) -> GuardedPath:
        curve = BlendedCurve(pieces, [])
        path = GuardedPath.along(self._guard.bodies, curve, self.limits, _CELL, proposed_cap)
        return replace(path, brakes=np.minimum(path.brakes, _HARDEST))


class _Way(NamedTuple):
    """A path along a proposal."""

    proposal: _Positions | _Velocity
    path: GuardedPath
    begin: float  # where in the proposal it begins [s]
    whole: bool  # whether it reaches the end of the proposal
    blocked: str  # what stands still in its way, if anything


def _explained(command: Command, way: _Way, s: float, tick: float) -> Command:
    """Return a command on a way with the reason why it is slower than proposed, if nobody who moves is that."""
    if command.reason:
        return command
    if command.doing is Doing.DONE:
        return replace(command, doing=Doing.STANDING, reason=way.blocked) if way.blocked else command
    if way.blocked and command.motion.places[-1] >= way.path.length - _SAME:
        return replace(command, doing=Doing.SLOWED, reason=way.blocked)
    in_time = min(s + tick, way.path.length) if way.whole else s + tick
    if command.motion.at(tick)[0] < in_time - _SAME:
        why = "limits of the joints, or the stop at the end of the proposal"
        return replace(command, doing=Doing.SLOWED, reason=why)
    return command


def _blocked(verdict: MotionVerdict, before: float) -> str:
    """Say what stands still in the way."""
    first, second = verdict.pair or ("nothing", "proven free")
    what = f"joint {first!r} leaves its limits" if second == "its limits" else f"{first} and {second}"
    return f"not free of what stands still before {before:.2f} s: {what}"


def _least_brake(limits: RateLimits) -> float:
    """Return the braking along a curve [1/s²] that is kept free at full speed: a share of what stops any joint."""
    return float(_SHARE * (limits.acceleration / limits.velocity).min())


def proposed_cap(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ ≤ 1 (N,) at which the accelerations leave enough for a stop within the window.

    It is |q″|ṡ² ≤ a − b|q′|, b the least braking, or |q″|ṡ² ≤ a/2, whichever allows more: with the latter a/2|q′| is
    left, and that is no less than b where no joint is faster than its limit.
    """
    room = limits.acceleration - _least_brake(limits) * cells.slopes
    squares = np.divide(room, cells.bends, out=np.full_like(room, np.inf), where=cells.bends > 0)
    fastest = np.sqrt(np.maximum(squares.min(axis=1), 0.0))
    found: FloatArray = np.minimum(1.0, np.maximum(fastest, bending_cap(cells, limits)))
    return found


# -------------------------------------------------------------------------------------------------- proposals


@dataclass(frozen=True)
class _Positions:
    """Positions (K, n) at times (K,) from its start on [s]; the start is None if it begins with the next command."""

    times: FloatArray
    positions: FloatArray
    start: float | None
    limits: RateLimits

    @classmethod
    def of(
        cls, motion: Any, rate: float | None, start: float | None, robot: Robot, limits: RateLimits
    ) -> _Positions:
        if start is not None:
            start = number("start", start)
        if rate is not None:
            positions = finite_array(motion, (None, robot.n), "chunk")
            if len(positions) < 2:
                raise InputError(f"must have two positions at least, got {len(positions)}", "chunk")
            times = np.arange(float(len(positions))) / number("rate", rate, above=0.0)
        else:
            given = Motion.of(motion, space=joint_space(robot)).for_robot(robot)
            if not given.timed:
                raise InputError("has no times: give the rate of a chunk", "motion")
            parts = [
                np.linspace(a, b, int(np.ceil((b - a) / _BETWEEN)), endpoint=False)
                for a, b in zip(given.times[:-1].tolist(), given.times[1:].tolist(), strict=True)
            ]
            at = np.append(np.concatenate(parts), given.times[-1])
            times, positions = at - at[0], given.at(at)
        found = cls(times, positions, start, limits)
        for k, step in enumerate(robot.difference(positions[:-1], positions[1:])):
            found.check_jump(step, float(times[k + 1] - times[k]), f"at {times[k]:.3g} s of it")
        return found

    def check_jump(self, step: FloatArray, span: float, where: str) -> None:
        """Raise InputError if joints cannot move by a step (n,) in a time [s]."""
        for i in np.flatnonzero(np.abs(step) > _JUMP * self.limits.velocity * span):
            raise InputError(
                f"jumps {where}: joint {self.limits.joint_names[i]!r} by {step[i]:.3g} within {span:.3g} s",
                "proposal",
            )

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    def curves(self, begin: float, state: State, shield: Shield) -> Iterator[tuple[list[Piece], float]]:
        """Yield curves from a state at `begin` of it on, and the ṡ with which they begin, the nearest to it first.

        With ṡ = 1 it is in time, if the accelerations suffice. Otherwise the curve begins as fast as proposed, in the
        direction in which the robot moves, and ṡ is as much less as the robot is slower. Where that bends too much, two
        positions are left out.
        """
        if self.duration - begin < _OVER:
            raise InputError(f"is too late: it was over {begin - self.duration:.3g} s ago", "proposal")
        first = int(np.searchsorted(self.times, begin, side="right"))
        if first + 1 < len(self.times):  # not the next position if that is very near
            first += bool(self.times[first] - begin < 0.5 * (self.times[first] - self.times[first - 1]))
        last = int(np.searchsorted(self.times, begin + shield._window + _AFTER)) + 1
        times = self.times[first:last] - begin
        given, robot = self.positions[first:last], shield.robot
        steps = [robot.difference(state.q, given[0])[None], robot.difference(given[:-1], given[1:])]
        points = state.q + np.cumsum(np.concatenate(steps), axis=0)
        self.check_jump(points[0] - state.q, float(times[0]), "from where the robot is")
        speed = float(np.linalg.norm(state.qd))
        for left_out in _LEFT_OUT:
            at, through = times[left_out:], points[left_out:]
            if not len(at):
                return
            fast = float(np.linalg.norm(through[0] - state.q) / at[0])
            for pace in dict.fromkeys((1.0, 0.0 if speed < _AT_REST else speed / max(fast, speed))):
                pieces = _spline(state.q, state.qd / pace if pace else None, at, through)
                if _can_begin(pieces[0], pace, self.limits):
                    yield pieces, pace


def _can_begin(piece: Piece, pace: float, limits: RateLimits) -> bool:
    """Return whether `proposed_cap` allows a ṡ where a piece begins."""
    most = limits.acceleration
    room = np.maximum(most - _least_brake(limits) * np.abs(piece.slope), _SHARE * most)
    return bool((np.abs(piece.bend) * pace * pace <= room).all())


def _spline(q: FloatArray, slope: FloatArray | None, times: FloatArray, points: FloatArray) -> list[Piece]:
    """Return the cubic spline from `q` at 0 through points (K, n) at times (K,); q″ is 0 at ends without a slope."""
    spans = np.diff(times, prepend=0.0)
    knots = np.vstack([q, points])
    chords = np.diff(knots, axis=0) / spans[:, None]
    count = len(knots)
    matrix, right = np.eye(count), np.zeros_like(knots)
    inner = np.arange(1, count - 1)
    matrix[inner, inner - 1], matrix[inner, inner + 1] = spans[:-1], spans[1:]
    matrix[inner, inner] = 2 * (spans[:-1] + spans[1:])
    right[inner] = 6 * np.diff(chords, axis=0)
    if slope is not None:
        matrix[0, :2] = 2 * spans[0], spans[0]
        right[0] = 6 * (chords[0] - slope)
    bends = np.linalg.solve(matrix, right)
    slopes = chords - spans[:, None] * (2 * bends[:-1] + bends[1:]) / 6
    if slope is not None:
        slopes[0] = slope  # exactly
    swings = np.diff(bends, axis=0) / spans[:, None]
    parts = zip(knots[:-1], slopes, bends[:-1], swings, spans.tolist(), strict=True)
    return [Piece(*part) for part in parts]


@dataclass(frozen=True)
class _Velocity:
    """A velocity of the joints (n,), or a twist of the tip (6,), held for some time [s]."""

    target: FloatArray
    held: float
    of_tip: bool = False
    start: float | None = None
    duration: float = np.inf

    def curves(self, begin: float, state: State, shield: Shield) -> Iterator[tuple[list[Piece], float]]:
        """Yield the curve from a state on; see `_Positions.curves`."""
        target = self.target
        if self.of_tip:
            jacobian = shield.robot.tip_jacobian(state.q)
            damped = jacobian @ jacobian.T + _DAMPING**2 * np.eye(6)
            target = jacobian.T @ np.linalg.solve(damped, target)
        pushes = _SHARE * shield.limits.joints.acceleration
        up = float((np.abs(target - state.qd) / pushes).max())
        down = max(float((np.abs(target) / pushes).max()), _SHORTEST)
        up = max(up, _SHORTEST) if up > 0 else 0.0
        still, q, pieces = np.zeros_like(target), state.q, []
        for slope, last, span in (
            (state.qd, target, up),
            (target, target, self.held - up),
            (target, still, down),
        ):
            if span > 0:
                pieces.append(Piece(q, slope, (last - slope) / span, still, span))
                q = q + span * (slope + last) / 2
        yield pieces, 1.0
