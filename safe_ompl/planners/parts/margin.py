"""An adaptive margin: what the motions of a planner keep from obstacles, as long as that costs no solution."""

from __future__ import annotations

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.task import Task
from safe_ompl.planners.parts.trees import Trees

_SHARE = 0.8  # of what start and goal keep; at all of it no motion could leave them
_PATIENCE = 12  # refusals before the margin falls …
_FALL = 0.6  # … to this share of itself
_LEAST = 5e-4  # [m]; below this there is none
_LOOKED_AT = 5  # starts, and goals


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
            kept = (
                max(self._task.clearance(q) for q in tree.roots[:_LOOKED_AT])
                for tree in (trees.start, trees.goal)
                if len(tree)
            )
            self._take(min(self.largest, _SHARE * min(kept)))

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

    def _take(self, level: float) -> None:
        self.level = level if level >= _LEAST else 0.0
