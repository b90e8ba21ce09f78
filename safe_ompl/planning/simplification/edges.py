"""Edges of paths: proofs, where paths may be, shortcuts between way points, and retreats from obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import compress, pairwise

import numpy as np

from safe_ompl.collision import DistanceBounds, MotionProver, Required
from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray
from safe_ompl.danger import DangerField
from safe_ompl.planning.simplification.cost import ActiveSetCost, DangerDensity, ObstacleCost
from safe_ompl.planning.simplification.costs import LOOKED_AT, PROVEN, Densities, arc_lengths, prove_edges, weeded_chain
from safe_ompl.robot import EdgeTable, StepLimits, plain

_REACH = 0.5  # [rad] of path on each side of a refused edge are held back at first,
_WIDENINGS = 6  # then twice as much, so many times


class EdgeProofs:
    """Proves that every edge of a path is free, and keeps more than a margin from obstacles, until `stop` says so."""

    def __init__(self, motion: MotionProver, stop: Callable[[], bool] = lambda: False) -> None:
        self._free = self._clear = replace(motion, stop=stop)
        self._stop = stop
        self._proven: set[bytes] = set()
        self._inherited: set[bytes] = set()

    def check(self, path: FloatArray) -> None:
        """Accept the edges of a path (N, n) without a margin; raise InputError if one is not proven free."""
        for k, (start, end) in enumerate(pairwise(path)):
            if not self._free.is_free(start, end):
                raise InputError(f"path: the edge from way point {k} on is not proven free")
        self.accept(path)

    def accept(self, path: FloatArray) -> None:
        """Accept the edges of a path (N, n), which are known to be free."""
        self._proven.update(_keys(path))

    def inherit(self, path: FloatArray) -> None:
        """Accept the edges of a path (N, n), parts of accepted ones, as soon as they are proven without the margin."""
        self._inherited.update(_keys(path))

    def keep(self, margin: float) -> None:
        """From here on ask for a clearance [m] of all edges that are not accepted yet."""
        separation = self._free.separation
        wider = replace(separation, margin=max(margin, separation.margin))
        self._clear = replace(self._free, separation=wider)

    def refused(self, path: FloatArray) -> list[int]:
        """Return the edges of a path (N, n) that are not proven."""
        keys = _keys(path)
        unknown = {key: k for k, key in enumerate(keys) if key not in self._proven}
        for inherited in () if self._stop() or not unknown else (False, True):
            asked = {key: k for key, k in unknown.items() if (key in self._inherited) is inherited}
            if asked:
                rows = np.fromiter(asked.values(), np.intp)
                prove = self._free.are_free if inherited else self._clear_edges
                self._proven.update(compress(asked, prove(path[rows], path[rows + 1]).tolist()))
        return [k for k, key in enumerate(keys) if key not in self._proven] if unknown else []

    def _clear_edges(self, starts: FloatArray, ends: FloatArray) -> BoolArray:
        """Return which edges between `starts` and `ends: (E, n)` keep the margin.

        Where all bodies are exact what bounds do not prove does not: coal would ask for as long as a descent takes.
        """
        motion = self._clear
        if motion.limits or not motion.required.pairs.bounds.exact.all():
            return motion.are_free(starts, ends)
        with motion.checker.changes.none():
            free, places = prove_edges(*_tables(motion), plain(starts), plain(ends))
        motion.checker.counts.bound_queries += places
        return free

    def chained(self, path: FloatArray, costs: FloatArray, most: float, known: IntArray) -> IntArray:
        """Return what comes before each way point of `path: (N, n)` on the cheapest way to it, by the costs (N, N).

        Edges on the way to the last one that are certainly blocked get infinite costs first, but for those that are
        `known: (N, N)`, and unless the way costs more than `most`.
        """
        motion = self._clear
        with motion.checker.changes.none():
            before, places = weeded_chain(*_tables(motion), costs, known, most, plain(path))
        motion.checker.counts.bound_queries += places
        if not motion.limits:
            for edge in np.argwhere(known == PROVEN):
                self._proven.update(_keys(path[edge]))
        known[known == PROVEN] = LOOKED_AT
        return before

    def held_back(self, path: FloatArray, known: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return `path: (N, n)`, held back to an accepted one where edges are refused, and which way points are there.

        Those beside a refused edge go back, those around them in part; if that does not help, more, and in the end all.
        """
        refused, reach = self.refused(path), _REACH
        if not refused:
            return path, np.zeros(len(path), dtype=bool)
        arc = arc_lengths(plain(known))
        share, held = np.ones(len(path)), path
        for _ in range(_WIDENINGS):
            for k in refused:
                beyond = np.maximum(arc[k] - arc, arc - arc[k + 1])
                share = np.minimum(share, np.maximum(0.0, beyond) / reach)
                share[k : k + 2] = 0.0
            held = np.where(share[:, None] < 1, known + share[:, None] * (path - known), path)
            held[share == 0] = known[share == 0]
            refused = self.refused(held)
            if not refused:
                return held, share == 0
            reach *= 2.0
        return known.copy(), np.ones(len(path), dtype=bool)


def _tables(motion: MotionProver) -> tuple[DistanceBounds, EdgeTable, Required, float]:
    """Return what compiled code needs to prove edges in the scene as it is."""
    required = motion.required
    return required.pairs.bounds, motion.checker.robot.joint_limits.table, required.allowed_for, motion.floor


