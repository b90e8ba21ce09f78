"""The replanner: at every tick a motion that is proven until the next one, and can always stop on its path."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import InputError
from safe_ompl.inputs import number, positive
from safe_ompl.live.command import Command, Doing
from safe_ompl.live.guarded_path import Drive, GuardedPath, Left, RobotBodies
from safe_ompl.live.surroundings import Surroundings
from safe_ompl.people.reach import ReachModel
from safe_ompl.people.tracking import Tracker, Violation
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.people import People
from safe_ompl.scene.scene import Scene
from safe_ompl.trajectories.blends import ArcProof
from safe_ompl.trajectories.curve import BlendedCurve
from safe_ompl.trajectories.trajectory import Trajectory

_log = logging.getLogger(__name__)

TICK = 0.05  # [s]
_HALVINGS = 3  # of how hard to push; the 8 steps that are left between braking and speeding up are enough
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

    Raises
    ------
    UnknownNameError
        If the scene has no obstacle of a name in `objects`.
    InputError
        If a number is out of its range.
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
    ) -> None:
        self.robot = robot
        self.people = People() if people is None else people
        self.tick = positive(tick, "tick", "number of seconds")
        self.lost_after = number("lost_after", lost_after, above=0.0)
        self.surroundings = Surroundings(scene, trackers, objects or {}, self.people, reach)
        self.still = self.surroundings.still
        self.motion = CertifiedMotion(CollisionChecker(robot, self.still))
        self._bodies = RobotBodies(robot)
        self._path: GuardedPath | None = None
        self._command: Command | None = None

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
        _prove(trajectory.curve, self.motion)
        self._path, self._command = path, None

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
        for violation in violations:
            _log.warning("%.3f s: %s: stop", time, violation)
        return violations

    def command(self, time: float) -> Command:
        """Return what the robot is to do from a time on; see `Command`.

        Raises
        ------
        InputError
            If nothing was started, or the time is before the last command or the last measurement.
        """
        path = self._path
        if path is None:
            raise InputError("start a trajectory first")
        if not time >= self.surroundings.time or not (self._command is None or time >= self._command.time):
            raise InputError(f"time must not go backwards: a command for {time!r} s", "time")
        found = self._next(path, time)
        self._say(time, found)
        self._command = found
        return found

    # ----------------------------------------------------------------------------------------------------- proofs

    def _next(self, path: GuardedPath, time: float) -> Command:
        last = self._command
        s, speed, _ = (0.0, 0.0, 0.0) if last is None else last.motion.at(time - last.time)
        measured = self.surroundings.time
        if speed == 0 and s >= path.length - _SAME:
            return Command(
                time, measured, path, path.drive(path.length, 0.0, 0.0, self.tick), Doing.DONE, Left(np.inf)
            )
        trouble = self.surroundings.trouble(time, self.lost_after)
        push, motion, left = self._fastest(path, s, speed, time, trouble is not None)
        if motion is None:
            if last is None or speed == 0:
                rest = path.drive(s, 0.0, -1.0, self.tick)
                return Command(time, measured, path, rest, Doing.STANDING, left, trouble or _told(left))
            reason = trouble or _told(left)
            return Command(last.time, last.measured, path, last.motion, Doing.BRAKING, left, reason)
        doing = Doing.MOVING if push == 1 else Doing.SLOWED
        if push == -1:
            doing = Doing.BRAKING if speed > 0 else Doing.STANDING
        return Command(
            time, measured, path, motion, doing, left, trouble or ("" if push == 1 else _told(self._forbids))
        )

    def _fastest(
        self, path: GuardedPath, s: float, speed: float, time: float, must_stop: bool
    ) -> tuple[float, Drive | None, Left]:
        """Return the fastest proven motion from (s, ṡ), how hard it pushes, and what is left along it."""
        tried: dict[float, tuple[Drive, Left]] = {}

        def proven(push: float) -> bool:
            motion = path.drive(s, speed * speed, push, self.tick)
            tried[push] = motion, path.left(motion, sets, since, self.people.clearance)
            return tried[push][1].margin >= 0

        if not self.surroundings.known:
            return -1.0, None, Left(np.inf)
        sets, since = self.surroundings.sets, time - self.surroundings.time
        if not must_stop and proven(1.0):
            return 1.0, *tried[1.0]
        self._forbids = tried[1.0][1] if 1.0 in tried else Left(np.inf)
        if speed == 0 and must_stop:
            return -1.0, None, self._forbids
        good, bad = -1.0, 1.0
        if speed == 0:
            good = 0.0
        elif not proven(good):
            return good, None, tried[good][1]
        if not must_stop:
            for _ in range(_HALVINGS):
                middle = 0.5 * (good + bad)
                if proven(middle):
                    good = middle
                else:
                    bad = middle
        if good == 0 and speed == 0:
            return good, None, self._forbids
        return good, *tried[good]

    # ------------------------------------------------------------------------------------------------------- log

    def _say(self, time: float, command: Command) -> None:
        before = None if self._command is None else self._command.doing
        if command.doing is before:
            return
        why = f": {command.reason}" if command.reason else ""
        level = logging.DEBUG if command.doing is Doing.SLOWED else logging.INFO
        _log.log(level, "%.3f s: %s%s", time, command.doing.value, why)


def _told(left: Left) -> str:
    """Return who may come to what, and how much is missing."""
    if left.link is None or left.who is None:
        return "not everybody was seen yet"
    who, limb = left.who
    named = f"{limb} of {who!r}" if limb else repr(who)
    return f"{named} may come to {left.link} before it stands ({1e3 * left.margin:.0f} mm)"


def _prove(curve: BlendedCurve, motion: CertifiedMotion) -> None:
    """Raise InputError unless all of a curve is proven free of what stands still."""
    arcs = ArcProof(motion)
    for k, piece in enumerate(curve.pieces):
        if piece.curvature:
            free = arcs.holds(piece)
        else:
            end: FloatArray = piece.start + piece.length * piece.forward
            free = motion.is_free(piece.start, end)
        if not free:
            raise InputError(
                f"piece {k} of the trajectory, from {piece.start.round(3).tolist()} on, is not free of what stands "
                "still"
            )
