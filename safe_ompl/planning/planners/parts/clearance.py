"""The margin that a planner's motions keep from all obstacles, as long as that costs no solution."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, sqrt

import numpy as np

from safe_ompl.collision import MotionProver, PairSet
from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.parts.problem import DangerWeight, PlanningProblem
from safe_ompl.planning.planners.parts.tree import Trees

_SHARE = 0.8  # of what start and goal keep; with all of it no motion could leave them
_REFUSALS = 12  # before the margin falls …
_FALL = 0.6  # … to this share of itself
_LEAST = 5e-4  # [m]; below this there is none
_EXAMINED = 5  # starts, and goals
_HALVINGS = 5  # of the logarithm of what start and goal keep: to within 15 %
_PENALTIES = 2  # of an edge before it is taken whatever it keeps
_PENALTY_FALL = 0.3  # share of the margin that remains after each penalty
WORTHWHILE = 0.02  # [m]; where start and goal keep less, penalties cost time and lead nowhere else


class ClearanceCache:
    """Lower bounds of the clearance from obstacles, computed once for each configuration.

    The first margin that is asked for should be the largest: bounds are only as tight as that margin needs them.
    """

    def __init__(self) -> None:
        # Pairs, their revision, and how good bounds are [m].
        self._source: tuple[PairSet, int, float] | None = None
        self._bounds: dict[bytes, float] = {}

    def keeps(self, motion: MotionProver, q: FloatArray, margin: float) -> bool:
        """Return whether the robot is proven to keep a margin [m] from obstacles at `q: (n,)`."""
        bound = self._bound(motion.checker.pairs, q, margin)
        return bound >= margin if isfinite(bound) else motion.is_free(q, q, margin)

    def _bound(self, pairs: PairSet, q: FloatArray, enough: float) -> float:
        known = self._source
        if known is None or known[:2] != (pairs, pairs.revision) or known[2] < enough:
            self._source, self._bounds = (pairs, pairs.revision, enough), {}
        key = q.tobytes()
        if key not in self._bounds:
            bounds = pairs.bounds.of(q[None], np.flatnonzero(pairs.meets_obstacle), enough)
            self._bounds[key] = float(bounds.min(initial=inf))
        return self._bounds[key]


class Margin:
    """The clearance that motions should keep: nearly what start and goal keep, but no more than the largest.

    The danger field accounts for dangerous obstacles only, so a way around them could graze all others. The margin is
    proven by the same queries as that a motion is free, while danger has weight. `largest`, `level`, the margin at
    present, and `allowed`, what start and goal allow, are in metres; before these were examined there is no level.
    """

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, least: float = _LEAST) -> None:
        self._problem, self._danger, self._least = problem, danger, least
        self.largest = 0.0
        self._clearances = ClearanceCache()
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.level: float | None = None
        self.allowed = 0.0

    def begin_between(self, ends: Sequence[FloatArray]) -> None:
        """Take the margin that one of each of the `ends: (R, n)` allows, unless that is known."""
        if self.is_unknown:
            self._take(self._allowed_by([Q[:_EXAMINED] for Q in ends if len(Q)]))
            self.allowed = self.level or 0.0

    @property
    def is_unknown(self) -> bool:
        """Whether there is to be a margin, and start and goal were not examined yet."""
        return self.level is None and self.largest > 0 and self._danger.weight > 0

    def lower(self) -> None:
        """Lower the margin to 60 %, or to none where little is left."""
        if self.level:
            self._take(_FALL * self.level)

    @property
    def in_force(self) -> float:
        """The margin [m] while danger has weight; 0 for none."""
        return self.level if self.level and self._danger.weight else 0.0

    def _allowed_by(self, ends: list[FloatArray]) -> float:
        """Return the largest margin [m] that one of each of the `ends: (R, n)` allows, by bisection; 0 for none.

        Exact distances of all pairs would cost more than a whole easy problem.
        """

        def is_allowed(margin: float) -> bool:
            return all(any(self._keeps(q, margin / _SHARE) for q in Q) for Q in ends)

        if is_allowed(self.largest):
            return self.largest
        low, high = self._least, self.largest
        if not is_allowed(low):
            return 0.0
        for _ in range(_HALVINGS):
            middle = sqrt(low * high)
            low, high = (middle, high) if is_allowed(middle) else (low, middle)
        return low

    def _keeps(self, q: FloatArray, margin: float) -> bool:
        """Return whether the robot is proven to keep a margin [m] from obstacles at `q: (n,)`."""
        motion = self._problem.motion_prover
        return motion is not None and self._clearances.keeps(motion, q, margin)

    def _take(self, level: float) -> None:
        self.level = level if level >= self._least else 0.0


class AdaptiveMargin(Margin):
    """The margin of trees: motions that do not keep it are refused, and the refusals lower it."""

    def reset(self) -> None:
        """Begin anew."""
        super().reset()
        self._refusals = 0

    def begin(self, trees: Trees) -> None:
        """Take the margin that starts and goals allow, unless that is known."""
        if self.is_unknown:
            self.begin_between([tree.roots for tree in (trees.start, trees.goal)])

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the motion between two configurations (n,) is free, and keeps the margin.

        Whether a motion that is refused would be free without a margin is not asked: it would cost as much again.
        """
        margin = self.in_force
        if self._problem.motion_is_free(start, end, margin):
            return True
        if margin:
            self.refuse()
        return False

    @property
    def falls_next(self) -> bool:
        """Whether the next refusal lowers the margin."""
        return self._refusals % _REFUSALS == _REFUSALS - 1

    def refuse(self) -> None:
        """Count a refusal; every twelfth lowers the margin."""
        self._refusals += 1
        if self._refusals % _REFUSALS == 0:
            self.lower()


class PenaltyMargin(Margin):
    """The margin of a roadmap: an edge that does not keep it is penalised, and again if it does not keep 30 % of it.

    So no way is closed, and the search takes a wider way where there is one that is not much longer. There is no margin
    where start and goal keep less than 25 mm: no way between them can do better.
    """

    def __init__(self, problem: PlanningProblem, danger: DangerWeight) -> None:
        super().__init__(problem, danger, WORTHWHILE)

    def after(self, penalties: int) -> float:
        """Return what an edge must keep [m] after so many penalties; 0 if it need only be free."""
        return self.in_force * _PENALTY_FALL**penalties if penalties < _PENALTIES else 0.0
