"""Nearest of many nodes: a scan, and a tree of boxes for many nodes.

The distance ρ is Euclidean, coordinates that wrap going the short way round. Sought is argmin ρ + α·cost, of equal ones
the first. The leaves of the tree hold up to 32 nodes each, coordinate by coordinate, so that processors compute their
distances by lanes. A full leaf is divided in the middle of its longest side. Every branch has the box and the least
cost of its nodes, and is left out where even the nearest place of its box, at its least cost, is worse than what was
found.
"""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, maker, part
from safe_ompl.robot.kernels import way

_ROUND = 2 * pi
_SLACK = 1 - 1e-12  # bounds of boxes are taken for less by this: no rounding may hide a node
SIZE = 32  # nodes that a leaf holds
LINKS = 7
LESS, MORE, ABOVE, SLOT, BY, COUNT, DEPTH = range(LINKS)  # columns of links


class BoxTree(NamedTuple):
    """A tree of boxes, in arrays that may have room for more branches, leaves and nodes.

    Branches have `links`: those beneath and above, −1 for none; the slot of a leaf, −1 of others; the coordinate that
    divides it; how many nodes a leaf holds; and how deep it is. `cuts` are where they are divided. Slots have the
    members of a leaf and their coordinates; nodes have the leaf that is their home, and a price, ∞ until it is known.
    `used` counts branches and slots, and tells how deep the tree is.
    """

    links: IntArray  # (M, 7)
    cuts: FloatArray  # (M,)
    lowest: FloatArray  # (M,)
    boxes: FloatArray  # (M, 2, n)
    members: IntArray  # (S, 32)
    places: FloatArray  # (S, n, 32)
    homes: IntArray  # (N,)
    prices: FloatArray  # (N,)
    used: IntArray  # (3,)


@part
def _distance(rows: FloatArray, node: int, q: FloatArray, wraps: BoolArray) -> float:
    """Return ρ from a node to q."""
    total = 0.0
    for i in range(len(q)):
        delta = way(rows[node, i], q[i], wraps[i])
        total += delta * delta
    return sqrt(total)


@part
def _box_distance(boxes: FloatArray, node: int, q: FloatArray, wraps: BoolArray) -> float:
    """Return ρ from the nearest place of a box to q."""
    total = 0.0
    for i in range(len(q)):
        low, high = boxes[node, 0, i], boxes[node, 1, i]
        gap = max(low - q[i], q[i] - high, 0.0)
        if wraps[i] and gap > 0.0:
            inside = (q[i] - low) % _ROUND <= high - low
            gap = 0.0 if inside else min((low - q[i]) % _ROUND, (q[i] - high) % _ROUND)
        total += gap * gap
    return sqrt(total) * _SLACK


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


@part
def _new_leaf(tree: BoxTree, above: int, depth: int, slot: int) -> int:
    """Add a leaf without nodes, and return it."""
    leaf = tree.used[0]
    tree.used[0] += 1
    tree.used[1], tree.used[2] = max(tree.used[1], slot + 1), max(tree.used[2], depth)
    tree.links[leaf, :] = -1
    tree.links[leaf, ABOVE], tree.links[leaf, SLOT] = above, slot
    tree.links[leaf, COUNT], tree.links[leaf, DEPTH] = 0, depth
    tree.lowest[leaf] = inf
    tree.boxes[leaf, 0, :], tree.boxes[leaf, 1, :] = inf, -inf
    return int(leaf)


@part
def _put(tree: BoxTree, leaf: int, node: int, rows: FloatArray) -> None:
    """Append a node to a leaf, which has room, and whose box holds it from then on."""
    slot, count = tree.links[leaf, SLOT], tree.links[leaf, COUNT]
    tree.members[slot, count] = node
    for i in range(rows.shape[1]):
        tree.places[slot, i, count] = rows[node, i]
    tree.links[leaf, COUNT], tree.homes[node] = count + 1, leaf
    tree.lowest[leaf] = min(tree.lowest[leaf], tree.prices[node])
    _widen(tree, leaf, node, rows)


@part
def _widen(tree: BoxTree, at: int, node: int, rows: FloatArray) -> None:
    for i in range(rows.shape[1]):
        tree.boxes[at, 0, i] = min(tree.boxes[at, 0, i], rows[node, i])
        tree.boxes[at, 1, i] = max(tree.boxes[at, 1, i], rows[node, i])


