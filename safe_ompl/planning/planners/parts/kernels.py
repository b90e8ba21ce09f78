"""Nearest of many nodes: a scan, and a tree of boxes for many nodes.

The distance ρ is Euclidean, coordinates that wrap going the short way round. Sought is argmin ρ + α·cost, of equal ones
the first. The tree's leaves hold up to 16 nodes. A full one is divided in the middle of the longest side of its box.
Its pages hold up to eight boxes: what three divisions make of one. Both are kept coordinate by coordinate, so that
processors compute the distances of all nodes of a leaf, or of all boxes of a page, by lanes. A box is left out where
even its nearest place, at the least cost in it, is worse than what was found.
"""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.robot.kernels import way

_ROUND = 2 * pi
_SLACK = 1 - 1e-12  # bounds of boxes are taken for less by this: no rounding may hide a node
_TURN_SLACK = 1e-12  # the same for the sides of boxes that wrap [rad]
_FINITE = float(np.finfo(np.float64).max)
BOXES, SIZE = 8, 16  # boxes in a page, nodes in a leaf
COUNT, HOME = SIZE, SIZE + 1  # columns of members
PAGES, LEAVES, NODES, PRICED, DEPTH = range(5)


class BoxTree(NamedTuple):
    """A tree of boxes, in arrays that may have room for more pages, leaves and nodes.

    Boxes of a page have numbers 8 to 15: box k was divided into 2k and 2k + 1, and box 1 is all of the page. One that
    is not divided is where the first would be that it could be divided into. `links` of a page are what is in its
    boxes, a page or, as ~leaf, a leaf; the box that the page is in, 8·page + box, −1 for none; and by which coordinate
    boxes 1 to 7 are divided, −1 for none. `boxes` are the lowest and the greatest coordinates of nodes, the least cost,
    and where boxes 1 to 7 are divided. `members` are the nodes of a leaf, their number and the leaf's box; `places`
    their coordinates and costs, ∞ until they are known. `homes` are the leaves of nodes. `used` counts pages, leaves,
    nodes, nodes with known costs, and the pages above a leaf at most.
    """

    wraps: BoolArray  # (n,)
    links: IntArray  # (P, 16)
    boxes: FloatArray  # (P, 2n + 2, 8)
    members: IntArray  # (S, 18)
    places: FloatArray  # (S, n + 1, 16)
    homes: IntArray  # (N,)
    used: IntArray  # (5,)


@part
def _distance(rows: FloatArray, node: int, q: FloatArray, wraps: BoolArray) -> float:
    """Return ρ from a node to q."""
    total = 0.0
    for i in range(len(q)):
        delta = way(rows[node, i], q[i], wraps[i])
        total += delta * delta
    return sqrt(total)


@compiled
def scan(rows: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, costs: FloatArray) -> int:
    """Return argmin ρ + α·cost of all nodes `rows: (N, n)`; costs (N,), or (0,) where α is 0."""
    best, least = 0, inf
    for node in range(len(rows)):
        score = _distance(rows, node, q, wraps)
        if alpha != 0.0:
            score += alpha * costs[node]
        if score < least:
            best, least = node, score
    return best


@compiled
def nearest(rows: FloatArray, q: FloatArray, alpha: float, costs: FloatArray, tree: BoxTree) -> int:
    """Return argmin ρ + α·cost, like `scan`; first put the nodes into the tree that are new, and their costs if α > 0.

    −1 says that the tree has no room for them.
    """
    if not _insert(rows, tree):
        return -1
    if alpha != 0.0:
        _price(costs, tree)
    room = BOXES * (tree.used[DEPTH] + 1)
    return _search(q, alpha, tree, np.empty(room, np.int64), np.empty(room), np.empty(SIZE))


