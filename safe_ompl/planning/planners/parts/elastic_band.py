"""Paths as elastic bands: contracted where that is as safe, and bent away from danger."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.parts.danger import DangerWeight
from safe_ompl.planning.planners.parts.extend import TangentialDescent
from safe_ompl.planning.planners.parts.problem import PlanningProblem

_POINTS = 8  # at which the danger of a straight motion is evaluated


class ElasticBand:
    """Treats paths as elastic bands (Quinlan 1994); every new motion is checked.

    Parameters
    ----------
    problem : PlanningProblem
        Says which motions are free.
    danger : DangerWeight
        What the band keeps away from.
    descent : TangentialDescent
        How its way points move.
    """

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, descent: TangentialDescent) -> None:
        self._problem = problem
        self._danger = danger
        self._descent = descent

    def settled(self, path: FloatArray, step: float, ptc: Any, margin: float = 0.0) -> FloatArray:
        """Return a path (N, n) contracted where that is as safe, then bent away from danger.

        Parameters
        ----------
        path : ndarray, shape (N, n)
            Configurations whose motions are free.
        step : float
            Range of the planner [rad]: motions longer than twice that are bent.
        ptc : ob.PlannerTerminationCondition
            When to stop.
        margin : float
            What new motions must keep from obstacles [m].
        """
        band = [path[0]]
        at = 0
        while at < len(path) - 1:
            at = self._farthest(path, at, ptc, margin)
            band += [*self.bent(band[-1], path[at], step, ptc, margin), path[at]]
        return np.array(band)

    def bent(
        self, start: FloatArray, end: FloatArray, step: float, ptc: Any, margin: float = 0.0
    ) -> list[FloatArray]:
        """Return way points between two configurations (n,): the middle, moved sideways, and those of the halves.

        Motions no longer than twice the range `step` stay straight, and so do those whose halves would not be free, or
        not keep a margin [m].
        """
        delta = self._problem.bridge.difference(start, end)
        length = float(np.sqrt(delta @ delta))
        if not self._descent.acts or length <= 2 * step or ptc():
            return []
        middle = self._descent.moved(start + delta / 2, delta / length, self._descent.share * step)
        is_free = self._problem.motion_is_free
        if middle is None or not (is_free(start, middle, margin) and is_free(middle, end, margin)):
            return []
        halves = ((start, middle), (middle, end))
        before, after = (self.bent(*half, step, ptc, margin) for half in halves)
        return [*before, middle, *after]

    def _farthest(self, path: FloatArray, at: int, ptc: Any, margin: float) -> int:
        """Return the way point to which a straight motion from way point `at` does what the path between does.

        The motion keeps the margin [m].
        """
        end = len(path) - 1
        while end > at + 1 and not ptc():
            is_as_safe = self._is_as_safe(path[at : end + 1])
            if is_as_safe and self._problem.motion_is_free(path[at], path[end], margin):
                return end
            end = (at + end) // 2
        return at + 1

    def _is_as_safe(self, path: FloatArray) -> bool:
        """Return whether the straight motion between the ends of a path (N, n) is no more dangerous on an average."""
        if not self._danger.weight:
            return True
        bridge = self._problem.bridge
        t = np.linspace(0.0, 1.0, _POINTS)[:, None]
        straight = path[0] + t * bridge.difference(path[0], path[-1])
        costs = self._danger.cost.values(np.vstack([bridge.wrapped(straight), path]))
        return bool(costs[:_POINTS].mean() <= costs[_POINTS:].mean())
