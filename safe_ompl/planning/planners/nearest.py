"""The nearest of many nodes: argmin ρ + α·cost, of equal ones the first.

The distance ρ is Euclidean, coordinates that wrap going the short way round. Few nodes are scanned. Many are divided
among leaves by a k-d tree: a full leaf in the middle of the longest side of its box. Every cell knows the box of its
nodes and their least cost, so that a search leaves out cells that can hold no better node. Leaves are kept coordinate
by coordinate, so that processors compute distances by lanes.
"""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import way

_FEW = 400  # nodes that a scan is through with before a search in the tree is
_NOTHING: FloatArray = np.empty(0)
_SIZE = 16  # nodes in a leaf
_ROUNDING = 1e-9  # [rad] by which gaps are taken for less where coordinates wrap: no rounding may hide a node
_LESS, _MORE, _BY, _LEAF = range(4)  # columns of cells
_LEAVES, _NODES, _PRICED, _DEPTH = range(4)


class BoxTree(NamedTuple):
    """A k-d tree, in arrays that may have room for more leaves; there is one cell less than twice as many.

    Cells have the two that they are divided into, and the coordinate by which; `cuts` are where. Those that are not
    divided have −1 for MORE, and a leaf. A cell whose nodes are all at one place is divided by their numbers, as if
    they were coordinate n. `boxes` are the least and the greatest coordinates in a cell, and the least cost.

    Leaves have the number of their nodes, the nodes, and their coordinates and costs. Costs are ∞ until they are known.
    `used` counts leaves, nodes, those with known costs, and the cells above a leaf.
    """

    cells: IntArray  # (2 S, 4)
    cuts: FloatArray  # (2 S,)
    boxes: FloatArray  # (2 S, 2n + 1)
    counts: IntArray  # (S,)
    nodes: IntArray  # (S, 16)
    places: FloatArray  # (S, n + 1, 16)
    used: IntArray  # (4,)


class NearestNode:
    """Finds the nearest of nodes that are only ever added; `wraps: (n,)` says which coordinates wrap."""

    def __init__(self, wraps: BoolArray) -> None:
        self._wraps = np.array(wraps, dtype=bool)
        self.tree = _room_for(0, len(self._wraps))

    def find(self, rows: FloatArray, q: FloatArray, alpha: float = 0.0, costs: FloatArray = _NOTHING) -> int:
        """Return the node for `q: (n,)` and α ≥ 0; 0 where there are none.

        `rows: (N, n)`, C-contiguous, and their costs (N,) are those of the last call, and others.
        """
        q = plain(q)
        while (found := nearest(rows, q, self._wraps, alpha, costs, self.tree)) < 0:
            self.make_room()
        return int(found)

    def make_room(self) -> None:
        """Make room in the tree for as many nodes again."""
        known, self.tree = self.tree, _room_for(2 * len(self.tree.counts) + _FEW, len(self._wraps))
        for old, new in zip(known, self.tree, strict=True):
            new[: len(old)] = old


def _room_for(leaves: int, n: int) -> BoxTree:
    """Return a tree of one leaf without nodes, with room for more."""
    cells, boxes = np.zeros((2 * leaves, 4), np.intp), np.full((2 * leaves, 2 * n + 1), inf)
    cells[:, _MORE], boxes[:, n : 2 * n] = -1, -inf
    nodes, places = np.empty((leaves, _SIZE), np.intp), np.full((leaves, n + 1, _SIZE), inf)
    return BoxTree(cells, np.empty(2 * leaves), boxes, np.zeros(leaves, np.intp), nodes, places, np.array([1, 0, 0, 0]))


@part
def _distance(rows: FloatArray, node: int, q: FloatArray, wraps: BoolArray) -> float:
    """Return ρ from a node to q."""
    total = 0.0
    for i in range(len(q)):
        delta = way(rows[node, i], q[i], wraps[i])
        total += delta * delta
    return sqrt(total)