@part
def _insert(rows: FloatArray, tree: BoxTree) -> bool:
    """Put new nodes into the tree, and return whether it has room for all of them."""
    links, boxes, used, n = tree.links, tree.boxes, tree.used, rows.shape[1]
    for node in range(used[NODES], len(rows)):
        # A node divides no more than one leaf, since neither half is full, and no more than one leaf becomes a page.
        if node == len(tree.homes) or used[PAGES] == len(links) or used[LEAVES] == len(tree.members):
            return False
        if node == 0:
            _new_page(tree, -1, ~_new_leaf(tree))
        page, depth = 0, 1
        while True:
            k = 1
            while k < BOXES and links[page, BOXES + k] >= 0:
                k = 2 * k + int(rows[node, links[page, BOXES + k]] >= boxes[page, 2 * n + 1, k])
            box = _first(k)
            inside = links[page, box]
            if inside < 0 and tree.members[~inside, COUNT] == SIZE:
                if k < BOXES:
                    _divide(tree, page, k, rows)
                    continue
                inside = _new_page(tree, BOXES * page + box, inside)
            if inside < 0:
                break
            _widen(tree, page, box, rows, node)
            page, depth = inside, depth + 1
        _put(tree, page, box, rows, node, inf)
        used[NODES], used[DEPTH] = node + 1, max(used[DEPTH], depth)
    return True


@part
def _first(k: int) -> int:
    """Return where box k of a page is, or the first of those that it is divided into."""
    while k < BOXES:
        k *= 2
    return k - BOXES


@part
def _new_leaf(tree: BoxTree) -> int:
    """Add a leaf without nodes, and return it."""
    leaf = tree.used[LEAVES]
    tree.used[LEAVES] += 1
    tree.members[leaf, COUNT] = 0
    tree.places[leaf] = inf
    return int(leaf)


