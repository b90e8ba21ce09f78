"""An adaptive margin: what the motions of a planner keep from obstacles, as long as that costs no solution."""

from __future__ import annotations

from math import sqrt

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.task import Task
from safe_ompl.planners.parts.trees import Trees

_SHARE = 0.8  # of what start and goal keep; at all of it no motion could leave them
_PATIENCE = 6  # refusals before the margin falls …
_FALL = 0.6  # … to this share of itself
_LEAST = 5e-4  # [m]; below this there is none
_LOOKED_AT = 5  # starts, and goals
_HALVINGS = 5  # of the logarithm of what start and goal keep: to within 15 %


class AdaptiveMargin:
    """The clearance that motions must keep: at first nearly what start and goal keep; it falls with the refusals.

    Danger knows dangerous things only: a way round them would graze everything else. The margin is proven by the same
    queries as that a motion is free, and is in force where danger has weight.

    Parameters
    ----------
    task : Task
        Says which motions are free, and which keep a margin.
    danger : WeightedDanger
        The danger with its weight α.

    Attributes
    ----------
    largest : float
        [m]; 0 for no margin.
    level : float or None
        The margin [m] that motions must keep now; None before start and goal were looked at.
    """

    def __init__(self, task: Task, danger: WeightedDanger) -> None:
        self._task = task
        self._danger = danger
        self.largest = 0.0
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.level: float | None = None
        self._refusals = 0

    def begin(self, trees: Trees) -> None:
        """Take the margin that starts and goals allow; nothing is done where that is known."""
        if self.level is None and self.largest and self._danger.weight:
            ends = [tree.roots[:_LOOKED_AT] for tree in (trees.start, trees.goal)]
            self._take(self._allowed_by(ends))

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the motion between two configurations (n,) is free, and keeps the margin.

        Whether a motion that is refused would be free without a margin is not asked: it would cost as much again.
        """
        margin = self.level if self.level and self._danger.weight else 0.0
        if self._task.motion_is_free(start, end, margin):
            return True
        if margin:
            self._refusals += 1
            if self._refusals % _PATIENCE == 0:
                self._take(_FALL * margin)
        return False

    def _allowed_by(self, ends: list[FloatArray]) -> float:
        """Return the largest margin [m] that one of each of the `ends: (R, n)` allows, by bisection; 0 for none.

        Exact distances of all pairs would cost more than an easy problem as a whole.
        """

        def is_allowed(margin: float) -> bool:
            return all(any(self._task.keeps(q, margin / _SHARE) for q in Q) for Q in ends)

        if is_allowed(self.largest):
            return self.largest
        low, high = _LEAST, self.largest
        if not is_allowed(low):
            return 0.0
        for _ in range(_HALVINGS):
            middle = sqrt(low * high)
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return low

    def _take(self, level: float) -> None:
        self.level = level if level >= _LEAST else 0.0