@part
def _scan(rows: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, costs: FloatArray) -> int:
    """Return the same by looking at all nodes."""
    best, least = 0, inf
    for node in range(len(rows)):
        score = _distance(rows, node, q, wraps)
        if alpha != 0.0:
            score += alpha * costs[node]
        if score < least:
            best, least = node, score
    return best


@compiled
def nearest(rows: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, costs: FloatArray, tree: BoxTree) -> int:
    """Return argmin ρ + α·cost of all nodes `rows: (N, n)`; costs (N,), or (0,) where α is 0.

    Few nodes are scanned. Many are put into the tree first; −1 if it has no room for them.
    """
    if len(rows) <= _FEW:
        return _scan(rows, q, wraps, alpha, costs)
    for node in range(tree.used[_NODES], len(rows)):
        if tree.used[_LEAVES] >= len(tree.counts):
            return -1
        _insert(rows, node, tree)
    if alpha != 0.0:
        _price(rows, costs, tree)
    # Arrays of their own, so that the compiler knows that what is written to one does not change another.
    stack, bounds = np.empty(tree.used[_DEPTH] + 2, np.int64), np.empty(tree.used[_DEPTH] + 2)
    scores = np.empty(_SIZE)
    stack[0], bounds[0], size = 0, -inf, 1
    best, least = 0, inf
    while size > 0:
        size -= 1
        cell = stack[size]
        if bounds[size] > least:
            continue
        if tree.cells[cell, _MORE] < 0:
            leaf = tree.cells[cell, _LEAF]
            _score(tree.places[leaf], q, wraps, alpha, scores)
            for lane in range(tree.counts[leaf]):
                node = tree.nodes[leaf, lane]
                if scores[lane] < least or (scores[lane] == least and node < best):
                    best, least = node, scores[lane]
            continue
        near, far = tree.cells[cell, _LESS], tree.cells[cell, _MORE]
        at_near, at_far = (_bound(tree.boxes[near], q, wraps, alpha), _bound(tree.boxes[far], q, wraps, alpha))
        if at_far < at_near:
            near, far, at_near, at_far = far, near, at_far, at_near
        stack[size], bounds[size] = far, at_far
        stack[size + 1], bounds[size + 1] = near, at_near
        size += 2
    return int(best) if least < inf else 0


@part
def _insert(rows: FloatArray, node: int, tree: BoxTree) -> None:
    """Put a node into its leaf, which is divided where it is full; neither half is full."""
    cell, depth = 0, 0
    while True:
        leaf = tree.cells[cell, _LEAF]
        if tree.cells[cell, _MORE] < 0 and tree.counts[leaf] == _SIZE:
            _divide(rows, cell, tree)
        if tree.cells[cell, _MORE] < 0:
            break
        _widen(tree.boxes[cell], rows, node, inf)
        cell, depth = _half(rows, node, cell, tree), depth + 1
    _put(rows, node, inf, cell, tree)
    tree.used[_NODES], tree.used[_DEPTH] = node + 1, max(tree.used[_DEPTH], depth)


@part
def _half(rows: FloatArray, node: int, cell: int, tree: BoxTree) -> int:
    """Return the half of a cell that a node belongs to, by a coordinate or by its number."""
    by = tree.cells[cell, _BY]
    place = rows[node, by] if by < rows.shape[1] else float(node)
    return int(tree.cells[cell, _MORE if place > tree.cuts[cell] else _LESS])


@part
def _widen(box: FloatArray, rows: FloatArray, node: int, cost: float) -> None:
    """Let a box hold a node with its cost."""
    n = rows.shape[1]
    for i in range(n):
        box[i], box[n + i] = min(box[i], rows[node, i]), max(box[n + i], rows[node, i])
    box[2 * n] = min(box[2 * n], cost)


