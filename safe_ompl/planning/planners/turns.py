"""SAFE_RRT-CONNECT in compiled code: turns of two trees that are to meet, with its EXTEND and CONNECT.

`take_turns` is a state machine. It goes on until the trees meet or it needs Python: for a look at the clock, for goals,
random numbers or room, or for what bounds of distances and the package's own danger field do not decide. Then it says
what it asks for. Called again, it goes on where it was. So the rules of a turn stand here alone, whatever says what is
free and what is dangerous.
"""

from __future__ import annotations

from math import inf, nan, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.collision import ALLOWANCE, EdgeTables, prove_edge
from safe_ompl.common import BoolArray, FloatArray, IntArray, caller, maker, part
from safe_ompl.danger.kernels import PointDanger, dangers
from safe_ompl.planning.planners.nearest import BoxTree, nearest
from safe_ompl.robot.kernels import bounded, descend, steer, way

_SHARPNESS = 4  # of the decay: easy problems are solved before danger loses weight
_FALL = 0.6  # to this share of itself a margin falls
_DANGEROUS = 8  # nodes that are refused before the threshold rises
_RARE = 4  # if obstacles refuse so many times as many steps as danger does, proofs go first
_SHORTEST = 0.05  # of a whole step
_LARGE = 64  # nodes; easy problems are solved before a tree has more
_IN_A_ROW = 8  # turns of a tree that lags before the other has one

ROOT = -1
SIZE, PRICED = range(2)  # of a tree: its nodes, and the first of them whose costs are known
NARROW, SLOPED = range(2)  # marks of a node: its last step was trapped; its gradient is known

TRAPPED, ADVANCED, REACHED = range(3)  # how a step ends
TURN, BEGIN, CHOOSE, STEP, LOOK, ENDED = range(6)  # what is next
ALONE, EXTEND, SHORTER, CONNECT = range(4)  # what a step is part of
GO_ON, MET, DONE, GIVEN_UP, PAUSE, GOALS, DRAWS, ROOM, MOTION, COST, COSTS, GRADIENT = range(12)  # what is asked for

_NUMBERS = (
    *("phase", "role", "growing", "side"),  # what is next; whose turn and whose step: 0 the start's, 1 the goal's
    *("old", "node", "new"),  # where a step begins; the last node; the one to connect to
    *("turns", "left", "in_a_row", "steps", "drawn"),  # the last three: of one tree; until a pause; random numbers
    *("nodes", "enough"),  # in both trees; with more of them goals are asked for
    "patience",  # motions that are refused before the margin falls
    *("outcome", "candidate", "looks", "proof_first", "held", "answer"),  # of a step; −1: there is no answer
    *("blocked", "dangerous", "refused", "too_near"),  # candidates; those since the threshold, and the margin, began
    *("own_danger", "own_proofs", "places", "evaluations"),  # what the kernel can do itself, and how often it did
)
_REALS = (
    *("range", "ignored", "half_life"),  # [rad]; share of the choices without danger; of the decay
    *("alpha", "scale", "slope", "share"),  # see `DangerWeight` and `TangentialDescent`
    *("rise", "level", "ceiling"),  # of the threshold
    *("margin", "least_margin", "kept"),  # [m]; `kept` is the margin that the required distances are for
    *("weight", "length", "cost"),  # of danger in a choice; of a step: how far its target is, and its danger
)
SEARCH = np.dtype([(name, np.int64) for name in _NUMBERS] + [(name, np.float64) for name in _REALS], align=True)


class Nodes(NamedTuple):
    """A tree in arrays with room for C nodes, SIZE of which there are; costs are NaN where they are not known."""

    rows: FloatArray  # (C, n)
    parents: IntArray  # (C,)
    costs: FloatArray  # (C,)
    gradients: FloatArray  # (C, n)
    marks: BoolArray  # (C, 2)
    used: IntArray  # (2,)


class Space(NamedTuple):
    """Bounds (n,) of configurations, and which coordinates wrap."""

    lower: FloatArray
    upper: FloatArray
    wraps: BoolArray


class Proofs(NamedTuple):
    """What proofs need: tables, distances (P,) that pairs must keep without a margin, and which meet obstacles."""

    tables: EdgeTables
    least: FloatArray
    meets: BoolArray


