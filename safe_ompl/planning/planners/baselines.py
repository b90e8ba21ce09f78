"""Planners of others that danger-aware planning is measured against: T-RRT, BiTRRT, GradienT-RRT and hRRT."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.parameters import Parameter
from safe_ompl.planning.planners.parts.extend import Extension
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.tree import Tree, Trees

_REFINEMENT = 0.1  # share of nodes that may refine what is explored already
_NEW_GROUND = 0.5  # of the range: nearer to the tree than this, descended nodes are not added
_DESCENT_STEPS = 5  # of GradienT-RRT, each a fifth of the range
_COLDEST = 1e-6  # initial temperature [1]
_TEMPERATURE_FACTOR = 2.0  # after an uphill step is accepted, or too many in a row are refused
_REFUSALS = 10  # refusals in a row before it warms up


class TransitionTest:
    """Accepts downhill steps always, and uphill steps with a probability that adapts itself (Jaillet 2010).

    `scale` is K, the usual cost: the mean of those of start and goal.
    """

    def __init__(self, rng: np.random.Generator, scale: float) -> None:
        self._rng, self._scale = rng, scale
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
        if self._refusals > _REFUSALS:
            self._temperature *= _TEMPERATURE_FACTOR
            self._refusals = 0
        return False


@dataclass(eq=False)
class TransitionStep:
    """EXTEND with the transition test.

    Where the test refuses a configuration (n,), `detour` may offer another one to test instead.
    """

    problem: PlanningProblem
    trees: Trees
    test: TransitionTest
    step: float
    detour: Callable[[Tree, FloatArray], FloatArray | None] = lambda tree, q: None

    def extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """Take one step from node `old` towards `target: (n,)`, if it is free and passes the transition test."""
        bridge, q_old = self.problem.bridge, tree.configurations[old]
        delta = bridge.difference(q_old, target)
        length = sqrt(delta @ delta)
        if length == 0.0:
            return Extension.REACHED, old
        reached, step = length <= self.step, min(length, self.step)
        q_new = target if reached else bridge.wrapped(q_old + (step / length) * delta)
        passed = self._passed(tree, old, q_new)
        if passed is None or not self.problem.motion_is_free(*tree.as_driven(q_old, passed[0])):
            return Extension.TRAPPED, old
        outcome = Extension.REACHED if reached and passed[0] is q_new else Extension.ADVANCED
        return outcome, self.trees.add(tree, passed[0], old, passed[1])

    def _passed(self, tree: Tree, old: int, q_new: FloatArray) -> tuple[FloatArray, float] | None:
        """Return the configuration at which the step may end, and its cost; None if it is too dear."""
        if self.problem.cost.is_zero:
            return q_new, 0.0
        tested = self._tested(tree, old, q_new)
        if tested is not None:
            return tested
        other = self.detour(tree, q_new)
        return None if other is None else self._tested(tree, old, other)

    def _tested(self, tree: Tree, old: int, q: FloatArray) -> tuple[FloatArray, float] | None:
        length = float(np.linalg.norm(self.problem.bridge.difference(tree.configurations[old], q)))
        before, after = float(tree.costs[old]), float(self.problem.cost.values(q[None])[0])
        return (q, after) if self.test.accepts(before, after, length) else None


def usual_cost(trees: Trees) -> float:
    """Return K, the mean cost of start and goal, or 1 where that is of no use."""
    ends = np.concatenate([trees.start.costs[:1], trees.goal.costs[:1]])
    usual = float(ends.mean())
    return usual if np.isfinite(usual) and usual > 0 else 1.0


class TRRT(SafePlanner):
    """One tree that climbs in cost reluctantly (T-RRT).

    A step up the cost is taken with a probability that falls with its slope and rises with the planner's lack of
    success. It needs an objective; without one it is an RRT.

    References
    ----------
    .. [1] L. Jaillet, J. Cortés, T. Siméon: Sampling-based path planning on configuration-space costmaps.
       IEEE Trans. Robotics, 2010.
    """

    goal_bias = Parameter(0.05, "Share of the extensions that go towards a goal.", at_most=1)

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, goals = self._trees.start, self._trees.goal
        test = TransitionTest(self._rng, usual_cost(self._trees))
        step = TransitionStep(self._problem, self._trees, test, self.getRange())
        while not ptc():
            self._take_goals(ptc)
            aims_at_goal = self._rng.random() < self.goal_bias
            goal = int(self._rng.integers(len(goals)))
            target = (
                goals.configurations[goal] if aims_at_goal else self._problem.random_configuration(self._rng)
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


class BiTRRT(SafePlanner):
    """Two such trees that try to connect [1]; new nodes that only refine what is explored are few.

    With `descends` it is GradienT-RRT [2].

    References
    ----------
    .. [1] D. Devaurs, T. Siméon, J. Cortés: Enhancing the transition-based RRT to deal with complex cost spaces.
       ICRA 2013.
    .. [2] D. Berenson, T. Siméon, S. Srinivasa: Addressing cost-space chasms in manipulation planning. ICRA 2011.
    """

    descends = Parameter(
        False,
        """Whether a step that is too dear follows the gradient of the cost down and is tried again. It needs an
        objective with gradients.""",
    )

    def _search(self, ptc: Any) -> FloatArray | None:
        tree, other = self._trees.start, self._trees.goal
        test = TransitionTest(self._rng, usual_cost(self._trees))
        step = TransitionStep(self._problem, self._trees, test, self.getRange(), self._detour)
        refining = 0
        while not ptc():
            self._take_goals(ptc)
            q_rand = self._problem.random_configuration(self._rng)
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
        """Return where the gradient leads down from a configuration that is too dear, to be tested instead."""
        if not (self.descends and self._problem.cost.has_gradients):
            return None
        lower = self._descended(q)
        # Where the tree has been already, it would fill the valley and never climb out of it.
        return lower if tree.distances(lower).min() >= _NEW_GROUND * self.getRange() else None

    def _descended(self, q: FloatArray) -> FloatArray:
        """Return where a few steps down the gradient lead."""
        step = self.getRange() / _DESCENT_STEPS
        for _ in range(_DESCENT_STEPS):
            gradient = self._problem.cost.value_and_gradient(q)[1]
            steepness = sqrt(gradient @ gradient)
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


class HRRT(SafePlanner):
    """One tree that grows from the nearest node with a probability that is the node's quality (hRRT).

    Where the node is refused another target is drawn.

    The quality of a node compares the cost of the best path through it with the others':

        m_quality = 1 − (cost − optimal)/(max − optimal)

    with cost the way to it and an estimate of the rest, optimal that estimate at the start, and max the dearest node
    of the tree. The cost of a motion is its length times 1 + λ CDF/CDF₀: CDF the mean danger of its ends, CDF₀ that of
    start and goal. The rest is estimated by its length, which never overestimates.

    References
    ----------
    .. [1] C. Urmson, R. Simmons: Approaches for heuristically biasing RRT growth. IROS 2003.
    """

    goal_bias = Parameter(0.05, "Share of the extensions that go towards a goal.", at_most=1)
    floor = Parameter(
        0.1,
        "Least probability with which a node is accepted, however poor: without one the tree may stop exploring.",
        at_most=1,
    )
    danger_weight = Parameter(1.0, "λ: weight of danger in the cost of a motion; 0 for lengths alone.")

    def _search(self, ptc: Any) -> FloatArray | None:
        tree = self._trees.start
        while not ptc():
            self._take_goals(ptc)
            self._measure(tree)
            target = self._target()
            old = tree.best(target, 0.0)
            if self._rng.random() >= max(self.quality(old), self.floor):
                continue
            outcome, new = self._extend(tree, old, target)
            if outcome is not Extension.TRAPPED and (met := self._reached(tree, new)) is not None:
                return tree.branch(met)
        return None

    def quality(self, node: int) -> float:
        """Return m_quality in [0, 1] of a node of the tree: 1 where the best path through it is as cheap as can be."""
        costs = np.array(self._through)
        if not np.isfinite(costs[node]):
            return 0.0
        known = costs[np.isfinite(costs)]
        optimal, dearest = known.min(), known.max()
        return float(1.0 - (costs[node] - optimal) / (dearest - optimal)) if dearest > optimal else 1.0

    def _target(self) -> FloatArray:
        """Return a random configuration (n,), now and then a goal."""
        if self._rng.random() >= self.goal_bias:
            return self._problem.random_configuration(self._rng)
        goals = self._trees.goal
        goal: FloatArray = goals.configurations[int(self._rng.integers(len(goals)))]
        return goal

    def _extend(self, tree: Tree, old: int, target: FloatArray) -> tuple[Extension, int]:
        """EXTEND: one step of at most the range from node `old` towards `target: (n,)`."""
        q_old = tree.configurations[old]
        delta = self._bridge.difference(q_old, target)
        length = sqrt(delta @ delta)
        if length == 0.0:
            return Extension.TRAPPED, old
        reached = length <= self.getRange()
        q_new = target if reached else self._bridge.wrapped(q_old + (self.getRange() / length) * delta)
        if not self._problem.motion_is_free(q_old, q_new):
            return Extension.TRAPPED, old
        new = self._trees.add(tree, q_new, old)
        self._measure(tree)
        return Extension.REACHED if reached else Extension.ADVANCED, new

    def _reached(self, tree: Tree, node: int) -> int | None:
        """Return the node at the nearest goal, if that is within a free step of `node`."""
        goals, q = self._trees.goal, tree.configurations[node]
        near = goals.best(q, 0.0)
        if (goals.configurations[near] == q).all():
            return node
        if goals.distances(q)[near] > self.getRange():
            return None
        outcome, met = self._extend(tree, node, goals.configurations[near])
        return met if outcome is Extension.REACHED else None

    def _measure(self, tree: Tree) -> None:
        """Note, for new nodes, the cost of the way to them, and of the best path through them."""
        for node in range(len(self._costs), len(tree)):
            parent = int(tree.parents[node])
            way = 0.0 if parent < 0 else self._costs[parent] + self._motion_cost(tree, parent, node)
            self._costs.append(way)
            self._through.append(way + float(self._trees.goal.distances(tree.configurations[node]).min()))

    def _motion_cost(self, tree: Tree, start: int, end: int) -> float:
        ends = tree.configurations[[start, end]]
        length = float(np.linalg.norm(self._bridge.difference(ends[0], ends[1])))
        if self._problem.cost.is_zero or not self.danger_weight:
            return length
        danger = float(tree.costs[[start, end]].mean()) / usual_cost(self._trees)
        return length * (1.0 + self.danger_weight * danger)

    def _forget(self) -> None:
        super()._forget()
        self._costs: list[float] = []  # of the way to each node
        self._through: list[float] = []  # of the best path through it, as far as known
