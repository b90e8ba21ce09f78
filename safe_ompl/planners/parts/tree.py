"""A tree of configurations that grows row by row, with the cost of every node."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.plugins.objective import StateCost
from safe_ompl.plugins.states import StateBridge

ROOT = -1


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
        self._size = 0

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
        new = np.flatnonzero(np.isnan(self._costs[: self._size]))
        if len(new):
            self._costs[new] = self._cost.values(self._rows[new])
        return self._costs[: self._size]

    def gradient(self, node: int) -> FloatArray:
        """Return the gradient (n,) of the cost at `node`; only for costs with gradients."""
        if node not in self._gradients:
            self._costs[node], self._gradients[node] = self._cost.value_and_gradient(self._rows[node])
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
        score = self.distances(q)
        if alpha:
            score += alpha * self.costs
        return int(score.argmin())

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
