"""The replanner: at every tick a motion that is proven until the next one, and can always stop on its path."""

from __future__ import annotations

import logging

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import InputError
from safe_ompl.people.replanning.detours import Detours, PeopleNow
from safe_ompl.people.replanning.guard import Command, Doing, Guard
from safe_ompl.people.replanning.guarded_path import GuardedPath, PathLimits, own_caps
from safe_ompl.people.replanning.retreat import Retreats
from safe_ompl.trajectories import BlendedCurve, BlendProof, Trajectory

_log = logging.getLogger(__name__)

_CRAWL = 0.3  # [rad/s] a robot that is slower tries whether a retreat gets
_FARTHER = 2.0  # so many times as far
_SAME = 1e-6  # [rad] configurations nearer than this are one


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

    _path: GuardedPath | None = None
    _detour: tuple[GuardedPath, float] | None = None  # and where on the path it begins
    _retreat: GuardedPath | None = None  # from where the robot stands
    _detours: Detours | None = None
    _retreats: Retreats | None = None
    _may_turn = False

    @property
    def detours(self) -> Detours | None:
        """What searches detours; None before the first trajectory on which they are allowed."""
        return self._detours

    # ----------------------------------------------------------------------------------------------- what is called

    def start(self, trajectory: Trajectory) -> None:
        """Take a trajectory to follow, from where the robot stands.

        Its curve is proven anew against all still obstacles. Its limits and caps are kept, except those by people; its
        time law is not.

        Raises
        ------
        InputError
            If the robot moves, or stands elsewhere; if the trajectory is of other joints, or not free.
        """
        if trajectory.joint_names != self.robot.joint_names:
            raise InputError(
                f"the trajectory is of the joints {trajectory.joint_names}, the robot's are {self.robot.joint_names}"
            )
        path = GuardedPath.of(self.bodies, trajectory)
        last = self._last
        if last is not None:
            if last.doing not in (Doing.DONE, Doing.STANDING):
                raise InputError("the robot still moves: start when it stands or is done")
            away = self.robot.difference(last.at(np.inf).q, path.curve.at(np.zeros(1)).q[0])
            if np.abs(away).max() > _SAME:
                raise InputError(
                    f"the trajectory begins {np.abs(away).max():.3g} rad from where the robot stands"
                )
        _prove(trajectory.curve, self.prover)
        self._path, self._last, self._detour, self._retreat = path, None, None, None
        self._cover(trajectory)

    def _cover(self, trajectory: Trajectory) -> None:
        """Add milestones around a trajectory, if detours may be taken."""
        caps = own_caps(trajectory)
        self._retreats = None
        if self.options.retreats and not caps and not self.prover.separation.tube:
            self._retreats = Retreats(self.prover, self.bodies, PathLimits.of(trajectory))
        self._may_turn = self.options.detours and not caps
        if not self._may_turn:
            if caps:
                _log.info("no detours are searched: nothing proves the cap %r on them", caps[0].name)
            return
        limits = PathLimits.of(trajectory)
        if self._detours is None:
            self._detours = Detours(self.prover, self.bodies, limits, self.options.seed)
        self._detours.keep_to(limits)
        self._detours.roadmap.cover(trajectory.curve)

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
        reaction = self.tick + max(0.0, command.time - self.surroundings.time)
        now = max(command.time, self.surroundings.time)
        people = PeopleNow(self.surroundings.sets, self.people.clearance, reaction, now, self.contact)
        if self._detours is not None and self._may_turn:
            self._detour = self._detours.search(command, people, units)
        if self._detour is None and self._retreats is not None and command.doing is Doing.STANDING:
            at = float(command.motion.places[-1])
            self._retreat = self._retreats.search(command.path, at, people.sets)
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


def _prove(curve: BlendedCurve, prover: MotionProver) -> None:
    """Raise InputError unless all of a curve is proven free of still obstacles."""
    blends = BlendProof(prover)
    for k, piece in enumerate(curve.pieces):
        if piece.straight:
            free = prover.is_free(piece.start, piece.start + piece.length * piece.slope)
        else:
            free = blends.holds(piece)
        if not free:
            raise InputError(
                f"piece {k} of the trajectory, from {piece.start.round(3).tolist()} on, is not free of what stands "
                "still"
            )
