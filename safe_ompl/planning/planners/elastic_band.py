"""Elastic bands, and how their way points move down the gradient of the danger."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.problem import DangerWeight, PlanningProblem
from safe_ompl.robot import Coordinates, StateBridge

_POINTS = 8  # at which the danger of a straight motion is evaluated


class TangentialDescent:
    """Moves a way point down the gradient of the danger, at right angles to the motion that leads to it.

    This is the null-space motion of the paper's JT-RRT (§4.3) for a straight motion in joint space: directions in which
    the motion does not lead turn the links away from danger. It acts where α > 0 and the objective offers gradients.
    The sideways motion is at most a `share` of the planner's range.
    """

    def __init__(self, bridge: StateBridge, danger: DangerWeight) -> None:
        self._coordinates = Coordinates(bridge.lower, bridge.upper, bridge.circular, bridge.rotations)
        self._danger = danger
        self.share = 0.0

    @property
    def acts(self) -> bool:
        """Whether way points are moved at all."""
        return self.share > 0 and self._danger.weight > 0 and self._danger.cost.has_gradients

    def moved(self, step: FloatArray, reach: float) -> FloatArray | None:
        """Return, where it acts, the first row of `step: (2, n)` moved down the gradient, at right angles to the other.

        That is a unit vector, and written over. The motion is at most the share of the range `reach`, shorter where the
        danger hardly changes; None where it does not change.
        """
        gradient = self._danger.cost.value_and_gradient(step[0])[1] / self._danger.slope
        return np.asarray(step[1]) if self._coordinates.descend(step, gradient, self.share * reach) else None


class ElasticBand:
    """Treats paths as elastic bands (Quinlan 1994); every new motion is checked."""

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, descent: TangentialDescent) -> None:
        self._problem, self._danger, self._descent = problem, danger, descent

    def settled(self, path: FloatArray, step: float, ptc: Any, margin: float = 0.0) -> FloatArray:
        """Return a path (N, n) contracted where that is as safe, then bent away from danger as by `bent`."""
        band = [path[0]]
        at = 0
        while at < len(path) - 1:
            at = self._farthest(path, at, ptc, margin)
            band += [*self.bent(band[-1], path[at], step, ptc, margin), path[at]]
        return np.array(band)

    def bent(self, start: FloatArray, end: FloatArray, step: float, ptc: Any, margin: float = 0.0) -> list[FloatArray]:
        """Return way points between two configurations (n,): the middle, moved sideways, and those of the halves.

        Motions no longer than twice the range `step` stay straight, and so do those whose halves would not be free, or
        not keep a margin [m].
        """
        delta = self._problem.bridge.difference(start, end)
        length = sqrt(delta @ delta)
        if not self._descent.acts or length <= 2 * step or ptc():
            return []
        middle = self._descent.moved(np.array([self._problem.bridge.moved(start, delta / 2), delta / length]), step)
        is_free = self._problem.motion_is_free
        if middle is None or not (is_free(start, middle, margin) and is_free(middle, end, margin)):
            return []
        halves = ((start, middle), (middle, end))
        before, after = (self.bent(*half, step, ptc, margin) for half in halves)
        return [*before, middle, *after]

    def _farthest(self, path: FloatArray, at: int, ptc: Any, margin: float) -> int:
        """Return the way point to which a straight motion from way point `at`, as safe and free, leads the farthest."""
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
        straight = bridge.moved(path[0], t * bridge.difference(path[0], path[-1]))
        costs = self._danger.cost.values(np.vstack([bridge.wrapped(straight), path]))
        return bool(costs[:_POINTS].mean() <= costs[_POINTS:].mean())
