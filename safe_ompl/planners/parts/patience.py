"""A schedule of how much danger is heeded: less and less, the longer no path is found."""

from __future__ import annotations

import numpy as np

from safe_ompl.planners.parts.danger import WeightedDanger

_SHARPNESS = 4  # easy problems are solved before danger begins to yield


class Patience:
    """Lets danger yield where it keeps a planner out of narrow places, so that heeding it never costs a solution.

    Of t turns the share 1/(1 + (t/`half_life`)⁴) heeds danger: nearly all at first, half of them after `half_life`, one
    in a hundred after three times as many. So easy problems are planned as ever, and what heeding danger costs in a
    hard one is bounded: about `half_life` turns of it.

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
        return self.half_life > 0 and self._danger.alpha > 0 and not self._danger.cost.is_zero

    @property
    def _share(self) -> float:
        return 1.0 / (1.0 + (self._turns / self.half_life) ** _SHARPNESS)
