"""What the safe RRTs share: the choice of a safe node, and EXTEND."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.base import fraction, non_negative
from safe_ompl.planners.parts.growing import Extension, TreePlanner
from safe_ompl.planners.parts.tree import ROOT, Tree

_PATIENCE = 5  # refusals of too dangerous nodes before the threshold rises


class SafeRRT(TreePlanner):
    """Base of the planners that grow trees from nodes which are near and safe (§4.3, §4.4)."""

    _nearest_fraction = 0.0
    _threshold_rise = 0.0
    _threshold = 0.0  # the danger above which no node is added now
    _refusals = 0

    def setNearestFraction(self, epsilon: float) -> None:
        """Set the share ε in [0, 1] of selections by distance alone."""
        self._nearest_fraction = fraction("nearest_fraction", epsilon)

    def getNearestFraction(self) -> float:
        """Return the share ε of selections by distance alone."""
        return self._nearest_fraction

    def setThresholdRise(self, share: float) -> None:
        """Set by what share the adaptive threshold on danger rises after five refusals; 0 for no threshold."""
        self._threshold_rise = non_negative("threshold_rise", share)

    def getThresholdRise(self) -> float:
        """Return by what share the adaptive threshold on danger rises."""
        return self._threshold_rise

    @property
    def _has_threshold(self) -> bool:
        return self._threshold_rise > 0 and self._danger_weight > 0

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
        # The reach of the slide shrinks as the target comes near, so that every step comes nearer to it.
        reach = self._slide * min(step, length - step)
        slid = self._slid(straight, delta / length, reach, lambda: tree.gradient(old))
        for q_new in (straight,) if slid is None else (slid, straight):
            if self._edge_is_free(tree, q_old, q_new):
                cost, gradient = self._examined(q_new)
                if not self._tolerates(cost, tree, old):
                    break
                return Extension.ADVANCED, self._add(tree, q_new, old, cost, gradient)
        return Extension.TRAPPED, old

    def _examined(self, q: FloatArray) -> tuple[float, FloatArray | None]:
        """Return the danger of a new node, and the gradient that the next step from it will want; NaN if not needed."""
        if not self._has_threshold:
            return np.nan, None
        if self._slides:
            return self._cost.value_and_gradient(q)
        return float(self._cost.values(q[None])[0]), None

    def _tolerates(self, cost: float, tree: Tree, old: int) -> bool:
        """Return whether a danger is no larger than the threshold, or than that of node `old`.

        The paper's CDF_Threshold, made adaptive: it begins with the danger that start or goal force, and rises with
        the refusals, so that no passage stays closed.
        """
        if not self._has_threshold:
            return True
        if not self._threshold:
            roots = (ends.costs[ends.parents == ROOT] for ends in (self._start_tree, self._goal_tree))
            self._threshold = max(float(costs.min()) for costs in roots if len(costs))
        if cost <= max(self._threshold, tree.costs[old]):
            return True
        self._refusals += 1
        if self._refusals % _PATIENCE == 0:
            self._threshold *= 1 + self._threshold_rise
        return False

    def _forget(self) -> None:
        super()._forget()
        self._threshold, self._refusals = 0.0, 0
