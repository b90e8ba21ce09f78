"""Margins: what the motions of a planner keep from obstacles, as long as that costs no solution."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from safe_ompl.arrays import FloatArray
from safe_ompl.planners.parts.danger import WeightedDanger
from safe_ompl.planners.parts.task import Task
from safe_ompl.planners.parts.trees import Trees

_SHARE = 0.8  # of what start and goal keep; at all of it no motion could leave them
_PATIENCE = 12  # refusals before the margin falls …
_FALL = 0.6  # … to this share of itself
_LEAST = 5e-4  # [m]; below this there is none
_LOOKED_AT = 5  # starts, and goals
_HALVINGS = 5  # of the logarithm of what start and goal keep: to within 15 %
_TOLLS = 2  # paid by an edge before it is taken whatever it keeps
_TOLL_FALL = 0.3  # share of the margin that each toll leaves
WORTHWHILE = 0.02  # [m]; in places narrower than this tolls would cost time, and lead nowhere else


class Margin:
    """The clearance that motions should keep: nearly what start and goal keep, but no more than the largest.

    Danger knows dangerous things only: a way round them would graze everything else. The margin is proven by the same
    queries as that a motion is free, and is in force where danger has weight.

    Parameters
    ----------
    task : Task
        Says which motions are free, and which keep a margin.
    danger : WeightedDanger
        The danger with its weight α.
    least : float
        [m]; where start and goal allow less there is no margin.

    Attributes
    ----------
    largest : float
        [m]; 0 for no margin.
    level : float or None
        The margin [m] now; None before start and goal were looked at.
    allowed : float
        The margin [m] that start and goal allow; 0 before they were looked at.
    """

    def __init__(self, task: Task, danger: WeightedDanger, least: float = _LEAST) -> None:
        self._task = task
        self._danger = danger
        self._least = least
        self.largest = 0.0
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.level: float | None = None
        self.allowed = 0.0

    def begin_between(self, ends: Sequence[FloatArray]) -> None:
        """Take the margin that one of each of the `ends: (R, n)` allows; nothing is done where that is known."""
        if self.is_unknown:
            self._take(self._allowed_by([Q[:_LOOKED_AT] for Q in ends if len(Q)]))
            self.allowed = self.level or 0.0

    @property
    def is_unknown(self) -> bool:
        """Whether there is to be a margin, and start and goal were not looked at."""
        return self.level is None and self.largest > 0 and self._danger.weight > 0

    def yield_some(self) -> None:
        """Let the margin fall to 60 %, and vanish where little is left."""
        if self.level:
            self._take(_FALL * self.level)

    @property
    def in_force(self) -> float:
        """The margin [m] while danger is heeded; 0 for none."""
        return self.level if self.level and self._danger.weight else 0.0

    def _allowed_by(self, ends: list[FloatArray]) -> float:
        """Return the largest margin [m] that one of each of the `ends: (R, n)` allows, by bisection; 0 for none.

        Exact distances of all pairs would cost more than an easy problem as a whole.
        """

        def is_allowed(margin: float) -> bool:
            return all(any(self._task.keeps(q, margin / _SHARE) for q in Q) for Q in ends)

        if is_allowed(self.largest):
            return self.largest
        low, high = self._least, self.largest
        if not is_allowed(low):
            return 0.0
        for _ in range(_HALVINGS):
            middle = sqrt(low * high)
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return low

    def _take(self, level: float) -> None:
        self.level = level if level >= self._least else 0.0


class AdaptiveMargin(Margin):
    """The margin of trees: motions that do not keep it are refused, and it falls with the refusals.

    Parameters
    ----------
    task, danger
        As for `Margin`.
    """

    def reset(self) -> None:
        """Begin anew."""
        super().reset()
        self._refusals = 0

    def begin(self, trees: Trees) -> None:
        """Take the margin that starts and goals allow; nothing is done where that is known."""
        if self.is_unknown:
            self.begin_between([tree.roots for tree in (trees.start, trees.goal)])

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the motion between two configurations (n,) is free, and keeps the margin.

        Whether a motion that is refused would be free without a margin is not asked: it would cost as much again.
        """
        margin = self.in_force
        if self._task.motion_is_free(start, end, margin):
            return True
        if margin:
            self.refuse()
        return False

    def refuse(self) -> None:
        """Count a refusal; every so often the margin falls."""
        self._refusals += 1
        if self._refusals % _PATIENCE == 0:
            self.yield_some()


class TollMargin(Margin):
    """The margin of a roadmap: edges that do not keep it are not refused, but cost a toll, and another for 30 % of it.

    So no way is closed, and the search takes a way with room where there is one that is not much longer. There is
    none where start and goal keep less than 25 mm: no way between them can do better.

    Parameters
    ----------
    task, danger
        As for `Margin`.
    """

    def __init__(self, task: Task, danger: WeightedDanger) -> None:
        super().__init__(task, danger, WORTHWHILE)

    def after(self, tolls: int) -> float:
        """Return what an edge must keep [m] that has paid so many tolls; 0: it must be free."""
        return self.in_force * _TOLL_FALL**tolls if tolls < _TOLLS else 0.0
