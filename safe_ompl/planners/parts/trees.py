"""The two trees of a planner: one that grows from the starts, and one from the goals."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.counts import Counts
from safe_ompl.planners.graphs.planner_graph import two_trees
from safe_ompl.planners.parts.tree import ROOT, Tree
from safe_ompl.plugins.objective import StateCost
from safe_ompl.plugins.states import StateBridge


class Trees:
    """Two trees that are to meet.

    Parameters
    ----------
    bridge : StateBridge
        The space.
    cost : StateCost
        Cost of configurations.
    counts : Counts
        Counts the nodes that are added.

    Attributes
    ----------
    start, goal : Tree
        The trees.
    blocked, dangerous : int
        How many candidates for nodes were refused because the step to them is not free, and as too dangerous.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, counts: Counts) -> None:
        self.start = Tree(bridge, cost, from_start=True)
        self.goal = Tree(bridge, cost, from_start=False)
        self.blocked = self.dangerous = 0
        self._counts = counts

    def add_start(self, q: FloatArray) -> None:
        """Take a start configuration (n,)."""
        self.start.add(q)

    def add_goal(self, q: FloatArray) -> None:
        """Take a goal configuration (n,)."""
        self.goal.add(q)

    @property
    def has_starts(self) -> bool:
        """Whether there is a start."""
        return len(self.start) > 0

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""
        return len(self.goal) > 0

    def add(
        self,
        tree: Tree,
        q: FloatArray,
        parent: int,
        cost: float = np.nan,
        gradient: FloatArray | None = None,
    ) -> int:
        """Add a node to one of the trees, as `Tree.add`, and count it."""
        self._counts.nodes += 1
        return tree.add(q, parent, cost, gradient)

    def path(self, tree: Tree, node: int, other: Tree, met: int) -> FloatArray:
        """Return the two branches (N, n), from start to goal; the configuration where they meet counts once."""
        if not tree.from_start:
            tree, node, other, met = other, met, tree, node
        return np.concatenate([tree.branch(node), other.branch(met)[-2::-1]])

    def forced_cost(self) -> float:
        """Return the cost that no path can avoid: of the cheapest start or the cheapest goal, whichever is dearer."""
        roots = (tree.costs[tree.parents == ROOT] for tree in (self.start, self.goal))
        return max(float(costs.min()) for costs in roots if len(costs))

    def graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        """Return vertices (N, n), edges (E, 2) in the direction of driving, and which vertices are starts and goals."""
        return two_trees(*((tree.configurations, tree.parents) for tree in (self.start, self.goal)))
