"""Places that are made step by step, and looked up at any time in between."""

from __future__ import annotations

from collections.abc import Callable

from safe_ompl.arrays import FloatArray

_FORGOTTEN = 1000  # steps after which those of more than a second ago are forgotten


class Stepwise:
    """A sequence of arrays, each made from the one before, linear in between.

    Parameters
    ----------
    first : ndarray
        At time 0.
    after : callable
        Makes the next one from the last one.
    step : float
        Time between two [s].
    """

    def __init__(self, first: FloatArray, after: Callable[[FloatArray], FloatArray], step: float) -> None:
        self._known, self._after, self._step = [first], after, step
        self._first = 0  # step of the first one that is kept

    def at(self, time: float) -> FloatArray:
        """Return the array at a time [s], no earlier than a second before the latest that was asked for."""
        place = max(time, 0.0) / self._step - self._first
        k = max(int(place), 0)
        while len(self._known) <= k + 1:
            self._known.append(self._after(self._known[-1]))
        share = place - k
        kept = k - round(1 / self._step)
        if kept > _FORGOTTEN:
            del self._known[:kept]
            self._first, k = self._first + kept, k - kept
        found: FloatArray = (1 - share) * self._known[k] + share * self._known[k + 1]
        return found
