"""What the safe RRTs share: the choice of a safe node, and EXTEND."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.base import fraction
from safe_ompl.planners.growing import Extension, TreePlanner
from safe_ompl.planners.tree import Tree


class SafeRRT(TreePlanner):
    """Base of the planners that grow trees from nodes which are near and safe (§4.3, §4.4)."""

    _nearest_fraction = 0.0

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of selections by distance alone."""
        self._nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of selections by distance alone."""
        return self._nearest_fraction

    def _select(self, tree: Tree, q: FloatArray) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        ignore_danger = self._rng.random() < self._nearest_fraction
        return tree.best(q, 0.0 if ignore_danger else self._danger_weight)

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND: one step of at most the range from node `old` towards `target`."""
        q_old = tree.configurations[old]
        delta = self._bridge.difference(q_old, target)
        length, step = float(np.sqrt(delta @ delta)), self.getRange()
        if length <= step:
            if not self._edge_is_free(tree, q_old, target):
                return Extension.TRAPPED, old
            return Extension.REACHED, self._add(tree, target, old)
        straight = q_old + (step / length) * delta
        # The reach shrinks as the target comes near, so that every step comes nearer to it.
        direction, reach = delta / length, self._slide * min(step, length - step)
        # Where the straight step is free, the slope at its end says best where to slide. Where it is not, one at
        # `old` must do: it costs nothing when the node is tried again.
        if self._edge_is_free(tree, q_old, straight):
            slid = self._slid(straight, direction, reach)
            ahead = straight if slid is None or not self._edge_is_free(tree, q_old, slid) else slid
            return Extension.ADVANCED, self._add(tree, ahead, old)
        slid = self._slid(straight, direction, reach, lambda: tree.gradient(old))
        if slid is None or not self._edge_is_free(tree, q_old, slid):
            return Extension.TRAPPED, old
        return Extension.ADVANCED, self._add(tree, slid, old)
