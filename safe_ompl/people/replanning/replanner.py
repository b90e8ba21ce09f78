"""What is driven at every tick: a motion that is proven until the next one, and its stop, on a guarded path.

`Guard` is what a `Replanner` and a `Shield` share: who is around, and the commands that are proven against them. A tick
is `update` (what was seen), `command` (the fastest motion that is proven) and, for a replanner, `think` (search detours
and retreats in the time that is left).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision import CollisionChecker, MotionProver
from safe_ompl.common import InputError
from safe_ompl.io import ticks_header
from safe_ompl.people import ReachViolation, Surroundings, Tracker
from safe_ompl.people.replanning.command import Command, Doing, ReplanningOptions
from safe_ompl.people.replanning.detours import Detours
from safe_ompl.people.replanning.guarded_path import Around, GuardedPath, MotionMargin, PathLimits, RobotBodies
from safe_ompl.people.replanning.retreat import Receding, Retreats
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories import SEPARATION, ContactLimits, Trajectory

_log = logging.getLogger(__name__)
_Given = TypeVar("_Given", bound=Command)

# Accelerations that are tried between full braking (−1) and full acceleration (1).
_PUSHES = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)
_RETREATS = (1.0, 0.2, 0.0, -1.0)  # the same of retreats
_CRAWL = 0.3  # [rad/s] a robot that is slower tries whether a retreat gets
_FARTHER = 2.0  # so many times as far
_SAME = 1e-6  # [rad] places nearer than this are one


class Guard:
    """A robot, who is around it, and the commands that are proven against them.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        What is around it. Obstacles that are named in `trackers` or `objects` move; the others stand still.
    trackers : mapping of str to Tracker
        The people that are tracked, and how. They need not be obstacles of the scene.
    objects : mapping of str to float, optional
        Obstacles of the scene that move, and bounds of their speeds [m/s].
    people : People, optional
        How far people go (their reach, or else their speeds), the clearance from the robot that must be left, and
        whether the robot may touch people at speeds that they bear. Its `reaction_time` is not used: the delay is known
        at every tick.
    options : ReplanningOptions, optional
        Time between commands, when somebody is lost, limits, detours.
    prover : MotionProver, optional
        Proves motions among still obstacles, with limits such as of danger or clearance. Its scene is `scene` without
        what moves. Default: motions must be free of collisions. If it has a tube (`Separation.tube`), all that is said
        holds for every robot whose joints are that near to the command at any time, beside people, too.

    Attributes
    ----------
    surroundings : Surroundings
        All people and objects that move.
    contact : ContactLimits or None
        At what speeds contact is borne; None: it is not allowed.
    tick : float
        Time between two commands [s].

    Raises
    ------
    UnknownNameError
        If the scene has no obstacle of a name in `objects`.
    InputError
        If a number is out of its range; if the prover is of another robot or of another scene; if the speed of tool or
        links is limited, or contact allowed, within a tube, which bounds positions only.
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
        prover: MotionProver | None = None,
    ) -> None:
        options = ReplanningOptions() if options is None else options
        people = People() if people is None else people
        self.robot, self.options, self.tick = robot, options, float(options.tick)
        self.surroundings = Surroundings(scene, trackers, objects or {}, people)
        still = self.surroundings.still
        self.prover = MotionProver(CollisionChecker(robot, still)) if prover is None else prover
        _check_prover(self.prover, robot, still)
        # A robot that is elsewhere in its tube is nearer to people.
        nearer = self.prover.separation.swing(self.prover.checker)
        if nearer and people.contact:
            raise InputError("bounds positions, not velocities: contact cannot be proven within it", "tube")
        limits = options.limits
        if nearer and limits is not None and (limits.tool_speed or limits.link_speed):
            raise InputError("bounds positions: speeds of tool and links cannot be proven within it", "tube")
        self.people = replace(people, clearance=people.clearance + nearer)
        self.contact = contact_limits(robot, self.surroundings, people) if people.contact else None
        self.bodies = RobotBodies(robot)
        self._last: Command | None = None  # the newest command
        self._time = 0.0  # for which it was asked for
        self._margin = MotionMargin(np.inf)  # of the motion that was tried last
        self._violated = False

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.robot.name!r}, {self.surroundings!r}, tick={self.tick:g})"

    def update(
        self, people: Mapping[str, ArrayLike | None], objects: Mapping[str, Any], time: float
    ) -> list[ReachViolation]:
        """Take what sensors saw, and return who moved farther than promised; while anyone did, the robot stops.

        Parameters
        ----------
        people : mapping of str to array_like of shape (J, 3)
            Key points of those that were seen, as their skeletons have them; NaN: not seen.
        objects : mapping of str to Pose, pin.SE3 or 4×4 matrix
            Poses of the objects that were seen.
        time : float
            When that was measured [s].

        Raises
        ------
        InputError
            If the time goes backwards, or key points or a pose cannot be used.
        UnknownNameError
            If a name is not known.
        """
        violations = self.surroundings.update(people, objects, time)
        if violations and not self._violated:
            _log.warning("%.3f s: %s: stop", time, violations[0])
        self._violated = bool(violations)
        return violations

    def _place(self, time: float) -> tuple[float, float]:
        """Return s and ṡ on the path of the last command at a time [s]; raise InputError if time goes backwards."""
        last = self._last
        if not time >= self.surroundings.time or not (last is None or time >= last.time):
            raise InputError(f"time must not go backwards: a command for {time!r} s", "time")
        return (0.0, 0.0) if last is None else last.motion.at(time - last.time)[:2]

    # ----------------------------------------------------------------------------------------------------- proofs

    def _next(self, path: GuardedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest motion from (s, ṡ) that is proven with its stop; None if none is."""
        measured = self.surroundings.time
        if speed == 0 and s >= path.length - _SAME:
            rest = path.motion_from(path.length, 0.0, -1.0, self.tick)
            return Command(time, measured, path, rest, Doing.DONE, MotionMargin(np.inf))
        if not self.surroundings.known:
            return None
        trouble = self.surroundings.trouble(time, self.options.lost_after)
        violated = trouble is not None
        around = self._around(time)

        def command(push: float, doing: Doing, reason: str) -> Command | None:
            motion = path.motion_from(s, speed * speed, push, self.tick)
            margin = path.margin(motion, around)
            if margin.margin < 0:
                self._margin = margin
                return None
            rule = self._margin.rule if reason and not violated else ""
            if rule not in ("", SEPARATION) and path.margin(motion, around._replace(contact=None)).margin >= 0:
                rule = SEPARATION
            return Command(time, measured, path, motion, doing, margin, reason, rule)

        if trouble is None:
            fastest = command(1.0, Doing.MOVING, "")
            if fastest is not None:
                return fastest
            trouble = self._margin.description
            pushes = [-1.0, *_PUSHES]
        else:
            pushes = [-1.0]
        if speed == 0:
            pushes = [push for push in pushes if push > 0]
        found, blamed, first, last = None, self._margin, 0, len(pushes)
        while first < last:  # by bisection: a motion that is slower than a proven one most often is proven
            middle, self._margin = (first + last) // 2, blamed
            push = pushes[middle]
            slower = command(push, Doing.SLOWED if push > -1 else Doing.BRAKING, trouble)
            found = slower or found
            first, last = (first, middle) if slower is None else (middle + 1, last)
        return found

    def _around(self, time: float) -> Around:
        """Return who is around when a motion begins at a time [s]."""
        known = self.surroundings
        return Around(known.sets, time - known.time, self.people.clearance, self.contact)

    def _kept(self, path: GuardedPath, s: float, speed: float, time: float) -> Command:
        """Return what is left of the stop that was proven before, or rest."""
        last = self._last
        trouble = self.surroundings.trouble(time, self.options.lost_after)
        why = self._margin, trouble or self._margin.description, "" if trouble else self._margin.rule
        if last is None or speed == 0:
            rest = path.motion_from(s, 0.0, -1.0, self.tick)
            return Command(time, self.surroundings.time, path, rest, Doing.STANDING, *why)
        doing = last.doing if last.doing is Doing.RETREATING else Doing.BRAKING
        return Command(last.time, last.measured, path, last.motion, doing, *why)

    # ------------------------------------------------------------------------------------------------------- log

    def log_header(self) -> dict[str, Any]:
        """Return the header of a log of ticks (`safe_ompl.io.TicksFile`, `safe_ompl.apps.exchange.McapLog`)."""
        around = self.surroundings
        return ticks_header(self.tick, self.robot, around.scene, around.description())

    def log_tick(self) -> dict[str, Any]:
        """Return the newest command and where all were seen last, as a tick of a log; distances are not measured.

        Raises
        ------
        InputError
            If there was no command yet.
        """
        if self._last is None:
            raise InputError("there was no command yet")
        unknown = dict.fromkeys(("distance", "link", "who", "limb"))
        return {**self._last.tick_at(self._time, self.tick), **self.surroundings.seen(), **unknown}

    def _given(self, command: _Given, time: float) -> _Given:
        """Keep a command as the last one, and return it; what the robot does now goes to the log if it is new."""
        before = None if self._last is None else self._last.doing
        self._last, self._time = command, time
        if command.doing is before:
            return command
        why = f": {command.reason}" if command.reason else ""
        drives = (Doing.MOVING, Doing.SLOWED)
        level = logging.DEBUG if command.doing in drives and before in drives else logging.INFO
        _log.log(level, "%.3f s: %s%s", time, command.doing.value, why)
        return command


def contact_limits(robot: Robot, surroundings: Surroundings, people: People) -> ContactLimits:
    """Return at what speeds contact is borne, for limbs and objects in the order of their reach sets."""
    bodies = {name: track.tracker.body for name, track in surroundings.people.items()}
    limbs = [(name, limb) for name, body in bodies.items() for limb in body.limbs]
    limbs += [(name, "") for name, shape in surroundings.shapes.items() for _ in shape.parts()]
    heights = {name: body.height for name, body in bodies.items()}
    # A limb may be clamped against an object, wherever that is by then.
    always = bool(surroundings.objects)
    return ContactLimits(robot, surroundings.still, people, limbs, heights, always_clamped=always)


def _check_prover(prover: MotionProver, robot: Robot, still: Scene) -> None:
    """Raise InputError unless a prover is of this robot among exactly the still obstacles."""
    checker = prover.checker
    if checker.robot.joint_names != robot.joint_names:
        raise InputError(f"is of the robot {checker.robot.name!r}, not of {robot.name!r}", "prover")
    for name in sorted(set(checker.scene.names) ^ set(still.names)):
        where = "in its scene, but it moves" if name in checker.scene.names else "not in its scene"
        raise InputError(f"{name!r} is {where}: give it the scene of what stands still", "prover")


class Replanner(Guard):
    """Drives a robot along trajectories beside people and things that move.

    What is executed is always proven: the motion until the next tick and the stop on the path after it touch nobody
    who keeps to the reach model; or, where contact is allowed, only at speeds of the robot's own that the limb bears
    (`safe_ompl.trajectories.contact`). At every tick the robot takes the fastest motion that is proven so against the
    newest measurement. If there is none, or only slow ones, it retreats from who is near: that brings no body nearer to
    them, but who runs after it may touch it. Or it follows the stop of the tick before: its proof still holds, because
    it covers all that people may do until the robot stands. It goes on as soon as a motion is proven again.

    Parameters are those of `Guard`. Trajectories and detours keep the limits of the prover.
    """

    detours: Detours | None = None  # None before the first trajectory, and if they are not searched
    _path: GuardedPath | None = None
    _detour: tuple[GuardedPath, float] | None = None  # and where on the path it begins
    _retreat: GuardedPath | None = None  # from where the robot stands
    _retreats: Retreats | None = None

    def start(self, trajectory: Trajectory) -> None:
        """Take a trajectory to follow, from where the robot stands.

        Its curve is proven anew against all still obstacles. Its limits and caps are kept, except those by people; its
        time law is not: the robot is as fast as limits and people let it.

        Raises
        ------
        InputError
            If the robot moves, or stands elsewhere; if the trajectory is of other joints, or not free; if it has a cap
            that is proven on its own curve only, such as of danger.
        """
        if trajectory.joint_names != self.robot.joint_names:
            raise InputError(
                f"the trajectory is of the joints {trajectory.joint_names}, the robot's are {self.robot.joint_names}"
            )
        path = GuardedPath.along(self.bodies, trajectory.curve, PathLimits.of(trajectory))
        last = self._last
        if last is not None:
            if last.doing not in (Doing.DONE, Doing.STANDING):
                raise InputError("the robot still moves: start when it stands or is done")
            away = self.robot.difference(last.at(np.inf).q, path.curve.at(np.zeros(1)).q[0])
            if np.abs(away).max() > _SAME:
                raise InputError(f"the trajectory begins {np.abs(away).max():.3g} rad from where the robot stands")
        for k, piece in enumerate(trajectory.curve.pieces):
            if not piece.is_free(self.prover):
                where = f"piece {k} of the trajectory, from {piece.start.round(3).tolist()} on"
                raise InputError(f"{where}, is not free of what stands still")
        self._path, self._last, self._detour, self._retreat = path, None, None, None
        retreats = self.options.retreats and not self.prover.separation.tube
        self._retreats = Retreats(self.prover, self.bodies, path.limits) if retreats else None
        if self.options.detours:
            if self.detours is None or not path.limits.same_as(self.detours.limits):
                self.detours = Detours(self.prover, self.bodies, path.limits, self.tick)
            self.detours.cover(trajectory.curve)

    def command(self, time: float) -> Command:
        """Return what the robot does from a time [s] on; see `Command`.

        Raises
        ------
        InputError
            If nothing was started, or the time is before the last command or the last measurement.
        """
        path = self._path
        if path is None:
            raise InputError("start a trajectory first")
        s, speed = self._place(time)
        found = None
        if self._detour is not None:
            way, begin = self._detour
            found = self._next(way, max(s - begin, 0.0), speed, time)
            self._detour = None
        if found is None:
            found = self._next(path, s, speed, time)
        if self._retreats is not None:
            found = self._retreating(found, path, s, speed, time)
        self._retreat = None
        if found is None:
            found = self._kept(path, s, speed, time)
        self._path = found.path
        return self._given(found, time)

    def think(self, units: int = 60) -> bool:
        """Search a detour if the path ahead is barred or slow; return whether the next command has one to take.

        Call it after `command`, in the time that is left until the next one. The next command takes the detour if that
        is proven.

        Parameters
        ----------
        units : int
            How much work may be done: an estimate for an edge is 1, a proof of one 8. What was learnt is kept.
        """
        command = self._last
        if command is None or not self.surroundings.known or command.doing is Doing.DONE:
            return False
        now = max(command.time, self.surroundings.time)
        around = self._around(now)
        if self.detours is not None:
            self._detour = self.detours.search(command, around, now, units)
        if self._detour is None and self._retreats is not None and command.doing is Doing.STANDING:
            at = float(command.motion.places[-1])
            self._retreat = self._retreats.search(command.path, at, around.sets)
        for way in (self._path, self._retreat):
            if way is not None and self._retreats is not None:
                way.prepare()
        return self._detour is not None

    def _retreating(
        self, found: Command | None, path: GuardedPath, s: float, speed: float, time: float
    ) -> Command | None:
        """Return a retreat if it gets much farther than what was found, or goes on; else what was found."""
        if found is not None and (found.path is not path or found.doing in (Doing.MOVING, Doing.DONE)):
            return found
        last = self._last
        gets = 0.0 if found is None else found.motion.at(self.tick)[0] - s
        if last is None or last.doing is not Doing.RETREATING:
            if max(speed * self.tick, gets) > _CRAWL * self.tick:
                return found
            gets *= _FARTHER
        away = self._recede(path, s, speed, time)
        if away is not None:
            return away if away.motion.at(self.tick)[0] - s > gets else found
        if found is None and self._retreat is not None and speed == 0:
            return self._recede(self._retreat, 0.0, 0.0, time)
        return found

    def _recede(self, path: GuardedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest motion from (s, ṡ) that recedes from all who are near; see `retreat`. None if none is."""
        if self.surroundings.trouble(time, self.options.lost_after) is not None:
            return None
        around = self._around(time)
        receding = Receding(path, s, around.sets)
        for push in _RETREATS:
            motion = path.motion_from(s, speed * speed, push, self.tick)
            if motion.places[-1] - s < _SAME:
                continue
            margin = path.margin(motion, around, receding=receding.along(motion))
            if margin.margin >= 0:
                why = margin, self._margin.description, SEPARATION
                return Command(time, self.surroundings.time, path, motion, Doing.RETREATING, *why)
        return None
