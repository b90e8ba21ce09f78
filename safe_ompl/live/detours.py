"""Other ways: when the way ahead is barred or slow, one is looked for on the roadmap, and made into a path to drive."""

from __future__ import annotations

import logging
from itertools import pairwise

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.live.around import Around
from safe_ompl.live.command import Command
from safe_ompl.live.guarded_path import GuardedPath
from safe_ompl.live.limits import DriveLimits
from safe_ompl.live.roadmap import Budget, Roadmap
from safe_ompl.live.robot_bodies import RobotBodies
from safe_ompl.trajectories.blends import blended

_log = logging.getLogger(__name__)

_GAIN, _WORTH = (
    0.75,
    0.3,
)  # another way must take less than this share of the time, and be this much quicker [s]
_SLOW = 1.2  # times as long as alone: then another way is looked for
_LONGEST = 30.0  # [s] ways that take longer are not looked for
_SMALL = 1e-6  # [rad]
_TOLERANCE = 0.3  # [rad] of blends: way points of a roadmap mean nothing
_CUTS = 12  # units of work for each straight motion that is tried instead of several edges


class Detours:
    """Looks for ways that are quicker beside people as they stand now.

    Parameters
    ----------
    motion : CertifiedMotion
        Proves what stands still.
    bodies : RobotBodies
        Of the robot.
    limits : DriveLimits
        What other ways keep to, until `keep_to`.
    seed : int
        Of the roadmap.
    """

    def __init__(
        self, motion: CertifiedMotion, bodies: RobotBodies, limits: DriveLimits, seed: int = 0
    ) -> None:
        self._motion, self._bodies, self._limits = motion, bodies, limits
        self._undisturbed: tuple[GuardedPath | None, float] = (
            None,
            0.0,
        )  # a path that needs no look until then [s]
        self.roadmap = Roadmap(motion, bodies, limits, seed=seed)

    def keep_to(self, limits: DriveLimits) -> None:
        """Have other ways keep to other limits from now on."""
        self._limits = limits
        self.roadmap.keep_to(limits)

    def other_way(
        self, command: Command, now: float, people: Around, units: int
    ) -> tuple[GuardedPath, float] | None:
        """Return a path that goes another way from where the stop of a command ends, if that is quicker.

        It begins with what is left of the command's path up to there, so that the robot can go over to it at any time
        before; the arc length of the command's path where it begins is returned as well.

        Parameters
        ----------
        command : Command
            What is being driven.
        now : float
            [s]
        people : Around
            Where they are.
        units : int
            How much may be done for it; where that is not enough, it is gone on with the next time.
        """
        path, budget = command.path, Budget(units)
        rest = float(command.motion.places[-1])
        if path.length - rest < _SMALL:
            return None
        if self._undisturbed[0] is path and now < self._undisturbed[1]:
            return None
        rough = path.coarse
        times, left = rough.pace(people.sets, people.clearance, people.reaction)
        self._undisturbed = path, now + left
        ahead = rough.edges[1:] > rest
        stay, alone = (
            float(times[ahead].sum()),
            float((np.diff(rough.edges) / np.sqrt(rough.squares))[ahead].sum()),
        )
        if stay < _SLOW * alone + _WORTH:
            return None
        start, goal = path.curve.at(np.array([rest, path.length])).q
        within = min(_GAIN * stay, stay - _WORTH, _LONGEST)
        found = self.roadmap.way(start, goal, now, people, within, budget)
        if found is None:
            return None
        points = self._shortened(found[0], people, budget)
        way = GuardedPath.along(
            self._bodies,
            blended(np.array(points), self._motion.checker.robot, _TOLERANCE, self._motion),
            self._limits,
        )
        takes = self._remaining(way, 0.0, people)
        if takes > within:
            return None
        _log.info(
            "%.3f s: another way of %.2f rad takes %.1f s in place of %.1f s", now, way.length, takes, stay
        )
        first = command.motion.at(now - command.time)[0]
        if rest - first <= _SMALL:  # it stands
            return way, rest
        begin = float(path.curve.starts[path.curve.piece_at(np.array([first]))[0]])
        return path.from_to(first, rest).then(way), begin

    def _remaining(self, path: GuardedPath, first: float, people: Around) -> float:
        times, _ = path.coarse.pace(people.sets, people.clearance, people.reaction)
        return float(times[path.coarse.edges[1:] > first].sum())

    def _shortened(self, points: list[FloatArray], people: Around, budget: Budget) -> list[FloatArray]:
        """Return the way without way points that a straight motion can leave out, free and no slower."""
        kept = [points[0]]
        k = 0
        while k < len(points) - 1:
            for other in range(len(points) - 1, k, -1):
                if other == k + 1 or (
                    budget.spend(_CUTS)
                    and self._motion.is_free(points[k], points[other])
                    and self._straight_time([points[k], points[other]], people)
                    <= self._straight_time(points[k : other + 1], people)
                ):
                    kept.append(points[other])
                    k = other
                    break
        return kept

    def _straight_time(self, points: list[FloatArray], people: Around) -> float:
        robot, total = self._motion.checker.robot, 0.0
        for a, b in pairwise(points):
            curve = blended(np.array([a, b]), robot, 0.0, None)
            total += self._remaining(GuardedPath.along(self._bodies, curve, self._limits), 0.0, people)
        return total
