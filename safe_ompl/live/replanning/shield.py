"""The shield, a safety filter: the robot follows proposed motions as far as they are proven.

A proposal becomes a curve q(s) whose parameter s is the proposed time. The curve begins in the robot's present position
and velocity: q(0) = q and q′(0)·ṡ = q̇. Proposed positions are joined by a cubic spline with continuous accelerations.
A proposed velocity is approached, held and left with half of the joints' acceleration limits. The robot follows the
curve with ṡ ≤ 1, so never faster than proposed; ṡ = 1 is the proposed timing.

The robot always executes the motion until the next tick and then a stop on the same curve. Both are proven:

* The curve is proven free of still obstacles piece by piece (`MotionProver.check_curve`), in a window that contains
  every stop. The curve is cut where the proof ends. ṡ is 0 there, so every motion stays on the proven part.
* In each cell of the curve |q′|b + |q″|ṡ² is within the acceleration limits; b is the braking along the curve. If a
  stop from ṡ = 1 would leave the window, ṡ is below 1, and a proposal with too large accelerations is followed late.
* Motion and stop keep the margin to all moving people and objects as in the `Replanner`, by the same code.

If a proposal is invalid, or no motion on it is proven, the robot follows the stop of the previous command. The proof of
this stop covers all motions of people until the robot stands, and does not depend on the proposal.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, SafeOmplError, finite_array
from safe_ompl.live import ReachSets
from safe_ompl.live.replanning.bounded_path import Around, BoundedPath, SpeedLimits, averaging_window
from safe_ompl.live.replanning.commands import Action, Command, CommandProver
from safe_ompl.live.replanning.proposals import HARDEST, Positions, Velocity, least_brake, proposed_velocity_limit
from safe_ompl.motions import Motion, RateLimits, State

_log = logging.getLogger(__name__)

# The largest cell of a curve.
_CELL = 0.02  # [s]
# ṡ may grow by this much in a tick in which people slow the robot down.
_FASTER = 0.1
# A piece that is not proven is halved at most this often.
_CUTS = 4
_EQUAL_POSITIONS = 1e-6  # [s]
_JOINED = 1e-6  # [rad or m]
# The transition to the beginning of a motion takes at least this long.
_OVER = 0.2  # [s]
_NO_PROPOSAL = "nothing was proposed"


@dataclass(frozen=True)
class ShieldCommand(Command):
    """A `Command` with its difference from the proposal; `reason` explains the difference."""

    # Whether the robot follows the newest proposal. Otherwise it follows an earlier stop, or stands.
    follows: bool = True
    # The delay of the robot at the end of the tick, relative to the timing of the newest proposal [s].
    delay: float = 0.0


class Shield(CommandProver):
    """Makes a robot follow proposals of a policy, a teleoperator or another planner as far as they are proven.

    At every tick call `update` with the measurements, one of `propose`, `propose_velocity` and `propose_twist`, and
    `command`. The robot stays on the proposed path and as near to the proposed timing as limits and proofs allow.
    Without a new proposal the robot continues the last one. Without a new command it follows the last command to its
    stop.

    Parameters are those of `CommandProver`.

    Examples
    --------
    >>> from safe_ompl.live import find_skeleton
    >>> robot = Robot.from_example("panda").with_accelerations({f"panda_joint{k}": 10.0 for k in range(1, 8)})
    >>> around = Surroundings(Scene(), {"anna": Tracker(find_skeleton("coco17"))}, people=People(speed=1.6))
    >>> shield = Shield(robot, around)
    >>> shield.start([0, 0, 0, -2.0, 0, 2.2, 0.785])
    >>> late = shield.update({"anna": [[3.0, 0.0, 1.0]] * 17}, {}, 0.0)
    >>> shield.propose_velocity([0.2, 0, 0, 0, 0, 0, 0])
    True
    >>> shield.command(0.02).follows
    True
    """

    _rest: BoundedPath | None = None
    _proposal: Positions | Velocity | None = None
    _refused = _NO_PROPOSAL
    # The path along a proposal that the last command follows.
    _way: _Way | None = None
    # The time at which the newest proposal began [s], NaN until its first command; and the time in the proposal at
    # which the robot joins it [s].
    _clock = _begin = np.nan

    @cached_property
    def limits(self) -> SpeedLimits:
        """Limits of the speeds of joints, tool and links."""
        given = self.options.limits
        return SpeedLimits(RateLimits.of(self.robot)) if given is None else given

    @cached_property
    def _window(self) -> float:
        """Duration of the part of a proposal that is proven in one tick [s]: a tick and the longest stop."""
        joints = self.limits.joints
        return self.tick + averaging_window(joints) + 0.5 / least_brake(joints) + 2 * _CELL

    # ----------------------------------------------------------------------------------------------- what is called

    def start(self, q: ArrayLike) -> None:
        """Set the configuration (n,) at which the robot stands [rad or m]; earlier proposals are dropped.

        Raises InputError if the robot still moves, or if the start is outside the limits by any amount: the first
        command would jump to the limit. If the robot's controller accepts this jump, pass `Robot.clipped_start(q)`.
        """
        last = self._last
        if last is not None and last.action not in (Action.DONE, Action.STANDING):
            raise InputError("the robot still moves: start when it stands or is done")
        here = self.robot.configuration(q)
        if (beyond := self.robot.beyond_limits(here)) is not None:
            raise InputError(beyond, "start")
        still = Motion(np.array([0.0, 1.0]), np.array([[here, *np.zeros((3, self.robot.n))]]), timed=False)
        self._rest = rest = self._path(still)
        # The first proof allocates and loads data that all proofs need. It runs here so that the first tick is fast.
        self.prover.proven_by_bounds(still.coefficients)
        self.prover.check_curve(still.coefficients[0])
        rest.margin(rest.motion_from(0.0, 0.0, -1.0, self.tick), Around(ReachSets.none()))
        self._last, self._way = None, None
        self._proposal, self._refused = None, _NO_PROPOSAL

    def propose(self, motion: Any, rate: float | None = None, start: float | None = None) -> bool:
        """Propose a chunk of positions, or a spline; return whether the proposal is valid.

        If it is invalid, the robot follows its stop, and the next commands and the log give the reason. The chunk must
        not jump: no joint may need more than twice its velocity limit from one position to the next. A robot that moves
        in another direction than the chunk, and cannot change its direction in time, skips the next two positions.

        A robot that moves away from the positions overshoots. On one curve to a position that is h seconds ahead the
        overshoot is at most 0.2 |q̇| h, as of the cubic spline; by one line of braking |q̇| maxⱼ(|q̇ⱼ|/aⱼ)/2. With
        a jerk limit the robot follows the stop of the previous command until a curve can join, at most for the duration
        of the slowest stop. For proposals that change at every tick no bound of the total overshoot is proven. With
        random proposals and no jerk limit, no joint overshot by more than twice v²/2a plus its motion in one tick; with
        a jerk limit the overshoot was up to 11 mrad larger.

        Parameters
        ----------
        motion : array_like of shape (K, n), Motion, or what `Motion.of` takes
            A chunk of positions [rad or m], position k at time k / rate; or a spline in time, which is sampled at its
            knots and every 0.05 s between them. Positions less than 0.01 s apart are thinned out.
        rate : float, optional
            Rate of the chunk's positions [Hz]; without it `motion` must be a motion in time.
        start : float, optional
            The time at which the proposal begins [s]. The part before the next command is left out; before it begins,
            the robot moves to its first position. Default: the time of the next command.
        """
        return self._take(lambda: Positions.of(motion, rate, start, self.robot, self.limits.joints))

    def follow(self, motion: Motion, since: float = 0.0, within: float = _EQUAL_POSITIONS) -> float:
        """Execute a whole motion on its own curve, from its time `since` [s] on; return the time of its begin [s].

        Call it after `start`. The whole motion is proven against still obstacles here, not in the ticks. If people
        block the motion, the robot stops on it and continues as soon as a motion is proven. The robot also stops where
        velocities jump. A motion of straight lines is executed along the spline through its positions (see `propose`).
        A robot that stands elsewhere first moves to the beginning, if no joint is farther away than `within` [rad or
        m]; the time returned is then before `since`. Raises InputError if a joint is farther away, if a command was
        given before, or if the motion is not free; the message names the obstacle and the time.
        """
        if self._rest is None or self._last is not None:
            raise InputError("start where the robot stands first")
        proposal = Positions.of(motion, None, None, self.robot, self.limits.joints)
        curve = proposal.own_curve(motion)
        curve = curve.part(since, curve.length) if since > 0 else curve
        stands = self._rest.curve.knots[0]
        away = self.robot.difference(stands, curve.knots[0])
        farthest = int(np.abs(away).argmax())
        if abs(away[farthest]) > within:
            where = f"{abs(away[farthest]):.3g} from where {self.robot.joint_names[farthest]!r} stands"
            raise InputError(f"begins {where}, and {within:.3g} is allowed", "motion")
        begin = since
        if abs(away[farthest]) > _JOINED:
            begin -= _OVER
            over = np.array([[stands, 0 * away, 3 * away, -2 * away]])
            curve = Motion(np.array([0.0, _OVER]), over, timed=False).then(curve)
        for k, piece in enumerate(curve.coefficients):
            verdict = self.prover.check_curve(piece)
            if verdict.verdict is not Verdict.FREE:
                at = begin + np.interp(verdict.at or 0.0, [0.0, 1.0], curve.times[k : k + 2])
                raise InputError(_blocked(verdict, f"at {at:.2f} s"))
        path = self._path(curve)
        # The ceiling is computed here so that the first tick does not have to.
        _ = path.ceiling
        self._proposal, self._refused, self._clock = proposal, "", np.nan
        self._way = _Way(proposal, path, begin, whole=True, blocked="")
        return begin

    def propose_velocity(self, velocity: ArrayLike) -> bool:
        """Propose joint velocities (n,) [rad/s or m/s] until the next tick; return whether they are valid.

        Joints approach the velocities with half of their acceleration limits. Without another proposal the robot stops.
        """
        return self._take(partial(self._velocity, velocity, of_tip=False))

    def propose_twist(self, twist: ArrayLike) -> bool:
        """Propose a twist v (6,) of the tip, linear [m/s] then angular [rad/s], in world axes; as `propose_velocity`.

        The joint velocities are q̇ = Jᵀ(JJᵀ + λ²)⁻¹v with λ = 0.05: near a singularity the tip is slower than v, and q̇
        stays below ‖v‖/2λ. If a joint would exceed its limit, all joints are slowed down by the same factor.
        """
        return self._take(partial(self._velocity, twist, of_tip=True))

    def command(self, time: float) -> ShieldCommand:
        """Return the command from a time [s] on; an InputError if it is before the last command or measurement."""
        if self._rest is None:
            raise InputError("start where the robot stands first")
        last = self._last
        s, speed = self._place(time)
        path = self._rest if last is None else last.path
        found, why, progress = None, self._refused, 0.0
        if self._proposal is not None:
            way, s0, speed0, why = self._next_way(time, s, speed)
            progress = self._begin
            if way is not None:
                found = self._next(way.path, s0, speed0, time)
                if found is not None:
                    self._way = way
                    progress = way.begin + found.motion.at(self.tick)[0]
                    found = _explained(found, way, s0, self.tick)
        follows = found is not None
        if found is None:
            found = self._kept(path, s, speed, time)
            found = replace(found, reason=why) if why else found
        delay = 0.0
        # A velocity is valid for one tick only.
        if not follows and isinstance(self._proposal, Velocity):
            self._proposal, self._refused = None, "no new velocity was proposed"
        if self._proposal is not None:
            delay = max(0.0, min(time + self.tick - self._clock, self._proposal.duration) - progress)
        return self._given(ShieldCommand(**vars(found), follows=follows, delay=delay), time)

    def log_tick(self) -> dict[str, Any]:
        """Return a tick of a log, with whether the command follows the newest proposal and its delay [s]."""
        found, last = super().log_tick(), self._last
        assert isinstance(last, ShieldCommand)
        return {**found, "follows": last.follows, "delay": last.delay}

    def _slower(self, path: BoundedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest proven motion with less acceleration, or with ṡ bounded near its present value.

        With the bound, curvature needs less of the acceleration limits, so that the stop is shorter.
        """
        fast = speed if self._past is None else max(speed, float(np.sqrt(self._past.squared_speeds.max())))
        slow = path.slowed(np.minimum(np.sqrt(path.squared_limits), fast + _FASTER), HARDEST)
        fastest = self._proven(slow, s, speed, 1.0, time, self._margin)
        return super()._slower(slow, s, speed, time) if fastest is None else fastest

    # ------------------------------------------------------------------------------------------------------- ways

    def _take(self, make: Callable[[], Positions | Velocity]) -> bool:
        """Make a proposal and store it as the newest one, or store the reason why it is invalid."""
        before, self._proposal, self._clock = self._refused, None, np.nan
        try:
            self._proposal, self._refused = make(), ""
        except SafeOmplError as error:
            self._refused = str(error)
            if before in ("", _NO_PROPOSAL):  # not at every tick
                _log.warning("the proposal is refused: %s", error)
        return self._proposal is not None

    def _velocity(self, given: ArrayLike, of_tip: bool) -> Velocity:
        shape, what = ((6,), "twist") if of_tip else ((self.robot.n,), "velocity")
        return Velocity(self.robot, self.limits.joints, finite_array(given, shape, what), self.tick, of_tip)

    def _next_way(self, time: float, s: float, speed: float) -> tuple[_Way | None, float, float, str]:
        """Return the path along the proposal that the robot follows next, its s and ṡ there; without a path, why."""
        proposal, way, last = self._proposal, self._way, self._last
        assert proposal is not None
        assert self._rest is not None
        if np.isnan(self._clock):
            self._clock = time if proposal.start is None else proposal.start
            self._begin = time - self._clock
        begin = self._begin
        if way is not None and way.proposal is proposal:
            if way.whole or way.blocked or s + self._window <= way.path.length:
                return way, s, speed, ""
            begin = way.begin + s
        else:
            way = None
        q = self._rest.curve.knots[0]
        state = State(q, np.zeros_like(q), np.zeros_like(q)) if last is None else last.at(time)
        why = "its joints would have to accelerate too much to join it"
        try:
            for curve, rate, acceleration in proposal.curves(begin, state, self._window):
                joined, blocked = self._joined(proposal, curve, begin, rate, acceleration)
                if joined is not None:
                    smooth = self.limits.joints.jerk is not None
                    self._past = joined.path.past(0.0, rate, acceleration) if smooth else None
                    return joined, 0.0, rate, ""
                why = blocked or why
        except InputError as error:
            why = str(error)
        return way, s, speed, why

    def _joined(
        self, proposal: Positions | Velocity, curve: Motion, begin: float, rate: float, acceleration: float
    ) -> tuple[_Way | None, str]:
        """Return the proven part of a curve as a path; None, and perhaps the reason, if the robot cannot join it."""
        length = curve.length if isinstance(proposal, Velocity) else min(curve.length, self._window)
        whole = begin + length >= proposal.duration - _EQUAL_POSITIONS or isinstance(proposal, Velocity)
        curve = curve.part(0.0, length) if length < curve.length else curve
        end, blocked = length, ""
        for k in np.flatnonzero(~self.prover.proven_by_bounds(curve.coefficients)).tolist():
            proven, verdict = self._proven_share(curve.coefficients[k])
            if verdict is not None:
                first, last = curve.times[k : k + 2].tolist()
                end, blocked = first + proven * (last - first), _blocked(verdict, f"before {begin + last:.2f} s")
                break
        if end <= 0.0:
            return None, blocked
        path = self._path(curve.part(0.0, end) if end < length else curve)
        if not path.admits(rate, acceleration):
            return None, ""
        return _Way(proposal, path, begin, whole and not blocked, blocked), ""

    def _proven_share(self, piece: FloatArray) -> tuple[float, MotionVerdict | None]:
        """Return the share of a piece (4, n) that is proven, by halving, and the first verdict that was not free."""
        first, share = None, 1.0
        for _ in range(1 + _CUTS):
            verdict = self.prover.check_curve(piece * share ** np.arange(len(piece))[:, None])
            if verdict.verdict is Verdict.FREE:
                return share, first
            first, share = first or verdict, 0.5 * share
        return 0.0, first

    def _path(self, curve: Motion) -> BoundedPath:
        path = BoundedPath.along(self.bodies, curve, self.limits, _CELL, proposed_velocity_limit)
        return replace(path, brakes=np.minimum(path.brakes, HARDEST))


