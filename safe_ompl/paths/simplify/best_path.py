"""The best path of a simplification so far."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray

Better = Callable[[FloatArray, float], None]


class Price(NamedTuple):
    """What a path costs: `cost`, its J, and `total`, with the obstacle cost."""

    cost: float
    total: float


class BestPath:
    """The best path so far: none is taken whose J is above that of the given path, or its total above `total`.

    Prices are those for the danger points that matter near a path when it is offered. When others turn out to matter,
    the price is `confirmed` anew, and a path that has become dearer than the given one is taken back.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        The given path.
    on_better : callable, optional
        Told every better path, and its J.

    Attributes
    ----------
    path : ndarray, shape (N', n)
    ceiling : float
        J of the given path.
    total : float
        What no other path may cost more than, obstacle cost included: what the best one costs, as a rule.
    """

    def __init__(self, path: FloatArray, on_better: Better | None) -> None:
        self.path = path
        self.ceiling = self.total = np.inf
        self._confirmed = path
        self._on_better = on_better

    @property
    def is_confirmed(self) -> bool:
        """Whether the price of the path is known for the danger points that matter near it."""
        return self.path is self._confirmed

    def take(self, path: FloatArray, price: Price) -> bool:
        """Take a proven path (N, n), if its price allows; return whether it does."""
        if not (price.cost <= self.ceiling and price.total <= self.total):
            return False
        self.path, self.total = path, price.total
        if self._on_better is not None:
            self._on_better(path, price.cost)
        return True

    def confirm(self, price: Price) -> bool:
        """Set what the path costs, as is known now; return False if that is too dear and another one is the best."""
        if price.cost > self.ceiling:
            self.path = self._confirmed
            return False
        self._confirmed, self.total = self.path, price.total
        return True
