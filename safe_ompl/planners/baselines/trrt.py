"""The transition-based RRTs that danger-aware planning is measured against: T-RRT, its two trees, and GradienT-RRT."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.inputs import fraction
from safe_ompl.planners.base import SafePlanner
from safe_ompl.planners.baselines.transition import TransitionStep, TransitionTest, usual_cost
from safe_ompl.planners.parts.growing import Extension
from safe_ompl.planners.parts.tree import Tree
from safe_ompl.planners.parts.trees import Trees

_REFINEMENT = 0.1  # share of nodes that may refine what is explored already
_NEW_GROUND = 0.5  # of the range: nearer to the tree than this, descended nodes are not added
_DESCENT_STEPS = 5  # of GradienT-RRT, each a fifth of the range


class TRRT(SafePlanner):
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
        self._forget()
        self.setRange(range)
        self.setGoalBias(goal_bias)

    def setGoalBias(self, share: float) -> None:
        """Set the share in [0, 1] of extensions towards a goal."""
        self._goal_bias = fraction("goal_bias", share)

    def getGoalBias(self) -> float:
        """Return the share of extensions towards a goal."""
        return self._goal_bias

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, goals = self._trees.start, self._trees.goal
        test = TransitionTest(self._rng, usual_cost(self._trees))
        step = TransitionStep(self._task, self._trees, test, self.getRange())
        while not ptc():
            self._take_goals(ptc)
            aims_at_goal = self._rng.random() < self._goal_bias
            goal = int(self._rng.integers(len(goals)))
            target = (
                goals.configurations[goal] if aims_at_goal else self._task.random_configuration(self._rng)
            )
            outcome, new = step.extend(tree, tree.best(target, 0.0), target)
            if outcome is Extension.TRAPPED:
                continue
            near = goals.best(tree.configurations[new], 0.0)
            if goals.distances(tree.configurations[new])[near] <= self.getRange():
                outcome, met = step.extend(tree, new, goals.configurations[near])
                if outcome is Extension.REACHED:
                    return tree.branch(met)
        return None

    @property
    def _grown(self) -> Trees:
        return self._trees

    def _forget(self) -> None:
        self._trees = Trees(self._bridge, self._task.cost, self.counts)


class BiTRRT(SafePlanner):
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
        self._forget()
        self.setRange(range)

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, other = self._trees.start, self._trees.goal
        test = TransitionTest(self._rng, usual_cost(self._trees))
        step = TransitionStep(self._task, self._trees, test, self.getRange(), self._detour)
        refining = 0
        while not ptc():
            self._take_goals(ptc)
            q_rand = self._task.random_configuration(self._rng)
            old = tree.best(q_rand, 0.0)
            refines = tree.distances(q_rand)[old] < self.getRange()
            if refines and refining > _REFINEMENT * (len(tree) + len(other)):
                continue
            outcome, new = step.extend(tree, old, q_rand)
            if outcome is not Extension.TRAPPED:
                refining += refines
                q_new = tree.configurations[new]
                outcome, met = _connect(step, other, q_new, ptc)
                if outcome is Extension.REACHED:
                    return self._trees.path(tree, new, other, met)
            tree, other = other, tree
        return None

    def _detour(self, tree: Tree, q: FloatArray) -> FloatArray | None:
        """Return a configuration to test instead of one that is too dear: here there is none."""
        return None

    @property
    def _grown(self) -> Trees:
        return self._trees

    def _forget(self) -> None:
        self._trees = Trees(self._bridge, self._task.cost, self.counts)


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

    def _detour(self, tree: Tree, q: FloatArray) -> FloatArray | None:
        """Return where the gradient leads down from a configuration that is too dear."""
        if not self._task.cost.has_gradients:
            return None
        lower = self._descended(q)
        # Where the tree has been already, it would fill the valley and never climb out of it.
        return lower if tree.distances(lower).min() >= _NEW_GROUND * self.getRange() else None

    def _descended(self, q: FloatArray) -> FloatArray:
        """Return where a few steps down the gradient lead."""
        step = self.getRange() / _DESCENT_STEPS
        for _ in range(_DESCENT_STEPS):
            gradient = self._task.cost.value_and_gradient(q)[1]
            steepness = float(np.sqrt(gradient @ gradient))
            if not 0 < steepness < np.inf:
                break
            q = self._bridge.inside(q - (step / steepness) * gradient)
        return q


def _connect(step: TransitionStep, tree: Tree, target: FloatArray, ptc: Any) -> tuple[Extension, int]:
    """CONNECT: extend towards the target until it is reached, or a step is blocked or too dear."""
    outcome, node = Extension.ADVANCED, tree.best(target, 0.0)
    while outcome is Extension.ADVANCED and not ptc():
        left = tree.distances(target)[node]
        outcome, node = step.extend(tree, node, target)
        if outcome is Extension.ADVANCED and tree.distances(target)[node] >= left:
            outcome = Extension.TRAPPED
    return outcome, node
