"""Trees of configurations that grow row by row, with the cost of every node; two that are to meet; what was built."""

from __future__ import annotations

from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from ompl import base as ob

from safe_ompl.common import Counts, FloatArray, IntArray
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.nearest import NearestNode
from safe_ompl.planning.planners.turns import NARROW, PRICED, ROOT, SIZE, SLOPED, Nodes
from safe_ompl.robot import StateBridge

_ROOM = 64  # nodes, at first


def branch(parents: IntArray, node: int) -> list[int]:
    """Return the nodes from the root to `node`, where `parents: (N,)` are the indices of the nodes' parents."""
    nodes = []
    while node != ROOT:
        nodes.append(node)
        node = int(parents[node])
    return nodes[::-1]


class Tree:
    """Configurations as rows of one array, each with the index of its parent; edges are driven from or to the start.

    Costs are evaluated when they are first asked for, all new nodes in one batch. Kernels add to the `arrays`, too.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, *, from_start: bool = True) -> None:
        self.from_start, self._cost = from_start, cost
        rows, parents, costs = np.empty((_ROOM, bridge.n)), np.empty(_ROOM, np.intp), np.empty(_ROOM)
        self.arrays = Nodes(rows, parents, costs, rows.copy(), np.empty((_ROOM, 2), bool), np.zeros(2, np.intp))
        self.nearest = NearestNode(bridge.circular)

    def __len__(self) -> int:
        return int(self.arrays.used[SIZE])

    @property
    def configurations(self) -> FloatArray:
        """The nodes (N, n)."""
        return self.arrays.rows[: len(self)]

    @property
    def parents(self) -> IntArray:
        """For each node the index of its parent (N,); -1 for roots."""
        return self.arrays.parents[: len(self)]

    @property
    def roots(self) -> FloatArray:
        """The nodes (R, n) that have no parent."""
        return np.asarray(self.configurations[self.parents == ROOT])

    @property
    def costs(self) -> FloatArray:
        """The cost of each node (N,)."""
        used = self.arrays.used
        costs: FloatArray = self.arrays.costs[: len(self)]
        if used[PRICED] < used[SIZE]:
            new = used[PRICED] + np.flatnonzero(np.isnan(costs[used[PRICED] :]))
            if len(new):
                costs[new] = self._cost.values(self.arrays.rows[new])
            used[PRICED] = used[SIZE]
        return costs

    def gradient(self, node: int) -> FloatArray:
        """Return the gradient (n,) of the cost at `node`; only for costs with gradients."""
        rows, _, costs, gradients, marks, _ = self.arrays
        if not marks[node, SLOPED]:
            value, gradients[node] = self._cost.value_and_gradient(rows[node])
            marks[node, SLOPED] = True
            if np.isnan(costs[node]):
                costs[node] = value
        return np.asarray(gradients[node])

    def add(self, q: FloatArray, parent: int = ROOT) -> int:
        """Append the configuration `q: (n,)` and return its index."""
        node = len(self)
        if node == len(self.arrays.rows):
            self.make_room()
        rows, parents, costs, _, marks, used = self.arrays
        rows[node], parents[node], costs[node], marks[node] = q, parent, np.nan, False
        if parent != ROOT:
            marks[parent, NARROW] = False
        used[SIZE] = node + 1
        return node

    def make_room(self) -> None:
        """Make room where there is none: for as many nodes again, or where the nearest is looked for."""
        *arrays, used = self.arrays
        if used[SIZE] < len(arrays[0]):
            self.nearest.make_room()
        else:
            wider = [np.empty((2 * len(each), *each.shape[1:]), each.dtype) for each in arrays]
            for old, new in zip(arrays, wider, strict=True):
                new[: len(old)] = old
            self.arrays = Nodes._make([*wider, used])

    def add_root(self, q: FloatArray) -> None:
        """Add a start or goal configuration (n,)."""
        self.add(q)

    def nodes(self) -> tuple[FloatArray, IntArray]:
        """Return configurations and parents."""
        return self.configurations, self.parents

    def best(self, q: FloatArray, alpha: float) -> int:
        """Return argmin of ρ(node, q) + α·cost(node); the nearest node for α = 0."""
        if alpha:
            return self.nearest.find(self.configurations, q, alpha, self.costs)
        return self.nearest.find(self.configurations, q)

    def as_driven(self, near: FloatArray, far: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the ends of an edge, `near` the root and `far` from it, in the order in which a path drives them."""
        return (near, far) if self.from_start else (far, near)

    def branch(self, node: int) -> FloatArray:
        """Return the configurations (k, n) from the root to `node`."""
        return self.configurations[branch(self.parents, node)]


