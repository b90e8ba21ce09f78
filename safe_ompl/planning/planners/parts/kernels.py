"""Nearest of many nodes: a scan, and a tree of boxes for many nodes.

The distance ρ is Euclidean, coordinates that wrap going the short way round. Sought is argmin ρ + α·cost, of equal ones
the first. A k-d tree divides the nodes among leaves: a full leaf in the middle of the longest side of its box. The
search does not descend it, but looks at the boxes of leaves, 32 to a page, and at boxes of pages, as in a B-tree.
Leaves and pages are kept coordinate by coordinate, so that processors compute distances by lanes, and in single
precision, as reading them takes longer than computing. These distances only say what may be left out: those of the
nodes that remain are computed from their rows.
"""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part
from safe_ompl.robot.kernels import way

SingleArray: TypeAlias = NDArray[np.float32]

_ROUND = 2 * pi
_TURN, _HALF, _ZERO, _FAR = np.float32(_ROUND), np.float32(0.5), np.float32(0.0), np.float32(inf)
# Shares by which single precision is taken for less, more than it can be wrong by: no rounding may hide a node.
_LESS, _UNIT = np.float32(1 - 1e-4), 1e-6  # of distances; of coordinates and costs
_GREAT, _MOST = 1e15, 1e18  # coordinates and scores from which on singles might overflow
BOXES, SIZE = 32, 16  # boxes in a page, nodes in a leaf
COUNT, HOME, CELL, OWN = range(4)  # columns of pages and leaves
LESS, MORE, BY, ABOVE = range(4)  # columns of cells
PAGES, LEAVES, CELLS, NODES, PRICED, DEPTH, ROOT = range(7)


class BoxTree(NamedTuple):
    """A tree of boxes, in arrays that may have room for more pages and leaves.

    Cells of the k-d tree have the two that they are divided into, the coordinate by which, and the cell that they are
    half of; `cuts` are where. Those that are not divided have their leaf for LESS, and MORE is −1. A cell whose nodes
    are all at one place is divided by their numbers, as if they were coordinate n.

    Pages and leaves have the counts of their boxes and nodes, the box that they are in, 32·page + box, −1 for none, and
    their cell. Then `pages` have what is in each box, a page or, as ~leaf, a leaf, and `leaves` their nodes. `boxes`
    are the least and the greatest coordinates in each box of a page, and the least cost; `places` the coordinates and
    costs of a leaf's nodes. Costs are ∞ until they are known, and are not where there is no box or node.

    `used` counts pages, leaves, cells, nodes, and those with known costs; then how many pages are above a leaf, and
    which page is above all. `extent` is the greatest absolute coordinate.
    """

    wraps: BoolArray  # (n,)
    cells: IntArray  # (2 S, 4)
    cuts: FloatArray  # (2 S,)
    pages: IntArray  # (P, OWN + 32)
    boxes: SingleArray  # (P, 2n + 1, 32)
    leaves: IntArray  # (S, OWN + 16)
    places: SingleArray  # (S, n + 1, 16)
    used: IntArray  # (7,)
    extent: FloatArray  # (1,)


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
    extent, n = _extent(q, tree), len(q)
    if not extent < _GREAT:
        return scan(rows, q, tree.wraps, alpha, costs)
    if alpha != 0.0:
        _price(rows, costs, tree)
    # Arrays of their own, so that the compiler knows that what is written to one does not change another.
    room = BOXES * tree.used[DEPTH] + 1
    stack, bounds, single = np.empty(room, np.int64), np.empty(room), q.astype(np.float32)
    squares, margins = np.empty(max(BOXES, SIZE), np.float32), np.empty(max(BOXES, SIZE), np.float32)
    slack = _UNIT * extent * sqrt(n) + 1e-18
    stack[0], bounds[0], size = tree.used[ROOT], -inf, 1
    best, least = 0, inf
    while size > 0:
        size -= 1
        at, bottom = stack[size], size
        if bounds[size] > least + slack:
            continue
        limit = min(least + slack + 1e-5 * abs(least), _MOST)
        if at < 0:
            _squares(tree.places[~at], single, tree.wraps, squares)
            prices = tree.places[~at, n]
            _margins(squares, prices, alpha, limit, margins[:SIZE])
            for lane in range(tree.leaves[~at, COUNT]):
                if margins[lane] >= _ZERO and _bound(squares, prices, alpha, lane) <= least + slack:
                    node = tree.leaves[~at, OWN + lane]
                    score = _distance(rows, node, q, tree.wraps)
                    if alpha != 0.0:
                        score += alpha * costs[node]
                    if score < least or (score == least and node < best):
                        best, least = node, score
            continue
        _gaps(tree.boxes[at], single, tree.wraps, squares)
        _margins(squares, tree.boxes[at, 2 * n], alpha, limit, margins[:BOXES])
        for box in range(tree.pages[at, COUNT]):
            if margins[box] >= _ZERO:
                bound, k = _bound(squares, tree.boxes[at, 2 * n], alpha, box), size
                while k > bottom and bounds[k - 1] < bound:
                    stack[k], bounds[k] = stack[k - 1], bounds[k - 1]
                    k -= 1
                stack[k], bounds[k], size = tree.pages[at, OWN + box], bound, size + 1
    return int(best) if least < _MOST else scan(rows, q, tree.wraps, alpha, costs)


