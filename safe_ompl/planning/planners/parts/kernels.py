"""Nearest of many nodes: a scan, and a tree of boxes for many nodes.

The distance ρ is Euclidean, coordinates that wrap going the short way round. Sought is argmin ρ + α·cost, of equal ones
the first. Every node of the tree of boxes is a node itself, with the box and the least cost of all nodes beneath it; a
branch is left out where even the nearest place of its box, at its least cost, is worse than what was found.
"""

from __future__ import annotations

from math import inf, pi, sqrt

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part

_ROUND = 2 * pi
_SLACK = 1 - 1e-12  # bounds of boxes are taken for less by this: no rounding may hide a node
LESS, MORE, ABOVE = 0, 1, 2


@part
def _distance(rows: FloatArray, node: int, q: FloatArray, wraps: BoolArray) -> float:
    """Return ρ from a node to q."""
    total = 0.0
    for i in range(len(q)):
        delta = q[i] - rows[node, i]
        if wraps[i]:
            delta -= _ROUND * np.rint(delta / _ROUND)
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


@compiled
def insert(rows: FloatArray, begin: int, links: IntArray, boxes: FloatArray, lowest: FloatArray) -> int:
    """Put the nodes from `begin` on into the tree, at the ends of its branches, and return how deep these are.

    `links: (N, 3)` are the nodes beneath and above each node, −1 for none; `boxes: (N, 2, n)`; `lowest: (N,)`. Nodes
    divide what is beneath them by one coordinate, the next one at each level.
    """
    n, deepest = rows.shape[1], 0
    for node in range(begin, len(rows)):
        links[node, :] = -1
        lowest[node] = inf
        for i in range(n):
            boxes[node, 0, i] = boxes[node, 1, i] = rows[node, i]
        if node == 0:
            continue
        at, depth = 0, 0
        while True:
            for i in range(n):
                boxes[at, 0, i] = min(boxes[at, 0, i], rows[node, i])
                boxes[at, 1, i] = max(boxes[at, 1, i], rows[node, i])
            by = depth % n
            side = LESS if rows[node, by] < rows[at, by] else MORE
            depth += 1
            if links[at, side] < 0:
                links[at, side] = node
                links[node, ABOVE] = at
                break
            at = links[at, side]
        deepest = max(deepest, depth)
    return deepest


@compiled
def price(costs: FloatArray, begin: int, links: IntArray, lowest: FloatArray) -> None:
    """Let the tree know the costs (N,) of the nodes from `begin` on."""
    for node in range(begin, len(costs)):
        at = node
        while at >= 0 and lowest[at] > costs[node]:
            lowest[at] = costs[node]
            at = links[at, ABOVE]


@compiled
def search(
    rows: FloatArray,
    q: FloatArray,
    wraps: BoolArray,
    alpha: float,
    costs: FloatArray,
    links: IntArray,
    boxes: FloatArray,
    lowest: FloatArray,
    deepest: int,
) -> int:
    """Return argmin ρ + α·cost of the nodes `rows: (N ≥ 1, n)`, all of which are in the tree; like `scan`."""
    stack, bounds = np.empty(deepest + 2, dtype=np.int64), np.empty(deepest + 2)
    stack[0], bounds[0], size = 0, -inf, 1
    best, least = 0, inf
    while size > 0:
        size -= 1
        node = stack[size]
        if bounds[size] > least:
            continue
        score = _distance(rows, node, q, wraps)
        if alpha != 0.0:
            score += alpha * costs[node]
        if score < least or (score == least and node < best):
            best, least = node, score
        first, second = links[node, LESS], links[node, MORE]
        near = _least(first, q, wraps, alpha, boxes, lowest)
        far = _least(second, q, wraps, alpha, boxes, lowest)
        if near > far:
            first, second, near, far = second, first, far, near
        if second >= 0 and far <= least:
            stack[size], bounds[size] = second, far
            size += 1
        if first >= 0 and near <= least:
            stack[size], bounds[size] = first, near
            size += 1
    return best


@part
def _least(
    node: int, q: FloatArray, wraps: BoolArray, alpha: float, boxes: FloatArray, lowest: FloatArray
) -> float:
    """Return a lower bound of ρ + α·cost in a branch; +∞ and beyond all else where there is none."""
    if node < 0:
        return inf
    bound = _box_distance(boxes, node, q, wraps)
    return bound + alpha * lowest[node] if alpha != 0.0 else bound
