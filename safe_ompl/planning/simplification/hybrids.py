"""Hybrids of paths: parts of several paths, joined by proven motions where that costs less than any of the paths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.planning.simplification.costs import arc_lengths
from safe_ompl.planning.simplification.descent import ActiveSetCost
from safe_ompl.planning.simplification.edges import LOOKED_AT, EdgeProofs, cheapest_proven_chain
from safe_ompl.planning.simplification.simplifier import SAME_CLEARANCE, Simplifier, Stop
from safe_ompl.robot import plain

# Motions from one path to another are no longer than this. Longer ones are rarely part of the cheapest path, and their
# danger would take most of the time; with 1 rad rather fewer hybrids were found.
_REACH = 2.0  # [rad]


def hybrid(simplifier: Simplifier, paths: Sequence[FloatArray], stop: Stop) -> FloatArray:
    """Return the cheapest proven path (N, n) through way points of several proven paths, with the ends of the first.

    The way points of all paths, (N_i, n) each [rad or m], are nodes of one graph, ordered by their share of the length
    of their path. An edge leads to a later node if a path through it may cost less than the first one, by an estimate:
    the cost of the path of its first node up to there, of the edge by the density at its ends, and of the path of its
    last node from there on. Edges are proven once they are part of the cheapest path so far. This is path merging by
    Raveh, Enosh & Halperin (A little more, a lot better, IEEE T-RO 27, 2011; OMPL's PathHybridization), with J as the
    cost, without that of obstacles; the least clearance is not below that of the first path by more than 0.1 mm. Where
    nothing is cheaper, or `stop` says so, the first path is returned.
    """
    robot, danger = simplifier.robot, simplifier.danger
    proofs, nodes, tables = EdgeProofs(simplifier.motion, stop), list[FloatArray](), list[FloatArray]()
    for number, given in enumerate(paths):
        path = robot.unrolled(given)
        proofs.accept(path)
        arc, density = arc_lengths(plain(path)), 1.0 + danger.values(path)
        spent = np.zeros(len(path))
        np.cumsum(0.5 * (density[1:] + density[:-1]) * (arc[1:] - arc[:-1]), out=spent[1:])
        inner = slice(None) if number == 0 else slice(1, -1)
        share = arc / (arc[-1] or 1.0)
        nodes.append(path[inner])
        tables.append(np.column_stack([share, density, spent, spent[-1] - spent])[inner])
    table = np.concatenate(tables)
    order = np.argsort(table[:, 0], kind="stable")
    merged, (_, density, before, after) = np.concatenate(nodes)[order], table[order].T
    lengths = np.linalg.norm(robot.difference(merged[:, None], merged[None]), axis=2)
    estimates = before[:, None] + 0.5 * (density[:, None] + density) * lengths + after
    wanted = np.triu((estimates < before[-1]) & (lengths > 0) & (lengths < _REACH), 1)
    own = np.argsort(order)[: len(nodes[0])]
    wanted[own[:-1], own[1:]] = True
    known = np.zeros(wanted.shape, dtype=np.intp)
    known[own[:-1], own[1:]] = LOOKED_AT
    if simplifier.obstacle_cost is not None:
        kept = min(simplifier.obstacle_cost.clearances(nodes[0])[1], simplifier.most_kept)
        proofs.keep(max(0.0, kept - SAME_CLEARANCE) if np.isfinite(kept) else 0.0)
    cost = ActiveSetCost(danger, None, nodes[0])
    cost.look_at(nodes[0], merged)
    found = cheapest_proven_chain(merged, wanted, cost, proofs, stop, known=known)
    return nodes[0] if found is None else robot.unrolled(found)
