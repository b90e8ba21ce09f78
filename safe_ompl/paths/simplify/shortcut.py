"""Shortcuts: of all straight motions between a path's way points, the chain that costs least."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.paths.simplify.cost import PathCost
from safe_ompl.paths.simplify.edge_proofs import EdgeProofs

_SPACING = 0.8  # [rad] between the samples of an edge's cost
_FEWEST, _MOST = 2, 4  # samples of an edge
MOST = 40  # way points of a path that edges may skip to
_JOINT = 1.2  # [rad]
_BATCH = 80  # edges whose costs are estimated at once


def shortcut(
    path: FloatArray, cost: PathCost, proofs: EdgeProofs, stop: Callable[[], bool], most: int = MOST
) -> FloatArray | None:
    """Return the cheapest chain of proven edges between way points of `path: (N, n)`, in their order, if there is one.

    Estimates the cost of the edges between up to `most` way points and of the path's own, and proves only those of the
    chain that is cheapest so far, until all of a chain is proven (as lazy roadmaps do: Bohlin & Kavraki, ICRA 2000).

    Parameters
    ----------
    path : ndarray, shape (N, n)
        From the first way point to the last one.
    cost : PathCost
        What edges cost.
    proofs : EdgeProofs
        Proves them; where the path's own edges are accepted already, there is a chain.
    stop : callable
        When it says so, there is none.
    most : int
        Way points that edges may skip to, evenly chosen where the path has more.
    """
    candidates = np.rint(np.linspace(0, len(path) - 1, min(len(path), most))).astype(int)
    wanted = np.eye(len(path), k=1, dtype=bool)
    wanted[np.ix_(candidates, candidates)] = True
    return _cheapest_proven_chain(path, wanted, cost, proofs, stop)


def joined(
    path: FloatArray, cost: PathCost, proofs: EdgeProofs, stop: Callable[[], bool]
) -> FloatArray | None:
    """Return the same where only the ends are new: besides the path's own edges those from there, short ones first."""
    for reach in (_JOINT, np.inf):
        wanted = np.eye(len(path), k=1, dtype=bool)
        wanted[0] |= np.linalg.norm(path - path[0], axis=1) < reach
        wanted[:, -1] |= np.linalg.norm(path - path[-1], axis=1) < reach
        found = _cheapest_proven_chain(path, wanted, cost, proofs, stop)
        if found is not None:
            return found
    return None


def _cheapest_proven_chain(
    path: FloatArray, wanted: BoolArray, cost: PathCost, proofs: EdgeProofs, stop: Callable[[], bool]
) -> FloatArray | None:
    costs = _edge_costs(path, wanted, cost, stop)
    while not stop():
        chain = _cheapest_chain(costs)
        if not all(np.isfinite(costs[edge]) for edge in pairwise(chain)):
            return None
        refused = [(i, j) for i, j in pairwise(chain) if not proofs.accepts(path[i], path[j])]
        if not refused:
            return path[chain]
        for edge in refused:
            costs[edge] = np.inf
    return None


def _edge_costs(path: FloatArray, wanted: BoolArray, cost: PathCost, stop: Callable[[], bool]) -> FloatArray:
    """Return the cost (N, N) of the edges from way points to later ones, infinite but for those that are wanted."""
    costs = np.full(wanted.shape, np.inf)
    first, second = np.nonzero(np.triu(wanted, 1))
    lengths = np.linalg.norm(cost.robot.difference(path[first], path[second]), axis=1)
    samples = np.clip(np.ceil(lengths / _SPACING).astype(int), _FEWEST, _MOST)
    for k in range(0, len(first), _BATCH):
        if stop():
            break
        i, j = first[k : k + _BATCH], second[k : k + _BATCH]
        costs[i, j] = cost.of_edges(path[i], path[j], samples[k : k + _BATCH])
    return costs


def _cheapest_chain(costs: FloatArray) -> list[int]:
    """Return the way points of the cheapest chain from the first to the last, by dynamic programming."""
    count = len(costs)
    best, before = np.zeros(count), np.zeros(count, dtype=int)
    for j in range(1, count):
        through = best[:j] + costs[:j, j]
        before[j] = through.argmin()
        best[j] = through[before[j]]
    chain = [count - 1]
    while chain[-1]:
        chain.append(int(before[chain[-1]]))
    return chain[::-1]
