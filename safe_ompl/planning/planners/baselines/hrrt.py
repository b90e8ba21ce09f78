"""HRRT: an RRT that prefers to grow from nodes through which paths promise to be cheap."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.baselines.trrt import usual_cost
from safe_ompl.planning.planners.parameters import Parameter
from safe_ompl.planning.planners.parts.extend import Extension
from safe_ompl.planning.planners.parts.tree import Tree


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

    # ---------------------------------------------------------------------------------------------- the search

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
        length = float(np.sqrt(delta @ delta))
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

    # -------------------------------------------------------------------------------------------- costs of nodes

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