def _keys(path: FloatArray) -> list[bytes]:
    data, row = path.tobytes(), path.itemsize * path.shape[1]
    return [data[k : k + 2 * row] for k in range(0, len(data) - row, row)]


RETREAT_STEP = 0.04  # [rad]
_LONGEST = 1.0  # [rad]
_LEFT = 0.3  # a retreat is over when this share of the cost of its end is left
_EXCESS = 600.0  # weight of danger: at 1.4 times that of the end it costs what a contact costs
_ONSET = 0.8  # share of the end's danger from which a point counts
_STUCK = 0.1  # share of a step: where the best one is shorter, nothing leads on


def retreat(
    end: FloatArray, obstacles: ObstacleCost, field: DangerField, limits: StepLimits, stop: Callable[[], bool]
) -> FloatArray:
    """Return a way (K, n) from an end (n,) of a path to where obstacles and danger are less; K = 1: there is none.

    The steepest descent of what is near, and of what is dangerous, w Σ_m (CDF(p_m)/CDF(end) − 0.8)₊²: sums of hinges
    have no kinks, unlike the danger, which is a maximum. Each step of 0.04 rad is the best of its length for their
    Gauss-Newton model (Nocedal & Wright, ch. 4), along the floor of a valley, where gradient steps would go from wall
    to wall. It is not proven free.
    """
    terms = DangerDensity(field, 1.0).terms()
    q, way, enough, reference = end, [end], None, 0.0
    while len(way) * RETREAT_STEP <= _LONGEST and not stop():
        Q = plain(q[None])
        near = obstacles.near(Q)
        densities = Densities(terms, near.carriers, near.table, obstacles.hinges)
        cost, reference, step = densities.retreat_step(Q, reference, _EXCESS, _ONSET, RETREAT_STEP)
        field.count(1, len(field.points))
        enough = _LEFT * cost if enough is None else enough
        if cost <= enough:
            return np.array(way)
        q = np.clip(q + step, *limits)
        if np.linalg.norm(q - way[-1]) < _STUCK * RETREAT_STEP:
            break
        way.append(q)
    return end[None]


MOST = 40  # way points of a path that edges may skip to
_JOINT = 1.2  # [rad]


def shortcut(
    path: FloatArray,
    cost: ActiveSetCost,
    proofs: EdgeProofs,
    stop: Callable[[], bool],
    most: int = MOST,
    worth: float = 1.0,
) -> FloatArray | None:
    """Return the cheapest chain of proven edges between way points of `path: (N, n)`, in their order, if there is one.

    Of the edges between up to `most` way points only those of the chain that is cheapest so far are proven (as in lazy
    roadmaps: Bohlin & Kavraki, ICRA 2000), unless it is estimated to cost more than the share `worth` of the path.
    """
    candidates = np.rint(np.linspace(0, len(path) - 1, min(len(path), most))).astype(int)
    wanted = np.eye(len(path), k=1, dtype=bool)
    wanted[np.ix_(candidates, candidates)] = True
    return cheapest_proven_chain(path, wanted, cost, proofs, stop, worth)


def joined(path: FloatArray, cost: ActiveSetCost, proofs: EdgeProofs, stop: Callable[[], bool]) -> FloatArray | None:
    """Return the same where only the ends are new: besides the path's own edges those from there, short ones first."""
    for reach in (_JOINT, np.inf):
        wanted = np.eye(len(path), k=1, dtype=bool)
        wanted[0] |= np.linalg.norm(path - path[0], axis=1) < reach
        wanted[:, -1] |= np.linalg.norm(path - path[-1], axis=1) < reach
        found = cheapest_proven_chain(path, wanted, cost, proofs, stop)
        if found is not None:
            return found
    return None


def cheapest_proven_chain(
    path: FloatArray,
    wanted: BoolArray,
    cost: ActiveSetCost,
    proofs: EdgeProofs,
    stop: Callable[[], bool],
    worth: float = np.inf,
    known: IntArray | None = None,
) -> FloatArray | None:
    """Return the cheapest chain of proven edges from the first to the last of `path: (N, n)`, or None.

    Edges lead to later way points, those that are `wanted: (N, N)`. An estimate above the share `worth` of the path's
    cost ends it. Edges that are `known: (N, N)` may be accepted without the margin, by default the path's own.
    """
    if stop():
        return None
    costs, samples = cost.terms.edge_costs(plain(path), wanted, cost.robot.continuous)
    cost.count(samples)
    most = worth * float(np.diagonal(costs, 1).sum()) if worth < np.inf else np.inf
    known = np.eye(len(path), k=1, dtype=np.intp) if known is None else known
    while not stop():
        before, chain = proofs.chained(path, costs, most, known), [len(costs) - 1]
        while chain[-1]:
            chain.append(int(before[chain[-1]]))
        chain.reverse()
        expected = sum(float(costs[edge]) for edge in pairwise(chain))
        if not expected <= most or expected == np.inf:
            return None
        refused = proofs.refused(path[chain])
        if not refused:
            return path[chain]
        for k in refused:
            costs[chain[k], chain[k + 1]] = np.inf
    return None