class SearchTree(Protocol):
    """One of two trees that are to meet."""

    def __len__(self) -> int: ...
    def add_root(self, q: FloatArray) -> None:
        """Add a start or goal configuration (n,)."""

    def nodes(self) -> tuple[FloatArray, IntArray]:
        """Return the configurations (N, n), and for each the index of its parent, negative for roots."""


AnyTree = TypeVar("AnyTree", bound=SearchTree)


class TwoTrees(Generic[AnyTree]):
    """What a planner builds from starts and goals: two trees that are to meet."""

    def __init__(self, start: AnyTree, goal: AnyTree) -> None:
        self.start, self.goal = start, goal

    def add_start(self, q: FloatArray) -> None:
        """Take a valid start configuration (n,)."""
        self.start.add_root(q)

    def add_goal(self, q: FloatArray) -> None:
        """Take a valid goal configuration (n,)."""
        self.goal.add_root(q)

    @property
    def has_starts(self) -> bool:
        """Whether there is a start."""
        return len(self.start) > 0

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""
        return len(self.goal) > 0

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


class Trees(TwoTrees[Tree]):
    """Two trees that are to meet; `counts` counts their nodes."""

    def __init__(self, bridge: StateBridge, cost: StateCost, counts: Counts) -> None:
        super().__init__(Tree(bridge, cost, from_start=True), Tree(bridge, cost, from_start=False))
        self.counts = counts

    def add(self, tree: Tree, q: FloatArray, parent: int) -> int:
        """Add a node to one of the trees, as `Tree.add`, and count it."""
        self.counts.nodes += 1
        return tree.add(q, parent)

    def path(self, tree: Tree, node: int, other: Tree, met: int) -> FloatArray:
        """Return the two branches (N, n), from start to goal; the configuration where they meet counts once."""
        if not tree.from_start:
            tree, node, other, met = other, met, tree, node
        return np.concatenate([tree.branch(node), other.branch(met)[-2::-1]])


class PlannerGraph(NamedTuple):
    """What a planner holds: `configurations: (N, n)` [rad or m], and which of them are starts and goals.

    `edges: (E, 2)` are free motions, each from one vertex to another in the direction in which it is driven.
    """

    configurations: FloatArray
    edges: IntArray
    starts: IntArray
    goals: IntArray

    def fill(self, data: Any, bridge: StateBridge) -> None:
        """Append the graph to an `ob.PlannerData`, which gets copies of the states; vertices keep their order."""
        starts, goals = set(self.starts.tolist()), set(self.goals.tolist())
        states: list[Any] = []
        numbers = []
        for k, q in enumerate(self.configurations):
            states.append(bridge.space.allocState())
            # It knows states by their addresses, and does not forget those that were freed when it was cleared
            while data.vertexExists(vertex := ob.PlannerDataVertex(states[-1])):
                states.append(bridge.space.allocState())
            bridge.write(q, states[-1])
            add = data.addStartVertex if k in starts else data.addGoalVertex if k in goals else data.addVertex
            numbers.append(add(vertex))
        for start, end in self.edges.tolist():
            data.addEdge(numbers[start], numbers[end])
        data.decoupleFromPlanner()  # it holds pointers to our states until then
