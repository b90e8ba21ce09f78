"""The replanner: at every tick a motion that is proven until the next one, and can always stop on its path."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import InputError
from safe_ompl.inputs import number, positive, whole_number
from safe_ompl.live.around import Around
from safe_ompl.live.command import Command, Doing
from safe_ompl.live.detours import Detours
from safe_ompl.live.drive import Left
from safe_ompl.live.guarded_path import GuardedPath
from safe_ompl.live.limits import DriveLimits, own_caps
from safe_ompl.live.robot_bodies import RobotBodies
from safe_ompl.live.still import check_motion, prove
from safe_ompl.live.surroundings import Surroundings
from safe_ompl.people.reach import ReachModel
from safe_ompl.people.tracking import Tracker, Violation
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.people import People
from safe_ompl.scene.scene import Scene
from safe_ompl.trajectories.trajectory import Trajectory

_log = logging.getLogger(__name__)

TICK = 0.05  # [s]
_PUSHES = (
    -0.75,
    -0.5,
    -0.25,
    0.0,
    0.25,
    0.5,
    0.75,
)  # shares of what brakes allow that are tried between −1 and 1
_SAME = 1e-6  # [rad] configurations nearer than this are one


class Replanner:
    """Drives a robot along trajectories beside people and things that move.

    What is executed is always proven: the motion until the next tick and the stop on the path after it, whatever
    people do who keep to their reach model. At every tick it takes the fastest motion for which that holds against the
    newest measurement. Where there is none it follows the stop of the tick before, which was proven then: who keeps to
    the model is where that proof let her be. A stop ends by itself, as soon as a motion is proven again.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        What is around it. Obstacles that are named in `people` or `objects` move; the others stand still.
    trackers : mapping of str to Tracker
        The people that are tracked, and how. They need not be in the scene.
    objects : mapping of str to float, optional
        Obstacles of the scene that move, and bounds of their speeds [m/s].
    people : People, optional
        How fast limbs may move, and what must be left between them and the robot. Its `reaction_time` and contact are
        not used: the former is known here at every tick, and people are not touched by a robot that moves.
    reach : ReachModel, optional
        What is assumed of how people move; default: limbs keep to the speeds of `people`.
    tick : float
        Time between two commands [s].
    lost_after : float
        Whoever is not seen for so long is lost: the robot stops [s].
    detours : bool
        Whether to look for other ways, in `think`.
    seed : int
        Of the roadmap on which they are looked for.
    motion : CertifiedMotion, optional
        What proves motions among all that stands still, with limits such as of danger or clearance: trajectories and
        other ways keep to them. Its scene is `scene` without what moves. Default: they must be free.

    Raises
    ------
    UnknownNameError
        If the scene has no obstacle of a name in `objects`.
    InputError
        If a number is out of its range; if the motion is of another robot or of another scene.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        trackers: Mapping[str, Tracker],
        objects: Mapping[str, float] | None = None,
        *,
        people: People | None = None,
        reach: ReachModel | None = None,
        tick: float = TICK,
        lost_after: float = 0.5,
        detours: bool = True,
        seed: int = 0,
        motion: CertifiedMotion | None = None,
    ) -> None:
        self.robot = robot
        self.people = People() if people is None else people
        self.tick = positive(tick, "tick", "number of seconds")
        self.lost_after = number("lost_after", lost_after, above=0.0)
        self.surroundings = Surroundings(scene, trackers, objects or {}, self.people, reach)
        self.still = self.surroundings.still
        self.motion = CertifiedMotion(CollisionChecker(robot, self.still)) if motion is None else motion
        check_motion(self.motion, robot, self.still)
        self._bodies = RobotBodies(robot)
        self._path: GuardedPath | None = None
        self._command: Command | None = None
        self._left = Left(np.inf)  # of the motion that was tried last
        self._detours_wanted, self._seed = detours, whole_number("seed", seed, at_least=0)
        self._detours: Detours | None = None
        self._may_turn = False
        self._violated = False
        self._other: tuple[GuardedPath, float] | None = None  # a way, and where on the path it begins

    def __repr__(self) -> str:
        return f"Replanner({self.robot.name!r}, {self.surroundings!r}, tick={self.tick:g})"

    # ---------------------------------------------------------------------------------------------------- doors

    def start(self, trajectory: Trajectory) -> None:
        """Take a trajectory to drive, from where the robot stands.

        Its curve is proven anew against all that stands still. Of its time law nothing is kept, of its limits and caps
        all but those by people.

        Raises
        ------
        InputError
            If the robot moves, or stands elsewhere; if the trajectory is of other joints, or not free.
        """
        if trajectory.joint_names != self.robot.joint_names:
            raise InputError(
                f"the trajectory is of the joints {trajectory.joint_names}, the robot's are {self.robot.joint_names}"
            )
        path = GuardedPath.of(self._bodies, trajectory)
        last = self._command
        if last is not None:
            if last.doing not in (Doing.DONE, Doing.STANDING):
                raise InputError("the robot still moves: start when it stands or is done")
            away = self.robot.difference(last.at(np.inf).q, path.curve.at(np.zeros(1)).q[0])
            if np.abs(away).max() > _SAME:
                raise InputError(
                    f"the trajectory begins {np.abs(away).max():.3g} rad from where the robot stands"
                )
        prove(trajectory.curve, self.motion)
        self._path, self._command, self._other = path, None, None
        self._cover(trajectory)

    def _cover(self, trajectory: Trajectory) -> None:
        """Have milestones about a trajectory, if other ways may be taken."""
        foreign = own_caps(trajectory)
        self._may_turn = self._detours_wanted and not foreign
        if not self._may_turn:
            if foreign:
                _log.info("no other ways are looked for: nothing proves the cap %r on them", foreign[0].name)
            return
        limits = DriveLimits.of(trajectory)
        if self._detours is None:
            self._detours = Detours(self.motion, self._bodies, limits, self._seed)
        self._detours.keep_to(limits)
        self._detours.roadmap.cover(trajectory.curve)

    def update(
        self, people: Mapping[str, ArrayLike | None], objects: Mapping[str, Any], time: float
    ) -> list[Violation]:
        """Take what sensors saw, and return who moved farther than was promised; then the robot stops.

        Parameters
        ----------
        people : mapping of str to array_like of shape (J, 3)
            Key points of those that were seen, as their skeletons have them; NaN: not seen.
        objects : mapping of str to Pose, pin.SE3 or 4×4 matrix
            Places of the objects that were seen.
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

    def command(self, time: float) -> Command:
        """Return what the robot is to do from a time on; see `Command`.

        Raises
        ------
        InputError
            If nothing was started, or the time is before the last command or the last measurement.
        """
        path, last = self._path, self._command
        if path is None:
            raise InputError("start a trajectory first")
        if not time >= self.surroundings.time or not (last is None or time >= last.time):
            raise InputError(f"time must not go backwards: a command for {time!r} s", "time")
        s, speed, _ = (0.0, 0.0, 0.0) if last is None else last.motion.at(time - last.time)
        found = None
        if self._other is not None:
            way, begin = self._other
            found = self._next(way, max(s - begin, 0.0), speed, time)
            self._other = None
        if found is None:
            found = self._next(path, s, speed, time)
        if found is None:
            found = self._kept(path, s, speed, time)
        self._say(time, found)
        self._path, self._command = found.path, found
        return found

    def think(self, units: int = 60) -> bool:
        """Look for another way, if the one ahead is barred or slow; return whether there is one for the next command.

        To be called after `command`, in the time that is left until the next one. It is taken over where that is
        proven.

        Parameters
        ----------
        units : int
            How much may be done: a look at an edge is 1, a proof of one 8. What was learnt is kept.
        """
        command = self._command
        if command is None or self._detours is None or not self._may_turn or not self.surroundings.known:
            return False
        if command.doing is Doing.DONE:
            return False
        reaction = self.tick + max(0.0, command.time - self.surroundings.time)
        around = Around(self.surroundings.sets, self.people.clearance, reaction)
        self._other = self._detours.other_way(
            command, max(command.time, self.surroundings.time), around, units
        )
        return self._other is not None

    # ----------------------------------------------------------------------------------------------------- proofs

    def _next(self, path: GuardedPath, s: float, speed: float, time: float) -> Command | None:
        """Return the fastest motion from (s, ṡ) that is proven with its stop; None if not even a stop is."""
        measured = self.surroundings.time
        if speed == 0 and s >= path.length - _SAME:
            rest = path.drive(path.length, 0.0, -1.0, self.tick)
            return Command(time, measured, path, rest, Doing.DONE, Left(np.inf))
        if not self.surroundings.known:
            return None
        trouble = self.surroundings.trouble(time, self.lost_after)

        def command(push: float, doing: Doing, reason: str) -> Command | None:
            motion = path.drive(s, speed * speed, push, self.tick)
            since = time - measured
            left = path.left(motion, self.surroundings.sets, since, self.people.clearance)
            self._left = left
            return Command(time, measured, path, motion, doing, left, reason) if left.margin >= 0 else None

        if trouble is None:
            fastest = command(1.0, Doing.MOVING, "")
            if fastest is not None:
                return fastest
            trouble = told(self._left)
            pushes = [-1.0, *_PUSHES]
        else:
            pushes = [-1.0]
        found = None
        for push in pushes:
            if push <= 0 and speed == 0:
                continue
            slower = command(push, Doing.SLOWED if push > -1 else Doing.BRAKING, trouble)
            if slower is None:
                break
            found = slower
        return found

    def _kept(self, path: GuardedPath, s: float, speed: float, time: float) -> Command:
        """Return what is left of the stop that was proven before, or rest."""
        last = self._command
        reason = self.surroundings.trouble(time, self.lost_after) or told(self._left)
        if last is None or speed == 0:
            rest = path.drive(s, 0.0, -1.0, self.tick)
            return Command(time, self.surroundings.time, path, rest, Doing.STANDING, self._left, reason)
        return Command(last.time, last.measured, path, last.motion, Doing.BRAKING, self._left, reason)

    # ------------------------------------------------------------------------------------------------------- log

    def _say(self, time: float, command: Command) -> None:
        before = None if self._command is None else self._command.doing
        if command.doing is before:
            return
        why = f": {command.reason}" if command.reason else ""
        drives = (Doing.MOVING, Doing.SLOWED)
        level = logging.DEBUG if command.doing in drives and before in drives else logging.INFO
        _log.log(level, "%.3f s: %s%s", time, command.doing.value, why)


def told(left: Left) -> str:
    """Return who may come to what, and how much is missing."""
    if left.link is None or left.who is None:
        return "not everybody was seen yet"
    who, limb = left.who
    named = f"{limb} of {who!r}" if limb else repr(who)
    return f"{named} may come to {left.link} before it stands ({1e3 * left.margin:.0f} mm)"
