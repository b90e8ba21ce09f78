"""The two trees of a bidirectional planner, and the graph of nodes and edges that a planner has built."""

from __future__ import annotations

from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from ompl import base as ob

from safe_ompl.common import Counts, FloatArray, IntArray
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.growth import Tree, branch
from safe_ompl.robot import OwnState, StateBridge


class SearchTree(Protocol):
    """One of the two trees of a bidirectional planner."""

    def __len__(self) -> int: ...
    def add_root(self, q: FloatArray) -> None:
        """Add a start or goal configuration (n,)."""

    def nodes(self) -> tuple[FloatArray, IntArray]:
        """Return the configurations (N, n), and for each the index of its parent, negative for roots."""


AnyTree = TypeVar("AnyTree", bound=SearchTree)


class TwoTrees(Generic[AnyTree]):
    """The two trees of a bidirectional planner, with roots at the starts and at the goals."""

    def __init__(self, start: AnyTree, goal: AnyTree) -> None:
        self.start, self.goal = start, goal

    def add_start(self, q: FloatArray) -> None:
        """Add a valid start configuration (n,)."""
        self.start.add_root(q)

    def add_goal(self, q: FloatArray) -> None:
        """Add a valid goal configuration (n,)."""
        self.goal.add_root(q)

    @property
    def has_starts(self) -> bool:
        """Whether there is a start."""
        return len(self.start) > 0

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""
        return len(self.goal) > 0

    def approach(self, bridge: StateBridge) -> FloatArray:
        """Return the branch (N, n) from a start to the node nearest to a goal; N = 1 if this node is a start."""
        (rows, parents), (back, followers) = self.start.nodes(), self.goal.nodes()
        return np.asarray(rows[branch(parents, nearest_row(bridge, rows, back[followers < 0]))])

    def graph(self) -> PlannerGraph:
        """Return what has been built; a configuration of both trees, where they have met, is one vertex."""
        (there, parents), (back, followers) = self.start.nodes(), self.goal.nodes()
        known = {q.tobytes(): k for k, q in enumerate(there)}
        numbers = np.empty(len(back), dtype=np.intp)
        new: list[int] = []
        for k, q in enumerate(back):
            numbers[k] = known.get(q.tobytes(), len(there) + len(new))
            if numbers[k] >= len(there):
                new.append(k)
        forward, backward = np.flatnonzero(parents >= 0), np.flatnonzero(followers >= 0)
        outwards = np.stack([parents[forward], forward], axis=1)
        homewards = np.stack([numbers[backward], numbers[followers[backward]]], axis=1)
        starts, goals = np.flatnonzero(parents < 0), np.unique(numbers[followers < 0])
        return PlannerGraph(np.concatenate([there, back[new]]), np.concatenate([outwards, homewards]), starts, goals)


def nearest_row(bridge: StateBridge, rows: FloatArray, goals: FloatArray) -> int:
    """Return the index of the configuration in `rows: (N, n)` that is nearest to one of the `goals: (G, n)`."""
    squares = [np.square(bridge.difference(rows, goal)).sum(axis=1) for goal in goals]
    return int(np.min(squares, axis=0).argmin())


class Trees(TwoTrees[Tree]):
    """The two trees of a planner; `counts` counts their nodes."""

    def __init__(self, bridge: StateBridge, cost: StateCost, counts: Counts) -> None:
        super().__init__(Tree(bridge, cost, from_start=True), Tree(bridge, cost, from_start=False))
        self.counts = counts

    def add(self, tree: Tree, q: FloatArray, parent: int) -> int:
        """Add a node to one of the trees, as `Tree.add`, and count it."""
        self.counts.nodes += 1
        return tree.add(q, parent)

    def path(self, tree: Tree, node: int, other: Tree, met: int) -> FloatArray:
        """Return the path (N, n) from start to goal along two branches; the node where they meet appears once."""
        if not tree.from_start:
            tree, node, other, met = other, met, tree, node
        return np.concatenate([tree.branch(node), other.branch(met)[-2::-1]])


class PlannerGraph(NamedTuple):
    """The graph of a planner: `configurations: (N, n)` [rad or m], and the indices of starts and goals among them.

    `edges: (E, 2)` are free motions as pairs of indices, in the direction in which the robot moves.
    """

    configurations: FloatArray
    edges: IntArray
    starts: IntArray
    goals: IntArray

    def fill(self, data: Any, bridge: StateBridge) -> None:
        """Append the graph to an `ob.PlannerData` with copies of the states; the order of vertices is kept."""
        starts, goals = set(self.starts.tolist()), set(self.goals.tolist())
        states, numbers = list[OwnState](), []
        for k, q in enumerate(self.configurations):
            states.append(OwnState(bridge))
            # PlannerData identifies states by their addresses, and keeps addresses of states that `clear` has freed.
            # Therefore states are taken until one has a new address.
            while data.vertexExists(vertex := ob.PlannerDataVertex(states[-1].state)):
                states.append(OwnState(bridge))
            bridge.write(q, states[-1].state)
            add = data.addStartVertex if k in starts else data.addGoalVertex if k in goals else data.addVertex
            numbers.append(add(vertex))
        for start, end in self.edges.tolist():
            data.addEdge(numbers[start], numbers[end])
        # Until this call the PlannerData has pointers to these states, which are reused afterwards.
        data.decoupleFromPlanner()