class Step(NamedTuple):
    """A step: its target (n,); places (2, n) and a slope (n,); its end (1, n) and the danger's gradient there."""

    target: FloatArray
    places: FloatArray
    slope: FloatArray
    end: FloatArray
    gradients: FloatArray


@part
def danger_share(turns: int, half_life: float) -> float:
    """Return the scale of danger after so many turns."""
    return 1.0 / (1.0 + (turns / half_life) ** _SHARPNESS)


@part
def lowered_margin(level: float, least: float) -> float:
    """Return the margin [m] after it was lowered; less than the least is none."""
    return _FALL * level if _FALL * level >= least else 0.0


@caller
def take_turns(
    search: Any,
    trees: tuple[Nodes, Nodes],
    boxes: tuple[BoxTree, BoxTree],
    space: Space,
    proofs: Proofs,
    danger: PointDanger,
    step: Step,
    draws: FloatArray,
) -> int:
    """Go on with a `search: (1,)` of `SEARCH` by the trees of start and goal; return what is asked for.

    MET: the trees have, in the node `new` of the one that is growing and the last `node` of the other. DONE: a step
    that is ALONE has ended. GIVEN_UP: no turn is left. PAUSE: so many `steps` are done. ROOM: the tree whose step it
    is, or its boxes, are full. The `answer` is 1 or 0, whether the MOTION to the candidate's place is free, and 1 when
    its COST is told (with gradient, if `share` > 0). COSTS are those of all nodes, GRADIENT that of the node `old`.
    """
    s = search[0]
    while True:
        asked = GO_ON
        if s.phase == TURN:
            if s.left == 0:
                return GIVEN_UP
            s.phase = BEGIN
            if s.nodes > s.enough:
                return GOALS
        elif s.phase == BEGIN:
            if s.drawn + len(step.target) + 4 > len(draws):
                return DRAWS
            _begin_turn(s, space, step.target, draws)
        elif s.phase == CHOOSE:
            asked = _choose(s, trees[s.side], boxes[s.side], space, danger, step)
        elif s.phase == STEP:
            asked = _begin_step(s, trees, space, danger, step)
        else:
            asked = _look(s, trees[s.side], danger, proofs, step)
        if asked != GO_ON:
            return asked
        if s.phase == ENDED:
            s.steps -= 1
            if s.role == ALONE:
                return DONE
            if s.role == CONNECT and s.outcome == REACHED:
                return MET
            _go_on(s, trees, space, step.target, draws)


@part
def _draw(s: Any, draws: FloatArray) -> float:
    s.drawn += 1
    return float(draws[s.drawn - 1])


@part
def _draw_weight(s: Any, draws: FloatArray) -> None:
    """Take the weight that danger has in a choice: none, by chance, in a share of them."""
    ignores = s.ignored > 0.0 and _draw(s, draws) < s.ignored
    s.weight = 0.0 if ignores else s.alpha * s.scale


@part
def _begin_turn(s: Any, space: Space, target: FloatArray, draws: FloatArray) -> None:
    """Draw whether danger has a weight in this turn, and a random configuration as its target."""
    s.left -= 1
    if s.half_life > 0.0:
        s.scale = 1.0 if _draw(s, draws) < danger_share(s.turns, s.half_life) else 0.0
        s.turns += 1
    for i in range(len(target)):
        target[i] = space.lower[i] + (space.upper[i] - space.lower[i]) * _draw(s, draws)
    s.role, s.side, s.phase = EXTEND, s.growing, CHOOSE
    _draw_weight(s, draws)


@part
def _choose(s: Any, tree: Nodes, boxes: BoxTree, space: Space, danger: PointDanger, step: Step) -> int:
    """Take argmin of ρ(node, target) + α·CDF(node) for the node from which to step."""
    size, costs = tree.used[SIZE], tree.costs[:0]
    if s.weight != 0.0:
        if not _priced(s, tree, danger):
            return COSTS
        costs = tree.costs[:size]
    s.old = nearest(tree.rows[:size], step.target, space.wraps, s.weight, costs, boxes)
    if s.old < 0:
        return ROOM
    s.phase = STEP
    return GO_ON


@maker
def _danger(s: Any, danger: PointDanger, row: FloatArray, slopes: FloatArray) -> float:
    """Return the danger at a row (1, n), and write its gradient (1 or 0, n)."""
    s.evaluations += 1
    return float(dangers(danger.tables, row, danger.points, danger.aggregate, slopes)[0])


