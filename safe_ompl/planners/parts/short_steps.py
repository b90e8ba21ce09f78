"""Shorter steps, where whole ones are trapped."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.plugins.states import StateBridge

_SHORTEST = 0.05  # of a whole step


class ShortSteps:
    """Decides where a shorter step is tried after a whole one was trapped, and how long it is.

    It leads out of narrow places; elsewhere it would double the checks and make for paths that graze obstacles. So
    where danger is heeded only nodes whose last step was trapped, too, get one.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    danger : WeightedDanger
        Whether danger is heeded.

    Attributes
    ----------
    allowed : bool
        Whether shorter steps are tried at all.
    """

    def __init__(self, bridge: StateBridge, danger: WeightedDanger) -> None:
        self._bridge = bridge
        self._danger = danger
        self.allowed = False

    def help(self, tree: Tree, node: int) -> bool:
        """Note that a step from a node was trapped; return whether a shorter one is to be tried."""
        if not self.allowed:
            return False
        narrow = node in tree.trapped
        tree.trapped.add(node)
        return narrow or not self._danger.weight

    def nearer(self, q: FloatArray, target: FloatArray, step: float, rng: np.random.Generator) -> FloatArray:
        """Return a configuration (n,) on the way to a target, log-uniformly nearer than a whole step [rad]."""
        delta = self._bridge.difference(q, target)
        length = float(np.sqrt(delta @ delta))
        step = _SHORTEST ** rng.random() * min(length, step)
        return self._bridge.inside(q + (step / length) * delta) if length else q
