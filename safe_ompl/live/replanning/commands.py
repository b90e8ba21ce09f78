"""One tick of a robot among people: the motion until the next tick and the stop after it are proven.

`CommandProver` is the base class of `Replanner` and `Shield`. At every tick:

1. `update` takes the measurements and computes the reach sets of people and objects (`Surroundings`).
2. `command` tries motions along a `BoundedPath`, from full acceleration to full braking. Each motion lasts a tick and
   ends in a stop. The fastest motion whose margin to the sets is never negative is taken (`_next`). If there is none,
   the robot follows the rest of the stop of the previous tick (`_kept`), whose proof still holds.
3. A replanner uses the time that is left to search detours, and retreats from people who are near (`think`).

A `Replanner` gets its path from a trajectory and from detours, a `Shield` from proposals.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.common import FloatArray, InputError, Section, key, number
from safe_ompl.io import ticks_header
from safe_ompl.live import ReachViolation, Surroundings
from safe_ompl.live.replanning.bounded_path import Around, BoundedPath, MotionMargin, RobotBodies, SpeedLimits, StopLaw
from safe_ompl.motions import SEPARATION, ContactLimits, State
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)
_Given = TypeVar("_Given", bound="Command")

# Path accelerations that are tried by bisection, as shares of the braking: from full braking to full acceleration.
_ACCELERATIONS: tuple[float, ...] = tuple((np.arange(-15, 16) / 16).tolist())
# Arc lengths that differ by less than this are equal.
_EQUAL_STATES = 1e-6  # [rad]


class Action(str, Enum):
    """State of the robot during a command."""

    MOVING = "moving"
    SLOWED = "slowed"
    BRAKING = "braking"
    STANDING = "standing"
    RETREATING = "retreating"
    DONE = "done"


@dataclass(frozen=True)
class Command:
    """A motion of one tick and the stop after it, both proven against the newest measurement.

    A controller follows `at`. If no other command comes, it follows this one to its end, where the robot stands.
    """

    # The time at which the command begins [s].
    time: float
    # The time of the measurement against which the command is proven [s].
    measured: float
    # The path that the robot follows.
    path: BoundedPath
    motion: StopLaw
    action: Action
    # The smallest margin along the motion. If the command is the rest of an earlier stop, or the robot stands, it is
    # the margin of the motion that could not be proven.
    left: MotionMargin
    # The reason why the robot is slower than its limits allow.
    reason: str = ""
    # The rule that slows the robot near people: ``separation``, ``contact`` or ``clamping``.
    rule: str = ""

    @property
    def standstill(self) -> float:
        """The latest time at which the robot stands [s]."""
        return self.time + self.motion.duration

    def at(self, time: float) -> State:
        """Return joint positions, velocities and accelerations (n,) at a time [s], at least `self.time`."""
        s, speed, acceleration = self.motion.at(time - self.time)
        q, first, second, _ = (values[0] for values in self.path.curve.places(np.array([s])))
        return State(q, first * speed, first * acceleration + second * speed * speed)

    def until_rest(self, time: float, step: float) -> tuple[FloatArray, list[State]]:
        """Return times (K,) [s] from `time` to standstill in steps [s], and the states at these times."""
        steps = np.arange(time, self.standstill - 1e-6, step)
        states = [*(self.at(each) for each in steps.tolist()), self.at(np.inf)]
        return np.append(steps, max(time, self.standstill)), states

    def tick_at(self, time: float, step: float) -> dict[str, Any]:
        """Return the robot's part of a tick (`safe_ompl.io.ticks`) at a time [s]; its stop is sampled in steps [s]."""
        times, states = self.until_rest(max(time, self.time), step)
        return {
            "time": time,
            "q": states[0].q.tolist(),
            "qd": states[0].qd.tolist(),
            "stop": stop_as_dict(times, states),
            "state": self.action.value,
            "margin": self.left.margin,
            "reason": self.reason,
            "rule": self.rule or None,
            "measured": self.measured,
        }


def stop_as_dict(times: FloatArray, states: Sequence[State]) -> dict[str, Any]:
    """Return the stop of a command, K times [s] and states, as plain values for a tick."""
    return {
        "times": times.tolist(),
        "q": [state.q.tolist() for state in states],
        "qd": [state.qd.tolist() for state in states],
    }


@dataclass(frozen=True)
class ReplanningOptions(Section):
    """Options of a `Replanner` or a `Shield`; raises InputError if a number is out of its range."""

    # Time between two commands [s].
    tick: float = key(number, default=0.05, above=0.0, kind="number of seconds")
    # The robot stops if a person or object is not seen for this long [s].
    lost_after: float = key(number, default=0.5, above=0.0)
    # The largest delay with which the robot follows a command [s].
    lag: float = key(number, default=0.0, at_least=0.0)
    # Speed limits of joints, tool and links for a `Shield`; default: the limits of the robot's joints. A `Replanner`
    # uses the limits of its trajectories.
    limits: SpeedLimits | None = None
    # Whether `Replanner.think` searches detours, and retreats from people who are near a robot that stands. People who
    # follow a retreating robot may touch it, as they may touch a robot that stands.
    detours: bool = True
    retreats: bool = True
    # The joints that the motion may move, such as all but those of a gripper. None means all.
    joints: tuple[str, ...] | None = None