@part
def _new_page(tree: BoxTree, above: int, inside: int) -> int:
    """Add a page with one box, that of a leaf: what was in the box `above`, where the page is from then on."""
    page, last = tree.used[PAGES], 2 * len(tree.wraps)
    tree.used[PAGES] += 1
    tree.links[page] = -1
    tree.boxes[page] = inf
    tree.boxes[page, last // 2 : last] = -inf
    if above >= 0:
        tree.links[above // BOXES, above % BOXES] = page
        for i in range(last + 1):
            tree.boxes[page, i, 0] = tree.boxes[above // BOXES, i, above % BOXES]
    tree.links[page, 0], tree.links[page, BOXES] = inside, above
    tree.members[~inside, HOME] = BOXES * page
    return int(page)


@part
def _divide(tree: BoxTree, page: int, k: int, rows: FloatArray) -> None:
    """Divide box k of a page, with a full leaf; where its nodes are all at one place each half gets half of them."""
    n, box, by, least, widest = rows.shape[1], _first(k), 0, 0.0, -inf
    for i in range(n):
        low, high = tree.boxes[page, i, box], tree.boxes[page, n + i, box]
        if high - low > widest:
            by, least, widest = i, low, high - low
    cut = 0.5 * (least + tree.boxes[page, n + by, box])
    cut = cut if cut > least else tree.boxes[page, n + by, box]
    leaf, more = ~tree.links[page, box], _first(2 * k + 1)
    new = _new_leaf(tree)
    tree.links[page, more], tree.links[page, BOXES + k], tree.boxes[page, 2 * n + 1, k] = ~new, by, cut
    tree.members[leaf, COUNT], tree.members[new, HOME] = 0, BOXES * page + more
    tree.boxes[page, :n, box], tree.boxes[page, n : 2 * n, box], tree.boxes[page, 2 * n, box] = inf, -inf, inf
    for lane in range(SIZE):
        node = tree.members[leaf, lane]
        first = lane < SIZE // 2 if widest == 0.0 else rows[node, by] < cut
        _put(tree, page, box if first else more, rows, node, tree.places[leaf, n, lane])


@part
def _put(tree: BoxTree, page: int, box: int, rows: FloatArray, node: int, cost: float) -> None:
    """Append a node to the leaf in a box, which has room."""
    leaf, n = ~tree.links[page, box], rows.shape[1]
    lane = tree.members[leaf, COUNT]
    tree.members[leaf, lane], tree.members[leaf, COUNT], tree.homes[node] = node, lane + 1, leaf
    for i in range(n):
        tree.places[leaf, i, lane] = rows[node, i]
    tree.places[leaf, n, lane] = cost
    tree.boxes[page, 2 * n, box] = min(tree.boxes[page, 2 * n, box], cost)
    _widen(tree, page, box, rows, node)


@part
def _widen(tree: BoxTree, page: int, box: int, rows: FloatArray, node: int) -> None:
    n = rows.shape[1]
    for i in range(n):
        tree.boxes[page, i, box] = min(tree.boxes[page, i, box], rows[node, i])
        tree.boxes[page, n + i, box] = max(tree.boxes[page, n + i, box], rows[node, i])


@part
def _price(costs: FloatArray, tree: BoxTree) -> None:
    """Let the tree know the costs (N,) of nodes that have none in it."""
    n = len(tree.wraps)
    for node in range(tree.used[PRICED], len(costs)):
        leaf, lane = tree.homes[node], 0
        while tree.members[leaf, lane] != node:
            lane += 1
        cost = costs[node] if costs[node] == costs[node] else inf
        tree.places[leaf, n, lane] = cost
        at = tree.members[leaf, HOME]
        while at >= 0 and tree.boxes[at // BOXES, 2 * n, at % BOXES] > cost:
            tree.boxes[at // BOXES, 2 * n, at % BOXES] = cost
            at = tree.links[at // BOXES, BOXES]
    tree.used[PRICED] = max(tree.used[PRICED], len(costs))


@part
def _search(
    q: FloatArray, alpha: float, tree: BoxTree, stack: IntArray, bounds: FloatArray, lanes: FloatArray
) -> int:
    """Return the nearest of all nodes, with memory for what is still to be looked at and for `lanes`: (16,)."""
    stack[0], bounds[0], size = 0, -inf, 1
    best, least = 0, _FINITE
    while size > 0:
        size -= 1
        at, bottom = stack[size], size
        if bounds[size] > least:
            continue
        if at >= 0:
            _bounds(tree.boxes[at], q, tree.wraps, alpha, lanes)
            for box in range(BOXES):
                if lanes[box] <= least:
                    k = size
                    while k > bottom and bounds[k - 1] < lanes[box]:
                        stack[k], bounds[k] = stack[k - 1], bounds[k - 1]
                        k -= 1
                    stack[k], bounds[k] = tree.links[at, box], lanes[box]
                    size += 1
            continue
        _scores(tree.places[~at], q, tree.wraps, alpha, lanes)
        for lane in range(tree.members[~at, COUNT]):
            node, score = tree.members[~at, lane], lanes[lane]
            if score < least or (score == least and node < best):
                best, least = node, score
    return int(best)


@part
def _bounds(boxes: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, out: FloatArray) -> None:
    """Write lower bounds of ρ + α·cost in the boxes of a page; ∞ or NaN where there is none."""
    n = len(q)
    for box in range(BOXES):
        out[box] = 0.0
    for i in range(n):
        if wraps[i]:
            for box in range(BOXES):
                low, high = boxes[i, box], boxes[n + i, box]
                delta = q[i] - 0.5 * (low + high)
                delta -= _ROUND * np.rint(delta / _ROUND)
                gap = max(abs(delta) - 0.5 * (high - low) - _TURN_SLACK, 0.0)
                out[box] += gap * gap
        else:
            for box in range(BOXES):
                gap = max(boxes[i, box] - q[i], q[i] - boxes[n + i, box], 0.0)
                out[box] += gap * gap
    for box in range(BOXES):
        out[box] = sqrt(out[box]) * _SLACK
    if alpha != 0.0:
        for box in range(BOXES):
            out[box] += alpha * boxes[2 * n, box]


@part
def _scores(places: FloatArray, q: FloatArray, wraps: BoolArray, alpha: float, out: FloatArray) -> None:
    """Write ρ + α·cost of the nodes of a leaf, summed like `_distance`."""
    n = len(q)
    for k in range(SIZE):
        out[k] = 0.0
    for i in range(n):
        if wraps[i]:
            for k in range(SIZE):
                delta = q[i] - places[i, k]
                delta -= _ROUND * np.rint(delta / _ROUND)
                out[k] += delta * delta
        else:
            for k in range(SIZE):
                delta = q[i] - places[i, k]
                out[k] += delta * delta
    for k in range(SIZE):
        out[k] = sqrt(out[k])
    if alpha != 0.0:
        for k in range(SIZE):
            out[k] += alpha * places[n, k]
