"""Edges of paths: proofs, where paths may be, shortcuts between way points, and retreats from obstacles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import compress, pairwise
from math import inf, sqrt

import numpy as np

from safe_ompl.collision import EdgeTables, MotionProver, hinge_costs, prove_edge
from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, caller, compiled
from safe_ompl.danger import DangerField
from safe_ompl.danger.kernels import MAXIMUM, PointDanger, high_levels
from safe_ompl.planning.simplification.cost import (
    ActiveSetCost,
    DangerDensity,
    DangerTerms,
    Densities,
    ObstacleCost,
    chained,
    danger_at,
    edge_costs,
    joint_values,
)
from safe_ompl.planning.simplification.measures import arc_lengths
from safe_ompl.robot import StepLimits, plain

_REACH = 0.5  # [rad] of path on each side of a refused edge are held back at first,
_WIDENINGS = 6  # then twice as much, so many times


class EdgeProofs:
    """Proves that every edge of a path is free, and keeps more than a margin from obstacles, until `stop` says so."""

    def __init__(self, motion: MotionProver, stop: Callable[[], bool] = lambda: False) -> None:
        self._free = self._clear = replace(motion, stop=stop)
        self._stop = stop
        self._proven: set[bytes] = set()
        self._inherited: set[bytes] = set()
        self._known: tuple[object, EdgeTables | None] = None, None

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
        self._clear, self._known = replace(self._free, separation=wider), (None, None)

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
            tables = self._tables()
            if tables is None:
                return np.zeros(len(starts), dtype=bool)
            free, places = _proven(plain(starts), plain(ends), tables)
        motion.checker.counts.bound_queries += places
        return free

    def _tables(self) -> EdgeTables | None:
        """Return what kernels need to prove that edges keep the margin in the scene as it is."""
        bounds = self._clear.required.pairs.bounds
        if self._known[0] is not bounds:
            self._known = bounds, self._clear.edge_tables()
        return self._known[1]

    def chained(self, path: FloatArray, costs: FloatArray, most: float, known: IntArray) -> IntArray:
        """Return what comes before each way point of `path: (N, n)` on the cheapest way to it, by the costs (N, N).

        Edges on the way to the last one that are certainly blocked get infinite costs first, but for those that are
        `known: (N, N)`, and unless the way costs more than `most`.
        """
        motion = self._clear
        with motion.checker.changes.none():
            tables = self._tables()
            if tables is None:
                return chained(costs)
            before, places = _weeded(costs, known, most, plain(path), tables)
        motion.checker.counts.bound_queries += places
        if not motion.limits:
            for edge in np.argwhere(known == _PROVEN):
                self._proven.update(_keys(path[edge]))
        known[known == _PROVEN] = _LOOKED_AT
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


def _keys(path: FloatArray) -> list[bytes]:
    data, row = path.tobytes(), path.itemsize * path.shape[1]
    return [data[k : k + 2 * row] for k in range(0, len(data) - row, row)]


RETREAT_STEP = 0.04  # [rad]
_LONGEST = 1.0  # [rad]
_LEFT = 0.3  # a retreat is over when this share of the cost of its end is left
_EXCESS = 600.0  # weight of danger: at 1.4 times that of the end it costs what a contact costs
_ONSET = 0.8  # share of the end's danger from which a point counts
_STUCK = 0.1  # share of a step: where the best one is shorter, nothing leads on
_FLAT = 1e-9  # share of the curvature, or of the slope per radian: less is as good as none
_NEWTON_STEPS, _PRECISION = 30, 1e-9


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
        cost, reference, step = _retreated(densities, Q, reference)
        field.count(1, len(field.points))
        enough = _LEFT * cost if enough is None else enough
        if cost <= enough:
            return np.array(way)
        q = np.clip(q + step, *limits)
        if np.linalg.norm(q - way[-1]) < _STUCK * RETREAT_STEP:
            break
        way.append(q)
    return end[None]


@caller
def _retreated(densities: Densities, Q: FloatArray, reference: float) -> tuple[float, float, FloatArray]:
    """Return what `Q: (1, n)` costs, the danger with which it is compared, 0: its own, and the best step from there."""
    terms = densities.terms
    values, columns, none = joint_values(Q, terms.matrix, terms.shift), terms.matrix.T.copy(), np.zeros(Q.shape[1])
    near, pushes, bends = hinge_costs(
        terms.danger.tables.joints, values, densities.carriers, densities.near, densities.hinges
    )
    tables, points, aggregate = terms.danger
    slopes = np.zeros(values.shape)
    levels = danger_at(terms, Q, slopes) if reference == 0.0 or aggregate.kind != MAXIMUM else np.zeros(0)
    reference = levels[0] if reference == 0.0 else reference
    if near[0] == 0.0 or not 0.0 < reference < inf:
        levels, slopes = levels[:0], slopes[:0]
    elif aggregate.kind == MAXIMUM:
        levels, slopes = high_levels(tables, values, points, _ONSET * reference)
    cost, gradient, rises = near[0], joint_values(pushes, columns, none)[0], joint_values(slopes, columns, none)
    for c in range(len(levels)):
        excess = max(0.0, levels[c] / reference - _ONSET)
        cost += _EXCESS * excess * excess
        for i in range(len(gradient)):
            gradient[i] += 2.0 * _EXCESS * excess * rises[c, i] / reference
            rises[c, i] *= sqrt(2.0 * _EXCESS) / reference if excess > 0.0 else 0.0
    return cost, reference, _step(gradient, np.concatenate((joint_values(bends, columns, none), rises)))


@compiled
def _step(gradient: FloatArray, bends: FloatArray) -> FloatArray:
    """Return the step s (n,), no longer than `RETREAT_STEP`, that minimises g·s + ½ sᵀHs, H = Σ vvᵀ of vectors (C, n).

    It is −(H + λ1)⁻¹g with the least λ ≥ 0 that makes it short enough, which Newton's method on 1/‖s(λ)‖ finds from
    below in a few steps (Moré & Sorensen 1983).
    """
    n, curvature, slope = len(gradient), 0.0, 0.0
    H, L, step, across = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.empty(n)
    for i in range(n):
        for j in range(n):
            for c in range(len(bends)):
                H[i, j] += bends[c, i] * bends[c, j]
        curvature, slope = curvature + H[i, i], slope + gradient[i] ** 2
    shift = _FLAT * max(curvature, sqrt(slope))
    for _ in range(_NEWTON_STEPS if slope > 0.0 else 0):
        for i in range(n):
            for j in range(i + 1):
                rest = H[i, j] + (shift if i == j else 0.0)
                for k in range(j):
                    rest -= L[i, k] * L[j, k]
                L[i, j] = sqrt(rest) if i == j else rest / L[j, j]
            step[i] = -gradient[i]
            for k in range(i):
                step[i] -= L[i, k] * step[k]
            step[i] /= L[i, i]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                step[i] -= L[k, i] * step[k]
            step[i] /= L[i, i]
        length, square = 0.0, 0.0
        for i in range(n):
            length += step[i] * step[i]
        length = sqrt(length)
        if length <= (1.0 + _PRECISION) * RETREAT_STEP:
            break
        for i in range(n):
            across[i] = step[i]
            for k in range(i):
                across[i] -= L[i, k] * across[k]
            across[i] /= L[i, i]
            square += across[i] ** 2
        shift += (length / RETREAT_STEP - 1.0) * length**2 / square
    return step


def ask_for_retreats() -> None:
    """Call what retreats need."""
    terms, carriers = DangerTerms(PointDanger.of_nothing(), 0.0, np.zeros((0, 1)), np.zeros(0)), np.zeros(0, np.intp)
    _retreated(Densities(terms, carriers, np.zeros((0, 10)), np.zeros((0, 2))), np.zeros((1, 1)), 0.0)


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
    return _cheapest_proven_chain(path, wanted, cost, proofs, stop, worth)


def joined(path: FloatArray, cost: ActiveSetCost, proofs: EdgeProofs, stop: Callable[[], bool]) -> FloatArray | None:
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
    path: FloatArray,
    wanted: BoolArray,
    cost: ActiveSetCost,
    proofs: EdgeProofs,
    stop: Callable[[], bool],
    worth: float = np.inf,
) -> FloatArray | None:
    if stop():
        return None
    costs, samples = edge_costs(cost.terms, plain(path), wanted, cost.robot.continuous)
    cost.count(samples)
    most = worth * float(np.diagonal(costs, 1).sum()) if worth < np.inf else np.inf
    known = np.eye(len(path), k=1, dtype=np.intp)  # the path's own edges may be accepted without the margin
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


_LOOKED_AT, _PROVEN = 1, 2


@caller
def _proven(starts: FloatArray, ends: FloatArray, tables: EdgeTables) -> tuple[BoolArray, int]:
    """Return which edges (E, n) bounds prove to be free, and at how many places they were looked at."""
    free, places = np.zeros(len(starts), np.bool_), 0
    for k in range(len(starts)):
        number, looked = prove_edge(starts[k], ends[k], tables)
        free[k], places = number == 0, places + looked
    return free, places


@caller
def _weeded(
    costs: FloatArray, known: IntArray, most: float, path: FloatArray, tables: EdgeTables
) -> tuple[IntArray, int]:
    """Return what `EdgeProofs.chained` does, and at how many places of edges bounds were looked at.

    Edges that are looked at become `known`, as proven ones, if they are.
    """
    places = 0
    while True:
        before, total, refused, j = chained(costs), 0.0, False, len(path) - 1
        while j > 0:
            total += costs[before[j], j]
            j = before[j]
        j = len(path) - 1 if total <= most and total < inf else 0
        while j > 0:
            i = before[j]
            if known[i, j] == 0:
                known[i, j] = _LOOKED_AT
                number, looked = prove_edge(path[i], path[j], tables)
                places += looked
                if number == 0:
                    known[i, j] = _PROVEN
                elif number < 0:
                    costs[i, j], refused = inf, True
            j = i
        if not refused:
            return before, places
