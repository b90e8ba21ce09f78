"""Trees of configurations that grow row by row, with the cost of every node; two that are to meet; whose turn it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import BoolArray, Counts, FloatArray, IntArray
from safe_ompl.planning.ompl import StateBridge, StateCost
from safe_ompl.planning.planners import kernels as kernel
from safe_ompl.planning.planners.graphs.planner_graph import two_trees

_FEW = 400  # nodes that a scan is through with before a search in the tree is
_NOTHING: FloatArray = np.empty(0)


class NearestNode:
    """Finds argmin ρ(node, q) + α·cost(node), of equal ones the first, among nodes that are only ever added.

    Parameters
    ----------
    wraps : ndarray of bool, shape (n,)
        Coordinates in which ρ, else Euclidean, goes the short way round.
    """

    def __init__(self, wraps: BoolArray) -> None:
        self._wraps = np.array(wraps, dtype=bool)
        self._links: IntArray = np.empty((0, 3), dtype=np.intp)
        self._boxes: FloatArray = np.empty((0, 2, len(self._wraps)))
        self._lowest: FloatArray = _NOTHING
        self._known = self._priced = self._deepest = 0

    def __repr__(self) -> str:
        return f"NearestNode({self._wraps.tolist()})"

    def find(self, rows: FloatArray, q: FloatArray, alpha: float = 0.0, costs: FloatArray = _NOTHING) -> int:
        """Return the node; 0 where there are none.

        Parameters
        ----------
        rows : ndarray, shape (N, n)
            The nodes, C-contiguous: those of the last call, and others.
        q : ndarray, shape (n,)
        alpha : float
            α ≥ 0.
        costs : ndarray, shape (N,), optional
            What α multiplies; the costs of nodes do not change.
        """
        q = np.require(q, np.float64, ["C", "W"])
        if len(rows) <= _FEW:
            return int(kernel.scan(rows, q, self._wraps, alpha, costs))
        if len(rows) > self._known:
            self._insert(rows)
        if alpha and len(costs) > self._priced:
            kernel.price(costs, self._priced, self._links, self._lowest)
            self._priced = len(costs)
        tree = self._links, self._boxes, self._lowest, self._deepest
        return int(kernel.search(rows, q, self._wraps, alpha, costs, *tree))

    def _insert(self, rows: FloatArray) -> None:
        if len(rows) > len(self._links):
            capacity = 2 * len(rows)
            self._links = _grown(self._links, capacity)
            self._boxes = _grown(self._boxes, capacity)
            self._lowest = _grown(self._lowest, capacity)
        deepest = kernel.insert(rows, self._known, self._links, self._boxes, self._lowest)
        self._deepest, self._known = max(self._deepest, deepest), len(rows)


def _grown(array: Any, capacity: int) -> Any:
    """Return a longer array that begins with `array`."""
    grown = np.empty((capacity, *array.shape[1:]), dtype=array.dtype)
    grown[: len(array)] = array
    return grown


ROOT = -1
_LARGE = 64  # nodes; easy problems are solved before a tree has more
_IN_A_ROW = 8  # turns of a tree that lags before the other has one


class Tree:
    """Configurations as rows of one array, each with the index of its parent.

    Costs are evaluated when they are first asked for, all new nodes in one batch.

    Parameters
    ----------
    bridge : StateBridge
        The space; gives the metric ρ, Euclidean with wrapping.
    cost : StateCost
        Cost of configurations.
    from_start : bool
        Whether the tree grows from the start (edges are driven away from the root) or from the goal.

    Attributes
    ----------
    trapped : set of int
        Nodes whose last step was trapped.
    """

    def __init__(self, bridge: StateBridge, cost: StateCost, *, from_start: bool = True) -> None:
        self.from_start = from_start
        self._bridge = bridge
        self._cost = cost
        self._rows: FloatArray = np.empty((64, bridge.n))
        self._parents: IntArray = np.empty(64, dtype=np.intp)
        self._costs: FloatArray = np.full(64, np.nan)  # NaN: not evaluated yet
        self._gradients: dict[int, FloatArray] = {}
        self.trapped: set[int] = set()
        self._nearest = NearestNode(bridge.circular)
        self._size = 0
        self._asked = 0  # nodes whose costs are known

    def __len__(self) -> int:
        return self._size

    @property
    def configurations(self) -> FloatArray:
        """The nodes (N, n)."""
        return self._rows[: self._size]

    @property
    def parents(self) -> IntArray:
        """For each node the index of its parent (N,); -1 for roots."""
        return self._parents[: self._size]

    @property
    def roots(self) -> FloatArray:
        """The nodes (R, n) that have no parent."""
        roots: FloatArray = self.configurations[self.parents == ROOT]
        return roots

    @property
    def costs(self) -> FloatArray:
        """The cost of each node (N,)."""
        if self._asked < self._size:
            new = self._asked + np.flatnonzero(np.isnan(self._costs[self._asked : self._size]))
            if len(new):
                self._costs[new] = self._cost.values(self._rows[new])
            self._asked = self._size
        return self._costs[: self._size]

    def gradient(self, node: int) -> FloatArray:
        """Return the gradient (n,) of the cost at `node`; only for costs with gradients."""
        if node not in self._gradients:
            value, self._gradients[node] = self._cost.value_and_gradient(self._rows[node])
            if np.isnan(self._costs[node]):
                self._costs[node] = value
        return self._gradients[node]

    def add(
        self, q: FloatArray, parent: int = ROOT, cost: float = np.nan, gradient: FloatArray | None = None
    ) -> int:
        """Append the configuration `q: (n,)`, with what is known of its cost, and return its index."""
        if self._size == len(self._rows):
            self._grow()
        self._rows[self._size] = q
        self._parents[self._size] = parent
        self.trapped.discard(parent)
        self._costs[self._size] = cost
        if gradient is not None:
            self._gradients[self._size] = gradient
        self._size += 1
        return self._size - 1

    def distances(self, q: FloatArray) -> FloatArray:
        """Return ρ (N,) from every node to `q: (n,)` [rad or m]."""
        delta = self._bridge.difference(self.configurations, q)
        distances: FloatArray = np.sqrt(np.einsum("ij,ij->i", delta, delta))
        return distances

    def best(self, q: FloatArray, alpha: float) -> int:
        """Return argmin of ρ(node, q) + α·cost(node); the nearest node for α = 0."""
        if alpha:
            return self._nearest.find(self.configurations, q, alpha, self.costs)
        return self._nearest.find(self.configurations, q)

    def as_driven(self, near: FloatArray, far: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the ends of an edge, `near` the root and `far` from it, in the order in which a path drives them."""
        return (near, far) if self.from_start else (far, near)

    def branch(self, node: int) -> FloatArray:
        """Return the configurations (k, n) from the root to `node`."""
        indices = []
        while node != ROOT:
            indices.append(node)
            node = int(self._parents[node])
        return self.configurations[indices[::-1]]

    def _grow(self) -> None:
        capacity = 2 * len(self._rows)
        self._rows = np.resize(self._rows, (capacity, self._bridge.n))
        self._parents = np.resize(self._parents, capacity)
        self._costs = np.concatenate([self._costs, np.full_like(self._costs, np.nan)])


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


class TreeSchedule:
    """Says which of two trees grows next: they alternate, but one that lags behind a large one has eight of nine turns.

    A tree in a narrow place hardly grows, while the other fills the space outside to little avail. The larger tree
    keeps some of the turns: the smaller one may be sealed in, and more goals are taken as nodes are added.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._in_a_row = 1

    def again(self, tree: Tree, other: Tree) -> bool:
        """Return whether the tree that had this turn has the next one, too."""
        lags = len(other) > max(_LARGE, len(tree))
        if lags and self._in_a_row < _IN_A_ROW:
            self._in_a_row += 1
            return True
        self._in_a_row = 1
        return False
