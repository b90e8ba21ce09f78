"""Thresholds on the danger of new nodes: one that adapts itself, and a fixed one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.task import Task
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.planners.parts.trees import Trees

_PATIENCE = 8  # refusals of too dangerous nodes before the threshold rises


class AdaptiveThreshold:
    """The paper's CDF_Threshold, made adaptive.

    It begins with the danger that start or goal force, and rises with the refusals, so that no passage stays closed.

    Parameters
    ----------
    danger : WeightedDanger
        It acts where that has weight.

    Attributes
    ----------
    rise : float
        Share by which it rises after eight refusals; 0 for no threshold.
    level : float
        The danger above which no node is added now; 0 before the first was looked at.
    """

    def __init__(self, danger: WeightedDanger) -> None:
        self._danger = danger
        self.rise = 0.0
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.level, self._refusals = 0.0, 0

    @property
    def acts(self) -> bool:
        """Whether there is a threshold."""
        return self.rise > 0 and self._danger.weight > 0

    def tolerates(self, cost: float, tree: Tree, old: int, trees: Trees) -> bool:
        """Return whether a danger is no larger than the threshold, or than that of node `old` of a tree."""
        if not self.acts:
            return True
        if not self.level:
            self.level = trees.forced_cost()
        if cost <= max(self.level, tree.costs[old]):
            return True
        self._refusals += 1
        if self._refusals % _PATIENCE == 0:
            self.level *= 1 + self.rise
        return False


class FixedThreshold:
    """The paper's CDF_Threshold as it is, on the end of a motion.

    Parameters
    ----------
    task : Task
        Says what configurations cost.
    is_free : callable
        Whether the motion between two configurations (n,) is free.

    Attributes
    ----------
    level : float
        The danger from which on no node is added, unless it is safer than the node that it grows from.
    is_strict : bool
        Whether that exception is not made, and random extensions are left alone, as in the paper.
    """

    def __init__(self, task: Task, is_free: Callable[[FloatArray, FloatArray], bool]) -> None:
        self._task = task
        self._is_free = is_free
        self.level = np.inf
        self.is_strict = False

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether a motion is free, and its end less dangerous than the threshold or than its start."""
        if not self._is_free(start, end):
            return False
        if np.isinf(self.level):
            return True
        if self.is_strict:
            return bool(self._task.cost.values(end[None])[0] < self.level)
        before, after = self._task.cost.values(np.array([start, end]))
        return bool(after < max(self.level, before))

    def random_motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return the same for a random extension, to which the paper's threshold does not apply."""
        if self.is_strict:
            return self._is_free(start, end)
        return self.motion_is_free(start, end)