@part
def _priced(s: Any, tree: Nodes, danger: PointDanger) -> bool:
    """Return whether the costs of all nodes are known; compute those that are not, where the kernel can."""
    used = tree.used
    for node in range(used[PRICED], used[SIZE]):
        if tree.costs[node] != tree.costs[node]:
            if not s.own_danger:
                return False
            tree.costs[node] = _danger(s, danger, tree.rows[node : node + 1], tree.rows[:0])
    used[PRICED] = used[SIZE]
    return True


@part
def _forced(tree: Nodes) -> float:
    """Return the cost of the cheapest root; NaN if one is, −∞ if there is none."""
    least, roots = inf, 0
    for node in range(tree.used[SIZE]):
        if tree.parents[node] == ROOT:
            roots += 1
            if not tree.costs[node] >= least:
                least = tree.costs[node]
            if least != least:
                break
    return least if roots > 0 else -inf


@part
def _begin_step(s: Any, trees: tuple[Nodes, Nodes], space: Space, danger: PointDanger, step: Step) -> int:
    """Steer to the target, at most a range away; descend from danger sideways, and take the threshold, on the way.

    Targets within a step are neither moved nor held to the threshold: they are configurations that the path needs.
    """
    tree, old, places = trees[s.side], s.old, step.places
    if tree.used[SIZE] == len(tree.rows):
        return ROOM
    if s.steps <= 0:
        return PAUSE
    s.length = steer(tree.rows[old], step.target, space.wraps, s.range, places)
    s.candidate, s.held, s.cost = 1, 0, nan
    if s.length > s.range and s.alpha * s.scale > 0.0:
        # The reach of the descent shrinks as the target comes near, so that every step comes nearer to it.
        reach = s.share * min(s.range, s.length - s.range)
        if reach > 0.0:
            if not tree.marks[old, SLOPED]:
                if not s.own_danger:
                    return GRADIENT
                cost = _danger(s, danger, tree.rows[old : old + 1], tree.gradients[old : old + 1])
                if tree.costs[old] != tree.costs[old]:
                    tree.costs[old] = cost
                tree.marks[old, SLOPED] = True
            for i in range(len(step.slope)):
                step.slope[i] = tree.gradients[old, i] / s.slope
            if descend(places, step.slope, reach, space.lower, space.upper, space.wraps):
                s.candidate = 0
        if s.rise > 0.0:
            if not (_priced(s, tree, danger) and (s.level != 0.0 or _priced(s, trees[1 - s.side], danger))):
                return COSTS
            if s.level == 0.0:  # what no path can avoid
                s.level = _forced(trees[0])
                other = _forced(trees[1])
                s.level = other if other > s.level else s.level
            cost = tree.costs[old]
            s.held, s.ceiling = 1, cost if cost > s.level else s.level
    _begin_looks(s)
    s.phase = LOOK
    return GO_ON


@part
def _begin_looks(s: Any) -> None:
    # A proof costs as much as a danger. The danger comes first, because a motion that is refused for obstacles lowers
    # the margin; but where danger refuses few steps, computing it first would be wasted.
    s.looks, s.proof_first = 0, int(s.blocked > _RARE * s.dangerous)


@part
def _look(s: Any, tree: Nodes, danger: PointDanger, proofs: Proofs, step: Step) -> int:
    """Look whether a candidate is free, or dangerous; where one with descent is not free the straight one is tried."""
    new, answer = step.places[1 - s.candidate], s.answer
    s.answer = -1
    if (s.proof_first == 1) == (s.looks == 0):
        if answer < 0:
            number = _proof(s, tree.rows[s.old], new, proofs) if s.own_proofs else 1
            if number > 0:
                return MOTION
            answer = int(number == 0)
        if answer == 0:
            if s.margin > 0.0 and s.scale > 0.0:
                s.too_near += 1
                if s.too_near % s.patience == 0:
                    s.margin = lowered_margin(s.margin, s.least_margin)
            s.blocked += int(s.length > s.range)
            if s.candidate == 1:
                s.outcome, s.phase = TRAPPED, ENDED
            else:
                s.candidate = 1
                _begin_looks(s)
            return GO_ON
    elif s.held:
        if answer < 0:
            if not s.own_danger:
                return COST
            for i in range(len(new)):
                step.end[0, i] = new[i]
            s.cost = _danger(s, danger, step.end, step.gradients[: int(s.share > 0.0)])
        if not s.cost <= s.ceiling:
            s.dangerous += 1
            s.refused += 1
            if s.refused % _DANGEROUS == 0:
                s.level *= 1.0 + s.rise
            s.outcome, s.phase = TRAPPED, ENDED
            return GO_ON
    s.looks += 1
    if s.looks == 2:
        _add(s, tree, new, step.gradients)
    return GO_ON


