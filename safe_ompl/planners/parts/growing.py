"""What planners share that grow trees of motions from start and goal."""

from __future__ import annotations

from enum import Enum
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.planners.parts.graph import two_trees
from safe_ompl.planners.parts.sliding import SlidingPlanner
from safe_ompl.planners.parts.tree import Tree


class Extension(Enum):
    """Outcome of EXTEND."""

    TRAPPED = "no new node"
    ADVANCED = "a new node on the way"
    REACHED = "a new node at the target"


class TreePlanner(SlidingPlanner):
    """A planner with two trees, one that grows from the starts and one from the goals."""

    def __init__(self, si: Any, name: str) -> None:
        super().__init__(si, name)
        self._start_tree: Tree
        self._goal_tree: Tree
        self._forget()

    def _edge_is_free(self, tree: Tree, near: FloatArray, far: FloatArray) -> bool:
        """Check the edge between a node and a new one in the direction in which the path drives it."""
        return self._motion_is_free(near, far) if tree.from_start else self._motion_is_free(far, near)

    def _add(
        self,
        tree: Tree,
        q: FloatArray,
        parent: int,
        cost: float = np.nan,
        gradient: FloatArray | None = None,
    ) -> int:
        self.counts.nodes += 1
        return tree.add(q, parent, cost, gradient)

    def _join(self, tree: Tree, node: int, other: Tree, met: int) -> FloatArray:
        """RETURN_PATH: the two branches, from start to goal; the configuration where they meet counts once."""
        if not tree.from_start:
            tree, node, other, met = other, met, tree, node
        return np.concatenate([tree.branch(node), other.branch(met)[-2::-1]])

    def _forget(self) -> None:
        self._start_tree = Tree(self._bridge, self._cost, from_start=True)
        self._goal_tree = Tree(self._bridge, self._cost, from_start=False)

    def _add_start(self, q: FloatArray) -> None:
        self._start_tree.add(q)

    def _add_goal(self, q: FloatArray) -> None:
        self._goal_tree.add(q)

    def _graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        trees = self._start_tree, self._goal_tree
        return two_trees(*((tree.configurations, tree.parents) for tree in trees))

    def _has_starts(self) -> bool:
        return len(self._start_tree) > 0

    def _has_goals(self) -> bool:
        return len(self._goal_tree) > 0