@part
def _extent(q: FloatArray, tree: BoxTree) -> float:
    """Return the greatest absolute coordinate of q and of all nodes."""
    extent = tree.extent[0]
    for i in range(len(q)):
        extent = max(extent, abs(q[i]))
    return float(extent)


@part
def _insert(rows: FloatArray, tree: BoxTree) -> bool:
    """Put new nodes into the tree, and return whether it has room for all of them; none from a too great one on."""
    used, n = tree.used, rows.shape[1]
    for node in range(used[NODES], len(rows)):
        # A node divides no more than one leaf, since neither half is full, and the pages above it.
        if used[PAGES] + used[DEPTH] + 2 > len(tree.pages) or used[LEAVES] + 2 > len(tree.leaves):
            return False
        tree.extent[0] = _extent(rows[node], tree)
        if not tree.extent[0] < _GREAT:
            return True
        if node == 0:
            used[DEPTH] = 1
            _append(tree, _new_page(tree, 0), ~_new_leaf(tree, -1))
        leaf = _leaf_of(rows, node, tree)
        if tree.leaves[leaf, COUNT] == SIZE:
            _make_room(tree, leaf)
            _divide(tree, leaf, rows)
            leaf = _leaf_of(rows, node, tree)
        lane = tree.leaves[leaf, COUNT]
        tree.leaves[leaf, COUNT], tree.leaves[leaf, OWN + lane] = lane + 1, node
        for i in range(n):
            tree.places[leaf, i, lane] = rows[node, i]
        home = tree.leaves[leaf, HOME]
        while home >= 0:
            page, box = home // BOXES, home % BOXES
            for i in range(n):
                place = tree.places[leaf, i, lane]
                tree.boxes[page, i, box] = min(tree.boxes[page, i, box], place)
                tree.boxes[page, n + i, box] = max(tree.boxes[page, n + i, box], place)
            home = tree.pages[page, HOME]
        used[NODES] = node + 1
    return True


@part
def _leaf_of(rows: FloatArray, node: int, tree: BoxTree) -> int:
    """Return the leaf that a node is in, or belongs to."""
    at = 0
    while tree.cells[at, MORE] >= 0:
        at = tree.cells[at, MORE if _place(rows, node, tree.cells[at, BY]) >= tree.cuts[at] else LESS]
    return int(tree.cells[at, LESS])


@part
def _place(rows: FloatArray, node: int, by: int) -> float:
    """Return by what a node is divided from others: a coordinate, as a single, or its number."""
    return float(np.float32(rows[node, by])) if by < rows.shape[1] else float(node)


@part
def _new_leaf(tree: BoxTree, above: int) -> int:
    """Add a leaf without nodes and a cell for it, half of the one above, and return it."""
    leaf, cell = tree.used[LEAVES], tree.used[CELLS]
    tree.used[LEAVES], tree.used[CELLS] = leaf + 1, cell + 1
    tree.leaves[leaf, COUNT], tree.leaves[leaf, CELL] = 0, cell
    tree.cells[cell, LESS], tree.cells[cell, MORE], tree.cells[cell, ABOVE] = leaf, -1, above
    tree.places[leaf] = _FAR
    return int(leaf)


