"""EXTEND: one step of a tree towards a configuration."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.slide import Slide
from safe_ompl.planners.parts.threshold import AdaptiveThreshold
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.planners.parts.trees import Trees
from safe_ompl.plugins.states import StateBridge

_RARE = 4  # refusals for obstacles to one by danger: from there on proofs go first


class Extension(Enum):
    """Outcome of EXTEND."""

    TRAPPED = "no new node"
    ADVANCED = "a new node on the way"
    REACHED = "a new node at the target"


class SafeStep:
    """EXTEND of the safe RRTs (§4.3, §4.4): a step that slides away from danger and keeps to a threshold.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    danger : WeightedDanger
        The danger of new nodes.
    slide : Slide
        How far, and where, a step slides.
    threshold : AdaptiveThreshold
        Refuses nodes that are too dangerous.
    is_free : callable
        Whether the motion between two configurations (n,) is free.
    """

    def __init__(
        self,
        bridge: StateBridge,
        danger: WeightedDanger,
        slide: Slide,
        threshold: AdaptiveThreshold,
        is_free: Callable[[FloatArray, FloatArray], bool],
    ) -> None:
        self._bridge = bridge
        self._danger = danger
        self._slide = slide
        self._threshold = threshold
        self._is_free = is_free

    def extend(
        self, trees: Trees, tree: Tree, old: int, target: FloatArray, step: float
    ) -> tuple[Extension, int]:
        """Add a node at most `step` [rad] from node `old` towards `target: (n,)`; return the outcome and the node.

        Where the slid step is not free the straight one is tried. Targets within a step are neither slid nor held
        to the threshold: they are configurations that the path needs.
        """
        q_old = tree.configurations[old]
        delta = self._bridge.difference(q_old, target)
        length = float(np.sqrt(delta @ delta))
        if length <= step:
            if not self._is_free(*tree.as_driven(q_old, target)):
                return Extension.TRAPPED, old
            return Extension.REACHED, trees.add(tree, target, old)
        straight = q_old + (step / length) * delta
        # The reach of the slide shrinks as the target comes near, so that every step comes nearer to it.
        reach = self._slide.share * min(step, length - step)
        slid = self._slide.slid(straight, delta / length, reach, lambda: tree.gradient(old))
        for q_new in (straight,) if slid is None else (slid, straight):
            # A proof costs as much as a danger. It waits, unless dangers refuse little: refusals lower the margin.
            proof_first = trees.blocked > _RARE * trees.dangerous
            if proof_first and not self._is_unblocked(trees, tree, q_old, q_new):
                continue
            cost, gradient = self._examined(q_new)
            if not self._threshold.tolerates(cost, tree, old, trees):
                trees.dangerous += 1
                break
            if proof_first or self._is_unblocked(trees, tree, q_old, q_new):
                return Extension.ADVANCED, trees.add(tree, q_new, old, cost, gradient)
        return Extension.TRAPPED, old

    def _is_unblocked(self, trees: Trees, tree: Tree, q_old: FloatArray, q_new: FloatArray) -> bool:
        """Return whether a step of a tree is free; note where it is not."""
        free = self._is_free(*tree.as_driven(q_old, q_new))
        trees.blocked += not free
        return free

    def _examined(self, q: FloatArray) -> tuple[float, FloatArray | None]:
        """Return the danger of a candidate, and the gradient that a step from it will want; NaN if not needed."""
        if not self._threshold.acts:
            return np.nan, None
        if self._slide.acts:
            return self._danger.cost.value_and_gradient(q)
        return float(self._danger.cost.values(q[None])[0]), None
