"""One run of the simplifier on one path: shortcuts, retreats from its ends, descent, and all that once more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from safe_ompl.collision import CertifiedMotion
from safe_ompl.common import FloatArray, StaleSceneError
from safe_ompl.paths.simplify.cost import DangerDensity
from safe_ompl.paths.simplify.descent import FeasibleSet, FreeGoal, GoalSet
from safe_ompl.paths.simplify.edges import EdgeProofs, divided, path_length, refined
from safe_ompl.paths.simplify.obstacle_cost import ActiveSetCost, ObstacleCost
from safe_ompl.paths.simplify.proven_descent import BestPath, Better, ProvenDescent, Terms
from safe_ompl.paths.simplify.shortcuts import joined, retreat, shortcut
from safe_ompl.robot import Robot

_SAME = 1e-4  # [m] clearances that differ by less are the same
_FEW = 14  # way points between which shortcuts are looked for after the descent
_WORTHWHILE = 0.08  # share of the cost that shortcuts after the descent must save to be taken
_ALLOWANCE = 1.3  # clearance below this times that of the nearer end costs most

Stop = Callable[[], bool]


@dataclass(frozen=True)
class Settings:
    """Settings of all runs of a `Simplifier`."""

    motion: CertifiedMotion
    danger: DangerDensity
    obstacle_cost: ObstacleCost | None
    spacing: float
    precision: float
    length_factor: float


class SimplificationRun:
    """A run that lowers the cost of one path, step by proven step, the cheapest gains first.

    Parameters
    ----------
    settings : Settings
        What counts.
    path : ndarray, shape (N, n)
        Unrolled.
    stop : callable
        Asked between steps; when it returns True, that is the end.
    on_better : callable, optional
        Told every better path, and its J.
    goal : GoalSet, optional
        Where the last way point may move.
    proven : bool
        Whether the path is proven already.

    Raises
    ------
    InputError
        If the path is not proven free.
    """

    def __init__(
        self,
        settings: Settings,
        path: FloatArray,
        stop: Stop,
        on_better: Better | None,
        goal: GoalSet | None,
        *,
        proven: bool,
    ) -> None:
        self._settings = settings
        self._revisions = settings.motion.checker.revision, settings.danger.field.revision
        self._robot = settings.danger.field.robot
        self._stop = stop
        self._best = BestPath(path, on_better)
        self._goal_is_free = goal is not None
        self._feasible = FeasibleSet(self._robot) if goal is None else FreeGoal(goal)
        self._proofs = EdgeProofs(settings.motion, stop)
        if proven:
            self._proofs.accept(path)
        else:
            self._proofs.check(path)
        longest = settings.length_factor * path_length(path)
        self._terms = Terms(self._proofs, self._feasible, longest, settings.precision)

    @property
    def best(self) -> FloatArray:
        """The best path (N', n) so far: always proven, and not above the given path's J as far as is known."""
        return self._best.path

    def improve(self) -> None:
        """Make the path cheaper until the cost falls no more.

        Raises
        ------
        StaleSceneError
            If obstacles have moved since the run began.
        """
        if self._revisions != (self._settings.motion.checker.revision, self._settings.danger.field.revision):
            raise StaleSceneError("obstacles have moved since this run began: begin another one")
        if self._stop():
            return
        self._look_around()
        self._shorten()
        self._descend()
        if not self._stop() and self._shorten_anew():
            self._descend()

    def _descend(self) -> None:
        """Leave ends that need it, and descend."""
        if self._stop() or not path_length(self.best):
            return  # where the start is the goal, nothing is shorter
        shortened = self._divided(self.best)
        if self._descend_between_retreats(shortened) or self._stop():
            return
        descent = self._descent(shortened, (shortened[:1], shortened[-1:]))
        descent.leads = True
        descent.run()

    def _look_around(self) -> None:
        """Find out what the given path keeps from obstacles, and what it costs."""
        self._obstacles = self._settings.obstacle_cost
        if self._obstacles is not None:
            ends, least = self._obstacles.clearances(self.best)
            self._obstacles = self._obstacles.afresh(_ALLOWANCE * ends)
            self._proofs.keep(max(0.0, least - _SAME) if np.isfinite(least) else 0.0)
        self._cost = ActiveSetCost(self._settings.danger, self._obstacles, self.best)
        self._best.ceiling = self._cost.of(self.best)

    def _shorten(self) -> None:
        """Take shortcuts between the way points of the given path."""
        shorter = self._shortcut(shortcut, self.best)
        if shorter is None or path_length(shorter) > self._terms.longest:
            return
        self._cost.look_at(shorter)  # where the given path has not been, other danger points may matter
        cost = self._cost.of(shorter)
        if self._best.take(shorter, cost):
            self._best.confirm(cost)

    def _shorten_anew(self) -> bool:
        """Take shortcuts between way points that have descended, if they lead out of a poor minimum; return whether."""
        before = self._cost.of(self.best)
        shorter = self._shortcut(partial(shortcut, most=_FEW), self.best)
        if shorter is None or path_length(shorter) > self._terms.longest:
            return False
        self._cost.look_at(shorter)
        cost = self._cost.of(shorter)
        if cost > (1.0 - _WORTHWHILE) * before or not self._best.take(shorter, cost):
            return False
        self._best.confirm(cost)
        return True

    def _descend_between_retreats(self, path: FloatArray) -> bool:
        """Leave ends that are near obstacles by retreats, and descend between; return whether that is the best."""
        start = self._retreat(path[0])
        goal = path[-1:] if self._goal_is_free else self._retreat(path[-1])
        apart = np.linalg.norm(self._robot.difference(start[0], goal[0]))
        if len(start) == len(goal) == 1 or apart <= path_length(start) + path_length(goal):
            return False  # nothing to leave, or nowhere to go from there
        if self._proofs.refused(start) or self._proofs.refused(goal[::-1]):
            return False
        between = self._shortcut(joined, np.concatenate([start[-1:], path[1:-1], goal[-1:]]))
        if between is None or sum(map(path_length, (start, between, goal))) > self._terms.longest:
            return False
        if self._stop():
            return False
        goal = goal[::-1] + (between[-1] - goal[-1])  # continuous joints may have been unwound
        descent = self._descent(self._divided(between), (start, goal))
        # Ends that are left well may cost more than shortcuts, though not more than the given path.
        whole = np.concatenate([start[:-1], between, goal[1:]])
        descent.leads = self._best.take(whole, descent.price.cost)
        descent.run()
        return descent.leads

    def _retreat(self, end: FloatArray) -> FloatArray:
        if self._obstacles is None:
            return end[None]
        return retreat(end, self._obstacles, self._settings.danger.field, self._feasible, self._stop)

    def _shortcut(self, method: Callable[..., FloatArray | None], path: FloatArray) -> FloatArray | None:
        found = method(path, self._cost.danger, self._proofs, self._stop)
        return None if found is None else unrolled(self._robot, found)

    def _divided(self, path: FloatArray) -> FloatArray:
        """Return the same path with way points where the descent needs them."""
        path = divided(path, self._settings.spacing)
        if self._obstacles is not None:
            path = refined(path, self._obstacles.near)
        self._proofs.inherit(path)
        return path

    def _descent(self, path: FloatArray, retreats: tuple[FloatArray, FloatArray]) -> ProvenDescent:
        """Return the descent of a path (N, n) between two that stay."""
        start, goal = retreats
        self._cost.look_at(np.concatenate([start[:-1], path, goal[1:]]))
        return ProvenDescent(path, retreats, self._cost, self._terms, self._best, self._stop)


def unrolled(robot: Robot, path: FloatArray) -> FloatArray:
    """Return the path (N, n) with continuous joints that do not jump where they wrap; the others stay as they are."""
    steps = path[1:] - path[:-1]
    turns = np.rint((robot.difference(path[:-1], path[1:]) - steps) / (2.0 * np.pi))
    found: FloatArray = path.copy()
    found[1:] += 2.0 * np.pi * np.cumsum(turns, axis=0)
    return found
