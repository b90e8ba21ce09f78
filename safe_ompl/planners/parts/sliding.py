"""Motions that slide away from danger on their way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.base import SafePlanner, fraction

_BAND_POINTS = 8


class SlidingPlanner(SafePlanner):
    """A planner whose way points slide down the gradient of the danger, at right angles to the way.

    This is the null-space motion of the paper's JT-RRT (§4.3) for a straight motion in C-space: what the way
    leaves free turns the links from danger. It acts where α > 0 and the objective offers gradients.
    """

    _slide = 0.0

    def setSlide(self, slide: float) -> None:
        """Set the largest sideways slide of a way point, in [0, 1], as a fraction of the range."""
        self._slide = fraction("slide", slide)

    def getSlide(self) -> float:
        """Return the largest sideways slide of a way point, as a fraction of the range."""
        return self._slide

    @property
    def _slides(self) -> bool:
        return self._slide > 0 and self._danger_weight > 0 and self._cost.has_gradients

    def _slid(
        self,
        q: FloatArray,
        direction: FloatArray,
        reach: float,
        gradient: Callable[[], FloatArray] | None = None,
    ) -> FloatArray | None:
        """Return `q: (n,)` moved down the danger's gradient at right angles to `direction: (n,)`, a unit vector.

        By at most `reach`, and by less where the danger hardly changes; None where it does not change at all.
        `gradient` gives another one than that at `q`.
        """
        if not (self._slides and reach):
            return None
        slope = (gradient() if gradient else self._cost.value_and_gradient(q)[1]) / self._cost_scale
        slope -= (slope @ direction) * direction
        steepness = float(np.sqrt(slope @ slope))
        if not 0 < steepness < np.inf:
            return None
        return self._bridge.inside(q - (reach * min(1.0, steepness) / steepness) * slope)

    def _bent(self, start: FloatArray, end: FloatArray, ptc: Any) -> list[FloatArray]:
        """Return way points between two configurations (n,): the middle, slid sideways, and those of the halves.

        Motions no longer than twice the range stay straight, and so do those whose halves would not be free.
        """
        delta = self._bridge.difference(start, end)
        length = float(np.sqrt(delta @ delta))
        if not self._slides or length <= 2 * self.getRange() or ptc():
            return []
        middle = self._slid(start + delta / 2, delta / length, self._slide * self.getRange())
        if middle is None or not (self._motion_is_free(start, middle) and self._motion_is_free(middle, end)):
            return []
        return [*self._bent(start, middle, ptc), middle, *self._bent(middle, end, ptc)]

    def _elastic(self, path: FloatArray, ptc: Any) -> FloatArray:
        """Return the path (N, n) as an elastic band (Quinlan 1994): contracted where as safe, then bent from danger."""
        band = [path[0]]
        at = 0
        while at < len(path) - 1:
            at = self._farthest(path, at, ptc)
            band += [*self._bent(band[-1], path[at], ptc), path[at]]
        return np.array(band)

    def _farthest(self, path: FloatArray, at: int, ptc: Any) -> int:
        """Return the way point to which a straight motion from way point `at` does what the path between does."""
        end = len(path) - 1
        while end > at + 1 and not ptc():
            if self._is_as_safe(path[at : end + 1]) and self._motion_is_free(path[at], path[end]):
                return end
            end = (at + end) // 2
        return at + 1

    def _is_as_safe(self, path: FloatArray) -> bool:
        """Return whether the straight motion between the ends of a path (N, n) is no more dangerous on an average."""
        if not self._danger_weight:
            return True
        t = np.linspace(0.0, 1.0, _BAND_POINTS)[:, None]
        straight = path[0] + t * self._bridge.difference(path[0], path[-1])
        costs = self._cost.values(np.vstack([self._bridge.wrapped(straight), path]))
        return bool(costs[:_BAND_POINTS].mean() <= costs[_BAND_POINTS:].mean())
