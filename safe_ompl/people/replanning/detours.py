"""Detours: when the path ahead is barred or slow, a quicker one is searched on the roadmap."""

from __future__ import annotations

import logging
from itertools import pairwise

import numpy as np

from safe_ompl.collision import CertifiedMotion
from safe_ompl.common import FloatArray
from safe_ompl.people.replanning.command import Command
from safe_ompl.people.replanning.guarded_path import GuardedPath, PathLimits, RobotBodies
from safe_ompl.people.replanning.roadmap import Budget, PeopleNow, Roadmap
from safe_ompl.trajectories import blended

_log = logging.getLogger(__name__)

# A detour must take less than this share of the time, and be this much quicker [s].
_GAIN, _WORTH = 0.75, 0.3
_SLOW = 1.2  # times as long as with nobody near: then a detour is searched
_LONGEST = 30.0  # [s] detours that take longer are not wanted
_SMALL = 1e-6  # [rad]
_TOLERANCE = 0.3  # [rad] of blends: the way points of a roadmap need not be met
_CUTS = 12  # units of work for each straight motion that is tried instead of several edges


class Detours:
    """Searches paths that are quicker beside people as they are now.

    Parameters
    ----------
    motion : CertifiedMotion
        Proves motions among still obstacles.
    bodies : RobotBodies
        The robot's.
    limits : PathLimits
        The limits that detours keep, until `keep_to`.
    seed : int
        Seed of the roadmap.
    """

    def __init__(
        self, motion: CertifiedMotion, bodies: RobotBodies, limits: PathLimits, seed: int = 0
    ) -> None:
        self._motion, self._bodies, self._limits = motion, bodies, limits
        # A path that nobody can slow down before a time [s].
        self._undisturbed: tuple[GuardedPath | None, float] = (None, 0.0)
        self.roadmap = Roadmap(motion, bodies, limits, seed=seed)

    def keep_to(self, limits: PathLimits) -> None:
        """Have detours keep other limits from now on."""
        self._limits = limits
        self.roadmap.keep_to(limits)

    def search(self, command: Command, people: PeopleNow, units: int) -> tuple[GuardedPath, float] | None:
        """Return a quicker path to the goal that leaves the command's path where its stop ends; None if none is found.

        It begins with the rest of the command's path up to there, so that the robot can change over at any time before
        that. The arc length of the command's path at which it begins is returned as well.

        Parameters
        ----------
        command : Command
            What the robot follows.
        people : PeopleNow
            Where they are.
        units : int
            How much work may be done; the next call goes on where this one ended.
        """
        now = people.time
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
        found = self.roadmap.quickest(start, goal, people, within, budget)
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
        _log.info("%.3f s: a detour of %.2f rad takes %.1f s instead of %.1f s", now, way.length, takes, stay)
        first = command.motion.at(now - command.time)[0]
        if rest - first <= _SMALL:  # it stands
            return way, rest
        begin = float(path.curve.starts[path.curve.piece_at(np.array([first]))[0]])
        return path.from_to(first, rest).then(way), begin

    def _remaining(self, path: GuardedPath, first: float, people: PeopleNow) -> float:
        times, _ = path.coarse.pace(people.sets, people.clearance, people.reaction)
        return float(times[path.coarse.edges[1:] > first].sum())

    def _shortened(self, points: list[FloatArray], people: PeopleNow, budget: Budget) -> list[FloatArray]:
        """Return the path without the points that a free and no slower straight motion can leave out."""
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

    def _straight_time(self, points: list[FloatArray], people: PeopleNow) -> float:
        robot, total = self._motion.checker.robot, 0.0
        for a, b in pairwise(points):
            curve = blended(np.array([a, b]), robot, 0.0, None)
            total += self._remaining(GuardedPath.along(self._bodies, curve, self._limits), 0.0, people)
        return total