class _Way(NamedTuple):
    """A path along a proposal."""

    proposal: Positions | Velocity
    path: BoundedPath
    # The time in the proposal at which the path begins [s].
    begin: float
    # Whether the path reaches the end of the proposal.
    whole: bool
    # The still obstacle that blocks the proposal, if there is one.
    blocked: str


def _explained(command: Command, way: _Way, s: float, tick: float) -> Command:
    """Add to a command the reason why it is slower than proposed, if the reason is not a moving person or object."""
    if command.reason:
        return command
    if command.action is Action.DONE:
        return replace(command, action=Action.STANDING, reason=way.blocked) if way.blocked else command
    if way.blocked and command.motion.places[-1] >= way.path.length - _EQUAL_POSITIONS:
        return replace(command, action=Action.SLOWED, reason=way.blocked)
    in_time = min(s + tick, way.path.length) if way.whole else s + tick
    if command.motion.at(tick)[0] < in_time - _EQUAL_POSITIONS:
        why = "limits of the joints, or the stop at the end of the proposal"
        return replace(command, action=Action.SLOWED, reason=why)
    return command


def _blocked(verdict: MotionVerdict, when: str) -> str:
    """Return a message that names the pair in collision or the violated limit that blocks a motion."""
    first, second = verdict.pair or ("", "")
    if second == "its limits":
        return f"joint {first!r} leaves its limits {when}"
    if second == "its limit":
        return f"the limit of {first} is not proven to hold {when}"
    return f"not proven free of collision {when}{f': {first} and {second}' if first else ''}"
