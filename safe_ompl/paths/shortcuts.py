"""Shortcuts between way points, and retreats from ends that are near obstacles."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.danger import DangerField
from safe_ompl.paths.cost import ObstacleCost, PathCost
from safe_ompl.paths.descent import FeasibleSet
from safe_ompl.paths.edges import EdgeProofs

RETREAT_STEP = 0.02  # [rad]
_LONGEST = 1.0  # [rad]
_LEFT = 0.3  # a retreat is over when this share of the cost of its end is left
_EXCESS = 600.0  # weight of danger: at 1.4 times that of the end it costs what a contact costs
_ONSET = 0.8  # share of the end's danger from which a point counts
_STUCK = 0.1  # share of a step: where the best one is shorter, nothing leads on
_FLAT = 1e-9  # share of the largest curvature, or of the slope per radian: less is as good as none
_NEWTON_STEPS, _PRECISION = 30, 1e-9


def retreat(
    end: FloatArray,
    obstacles: ObstacleCost,
    field: DangerField,
    feasible: FeasibleSet,
    stop: Callable[[], bool],
) -> FloatArray:
    """Return a way (K, n) from an end (n,) of a path to where obstacles and danger are less; K = 1: there is none.

    The steepest descent of what is near, Σ over pairs of link and obstacle, and of what is dangerous, the field of the
    danger points over that of the most dangerous one at the end: w Σ_m (CDF(p_m)/CDF(end) − 0.8)₊². Sums of hinges have
    no kinks, unlike the danger, which is a maximum; and each step of 0.02 rad is the best of its length for their
    Gauss-Newton model (Nocedal & Wright, ch. 4). So it goes along the floor of the valley between two fingers'
    obstacles, where gradient steps would go from wall to wall. It is not proven free, and `obstacles` is anchored anew.
    """
    reference = field.value(end)
    q, way, enough = end, [end], None
    while len(way) * RETREAT_STEP <= _LONGEST and not stop():
        cost, gradient, bends = _model(q, obstacles, field, reference)
        enough = _LEFT * cost if enough is None else enough
        if cost <= enough:
            return np.array(way)
        q = feasible.within(q + _step(gradient, bends.T @ bends))
        if np.linalg.norm(q - way[-1]) < _STUCK * RETREAT_STEP:
            break
        way.append(q)
    return end[None]


def _model(
    q: FloatArray, obstacles: ObstacleCost, field: DangerField, reference: float
) -> tuple[float, FloatArray, FloatArray]:
    """Return what `q: (n,)` costs, the gradient (n,), and vectors v (C, n): it bends like Σ vvᵀ."""
    Q = q[None]
    obstacles.anchor(Q)
    near, slopes, _, bends = obstacles.expansion(Q)
    if not near[0] or not 0 < reference < np.inf:
        return float(near[0]), slopes[0], bends
    _, danger, rises = field.terms_above(Q, _ONSET * reference)
    excess, rises = danger / reference - _ONSET, rises / reference
    return (
        float(near[0] + _EXCESS * excess @ excess),
        slopes[0] + 2.0 * _EXCESS * excess @ rises,
        np.concatenate([bends, np.sqrt(2.0 * _EXCESS) * rises]),
    )


def _step(gradient: FloatArray, curvature: FloatArray) -> FloatArray:
    """Return the step s (n,), no longer than `RETREAT_STEP`, that minimises g·s + ½ sᵀHs.

    It is −(H + λ1)⁻¹g with the least λ ≥ 0 that makes it short enough, which Newton's method on 1/‖s(λ)‖ finds in a few
    steps (Moré & Sorensen 1983).
    """
    bends, directions = np.linalg.eigh(curvature)
    slopes = directions.T @ gradient
    bends = np.maximum(bends, _FLAT * max(bends[-1], float(np.sqrt(slopes @ slopes))))
    shares, shift = slopes / bends if slopes.any() else slopes, 0.0
    for _ in range(_NEWTON_STEPS):
        length = float(np.sqrt(shares @ shares))
        if length <= (1.0 + _PRECISION) * RETREAT_STEP:
            break
        slower = float(shares @ (shares / (bends + shift)))
        shift += (length / RETREAT_STEP - 1.0) * length**2 / slower
        shares = slopes / (bends + shift)
    step: FloatArray = -directions @ shares
    return step


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