@part
def _new_page(tree: BoxTree, cell: int) -> int:
    """Add a page without boxes, and return it."""
    page = tree.used[PAGES]
    tree.used[PAGES] += 1
    tree.pages[page, COUNT], tree.pages[page, HOME], tree.pages[page, CELL] = 0, -1, cell
    tree.boxes[page] = _FAR
    return int(page)


@part
def _append(tree: BoxTree, page: int, inside: int) -> None:
    """Let a page, which has room, have another box with a page or, as ~leaf, a leaf."""
    box = tree.pages[page, COUNT]
    tree.pages[page, COUNT] = box + 1
    _hold(tree, page, box, inside)


@part
def _hold(tree: BoxTree, page: int, box: int, inside: int) -> None:
    """Let a box have a page or, as ~leaf, a leaf in it, and measure it."""
    n = len(tree.wraps)
    tree.pages[page, OWN + box] = inside
    if inside < 0:
        count, lows, highs = tree.leaves[~inside, COUNT], tree.places[~inside], tree.places[~inside]
        tree.leaves[~inside, HOME] = BOXES * page + box
    else:
        count, lows, highs = tree.pages[inside, COUNT], tree.boxes[inside], tree.boxes[inside, n:]
        tree.pages[inside, HOME] = BOXES * page + box
    for i in range(n):
        low, high = _FAR, -_FAR
        for k in range(count):
            low, high = min(low, lows[i, k]), max(high, highs[i, k])
        tree.boxes[page, i, box], tree.boxes[page, n + i, box] = low, high
    cost = _FAR
    for k in range(count):
        cost = min(cost, highs[n, k])
    tree.boxes[page, 2 * n, box] = cost