@part
def _proof(s: Any, q: FloatArray, new: FloatArray, proofs: Proofs) -> int:
    """Return 0 if the motion between a node and a new one is proven, −1 if it is not free, more if neither is known."""
    margin = s.margin if s.scale > 0.0 else 0.0
    if s.kept != margin:
        required, most = proofs.tables.required, -inf
        for p in range(len(proofs.least)):
            least = proofs.least[p]
            required.distances[p] = (max(least, margin) if proofs.meets[p] else least) + ALLOWANCE
            most = max(most, required.distances[p])
        required.most[0] = most
        s.kept = margin
    start, end = (q, new) if s.side == 0 else (new, q)  # as it is driven
    number, places = prove_edge(start, end, proofs.tables)
    s.places += places
    return number


@part
def _add(s: Any, tree: Nodes, new: FloatArray, gradients: FloatArray) -> None:
    """Add the node that a step leads to."""
    node = tree.used[SIZE]
    sloped = s.held == 1 and s.share > 0.0
    for i in range(len(new)):
        tree.rows[node, i] = new[i]
        if sloped:
            tree.gradients[node, i] = gradients[0, i]
    tree.parents[node], tree.costs[node] = s.old, s.cost
    tree.marks[node, NARROW], tree.marks[node, SLOPED], tree.marks[s.old, NARROW] = False, sloped, False
    tree.used[SIZE] = node + 1
    s.nodes += 1
    s.node, s.outcome, s.phase = node, ADVANCED if s.length > s.range else REACHED, ENDED


@part
def _go_on(s: Any, trees: tuple[Nodes, Nodes], space: Space, target: FloatArray, draws: FloatArray) -> None:
    """Go on after a step of a turn.

    Where a step was trapped a shorter one may lead out of a narrow place; elsewhere it would double the checks and make
    for paths that graze obstacles. So while danger has weight, or there is a margin, only nodes whose last step was
    trapped, too, get one.
    """
    tree = trees[s.side]
    if s.outcome == TRAPPED and s.role == EXTEND:
        narrow = tree.marks[s.old, NARROW]
        tree.marks[s.old, NARROW] = True
        if narrow or not (s.scale > 0.0 and (s.alpha > 0.0 or s.margin > 0.0)):
            _bring_nearer(s, tree.rows[s.old], space, target, draws)
            s.role, s.phase = SHORTER, STEP
            return
    elif s.outcome == ADVANCED and s.role == CONNECT:
        s.old, s.phase = s.node, STEP
        return
    elif s.outcome != TRAPPED:
        for i in range(len(target)):
            target[i] = tree.rows[s.node, i]
        s.new, s.role, s.side, s.phase = s.node, CONNECT, 1 - s.side, CHOOSE
        _draw_weight(s, draws)
        return
    # The larger tree keeps some of the turns: the smaller one may be enclosed, and more nodes let in more goals.
    size, others = trees[s.growing].used[SIZE], trees[1 - s.growing].used[SIZE]
    if others > max(_LARGE, size) and s.in_a_row < _IN_A_ROW:
        s.in_a_row += 1
    else:
        s.in_a_row, s.growing = 1, 1 - s.growing
    s.phase = TURN


@part
def _bring_nearer(s: Any, q: FloatArray, space: Space, target: FloatArray, draws: FloatArray) -> None:
    """Bring a target log-uniformly nearer than a whole step."""
    length = 0.0
    for i in range(len(q)):
        delta = way(q[i], target[i], space.wraps[i])
        length += delta * delta
    length = sqrt(length)
    step = _SHORTEST ** _draw(s, draws) * min(length, s.range)
    for i in range(len(q)):
        if length > 0.0:
            target[i] = q[i] + (step / length) * way(q[i], target[i], space.wraps[i])
        target[i] = bounded(target[i], space.lower[i], space.upper[i], space.wraps[i])
