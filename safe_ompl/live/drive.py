"""A motion of one tick with its stop, and what is left between it and what moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray


class Left(NamedTuple):
    """The least that is left between a motion and what moves.

    Attributes
    ----------
    margin : float
        Lower bound of distance less growth, less what must be left [m]; +inf if there is nobody.
    link : str or None
    who : (str, str) or None
        Who, and which limb.
    """

    margin: float
    link: str | None = None
    who: tuple[str, str] | None = None


class Drive(NamedTuple):
    """A motion of one tick along a path, and the stop after it.

    Attributes
    ----------
    cells : ndarray of int, shape (W,)
        In which cell each piece of it is.
    places, squares, times : ndarray, shape (W + 1,)
        s, ṡ², and the time since it began [s] where pieces meet.
    """

    cells: IntArray
    places: FloatArray
    squares: FloatArray
    times: FloatArray

    @property
    def duration(self) -> float:
        """When it stands [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> tuple[float, float, float]:
        """Return s, ṡ and s̈ at a time since it began [s]; at rest after its end."""
        if time >= self.duration:
            return float(self.places[-1]), 0.0, 0.0
        k = max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)
        span, since = self.times[k + 1] - self.times[k], max(time, 0.0) - self.times[k]
        speed, after = np.sqrt(self.squares[k]), np.sqrt(self.squares[k + 1])
        push = (after - speed) / span if span > 0 else 0.0
        place = self.places[k] + since * (speed + 0.5 * since * push)
        return float(min(place, self.places[k + 1])), float(max(speed + since * push, 0.0)), float(push)