class CommandProver:
    """Base class of `Replanner` and `Shield`: proves commands of a robot against people and objects around it.

    Parameters
    ----------
    robot : Robot
        The robot.
    surroundings : Surroundings
        The still obstacles, the people and objects that move, and the rules for them. The reaction time in the rules is
        not used, because the delay is known at every tick.
    options : ReplanningOptions, optional
        Time between commands, time after which a person is lost, limits, detours.
    prover : MotionProver, optional
        Proves motions among the still obstacles, with limits such as of danger or clearance. Its scene is
        `surroundings.still`. Default: motions must be free of collision. If the prover has a tube (`Separation.tube`),
        all proofs, also those against people, hold for every robot whose joints stay in the tube about the command.

    Raises
    ------
    InputError
        If a number is out of its range; if the prover has another robot or another scene; if there is a tube, which
        bounds positions only, and the speed of tool or links is limited, or contact is allowed.
    """

    def __init__(
        self,
        robot: Robot,
        surroundings: Surroundings,
        *,
        options: ReplanningOptions | None = None,
        prover: MotionProver | None = None,
    ) -> None:
        self.robot, self.surroundings = robot, surroundings
        self.options = options = ReplanningOptions() if options is None else options
        # The time between two commands [s].
        self.tick = float(options.tick)
        people, still = surroundings.rules, surroundings.still
        self.prover = MotionProver(CollisionChecker(robot, still)) if prover is None else prover
        _check_prover(self.prover, robot, still)
        tube = self.prover.separation.tube
        if tube and people.contact:
            raise InputError("bounds positions, not velocities: contact cannot be proven within it", "tube")
        limits = options.limits
        if tube and limits is not None and (limits.tool_speed or limits.link_speed):
            raise InputError("bounds positions: speeds of tool and links cannot be proven within it", "tube")
        # The distance from people that must be kept everywhere in the robot's tube [m].
        self.clearance = people.clearance
        # The contact speeds that limbs tolerate; None if contact is not allowed.
        self.contact = contact_limits(robot, surroundings) if people.contact else None
        self.bodies = RobotBodies(robot, tube)
        # The newest command.
        self._last: Command | None = None
        # The time for which a command was requested last.
        self._time = 0.0
        # The margin of the motion that was tried last.
        self._margin = MotionMargin(np.inf)
        # With a jerk limit: the past of the time law, which the next motion continues.
        self._past: StopLaw | None = None
        self._violated = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.robot.name!r}, {self.surroundings!r}, tick={self.tick:g})"

    def update(
        self, people: Mapping[str, ArrayLike | None], objects: Mapping[str, Any], time: float
    ) -> list[ReachViolation]:
        """Take the measurements of a time [s]; return limbs and objects that left their reach sets.

        After such a violation the robot stops. `people` maps names of visible people to key points (J, 3) in the order
        and frame of their skeletons; NaN: not seen. `objects` maps names to poses (Pose, pin.SE3 or 4×4), or for
        clouds to points (N, 3) in the world [m]. Raises InputError if the time goes backwards, a name is unknown, or a
        measurement is invalid.
        """
        violations = self.surroundings.update(people, objects, time)
        if violations and not self._violated:
            _log.warning("%.3f s: %s: stop", time, violations[0])
        self._violated = bool(violations)
        return violations

    def _place(self, time: float) -> tuple[float, float]:
        """Return s and ṡ on the path of the last command at a time [s]; an InputError if the time goes backwards."""
        last = self._last
        if not time >= self.surroundings.time or not (last is None or time >= last.time):
            raise InputError(f"time must not go backwards: a command for {time!r} s", "time")
        self._past = None
        if last is None:
            return 0.0, 0.0
        s, speed, _ = last.motion.at(time - last.time)
        if last.motion.window and speed > 0:
            self._past = last.motion.past(time - last.time)
        return s, speed

    # ----------------------------------------------------------------------------------------------------- proofs

    def _next(self, path: BoundedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest motion from (s, ṡ) that is proven with its stop; None if there is none."""
        if speed == 0 and s >= path.length - _EQUAL_STATES:
            rest = path.motion_from(path.length, 0.0, -1.0, self.tick)
            return Command(time, self.surroundings.time, path, rest, Action.DONE, MotionMargin(np.inf))
        if not self.surroundings.known:
            return None
        trouble = self.surroundings.trouble(time, self.options.lost_after)
        if trouble is not None:
            return self._proven(path, s, speed, -1.0, time, trouble) if speed > 0 else None
        fastest = self._proven(path, s, speed, 1.0, time)
        return self._slower(path, s, speed, time) if fastest is None else fastest

    def _slower(self, path: BoundedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest proven motion with less than full acceleration; None if there is none."""
        shares = [share for share in (-1.0, *_ACCELERATIONS) if speed > 0 or share > 0]
        found, blamed, first, last = None, self._margin, 0, len(shares)
        # This is a bisection, because a motion that is slower than a proven one is proven in most cases.
        while first < last:
            middle, self._margin = (first + last) // 2, blamed
            slower = self._proven(path, s, speed, shares[middle], time, blamed)
            found = slower or found
            first, last = (first, middle) if slower is None else (middle + 1, last)
        return found

    def _proven(
        self, path: BoundedPath, s: float, speed: float, share: float, time: float, why: MotionMargin | str = ""
    ) -> Command | None:
        """Return the motion from (s, ṡ) with s̈ = share · brakes if it and its stop are proven; else store the margin.

        `why` is the reason why the motion is not the fastest one: the margin of a faster motion, or a message about
        the measurements.
        """
        around = self._around(time)
        motion = path.motion_from(s, speed * speed, share, self.tick, self._past)
        margin = path.margin(motion, around)
        if margin.margin < 0:
            self._margin = margin
            return None
        action = Action.BRAKING if share == -1.0 else Action.SLOWED if why else Action.MOVING
        reason, rule = (why.description, why.rule) if isinstance(why, MotionMargin) else (why, "")
        if rule not in ("", SEPARATION) and path.margin(motion, around._replace(contact=None)).margin >= 0:
            rule = SEPARATION
        return Command(time, self.surroundings.time, path, motion, action, margin, reason, rule)

    def _around(self, time: float) -> Around:
        """Return the surroundings for a motion that the robot begins at a time [s] plus the lag."""
        known = self.surroundings
        return Around(known.sets, time - known.time + self.options.lag, self.clearance, self.contact)

    def _kept(self, path: BoundedPath, s: float, speed: float, time: float) -> Command:
        """Return the rest of the stop that was proven before; a robot that stands continues to stand."""
        last = self._last
        trouble = self.surroundings.trouble(time, self.options.lost_after)
        why = self._margin, trouble or self._margin.description, "" if trouble else self._margin.rule
        if last is None or speed == 0:
            rest = path.motion_from(s, 0.0, -1.0, self.tick)
            return Command(time, self.surroundings.time, path, rest, Action.STANDING, *why)
        action = last.action if last.action is Action.RETREATING else Action.BRAKING
        return Command(last.time, last.measured, path, last.motion, action, *why)

    # ------------------------------------------------------------------------------------------------------- log

    def log_header(self) -> dict[str, Any]:
        """Return the header of a log of ticks (`safe_ompl.io.TicksFile`, `safe_ompl.live.ros.McapLog`)."""
        around = self.surroundings
        return ticks_header(self.tick, self.robot, around.scene, around.description())

    def log_tick(self) -> dict[str, Any]:
        """Return the newest command and measurements as a tick of a log; its distances to people are None."""
        if self._last is None:
            raise InputError("there was no command yet")
        unknown = dict.fromkeys(("distance", "link", "who", "limb"))
        return {**self._last.tick_at(self._time, self.tick), **self.surroundings.seen(), **unknown}

    def _given(self, command: _Given, time: float) -> _Given:
        """Store a command as the last one, log a change of its action, and return it."""
        before = None if self._last is None else self._last.action
        self._last, self._time = command, time
        if command.action is before:
            return command
        why = f": {command.reason}" if command.reason else ""
        drives = (Action.MOVING, Action.SLOWED)
        level = logging.DEBUG if command.action in drives and before in drives else logging.INFO
        _log.log(level, "%.3f s: %s%s", time, command.action.value, why)
        return command


def contact_limits(robot: Robot, surroundings: Surroundings) -> ContactLimits:
    """Return the contact speeds that limbs and objects tolerate, in the order of their reach sets."""
    bodies = {name: track.tracker.body for name, track in surroundings.people.items()}
    limbs = [(name, limb) for name, body in bodies.items() for limb in body.limbs]
    solids = [name for name in surroundings.shapes if name not in surroundings.clouds]
    limbs += [(name, "") for name in solids for _ in surroundings.shapes[name].parts()]
    heights = {name: body.height for name, body in bodies.items()}
    # A limb may be clamped against an object that moves, so clamping counts everywhere if there are such objects.
    always = bool(surroundings.objects)
    return ContactLimits(robot, surroundings.still, surroundings.rules, limbs, heights, always_clamped=always)


def _check_prover(prover: MotionProver, robot: Robot, still: Scene) -> None:
    """Raise InputError unless a prover has this robot and exactly the still obstacles."""
    checker = prover.checker
    if checker.robot.joint_names != robot.joint_names:
        raise InputError(f"is of the robot {checker.robot.name!r}, not of {robot.name!r}", "prover")
    for name in sorted(set(checker.scene.names) ^ set(still.names)):
        fault = f"contains {name!r}, which moves" if name in checker.scene.names else f"lacks the obstacle {name!r}"
        raise InputError(f"its scene {fault}: it must consist of all obstacles that do not move", "prover")
