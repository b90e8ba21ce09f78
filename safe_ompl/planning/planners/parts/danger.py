"""Danger in a planner's decisions: its weight and decay, the choice of nodes, and thresholds on new nodes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import Tree, Trees

_SHARPNESS = 4  # of the decay: easy problems are solved before danger loses weight
_REFUSALS = 8  # of nodes that are too dangerous before the threshold rises


class DangerWeight:
    """The danger of configurations with its weight α, by which planners compare it with lengths.

    Parameters
    ----------
    problem : PlanningProblem
        Gives the danger and its usual slope.

    Attributes
    ----------
    alpha : float
        α, relative to the usual slope of the danger; 0 plans classically.
    scale : float
        Factor of α in [0, 1] at present, see `DangerDecay`.
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

        Parameters
        ----------
        costs : ndarray, shape (K,)
            Dangers.
        rates : ndarray, shape (n,)
            How far a unit of each joint moves the arm [m/rad].
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
    about `half_life` turns.

    Parameters
    ----------
    danger : DangerWeight
        Its scale is lowered.

    Attributes
    ----------
    half_life : float
        In turns; 0 for no decay.
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
    """Chooses the node to extend: near and safe, or in some of the choices the nearest whatever its danger.

    Parameters
    ----------
    danger : DangerWeight
        The danger with its weight.

    Attributes
    ----------
    nearest_fraction : float
        ε: share of the choices by distance alone.
    """

    def __init__(self, danger: DangerWeight) -> None:
        self._danger = danger
        self.nearest_fraction = 0.0

    def best(self, tree: Tree, q: FloatArray, rng: np.random.Generator) -> int:
        """Return argmin of ρ(node, q) + α·CDF(node)."""
        ignore_danger = self.nearest_fraction > 0 and rng.random() < self.nearest_fraction
        return tree.best(q, 0.0 if ignore_danger else self._danger.weight)


class AdaptiveThreshold:
    """The paper's CDF_Threshold, made adaptive.

    It begins with the danger that start or goal force upon every path, and rises with the refusals, so that no passage
    stays closed.

    Parameters
    ----------
    danger : DangerWeight
        The threshold acts while danger has weight.

    Attributes
    ----------
    rise : float
        Share by which it rises after eight refusals; 0 for no threshold.
    level : float
        The danger above which no node is added at present; 0 before the first node was examined.
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
    """A threshold on the danger at the end of a motion, which may be exceeded where the start is more dangerous.

    Parameters
    ----------
    problem : PlanningProblem
        Gives the danger.
    is_free : callable
        Whether the motion between two configurations (n,) is free.

    Attributes
    ----------
    level : float
        The danger from which on no node is added, unless it is safer than the node that it grows from.
    """

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
