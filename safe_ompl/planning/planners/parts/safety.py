"""Danger and clearance in a planner's decisions: weight and decay, choice of nodes, thresholds, margins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import Tree, Trees

_SHARPNESS = 4  # of the decay: easy problems are solved before danger loses weight
_REFUSALS = 8  # of nodes that are too dangerous before the threshold rises


class DangerWeight:
    """The danger of configurations with its weight, by which planners compare it with lengths.

    `alpha` is relative to the usual slope of the danger; 0 plans classically. `scale` in [0, 1] is a factor of it, see
    `DangerDecay`.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self._problem = problem
        self.alpha = 1.0
        self.scale = 1.0

    @property
    def cost(self) -> StateCost:
        """The danger of configurations."""
        return self._problem.cost

    @property
    def slope(self) -> float:
        """The usual slope of the danger [danger/rad]; 0 where there is none."""
        return self._problem.slope

    @property
    def weight(self) -> float:
        """The weight of danger at present, in length per danger; 0 where danger is ignored."""
        alpha = self.alpha * self.scale
        if not alpha:  # the slope need not be known
            return 0.0
        return alpha / self.slope if self.slope else 0.0

    def in_metres(self, costs: FloatArray, rates: FloatArray) -> FloatArray:
        """Return dangers (K,) as lengths [m], by their usual slope and on a logarithmic scale; 0 without a slope.

        `rates: (n,)` is how far a unit of each joint moves the arm [m/rad].
        """
        usual, slope = self.cost.usual_value, self.slope
        if not (usual > 0 and slope > 0):
            return costs * 0.0
        metres = float(np.sqrt(np.mean(rates**2))) / slope
        scaled: FloatArray = metres * usual * np.log1p(costs / usual)
        return scaled

    def prepare(self) -> None:
        """Measure the slope if it will be needed, so that planning need not."""
        if self.alpha:
            _ = self.slope


class DangerDecay:
    """Lowers the weight of danger the longer no path is found, so that weighing danger never costs a solution.

    After t turns the scale of the danger is 1/(1 + (t/`half_life`)⁴): nearly 1 at first, 1/2 after `half_life` turns,
    and 1/100 after three times as many. Easy problems are planned with the whole weight; in hard ones danger costs
    about `half_life` turns. With a half-life of 0 there is no decay.
    """

    def __init__(self, danger: DangerWeight) -> None:
        self._danger = danger
        self.half_life = 0.0
        self._turns = 0

    def reset(self) -> None:
        """Begin anew, with the whole weight."""
        self._turns = 0
        self._danger.scale = 1.0

    def turn(self, rng: np.random.Generator) -> None:
        """Begin a turn in which danger has its whole weight or, by chance, none."""
        if self._acts:
            self._danger.scale = float(rng.random() < self._share)
            self._turns += 1

    def fade(self) -> None:
        """Begin a turn in which danger has a little less weight than in the one before."""
        if self._acts:
            self._danger.scale = self._share
            self._turns += 1

    @property
    def _acts(self) -> bool:
        return self.half_life > 0 and self._danger.alpha > 0 and not self._danger.cost.is_zero

    @property
    def _share(self) -> float:
        return 1.0 / (1.0 + (self._turns / self.half_life) ** _SHARPNESS)


class SafeSelection:
    """Chooses the node to extend: near and safe, or in a share `nearest_fraction` of the choices the nearest."""

    def __init__(self, danger: DangerWeight) -> None:
        self._danger = danger
        self.nearest_fraction = 0.0

    def best(self, tree: Tree, q: FloatArray, rng: np.random.Generator) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        ignore_danger = self.nearest_fraction > 0 and rng.random() < self.nearest_fraction
        return tree.best(q, 0.0 if ignore_danger else self._danger.weight)


class AdaptiveThreshold:
    """The paper's CDF_Threshold, made adaptive.

    Its `level` begins with the danger that start or goal force upon every path, and after eight refusals it rises by a
    share, `rise`, so that no passage stays closed. It acts while danger has weight.
    """

    def __init__(self, danger: DangerWeight) -> None:
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
        if self._refusals % _REFUSALS == 0:
            self.level *= 1 + self.rise
        return False


class FixedThreshold:
    """A threshold on the danger at the end of a motion, which may be exceeded where the start is more dangerous."""

    def __init__(self, problem: PlanningProblem, is_free: Callable[[FloatArray, FloatArray], bool]) -> None:
        self._problem = problem
        self._is_free = is_free
        self.level = np.inf

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether a motion is free, and its end less dangerous than the threshold or than its start."""
        if not self._is_free(start, end):
            return False
        if np.isinf(self.level):
            return True
        before, after = self._problem.cost.values(np.array([start, end]))
        return bool(after < max(self.level, before))


_MARGIN_SHARE = 0.8  # of what start and goal keep; with all of it no motion could leave them
_MARGIN_REFUSALS = 12  # before the margin falls …
_MARGIN_FALL = 0.6  # … to this share of itself
_LEAST_MARGIN = 5e-4  # [m]; below this there is none
_EXAMINED = 5  # starts, and goals
_HALVINGS = 5  # of the logarithm of what start and goal keep: to within 15 %
_PENALTIES = 2  # of an edge before it is taken whatever it keeps
_PENALTY_FALL = 0.3  # share of the margin that remains after each penalty
WORTHWHILE = 0.02  # [m]; where start and goal keep less, penalties cost time and lead nowhere else


class Margin:
    """The clearance that motions should keep: nearly what start and goal keep, but no more than the largest.

    Attributes
    ----------
    largest : float
        [m]; 0 for no margin. The danger field accounts for dangerous obstacles only, so a way around them could graze
        all others. The margin is proven by the same queries as that a motion is free, while danger has weight.
    level : float or None
        The margin [m] at present; None before start and goal were examined.
    allowed : float
        The margin [m] that start and goal allow; 0 before they were examined.
    """

    def __init__(self, problem: PlanningProblem, danger: DangerWeight, least: float = _LEAST_MARGIN) -> None:
        self._problem = problem
        self._danger = danger
        self._least = least
        self.largest = 0.0
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
            self._take(_MARGIN_FALL * self.level)

    @property
    def in_force(self) -> float:
        """The margin [m] while danger has weight; 0 for none."""
        return self.level if self.level and self._danger.weight else 0.0

    def _allowed_by(self, ends: list[FloatArray]) -> float:
        """Return the largest margin [m] that one of each of the `ends: (R, n)` allows, by bisection; 0 for none.

        Exact distances of all pairs would cost more than a whole easy problem.
        """

        def is_allowed(margin: float) -> bool:
            return all(any(self._problem.keeps(q, margin / _MARGIN_SHARE) for q in Q) for Q in ends)

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

    def refuse(self) -> None:
        """Count a refusal; every twelfth lowers the margin."""
        self._refusals += 1
        if self._refusals % _MARGIN_REFUSALS == 0:
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
