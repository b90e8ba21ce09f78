"""Way points that slide down the gradient of the danger, at right angles to their way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.plugins.states import StateBridge


class Slide:
    """The null-space motion of the paper's JT-RRT (§4.3) for a straight motion in C-space.

    What the way leaves free turns the links from danger. It acts where α > 0 and the objective offers gradients.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    danger : WeightedDanger
        What to slide away from.

    Attributes
    ----------
    share : float
        Largest sideways slide, as a fraction of a planner's range.
    """

    def __init__(self, bridge: StateBridge, danger: WeightedDanger) -> None:
        self._bridge = bridge
        self._danger = danger
        self.share = 0.0

    @property
    def acts(self) -> bool:
        """Whether way points slide at all."""
        return self.share > 0 and self._danger.weight > 0 and self._danger.cost.has_gradients

    def slid(
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
        if not (self.acts and reach):
            return None
        slope = (gradient() if gradient else self._danger.cost.value_and_gradient(q)[1]) / self._danger.slope
        slope -= (slope @ direction) * direction
        steepness = float(np.sqrt(slope @ slope))
        if not 0 < steepness < np.inf:
            return None
        return self._bridge.inside(q - (reach * min(1.0, steepness) / steepness) * slope)
