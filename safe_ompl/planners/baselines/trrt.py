"""The transition-based RRTs that danger-aware planning is measured against: T-RRT, its two trees, and GradienT-RRT."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError
from safe_ompl.planners.base import fraction
from safe_ompl.planners.parts.growing import Extension, TreePlanner
from safe_ompl.planners.parts.tree import Tree

_COLDEST = 1e-6  # initial temperature [1]
_TEMPERATURE_FACTOR = 2.0  # after an uphill step is accepted, or too many in a row are refused
_PATIENCE = 10  # refusals in a row before it warms up
_REFINEMENT = 0.1  # share of nodes that may refine what is explored already
_NEW_GROUND = 0.5  # of the range: nearer to the tree than this, descended nodes are not added
_DESCENT_STEPS = 5  # of GradienT-RRT, each a fifth of the range


class TransitionTest:
    """Accepts downhill steps always, and uphill steps with a probability that adapts itself [1].

    Parameters
    ----------
    rng : numpy.random.Generator
        Random numbers.
    scale : float
        K, the usual cost: the mean of those of start and goal.
    """

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self._rng = rng
        self._scale = scale
        self._temperature = _COLDEST
        self._refusals = 0

    def accepts(self, before: float, after: float, length: float) -> bool:
        """Return whether a step of this length [rad], from one cost to another, is taken."""
        if after <= before:
            return True
        slope = (after - before) / length
        if self._rng.random() < np.exp(-slope / (self._scale * self._temperature)):
            self._temperature /= _TEMPERATURE_FACTOR
            self._refusals = 0
            return True
        self._refusals += 1
        if self._refusals > _PATIENCE:
            self._temperature *= _TEMPERATURE_FACTOR
            self._refusals = 0
        return False


class TransitionPlanner(TreePlanner):
    """What the transition-based planners share: EXTEND with the transition test."""

    def setAlpha(self, alpha: float) -> NoReturn:
        """Raise InputError: the temperature weighs the danger here."""
        raise InputError(f"{self.getName()} has no parameter 'alpha': its temperature weighs the danger")

    def setSlide(self, slide: float) -> NoReturn:
        """Raise InputError: motions are straight here."""
        raise InputError(f"{self.getName()} has no parameter 'slide': its motions are straight")

    def _extend(
        self, tree: Tree, old: int, target: FloatArray, test: TransitionTest
    ) -> tuple[Extension, int]:
        """EXTEND: one step towards the target, if it is free and passes the transition test."""
        q_old = tree.configurations[old]
        delta = self._bridge.difference(q_old, target)
        length = float(np.sqrt(delta @ delta))
        if length == 0.0:
            return Extension.REACHED, old
        reached, step = length <= self.getRange(), min(length, self.getRange())
        q_new = target if reached else self._bridge.wrapped(q_old + (step / length) * delta)
        passed = self._passed(tree, old, q_new, test)
        if passed is None or not self._edge_is_free(tree, q_old, passed[0]):
            return Extension.TRAPPED, old
        outcome = Extension.REACHED if reached and passed[0] is q_new else Extension.ADVANCED
        return outcome, self._add(tree, passed[0], old, passed[1])

    def _passed(
        self, tree: Tree, old: int, q_new: FloatArray, test: TransitionTest
    ) -> tuple[FloatArray, float] | None:
        """Return the configuration at which the step may end, and its cost; None if it is too dear."""
        if self._cost.is_zero:
            return q_new, 0.0
        length = float(np.linalg.norm(self._bridge.difference(tree.configurations[old], q_new)))
        before, after = float(tree.costs[old]), float(self._cost.values(q_new[None])[0])
        return (q_new, after) if test.accepts(before, after, length) else None

    def _new_test(self) -> TransitionTest:
        ends = np.concatenate([self._start_tree.costs[:1], self._goal_tree.costs[:1]])
        usual = float(ends.mean())
        return TransitionTest(self._rng, usual if np.isfinite(usual) and usual > 0 else 1.0)


class TRRT(TransitionPlanner):
    """One tree that climbs in cost reluctantly (T-RRT).

    A step up the cost is taken with a probability that falls with its slope and rises with the planner's lack of
    success. It needs an objective; without one it is an RRT.

    Parameters
    ----------
    si : ob.SpaceInformation
        Any space of real vectors and SO(2) parts.
    name : str
        Name in logs and benchmarks.
    range : float
        Largest length of one extension [rad]; 0 takes 7.5 % of the space's extent.
    goal_bias : float
        Share of the extensions that go towards a goal.

    References
    ----------
    .. [1] L. Jaillet, J. Cortés, T. Siméon: Sampling-based path planning on configuration-space costmaps.
       IEEE Trans. Robotics, 2010.
    """

    def __init__(self, si: Any, name: str = "TRRT", *, range: float = 0.0, goal_bias: float = 0.05) -> None:
        super().__init__(si, name)
        self.setRange(range)
        self.setGoalBias(goal_bias)

    def setGoalBias(self, share: float) -> None:
        """Set the share in [0, 1] of extensions towards a goal."""
        self._goal_bias = fraction("goal_bias", share)

    def getGoalBias(self) -> float:
        """Return the share of extensions towards a goal."""
        return self._goal_bias

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, goals = self._start_tree, self._goal_tree
        test = self._new_test()
        while not ptc():
            self._take_goals(ptc)
            aims_at_goal = self._rng.random() < self._goal_bias
            goal = int(self._rng.integers(len(goals)))
            target = goals.configurations[goal] if aims_at_goal else self._random_configuration()
            outcome, new = self._extend(tree, tree.best(target, 0.0), target, test)
            if outcome is Extension.TRAPPED:
                continue
            near = goals.best(tree.configurations[new], 0.0)
            if goals.distances(tree.configurations[new])[near] <= self.getRange():
                outcome, met = self._extend(tree, new, goals.configurations[near], test)
                if outcome is Extension.REACHED:
                    return tree.branch(met)
        return None


class BiTRRT(TransitionPlanner):
    """Two such trees that try to connect [1]; new nodes that only refine what is explored are few.

    Parameters
    ----------
    si, name, range
        As for `TRRT`.

    References
    ----------
    .. [1] D. Devaurs, T. Siméon, J. Cortés: Enhancing the transition-based RRT to deal with complex cost spaces.
       ICRA 2013.
    """

    def __init__(self, si: Any, name: str = "BiTRRT", *, range: float = 0.0) -> None:
        super().__init__(si, name)
        self.setRange(range)

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, other = self._start_tree, self._goal_tree
        test = self._new_test()
        refining = 0
        while not ptc():
            self._take_goals(ptc)
            q_rand = self._random_configuration()
            old = tree.best(q_rand, 0.0)
            refines = tree.distances(q_rand)[old] < self.getRange()
            if refines and refining > _REFINEMENT * (len(tree) + len(other)):
                continue
            outcome, new = self._extend(tree, old, q_rand, test)
            if outcome is not Extension.TRAPPED:
                refining += refines
                q_new = tree.configurations[new]
                outcome, met = self._connect(other, q_new, test, ptc)
                if outcome is Extension.REACHED:
                    return self._join(tree, new, other, met)
            tree, other = other, tree
        return None

    def _connect(
        self, tree: Tree, target: FloatArray, test: TransitionTest, ptc: Any
    ) -> tuple[Extension, int]:
        """Extend towards the target until it is reached, or a step is blocked or too dear."""
        outcome, node = Extension.ADVANCED, tree.best(target, 0.0)
        while outcome is Extension.ADVANCED and not ptc():
            left = tree.distances(target)[node]
            outcome, node = self._extend(tree, node, target, test)
            if outcome is Extension.ADVANCED and tree.distances(target)[node] >= left:
                outcome = Extension.TRAPPED
        return outcome, node


class GradienTRRT(BiTRRT):
    """BiTRRT that, where a step is too dear, follows the gradient of the cost down and tries again.

    Without an objective that offers gradients it is BiTRRT.

    Parameters
    ----------
    si, name, range
        As for `TRRT`.

    References
    ----------
    .. [1] D. Berenson, T. Siméon, S. Srinivasa: Addressing cost-space chasms in manipulation planning. ICRA 2011.
    """

    def __init__(self, si: Any, name: str = "GradienTRRT", *, range: float = 0.0) -> None:
        super().__init__(si, name, range=range)

    def _passed(
        self, tree: Tree, old: int, q_new: FloatArray, test: TransitionTest
    ) -> tuple[FloatArray, float] | None:
        passed = super()._passed(tree, old, q_new, test)
        if passed is not None or not self._cost.has_gradients:
            return passed
        lower = self._descended(q_new)
        # Where the tree has been already, it would fill the valley and never climb out of it.
        if tree.distances(lower).min() < _NEW_GROUND * self.getRange():
            return None
        return super()._passed(tree, old, lower, test)

    def _descended(self, q: FloatArray) -> FloatArray:
        """Return where a few steps down the gradient lead."""
        step = self.getRange() / _DESCENT_STEPS
        for _ in range(_DESCENT_STEPS):
            gradient = self._cost.value_and_gradient(q)[1]
            steepness = float(np.sqrt(gradient @ gradient))
            if not 0 < steepness < np.inf:
                break
            q = self._bridge.inside(q - (step / steepness) * gradient)
        return q
