"""The planning problem on arrays, and danger in a planner's decisions: weight, decay, choice of nodes, thresholds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerLimit
from safe_ompl.planning.ompl import CertifiedMotionValidator, ScratchState, StateBridge, StateCost
from safe_ompl.planning.planners.parts.tree import Tree, Trees
from safe_ompl.robot import JointLimits

_SHARPNESS = 4  # of the decay: easy problems are solved before danger loses weight
_REFUSALS = 8  # of nodes that are too dangerous before the threshold rises


class PlanningProblem:
    """A space with its validity checker, motion validator and cost, asked with arrays instead of OMPL's states.

    The space is one of real vectors and SO(2) parts. The cost is the danger, and `limit` what a planner requires on top
    of the validity checker.
    """

    def __init__(self, si: Any) -> None:
        self.bridge = StateBridge(si.getStateSpace())
        self._si = si
        self._from, self._to = ScratchState(self.bridge), ScratchState(self.bridge)
        self._limits: tuple[MotionProver, JointLimits] | None = None
        self.take(None, None)

    def take(self, objective: Any, limit: DangerLimit | None) -> None:
        """Take another objective, or None, and another limit."""
        self.cost = StateCost(objective, self.bridge)
        self.limit = limit
        self._slope: float | None = None

    @property
    def slope(self) -> float:
        """The median of ‖∇cost‖ over valid configurations; measured when it is first asked for."""
        if self._slope is None:
            self._slope = self.cost.slope(self._si)
        return self._slope

    def is_valid(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is valid, and no more dangerous than the limit."""
        if not self._si.isValid(self._from.set(q)):
            return False
        return self.limit is None or self.limit.allows(q)

    def motion_is_free(self, start: FloatArray, end: FloatArray, margin: float = 0.0) -> bool:
        """Return whether the motion between two configurations (n,) is free, and keeps to the limit.

        With a margin [m], also whether it keeps that distance from obstacles, where a `MotionProver` can prove it.
        A `MotionProver` is asked directly: the detour by OMPL's states would cost a sixth of a check.
        """
        motion = self.motion_prover
        if motion is not None:
            free = motion.is_free(start, end, margin, self.limits_of(motion))
        else:
            free = self._si.checkMotion(self._from.set(start), self._to.set(end))
        return free and (self.limit is None or self.limit.allows_motion(start, end))

    def limits_of(self, motion: MotionProver) -> JointLimits:
        """Return the joint limits of the robot that are also within the bounds of the space."""
        known = self._limits
        if known is None or known[0] is not motion:
            self._limits = known = motion, JointLimits(motion.checker.robot).within(*self.bridge.held)
        return known[1]

    @property
    def motion_prover(self) -> MotionProver | None:
        """What proves motions; None where the problem's motion validator is another one."""
        validator = self._si.getMotionValidator()
        return validator.motion if type(validator) is CertifiedMotionValidator else None

    def random_configuration(self, rng: np.random.Generator) -> FloatArray:
        """Return a uniform random configuration (n,)."""
        return self.bridge.between_bounds(rng.random(self.bridge.n))

    def state(self, q: FloatArray) -> Any:
        """Return an `ob.State` at `q: (n,)`, which holds until the next question."""
        return self._from.set(q)


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

    def ceiling(self, tree: Tree, old: int, trees: Trees) -> float:
        """Return the larger one of the threshold and the danger of node `old` of a tree: what steps from there keep."""
        if not self.level:
            self.level = trees.forced_cost()
        return max(self.level, float(tree.costs[old]))

    def tolerates(self, cost: float, tree: Tree, old: int, trees: Trees) -> bool:
        """Return whether a danger is no larger than the ceiling of node `old` of a tree; count a refusal."""
        if not self.acts or cost <= self.ceiling(tree, old, trees):
            return True
        self.refuse()
        return False

    def refuse(self) -> None:
        """Count a refusal; every eighth raises the threshold."""
        self._refusals += 1
        if self._refusals % _REFUSALS == 0:
            self.level *= 1 + self.rise


class FixedThreshold:
    """A threshold on the danger at the end of a motion, which may be exceeded where the start is more dangerous."""

    def __init__(self, problem: PlanningProblem, is_free: Callable[[FloatArray, FloatArray], bool]) -> None:
        self._problem, self._is_free = problem, is_free
        self.level = np.inf

    @property
    def acts(self) -> bool:
        """Whether there is a threshold."""
        return not np.isinf(self.level)

    def motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether a motion is free, and its end less dangerous than the threshold or than its start."""
        if not self._is_free(start, end):
            return False
        if not self.acts:
            return True
        before, after = self._problem.cost.values(np.array([start, end]))
        return bool(after < max(self.level, before))
