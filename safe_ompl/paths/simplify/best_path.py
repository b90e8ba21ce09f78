"""The best path of a simplification so far."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.arrays import FloatArray

Better = Callable[[FloatArray, float], None]


class BestPath:
    """The path that was taken last: none is taken whose J is above that of the given path.

    J is known for the danger points that matter near a path when it is offered. When others turn out to matter, it is
    `confirmed` anew, and a path that has become dearer than the given one is taken back.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        The given path.
    on_better : callable, optional
        Told every path that is taken, and its J.

    Attributes
    ----------
    path : ndarray, shape (N', n)
    ceiling : float
        J of the given path.
    """

    def __init__(self, path: FloatArray, on_better: Better | None) -> None:
        self.path = path
        self.ceiling = np.inf
        self._confirmed = path
        self._on_better = on_better

    @property
    def is_confirmed(self) -> bool:
        """Whether J of the path is known for the danger points that matter near it."""
        return self.path is self._confirmed

    def take(self, path: FloatArray, cost: float) -> bool:
        """Take a proven path (N, n), if its J is not too high; return whether it is taken."""
        if not cost <= self.ceiling:
            return False
        self.path = path
        if self._on_better is not None:
            self._on_better(path, cost)
        return True

    def confirm(self, cost: float) -> bool:
        """Say what J of the path is, as is known now; if that is too high, take it back and return False."""
        if cost > self.ceiling:
            self.path = self._confirmed
            return False
        self._confirmed = self.path
        return True