@part
def _divide(tree: BoxTree, leaf: int, rows: FloatArray) -> None:
    """Divide a full leaf, whose page has room; where its nodes are all at one place, into the earlier and the later."""
    n, home = rows.shape[1], tree.leaves[leaf, HOME]
    box = tree.boxes[home // BOXES, :, home % BOXES]
    by, widest, value = n, 0.0, float(tree.leaves[leaf, OWN + SIZE // 2])
    for i in range(n):
        low, high = float(box[i]), float(box[n + i])
        if high - low > widest:
            by, widest, value = i, high - low, 0.5 * (low + high)
    whole = tree.leaves[leaf, CELL]
    less, tree.leaves[leaf, CELL] = tree.used[CELLS], tree.used[CELLS]
    tree.used[CELLS] += 1
    tree.cells[less, LESS], tree.cells[less, MORE], tree.cells[less, ABOVE] = leaf, -1, whole
    more = _new_leaf(tree, whole)
    tree.cells[whole, LESS], tree.cells[whole, MORE], tree.cells[whole, BY] = (less, tree.leaves[more, CELL], by)
    tree.cuts[whole] = value
    tree.leaves[leaf, COUNT] = 0
    for k in range(SIZE):
        node = tree.leaves[leaf, OWN + k]
        half = more if _place(rows, node, by) >= value else leaf
        lane = tree.leaves[half, COUNT]
        tree.leaves[half, COUNT], tree.leaves[half, OWN + lane] = lane + 1, node
        for i in range(n + 1):
            tree.places[half, i, lane] = tree.places[leaf, i, k]
    tree.places[leaf, :, tree.leaves[leaf, COUNT] :] = _FAR
    _hold(tree, home // BOXES, home % BOXES, ~leaf)
    _append(tree, home // BOXES, ~more)


@part
def _make_room(tree: BoxTree, leaf: int) -> None:
    """Divide pages until that of a leaf has room for another box: first those above it that are full."""
    pages = tree.pages
    while pages[tree.leaves[leaf, HOME] // BOXES, COUNT] == BOXES:
        page = tree.leaves[leaf, HOME] // BOXES
        while pages[page, HOME] >= 0 and pages[pages[page, HOME] // BOXES, COUNT] == BOXES:
            page = pages[page, HOME] // BOXES
        if pages[page, HOME] < 0:
            tree.used[ROOT] = _new_page(tree, 0)
            tree.used[DEPTH] += 1
            _append(tree, tree.used[ROOT], page)
        _split(tree, page)


@part
def _split(tree: BoxTree, page: int) -> None:
    """Divide a page like its cell; the page that it is in has room."""
    pages, whole, home = tree.pages, tree.pages[page, CELL], tree.pages[page, HOME]
    less, more = tree.cells[whole, LESS], tree.cells[whole, MORE]
    new = _new_page(tree, more)
    pages[page, CELL], pages[page, COUNT] = less, 0
    for box in range(BOXES):
        inside = pages[page, OWN + box]
        at = tree.leaves[~inside, CELL] if inside < 0 else pages[inside, CELL]
        while at != less and at != more:
            at = tree.cells[at, ABOVE]
        _append(tree, page if at == less else new, inside)
    tree.boxes[page, :, pages[page, COUNT] :] = _FAR
    _hold(tree, home // BOXES, home % BOXES, page)
    _append(tree, home // BOXES, new)


@part
def _price(rows: FloatArray, costs: FloatArray, tree: BoxTree) -> None:
    """Let the tree know the costs (N,) of nodes that have none in it."""
    n = len(tree.wraps)
    for node in range(tree.used[PRICED], len(costs)):
        leaf, lane = _leaf_of(rows, node, tree), 0
        while tree.leaves[leaf, OWN + lane] != node:
            lane += 1
        cost = costs[node] - _UNIT * abs(costs[node])
        cost = np.float32(cost if cost < _MOST else _MOST)  # also of ∞ and NaN
        tree.places[leaf, n, lane] = cost
        home = tree.leaves[leaf, HOME]
        while home >= 0 and tree.boxes[home // BOXES, 2 * n, home % BOXES] > cost:
            tree.boxes[home // BOXES, 2 * n, home % BOXES] = cost
            home = tree.pages[home // BOXES, HOME]
        tree.used[PRICED] = node + 1


@part
def _gaps(boxes: SingleArray, q: SingleArray, wraps: BoolArray, out: SingleArray) -> None:
    """Write ρ² from the nearest places of the boxes of a page to q."""
    n = len(wraps)
    for box in range(BOXES):
        out[box] = _ZERO
    for i in range(n):
        at = q[i]
        if wraps[i]:
            for box in range(BOXES):
                low, high = boxes[i, box], boxes[n + i, box]
                delta = at - _HALF * (low + high)
                delta -= _TURN * np.rint(delta / _TURN)
                gap = max(abs(delta) - _HALF * (high - low), _ZERO)
                out[box] += gap * gap
        else:
            for box in range(BOXES):
                gap = max(boxes[i, box] - at, at - boxes[n + i, box], _ZERO)
                out[box] += gap * gap


@part
def _squares(places: SingleArray, q: SingleArray, wraps: BoolArray, out: SingleArray) -> None:
    """Write ρ² from the nodes of a leaf to q."""
    for k in range(SIZE):
        out[k] = _ZERO
    for i in range(len(wraps)):
        at = q[i]
        if wraps[i]:
            for k in range(SIZE):
                delta = at - places[i, k]
                delta -= _TURN * np.rint(delta / _TURN)
                out[k] += delta * delta
        else:
            for k in range(SIZE):
                delta = at - places[i, k]
                out[k] += delta * delta


@part
def _margins(squares: SingleArray, costs: SingleArray, alpha: float, limit: float, out: SingleArray) -> None:
    """Write by how much ρ² is less than what the limit of ρ + α·cost allows; negative: what may be left out."""
    weight, most = np.float32(alpha), np.float32(limit)
    if alpha != 0.0:
        for k in range(len(out)):
            room = max(most - weight * costs[k], _ZERO)
            out[k] = room * room - _LESS * squares[k]
    else:
        for k in range(len(out)):
            out[k] = most * most - _LESS * squares[k]


@part
def _bound(squares: SingleArray, costs: SingleArray, alpha: float, k: int) -> float:
    """Return a lower bound of ρ + α·cost."""
    distance = float(np.sqrt(squares[k]) * _LESS)
    return distance + alpha * float(costs[k]) if alpha != 0.0 else distance