@part
def _put(rows: FloatArray, node: int, cost: float, cell: int, tree: BoxTree) -> None:
    """Put a node with its cost into the leaf of a cell, which has room."""
    leaf, n = tree.cells[cell, _LEAF], rows.shape[1]
    lane = tree.counts[leaf]
    tree.counts[leaf], tree.nodes[leaf, lane] = lane + 1, node
    for i in range(n):
        tree.places[leaf, i, lane] = rows[node, i]
    tree.places[leaf, n, lane] = cost
    _widen(tree.boxes[cell], rows, node, cost)


@part
def _divide(rows: FloatArray, cell: int, tree: BoxTree) -> None:
    """Divide a cell whose leaf is full; where its nodes are all at one place, into the earlier and the later."""
    n, leaf, more = rows.shape[1], tree.cells[cell, _LEAF], tree.used[_LEAVES]
    by, widest, cut = n, 0.0, float(tree.nodes[leaf, _SIZE // 2 - 1])
    for i in range(n):
        low, high = tree.boxes[cell, i], tree.boxes[cell, n + i]
        if high - low > widest:
            by, widest, cut = i, high - low, 0.5 * (low + high)
            if cut >= high:  # by rounding
                cut = low
    first = 2 * more - 1
    tree.cells[cell, _LESS], tree.cells[cell, _MORE], tree.cells[cell, _BY] = first, first + 1, by
    tree.cells[first, _LEAF], tree.cells[first + 1, _LEAF] = leaf, more
    tree.cuts[cell] = cut
    tree.counts[leaf] = 0
    tree.used[_LEAVES] = more + 1
    for k in range(_SIZE):
        node = tree.nodes[leaf, k]
        _put(rows, node, tree.places[leaf, n, k], _half(rows, node, cell, tree), tree)


@part
def _price(rows: FloatArray, costs: FloatArray, tree: BoxTree) -> None:
    """Let the tree know the costs (N,) of nodes that have none in it."""
    n = rows.shape[1]
    for node in range(tree.used[_PRICED], len(costs)):
        cost = costs[node] if costs[node] < inf else inf  # also of NaN
        cell, lane = 0, 0
        while tree.cells[cell, _MORE] >= 0:
            tree.boxes[cell, 2 * n] = min(tree.boxes[cell, 2 * n], cost)
            cell = _half(rows, node, cell, tree)
        tree.boxes[cell, 2 * n] = min(tree.boxes[cell, 2 * n], cost)
        leaf = tree.cells[cell, _LEAF]
        while tree.nodes[leaf, lane] != node:
            lane += 1
        tree.places[leaf, n, lane] = cost
    tree.used[_PRICED] = max(tree.used[_PRICED], len(costs))


@part
def _bound(box: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float) -> float:
    """Return a lower bound of ρ + α·cost of the nodes in a box."""
    total, n = 0.0, len(q)
    for i in range(n):
        low, high = box[i], box[n + i]
        if wraps[i]:
            middle = 0.5 * (low + high)
            off = abs(q[i] - middle)
            if off > pi:
                off = abs(way(middle, q[i], True))
            gap = max(off - 0.5 * (high - low) - _ROUNDING, 0.0)
        else:
            gap = max(low - q[i], q[i] - high, 0.0)
        total += gap * gap
    return sqrt(total) + alpha * box[2 * n] if alpha != 0.0 else sqrt(total)


@part
def _score(places: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, out: FloatArray) -> None:
    """Write ρ + α·cost (16,) of the nodes of a leaf."""
    for lane in range(_SIZE):
        out[lane] = 0.0
    for i in range(len(q)):
        at = q[i]
        if wraps[i]:
            for lane in range(_SIZE):
                delta = way(places[i, lane], at, True)
                out[lane] += delta * delta
        else:
            for lane in range(_SIZE):
                delta = at - places[i, lane]
                out[lane] += delta * delta
    for lane in range(_SIZE):
        out[lane] = sqrt(out[lane])
    if alpha != 0.0:
        for lane in range(_SIZE):
            out[lane] += alpha * places[len(q), lane]
