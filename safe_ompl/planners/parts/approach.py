"""Distances of the nodes of a tree from a place of the tip, and the choice of the node to go there from."""

from __future__ import annotations

from heapq import heapify, heappop, heappush

import numpy as np

from safe_ompl.planners.parts.tree import Tree
from safe_ompl.plugins.goals import WorkspaceGoal


class Approach:
    """Distances of a tree's nodes from a goal in the workspace, and the nodes not yet chosen, in order.

    Parameters
    ----------
    goal : WorkspaceGoal or None
        The goal; without one nothing is measured.

    Attributes
    ----------
    distances : list of float
        WS_DISTANCE of the tip from the goal, for each node.
    untried : list of int
        Nodes that may be chosen and are not ranked yet.
    arrived : int or None
        The first node at the goal.
    """

    def __init__(self, goal: WorkspaceGoal | None) -> None:
        self._goal = goal
        self.distances: list[float] = []
        self.untried: list[int] = []
        self.arrived: int | None = None
        self._ranked: list[tuple[float, int]] = []  # a heap

    def measure(self, tree: Tree) -> None:
        """Note how far the tip is from the goal at new nodes, and whether it is there."""
        if self._goal is None:
            return
        for node in range(len(self.distances), len(tree)):
            self.distances.append(self._goal.place.distance(tree.configurations[node]))
            if self.arrived is None and self.distances[node] < self._goal.tolerance:
                self.arrived = node

    def take_new(self, tree: Tree) -> None:
        """Measure new nodes, and let them be chosen."""
        self.untried += range(len(self.distances), len(tree))
        self.measure(tree)

    def best(self, tree: Tree, weight: float, at_random: float, rng: np.random.Generator) -> int | None:
        """Return argmin of WS_DISTANCE + weight·CDF over the nodes not chosen before; None if there is none.

        Nodes that a step towards the goal has added count as chosen: going on from them is what was done. In a share
        `at_random` of the choices any node is taken, or the best ones, all in the same dead end, would have to be
        tried one by one.
        """
        self._rank(tree, weight)
        if not self._ranked:
            return None
        if not at_random or rng.random() >= at_random:
            return heappop(self._ranked)[1]
        _, node = self._ranked.pop(int(rng.integers(len(self._ranked))))
        heapify(self._ranked)
        return node

    def _rank(self, tree: Tree, weight: float) -> None:
        """Put the new nodes among those ranked by WS_DISTANCE + weight·CDF."""
        danger = tree.costs if weight and self.untried else np.zeros(len(tree))
        for node in self.untried:
            heappush(self._ranked, (self.distances[node] + weight * float(danger[node]), node))
        self.untried.clear()
