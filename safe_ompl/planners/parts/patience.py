"""How long a planner heeds danger: less and less, the longer it finds no path."""

from __future__ import annotations

import numpy as np

from safe_ompl.planners.parts.danger import WeightedDanger


class Patience:
    """Lets danger yield where it keeps a planner out of narrow places, so that heeding it never costs a solution.

    After `half_life` turns every second one is as in the classical planner, after twice as many three of four. So what
    heeding danger costs in a hard problem is bounded: about `half_life` turns of it.

    Parameters
    ----------
    danger : WeightedDanger
        What yields.

    Attributes
    ----------
    half_life : float
        In turns; 0: danger never yields.
    """

    def __init__(self, danger: WeightedDanger) -> None:
        self._danger = danger
        self.half_life = 0.0
        self._turns = 0

    def reset(self) -> None:
        """Begin anew, with danger heeded in full."""
        self._turns = 0
        self._danger.heed = 1.0

    def turn(self, rng: np.random.Generator) -> None:
        """Begin a turn: danger is heeded in it, or not at all, by chance."""
        if self._yields:
            self._danger.heed = float(rng.random() < self._share)
            self._turns += 1

    def fade(self) -> None:
        """Begin a turn: danger is heeded in it, but less than in the one before."""
        if self._yields:
            self._danger.heed = self._share
            self._turns += 1

    @property
    def _yields(self) -> bool:
        return self.half_life > 0 and self._danger.alpha > 0

    @property
    def _share(self) -> float:
        return float(2.0 ** (-self._turns / self.half_life))
