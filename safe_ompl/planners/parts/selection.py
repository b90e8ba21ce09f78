"""The choice of the node from which a tree grows."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.tree import Tree


class SafeSelection:
    """Chooses nodes that are near and safe, and now and then the nearest whatever its danger.

    Parameters
    ----------
    danger : WeightedDanger
        The danger with its weight α.

    Attributes
    ----------
    nearest_fraction : float
        ε: share of the choices by distance alone.
    """

    def __init__(self, danger: WeightedDanger) -> None:
        self._danger = danger
        self.nearest_fraction = 0.0

    def best(self, tree: Tree, q: FloatArray, rng: np.random.Generator) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        ignore_danger = self.nearest_fraction > 0 and rng.random() < self.nearest_fraction
        return tree.best(q, 0.0 if ignore_danger else self._danger.weight)
