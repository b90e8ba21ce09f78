"""Base of the safe planners: the weight α of danger, and motions that slide away from it and keep a margin."""

from __future__ import annotations

from typing import Any

from safe_ompl.inputs import fraction, number
from safe_ompl.planners.base import SafePlanner
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.margin import Margin
from safe_ompl.planners.parts.patience import Patience
from safe_ompl.planners.parts.slide import Slide


class WeighingPlanner(SafePlanner):
    """Base of the planners that weigh danger against lengths by α; their motions slide away from it and keep a margin.

    Parameters
    ----------
    si, name
        As for `SafePlanner`.
    """

    def __init__(self, si: Any, name: str) -> None:
        super().__init__(si, name)
        self._danger = WeightedDanger(self._task)
        self._slide = Slide(self._bridge, self._danger)
        self._patience = Patience(self._danger)
        self._margin = Margin(self._task, self._danger)

    def setup(self) -> None:
        """Prepare for `solve`: read the problem's objective, and measure its scale if danger has weight."""
        super().setup()
        self._danger.prepare()

    def setAlpha(self, alpha: float) -> None:
        """Set the weight of danger α, in the robot's own scale; 0 plans classically."""
        self._danger.alpha = number("alpha", alpha, at_least=0)

    def getAlpha(self) -> float:
        """Return the weight of danger α."""
        return self._danger.alpha

    def setClearance(self, distance: float) -> None:
        """Set the largest clearance [m] that motions should keep, as long as that costs no solution; 0 for none."""
        self._margin.largest = number("clearance", distance, at_least=0)

    def getClearance(self) -> float:
        """Return the largest clearance [m] that motions should keep."""
        return self._margin.largest

    def setSlide(self, slide: float) -> None:
        """Set the largest sideways slide of a way point, in [0, 1], as a fraction of the range."""
        self._slide.share = fraction("slide", slide)

    def getSlide(self) -> float:
        """Return the largest sideways slide of a way point, as a fraction of the range."""
        return self._slide.share

    def setPatience(self, turns: float) -> None:
        """Set after how many turns danger has half its say, so that it never costs a solution; 0: it never yields."""
        self._patience.half_life = number("patience", turns, at_least=0)

    def getPatience(self) -> float:
        """Return after how many turns danger has half its say."""
        return self._patience.half_life
