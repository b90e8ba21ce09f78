"""The nearest of the nodes of a tree that grows, exactly, in a time that hardly grows with them."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.planning.planners import kernels as kernel

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
