"""The nearest of many nodes: argmin ρ + α·cost, of equal ones the first.

The distance ρ is Euclidean, coordinates that wrap going the short way round. Few nodes are scanned. Many are divided
among leaves by a k-d tree: a full leaf in the middle of the longest side of its box. Every cell knows the box of its
nodes and their least cost, so that a search leaves out cells that can hold no better node. In a large tree a search
mostly waits for memory. So the boxes of up to 16 cells stand together in a group, as the nodes of a leaf do, coordinate
by coordinate, for processors to compute by lanes; and single precision bounds what is computed exactly where it counts.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, maker, part
from safe_ompl.robot import plain
from safe_ompl.robot.kernels import way

_FEW = 400  # nodes that a scan is through with before a search in the tree is
_NOTHING: FloatArray = np.empty(0)
_SIZE = 16  # nodes in a leaf, cells in a group
_ROUNDING = 1e-9  # [rad] by which gaps are taken for less where coordinates wrap: no rounding may hide a node
_SINGLE = 1.2e-7  # more than the relative distance of a number in single precision from the next
_LESS, _MORE, _BY, _GROUP, _LANE = range(5)  # columns of cells
_NODES, _PRICED, _LEAVES, _GROUPS, _ROOT, _DEPTH = range(6)


class BoxTree(NamedTuple):
    """A k-d tree, in arrays that may have room for more leaves; there is one cell less than twice as many.

    Cells have the two that they are divided into, and the coordinate by which; `cuts` are where. A cell whose nodes are
    all at one place is divided by their numbers, as if they were coordinate n. Groups are to cells what the nodes of a
    B-tree are to keys: each has the cells that one cell is divided into by some cuts. GROUP and LANE are where a cell
    stands, −1 if only cells that it is divided into do. `below` a cell of a group is another one, which divides it
    further, or its leaf k as −1 − k. `boxes` are the least and the greatest coordinates in a cell, and the least cost.

    Leaves have their nodes, and the coordinates and costs of these, rounded down; ∞ in lanes without nodes, and costs
    until they are known. `used` counts nodes, those with known costs, leaves and groups; then come the group where a
    search begins, and how many there are above a leaf at most.
    """

    cells: IntArray  # (2 S, 5)
    cuts: FloatArray  # (2 S,)
    sizes: IntArray  # (G,) of groups
    owners: IntArray  # (G, 16)
    below: IntArray  # (G, 16)
    boxes: Any  # (G, 2n + 1, 16), in single precision
    counts: IntArray  # (S,) of nodes in leaves
    nodes: IntArray  # (S, 16)
    places: Any  # (S, n + 1, 16), in single precision
    used: IntArray  # (6,)


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
    groups = (leaves + 3) // 4  # they have ten cells each, mostly
    cells, cuts, sizes = np.full((2 * leaves, 5), -1), np.empty(2 * leaves), np.zeros(groups, np.intp)
    owners, below = np.zeros((groups, _SIZE), np.intp), np.full((groups, _SIZE), -1)
    boxes = np.zeros((groups, 2 * n + 1, _SIZE), np.float32)
    counts, nodes = np.zeros(leaves, np.intp), np.empty((leaves, _SIZE), np.intp)
    places, used = np.full((leaves, n + 1, _SIZE), inf, np.float32), np.array([0, 0, 1, 1, 0, 1])
    cells[:1, _GROUP:], sizes[:1], boxes[:, 0], boxes[:1, n : 2 * n, 0] = 0, 1, inf, -inf
    return BoxTree(cells, cuts, sizes, owners, below, boxes, counts, nodes, places, used)


@part
def _score(rows: FloatArray, node: int, q: FloatArray, wraps: BoolArray, alpha: float, costs: FloatArray) -> float:
    """Return ρ from a node to q + α·cost."""
    total = 0.0
    for i in range(len(q)):
        delta = way(rows[node, i], q[i], wraps[i])
        total += delta * delta
    return sqrt(total) + alpha * costs[node] if alpha != 0.0 else sqrt(total)


@compiled
def nearest(rows: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, costs: FloatArray, tree: BoxTree) -> int:
    """Return argmin ρ + α·cost of all nodes `rows: (N, n)`; costs (N,), or (0,) where α is 0.

    Few nodes are scanned. Many are put into the tree first; −1 if it has no room for them.
    """
    best, least = 0, inf
    if len(rows) <= _FEW:
        for node in range(len(rows)):
            score = _score(rows, node, q, wraps, alpha, costs)
            if score < least:
                best, least = node, score
        return best
    used = tree.used
    for node in range(used[_NODES], len(rows)):
        if used[_LEAVES] == len(tree.counts) or used[_GROUPS] + 2 * used[_DEPTH] >= len(tree.sizes) - 2:
            return -1
        _insert(rows, node, tree)
    if alpha != 0.0:
        _price(rows, costs, tree)
    # Arrays of their own, so that the compiler knows that what is written to one does not change another.
    room = (used[_DEPTH] + 1) * _SIZE
    stack, bounds, lanes = np.empty(room, np.int64), np.empty(room), np.empty(_SIZE)
    stack[0], bounds[0], size = used[_ROOT], -inf, 1
    while size > 0:
        size -= 1
        group, first = stack[size], size
        if bounds[size] > least:
            continue
        _bound(tree.boxes[group] if group >= 0 else tree.places[-1 - group], q, wraps, alpha, lanes)
        for lane in range(_SIZE):
            bound = lanes[lane]
            if not (bound <= least and bound < inf):
                continue
            if group >= 0:
                at, size = size, size + 1
                while at > first and bounds[at - 1] < bound:  # the least one is looked at first
                    stack[at], bounds[at] = stack[at - 1], bounds[at - 1]
                    at -= 1
                stack[at], bounds[at] = tree.below[group, lane], bound
            else:
                node = tree.nodes[-1 - group, lane]
                score = _score(rows, node, q, wraps, alpha, costs)
                if score < least or (score == least and node < best):
                    best, least = node, score
    return int(best)


@part
def _insert(rows: FloatArray, node: int, tree: BoxTree) -> None:
    """Put a node into its leaf, which is divided where it is full; neither half is full."""
    used, cell, depth = tree.used, 0, 0
    while True:
        if cell == 0 and tree.sizes[used[_ROOT]] == _SIZE:
            _enter(0, used[_ROOT], used[_GROUPS], 0, tree)
            used[_ROOT], used[_GROUPS], used[_DEPTH] = used[_GROUPS], used[_GROUPS] + 1, used[_DEPTH] + 1
        group, lane = tree.cells[cell, _GROUP], tree.cells[cell, _LANE]
        if group < 0:
            cell = _half(rows, node, cell, tree)
            continue
        below = tree.below[group, lane]
        if below >= 0 and tree.sizes[below] == _SIZE:
            _split(cell, tree)
        elif below < 0 and tree.counts[-1 - below] == _SIZE:
            if tree.sizes[group] < _SIZE:
                _divide(rows, cell, tree)
            else:  # the cell has come into this group as another one was split: now it is this one's turn, from above
                cell, depth = 0, 0
        else:
            _widen(rows, node, tree.boxes[group], lane)
            depth += 1
            if below < 0:
                break
            cell = _half(rows, node, cell, tree)
    _put(rows, node, inf, -1 - below, tree)
    used[_NODES], used[_DEPTH] = node + 1, max(used[_DEPTH], depth)


@part
def _half(rows: FloatArray, node: int, cell: int, tree: BoxTree) -> int:
    """Return the half of a cell that a node belongs to, by a coordinate or by its number."""
    by = tree.cells[cell, _BY]
    place = rows[node, by] if by < rows.shape[1] else float(node)
    return int(tree.cells[cell, _MORE if place > tree.cuts[cell] else _LESS])


@part
def _under(number: float) -> np.float32:
    """Return the greatest number in single precision that is not greater."""
    single = np.float32(number)
    return single if single <= number else np.nextafter(single, np.float32(-inf))


@part
def _widen(rows: FloatArray, node: int, boxes: Any, lane: int) -> None:
    """Let a box of a group, `boxes: (2n + 1, 16)`, hold a node."""
    n = rows.shape[1]
    for i in range(n):
        boxes[i, lane] = min(boxes[i, lane], _under(rows[node, i]))
        boxes[n + i, lane] = max(boxes[n + i, lane], -_under(-rows[node, i]))


@part
def _put(rows: FloatArray, node: int, cost: float, leaf: int, tree: BoxTree) -> None:
    """Put a node with its cost into a leaf that has room."""
    n, lane = rows.shape[1], tree.counts[leaf]
    tree.counts[leaf], tree.nodes[leaf, lane] = lane + 1, node
    for i in range(n):
        tree.places[leaf, i, lane] = _under(rows[node, i])
    tree.places[leaf, n, lane] = cost


@part
def _divide(rows: FloatArray, cell: int, tree: BoxTree) -> None:
    """Divide a cell whose leaf is full; where its nodes are all at one place, into the earlier and the later."""
    n, more, group, lane = rows.shape[1], tree.used[_LEAVES], tree.cells[cell, _GROUP], tree.cells[cell, _LANE]
    leaf = -1 - tree.below[group, lane]
    nodes = tree.nodes[leaf]
    by, widest, cut = n, 0.0, float(nodes[_SIZE // 2 - 1])
    for i in range(n):
        low, high = inf, -inf
        for k in range(_SIZE):
            low, high = min(low, rows[nodes[k], i]), max(high, rows[nodes[k], i])
        if high - low > widest:
            by, widest, cut = i, high - low, 0.5 * (low + high)
            if cut >= high:  # by rounding
                cut = low
    first = 2 * more - 1
    tree.cells[cell, _LESS], tree.cells[cell, _MORE], tree.cells[cell, _BY] = first, first + 1, by
    tree.cells[cell, _GROUP], tree.cuts[cell] = -1, cut
    tree.counts[leaf], tree.used[_LEAVES] = 0, more + 1
    for k in range(_SIZE):
        half = leaf if _half(rows, nodes[k], cell, tree) == first else more
        _put(rows, nodes[k], tree.places[leaf, n, k], half, tree)
    for k in range(tree.counts[leaf], _SIZE):
        tree.places[leaf, 0, k] = inf
    _enter(first, -1 - leaf, group, lane, tree)
    _enter(first + 1, -1 - more, group, tree.sizes[group], tree)


@part
def _enter(cell: int, below: int, group: int, lane: int, tree: BoxTree) -> None:
    """Let a cell stand in a lane of a group, with the box of what is below it."""
    boxes, n = tree.boxes[group], tree.boxes.shape[1] // 2
    inner, size = tree.boxes[max(below, 0)], tree.sizes[max(below, 0)]
    if below < 0:
        inner, size = tree.places[-1 - below], tree.counts[-1 - below]
    far, ulp = (n, 0.0) if below >= 0 else (0, _SINGLE)
    for i in range(n):
        low, high = inner[i, 0], inner[far + i, 0]
        for k in range(1, size):
            low, high = min(low, inner[i, k]), max(high, inner[far + i, k])
        boxes[i, lane], boxes[n + i, lane] = low, -_under(-high - ulp * abs(high))
    boxes[2 * n, lane] = inner[far + n, 0]
    for k in range(1, size):
        boxes[2 * n, lane] = min(boxes[2 * n, lane], inner[far + n, k])
    tree.cells[cell, _GROUP], tree.cells[cell, _LANE] = group, lane
    tree.owners[group, lane], tree.below[group, lane] = cell, below
    tree.sizes[group] = max(tree.sizes[group], lane + 1)


@part
def _move(cell: int, group: int, tree: BoxTree) -> None:
    """Let a cell stand in another group; the last one of its group takes its place there."""
    old, lane = tree.cells[cell, _GROUP], tree.cells[cell, _LANE]
    last, below = tree.sizes[old] - 1, tree.below[old, lane]
    _enter(tree.owners[old, last], tree.below[old, last], old, lane, tree)
    tree.sizes[old], tree.boxes[old, 0, last] = last, inf
    _enter(cell, below, group, tree.sizes[group], tree)


@maker
def _split(cell: int, tree: BoxTree) -> None:
    """Split the full group below a cell: the two that the cell is divided into stand in its group instead."""
    group, lane = tree.cells[cell, _GROUP], tree.cells[cell, _LANE]
    full, stays, goes = tree.below[group, lane], tree.cells[cell, _LESS], tree.cells[cell, _MORE]
    if tree.cells[stays, _GROUP] >= 0:  # it needs no group of its own
        stays, goes = goes, stays
    tree.cells[cell, _GROUP] = -1
    if tree.cells[goes, _GROUP] >= 0:
        _move(goes, group, tree)
    else:
        new, rest, size = tree.used[_GROUPS], np.empty(_SIZE, np.intp), 1
        rest[0], tree.used[_GROUPS] = goes, new + 1
        while size > 0:
            size -= 1
            below = rest[size]
            if tree.cells[below, _GROUP] >= 0:
                _move(below, new, tree)
            else:
                rest[size], rest[size + 1], size = tree.cells[below, _LESS], tree.cells[below, _MORE], size + 2
        _enter(goes, new, group, tree.sizes[group], tree)
    _enter(stays, full, group, lane, tree)


@part
def _price(rows: FloatArray, costs: FloatArray, tree: BoxTree) -> None:
    """Let the tree know the costs (N,) of nodes that have none in it."""
    n = rows.shape[1]
    for node in range(tree.used[_PRICED], len(costs)):
        cost = _under(costs[node]) if costs[node] < inf else np.float32(inf)  # also of NaN
        cell, below, k = 0, 0, 0
        while below >= 0:
            group, lane = tree.cells[cell, _GROUP], tree.cells[cell, _LANE]
            if group >= 0:
                tree.boxes[group, 2 * n, lane] = min(tree.boxes[group, 2 * n, lane], cost)
                below = tree.below[group, lane]
            if below >= 0:
                cell = _half(rows, node, cell, tree)
        while tree.nodes[-1 - below, k] != node:
            k += 1
        tree.places[-1 - below, n, k] = cost
    tree.used[_PRICED] = max(tree.used[_PRICED], len(costs))


@part
def _bound(inner: Any, q: FloatArray, wraps: BoolArray, alpha: float, out: FloatArray) -> None:
    """Write lower bounds (16,) of ρ + α·cost of the nodes in the boxes of a group, or of those of a leaf.

    The number of lanes is read from the array: loops of known length are unrolled, but not computed by lanes.
    """
    n, lanes = len(q), inner.shape[1]
    far, ulp = (n, 0.0) if len(inner) > n + 1 else (0, _SINGLE)
    for lane in range(lanes):
        out[lane] = 0.0
    for i in range(n):
        at = q[i]
        if wraps[i]:
            for lane in range(lanes):
                low, high = float(inner[i, lane]), float(inner[far + i, lane])
                high += ulp * abs(high)
                gap = max(abs(way(0.5 * (low + high), at, True)) - 0.5 * (high - low) - _ROUNDING, 0.0)
                out[lane] += gap * gap
        else:
            for lane in range(lanes):
                low, high = float(inner[i, lane]), float(inner[far + i, lane])
                under, over = low - at, at - (high + ulp * abs(high))
                gap = under if under > over else over
                gap = gap if gap > 0.0 else 0.0
                out[lane] += gap * gap
    for lane in range(lanes):
        out[lane] = sqrt(out[lane])
    if alpha != 0.0:
        for lane in range(lanes):
            out[lane] += alpha * float(inner[far + n, lane])
