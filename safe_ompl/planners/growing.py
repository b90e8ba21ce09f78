"""Base of the safe RRTs: trees that grow from safe nodes, by steps that keep to a threshold and a margin."""

from __future__ import annotations

from typing import Any

from safe_ompl.inputs import flag, fraction, number
from safe_ompl.planners.parts.margin import AdaptiveMargin
from safe_ompl.planners.parts.selection import SafeSelection
from safe_ompl.planners.parts.threshold import AdaptiveThreshold
from safe_ompl.planners.weighing import WeighingPlanner


class GrowingPlanner(WeighingPlanner):
    """Base of the planners whose trees grow from nodes that are near and safe.

    Parameters
    ----------
    si, name
        As for `SafePlanner`.
    """

    def __init__(self, si: Any, name: str) -> None:
        super().__init__(si, name)
        self._selection = SafeSelection(self._danger)
        self._threshold = AdaptiveThreshold(self._danger)
        self._margin: AdaptiveMargin = AdaptiveMargin(self._task, self._danger)

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of selections by distance alone."""
        self._selection.nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of selections by distance alone."""
        return self._selection.nearest_fraction

    def setThresholdRise(self, share: float) -> None:
        """Set by what share the adaptive threshold on danger rises after eight refusals; 0 for no threshold."""
        self._threshold.rise = number("threshold_rise", share, at_least=0)

    def getThresholdRise(self) -> float:
        """Return by what share the adaptive threshold on danger rises."""
        return self._threshold.rise

    def setRawAlpha(self, raw: bool) -> None:
        """Set whether α is taken as it is, in length per danger."""
        self._danger.is_raw = flag("raw_alpha", raw)

    def getRawAlpha(self) -> bool:
        """Return whether α is taken as it is."""
        return self._danger.is_raw