@maker
def _divide(tree: BoxTree, leaf: int, rows: FloatArray) -> None:
    """Make a full leaf a branch with two leaves; where its nodes are all at one place each gets half of them."""
    links, box, by = tree.links, tree.boxes[leaf], 0
    for i in range(rows.shape[1]):
        if box[1, i] - box[0, i] > box[1, by] - box[0, by]:
            by = i
    cut = 0.5 * (box[0, by] + box[1, by])
    cut = cut if cut > box[0, by] else box[1, by]
    same, slot = box[0, by] == box[1, by], links[leaf, SLOT]
    held = tree.members[slot].copy()
    less = _new_leaf(tree, leaf, links[leaf, DEPTH] + 1, slot)
    more = _new_leaf(tree, leaf, links[leaf, DEPTH] + 1, tree.used[1])
    links[leaf, LESS], links[leaf, MORE], links[leaf, SLOT], links[leaf, BY] = less, more, -1, by
    tree.cuts[leaf] = cut
    for k in range(SIZE):
        first = k < SIZE // 2 if same else rows[held[k], by] < cut
        _put(tree, less if first else more, held[k], rows)


@compiled
def insert(rows: FloatArray, begin: int, tree: BoxTree) -> int:
    """Put the nodes from `begin` on into the tree, until there is no room for one; return the first that is not in."""
    links, used = tree.links, tree.used
    for node in range(begin, len(rows)):
        # A leaf is divided as often as it holds nodes at most before there is room for another.
        if used[0] + 2 * SIZE + 3 > len(links) or used[1] + SIZE + 2 > len(tree.members):
            return node
        tree.prices[node] = inf
        at = 0 if used[0] else _new_leaf(tree, -1, 0, 0)
        while links[at, SLOT] < 0 or links[at, COUNT] == SIZE:
            _widen(tree, at, node, rows)
            if links[at, SLOT] >= 0:
                _divide(tree, at, rows)
            at = links[at, LESS if rows[node, links[at, BY]] < tree.cuts[at] else MORE]
        _put(tree, at, node, rows)
    return len(rows)


@compiled
def price(costs: FloatArray, begin: int, tree: BoxTree) -> None:
    """Let the tree know the costs (N,) of the nodes from `begin` on."""
    for node in range(begin, len(costs)):
        at = tree.homes[node]
        tree.prices[node] = costs[node] if costs[node] == costs[node] else inf
        while at >= 0 and tree.lowest[at] > costs[node]:
            tree.lowest[at] = costs[node]
            at = tree.links[at, ABOVE]


@compiled
def search(q: FloatArray, wraps: BoolArray, alpha: float, costs: FloatArray, tree: BoxTree) -> int:
    """Return argmin ρ + α·cost of the nodes, all of which are in the tree, with their prices if α > 0; like `scan`."""
    links, deepest = tree.links, tree.used[2]
    stack, bounds, squares = np.empty(deepest + 2, np.int64), np.empty(deepest + 2), np.empty(SIZE)
    stack[0], bounds[0], size = 0, -inf, 1
    best, least = 0, inf
    while size > 0:
        size -= 1
        at = stack[size]
        if bounds[size] > least:
            continue
        if links[at, SLOT] < 0:
            first, second = links[at, LESS], links[at, MORE]
            near, far = _least(first, q, wraps, alpha, tree), _least(second, q, wraps, alpha, tree)
            if near > far:
                first, second, near, far = second, first, far, near
            if far <= least:
                stack[size], bounds[size] = second, far
                size += 1
            if near <= least:
                stack[size], bounds[size] = first, near
                size += 1
            continue
        slot = links[at, SLOT]
        _squares(tree.places[slot], q, wraps, squares)
        for k in range(links[at, COUNT]):
            node, score = tree.members[slot, k], sqrt(squares[k])
            if alpha != 0.0:
                if score + alpha * tree.lowest[at] > least:
                    continue
                score += alpha * costs[node]
            if score < least or (score == least and node < best):
                best, least = node, score
    return best


@part
def _squares(places: FloatArray, q: FloatArray, wraps: BoolArray, out: FloatArray) -> None:
    """Write ρ² from the nodes of a leaf, by coordinates (n, 32), to q; summed like `_distance`."""
    for k in range(SIZE):
        out[k] = 0.0
    for i in range(len(q)):
        if wraps[i]:
            for k in range(SIZE):
                delta = q[i] - places[i, k]
                delta -= _ROUND * np.rint(delta / _ROUND)
                out[k] += delta * delta
        else:
            for k in range(SIZE):
                delta = q[i] - places[i, k]
                out[k] += delta * delta


@part
def _least(at: int, q: FloatArray, wraps: BoolArray, alpha: float, tree: BoxTree) -> float:
    """Return a lower bound of ρ + α·cost in a branch."""
    bound = _box_distance(tree.boxes, at, q, wraps)
    return bound + alpha * tree.lowest[at] if alpha != 0.0 else bound
