"""Edges of paths: proofs, where paths may be, shortcuts between way points, and retreats from obstacles."""

from cpython.bytes cimport PyBytes_FromStringAndSize
from libc.math cimport INFINITY

from safe_ompl.collision.proofs cimport DistanceBounds, Outcome, Required, Workspace, prove_edge
from safe_ompl.planning.simplification.costs cimport DangerTerms, Densities, distance
from safe_ompl.robot.kinematics cimport EdgeTable

from dataclasses import replace

import numpy as np

from safe_ompl.common import InputError
from safe_ompl.planning.simplification.cost import DangerDensity
from safe_ompl.planning.simplification.costs import arc_lengths

# Parts of a path so long [rad] on each side of a refused edge are held back at first, then twice as long, and so on.
cdef double FIRST_HELD_BACK = 0.5
cdef enum:
    WIDENINGS = 6
    _LOOKED_AT = 1

# Of edges between way points: whether bounds were looked at.
UNKNOWN, LOOKED_AT = 0, _LOOKED_AT


def _never():
    return False


cdef class EdgeProofs:
    """Proves that every edge of a path is free, and keeps more than a margin from obstacles, until `stop` says so."""

    def __init__(self, motion, stop=_never):
        self._free = self._clear = replace(motion, stop=stop)
        self._stop = stop
        self._proven, self._inherited = set(), set()

    def check(self, path):
        """Accept the edges of a path (N, n) without a margin; raise InputError if one is not proven free."""
        for k in range(len(path) - 1):
            if not self._free.is_free(path[k], path[k + 1]):
                raise InputError(f"path: the edge from way point {k} on is not proven free")
        self.accept(path)

    def accept(self, const double[:, ::1] path not None):
        """Accept the edges of a path (N, n), which are known to be free."""
        self._proven.update(_keys(path))

    def inherit(self, const double[:, ::1] path not None):
        """Accept the edges of a path (N, n), parts of accepted ones, as soon as they are proven without the margin."""
        self._inherited.update(_keys(path))

    def keep(self, double margin):
        """From here on ask for a clearance [m] of all edges that are not accepted yet."""
        separation = self._free.separation
        self._clear = replace(self._free, separation=replace(separation, margin=max(margin, separation.margin)))

    def refused(self, const double[:, ::1] path not None):
        """Return the edges of a path (N, n) that are not proven."""
        cdef list keys = _keys(path)
        cdef list unknown = [k for k, key in enumerate(keys) if key not in self._proven]
        if not unknown or self._stop():
            return unknown
        self._prove(self._clear, False, path, keys, [k for k in unknown if keys[k] not in self._inherited])
        self._prove(self._free, True, path, keys, [k for k in unknown if keys[k] in self._inherited])
        return [k for k in unknown if keys[k] not in self._proven]

    cdef int _prove(self, motion, bint surely, const double[:, ::1] path, list keys, list edges) except -1:
        """Try to prove some edges of a path, and accept them.

        What bounds do not prove is asked of coal if that must `surely` be known, or not all bodies are exact: it would
        ask for as long as a descent takes.
        """
        cdef list left = edges if motion.limits or not edges else self._left_by_bounds(motion, path, keys, edges)
        if left and (surely or motion.limits or not motion.required.pairs.bounds.exact.all()):
            Q, rows = np.asarray(path), np.array(left)
            for k, free in zip(left, motion.are_free(Q[rows], Q[rows + 1]).tolist()):
                if free:
                    self._proven.add(keys[k])
        return 0

    cdef list _left_by_bounds(self, motion, const double[:, ::1] path, list keys, list edges):
        """Accept those edges of a path that bounds prove; return the others."""
        cdef _Tables tables = _Tables(motion, path.shape[1])
        cdef Py_ssize_t k
        cdef Outcome outcome
        cdef list left = []
        if not tables.bounds.bounded:
            return edges
        with motion.checker.changes.read_lock():
            tables.open()
            for k in edges:
                if keys[k] in self._proven:
                    continue
                with nogil:
                    outcome = tables.prove(&path[k, 0], &path[k + 1, 0])
                if outcome.number == 0:
                    self._proven.add(keys[k])
                else:
                    left.append(k)
            tables.close()
        return left

    def chained(
        self, const double[:, ::1] path not None, double[:, ::1] costs not None, double most,
        Py_ssize_t[:, ::1] known not None,
    ):
        """Return the cheapest way from the first to the last way point of `path: (N, n)`, by the costs (N, N) of edges.

        Edges on the way that are certainly blocked get infinite costs first, but for those that are `known: (N, N)`,
        and unless the way costs more than `most`. Edges that are looked at become known.
        """
        cdef Py_ssize_t N = path.shape[0], i, j
        cdef Outcome outcome
        cdef double total
        cdef bint refused = True
        motion = self._clear
        cdef bint accepted = not motion.limits
        if costs.shape[0] != N or costs.shape[1] != N or known.shape[0] != N or known.shape[1] != N or not N:
            raise InputError(f"there must be a cost for each two of {N} way points")
        cdef _Tables tables = _Tables(motion, path.shape[1])
        cdef double[::1] best = np.zeros(N)
        cdef Py_ssize_t[::1] before = np.zeros(N, np.intp)
        with motion.checker.changes.read_lock():
            tables.open()
            while refused:
                with nogil:
                    total, refused = _write_chain(costs, &best[0], &before[0]), False
                j = N - 1 if tables.bounds.bounded and total <= most and total < INFINITY else 0
                while j > 0:
                    i = before[j]
                    if known[i, j] != _LOOKED_AT:
                        known[i, j] = _LOOKED_AT
                        with nogil:
                            outcome = tables.prove(&path[i, 0], &path[j, 0])
                        if outcome.number == 0 and accepted:
                            self._proven.add(_key(path, i, j))
                        elif outcome.number < 0:
                            costs[i, j], refused = INFINITY, True
                    j = i
            tables.close()
        chain, j = [N - 1], N - 1
        while j > 0:
            j = before[j]
            chain.append(j)
        return chain[::-1]

    def held_back(self, path, known):
        """Return `path: (N, n)`, held back to an accepted one where edges are refused, and which way points are there.

        Those beside a refused edge go back, those around them in part; if that does not help, more, and in the end all.
        None stands for no way point.
        """
        cdef list refused = self.refused(path)
        if not refused:
            return path, None
        cdef const double[:, ::1] wanted = path
        cdef const double[:, ::1] accepted = known
        cdef double[::1] arc = arc_lengths(known)
        cdef Py_ssize_t N = wanted.shape[0], n = wanted.shape[1], j, k, i
        cdef double reach = FIRST_HELD_BACK, beyond
        found, shares = np.empty((N, n)), np.ones(N)
        cdef double[:, ::1] held = found
        cdef double[::1] share = shares
        if accepted.shape[0] != N or accepted.shape[1] != n:
            raise InputError(f"paths must have as many way points and joints, got {known.shape} and {path.shape}")
        for _ in range(WIDENINGS):
            for k in refused:
                for j in range(N):
                    beyond = max(arc[k] - arc[j], arc[j] - arc[k + 1])
                    share[j] = min(share[j], max(0.0, beyond) / reach)
                share[k] = share[k + 1] = 0.0
            for j in range(N):
                for i in range(n):
                    held[j, i] = wanted[j, i]
                    if share[j] < 1.0:
                        held[j, i] = accepted[j, i]
                        if share[j] > 0.0:
                            held[j, i] = accepted[j, i] + share[j] * (wanted[j, i] - accepted[j, i])
            refused = self.refused(found)
            if not refused:
                return found, shares == 0
            reach *= 2.0
        return known.copy(), np.ones(N, dtype=bool)


cdef class _Tables:
    """What compiled code needs to prove edges of n joints in the scene as it is; memory between `open` and `close`."""

    cdef DistanceBounds bounds
    cdef EdgeTable limits
    cdef Required required
    cdef Workspace work
    cdef double floor
    cdef Py_ssize_t places
    cdef object _counts

    def __init__(self, motion, Py_ssize_t n):
        required = motion.required
        self.bounds, self.required = required.pairs.bounds, required.allowed_for
        self.limits, self.floor = motion.checker.robot.joint_limits.table, motion.floor
        self._counts, self.places = motion.checker.counts, 0
        self.bounds._check(self.required, self.limits.m)
        if n != self.limits.n:
            raise InputError(f"way points must have {self.limits.n} joints, got {n}")

    cdef int open(self) except -1:
        """Take memory; there is none, and nothing can be proven, where not all bodies are finite."""
        self.work = self.bounds.workspace() if self.bounds.bounded else None
        return 0

    cdef Outcome prove(self, const double *start, const double *end) noexcept nogil:
        """Try to prove the motion between two configurations (n,)."""
        cdef Outcome outcome = prove_edge(
            &self.bounds.pairs, self.work, start, end, self.limits,
            &self.required.distances[0] if self.bounds.pairs.count else NULL, self.required.most, self.floor,
        )
        self.places += outcome.places
        return outcome

    cdef int close(self) except -1:
        """Give the memory back, and count the places at which bounds were computed."""
        if self.work is not None:
            self.bounds._free.append(self.work)
        self._counts.bound_queries += self.places
        return 0


cdef double _write_chain(const double[:, ::1] costs, double *best, Py_ssize_t *before) noexcept nogil:
    """Write what comes before each node (N,) on the cheapest way to it, and what that costs; return what all costs.

    The costs (N, N) are those of edges to later nodes.
    """
    cdef Py_ssize_t N = costs.shape[0], i, j
    cdef double total = 0.0
    best[0], before[0] = 0.0, 0
    for j in range(1, N):
        best[j], before[j] = best[0] + costs[0, j], 0
        for i in range(1, j):
            if best[i] + costs[i, j] < best[j]:
                best[j], before[j] = best[i] + costs[i, j], i
    j = N - 1
    while j > 0:
        total, j = total + costs[before[j], j], before[j]
    return total


cdef bytes _key(const double[:, ::1] path, Py_ssize_t i, Py_ssize_t j):
    cdef Py_ssize_t row = path.shape[1] * sizeof(double)
    if j == i + 1:
        return PyBytes_FromStringAndSize(<const char *> &path[i, 0], 2 * row)
    start = PyBytes_FromStringAndSize(<const char *> &path[i, 0], row)
    return start + PyBytes_FromStringAndSize(<const char *> &path[j, 0], row)


cdef list _keys(const double[:, ::1] path):
    """Return what tells the edges of a path (N, n) from others: their ends, bit by bit."""
    return [_key(path, k, k + 1) for k in range(path.shape[0] - 1)]


RETREAT_STEP = 0.04  # [rad]
# A retreat is no longer than this [rad], and over when this share of the cost of its end is left.
cdef double LONGEST_RETREAT = 1.0
cdef double ENOUGH = 0.3
# Weight of danger: at 1.4 times that of the end it costs what a contact costs. A point counts from this share on.
cdef double EXCESS_WEIGHT = 600.0
cdef double ONSET = 0.8
# Where the best step is shorter than this share of a step, nothing leads on.
cdef double STUCK = 0.1


def retreat(end, obstacles, field, limits, stop):
    """Return a way (K, n) from an end (n,) of a path to where obstacles and danger are less; K = 1: there is none.

    The steepest descent of what is near, and of what is dangerous, w Σ_m (CDF(p_m)/CDF(end) − 0.8)₊²: sums of hinges
    have no kinks, unlike the danger, which is a maximum. Each step of 0.04 rad is the best of its length for their
    Gauss-Newton model (Nocedal & Wright, ch. 4), along the floor of a valley, where gradient steps would go from wall
    to wall. It is not proven free.
    """
    cdef DangerTerms terms = DangerDensity(field, 1.0).terms()
    cdef double cost, reference = 0.0, enough = -1.0, squared
    hinges, points = obstacles.hinges, len(field.points)
    lower, upper = limits
    Q, way = np.array(end[None]), [end]
    while len(way) * RETREAT_STEP <= LONGEST_RETREAT and not stop():
        near = obstacles.near(Q)
        densities = Densities(terms, near.carriers, near.table, hinges)
        cost, reference, step = densities.retreat_step(Q, reference, EXCESS_WEIGHT, ONSET, RETREAT_STEP)
        field.count(1, points)
        enough = ENOUGH * cost if enough < 0.0 else enough
        if cost <= enough:
            return np.array(way)
        before, Q = Q, np.minimum(np.maximum(Q + step, lower), upper)
        moved = (Q - before)[0]
        squared = moved @ moved
        if squared < (STUCK * RETREAT_STEP) ** 2:
            break
        way.append(Q[0])
    return end[None]


# An edge may skip to at most this many way points.
MOST = 40
# Way points nearer to an end than this [rad] are tried first.
cdef double JOINT = 1.2


def shortcut(const double[:, ::1] path not None, cost, proofs, stop, Py_ssize_t most=MOST, double worth=1.0):
    """Return the cheapest chain of proven edges between way points of `path: (N, n)`, in their order, if there is one.

    Of the edges between up to `most` way points only those of the chain that is cheapest so far are proven (as in lazy
    roadmaps: Bohlin & Kavraki, ICRA 2000), unless it is estimated to cost more than the share `worth` of the path.
    """
    cdef Py_ssize_t N = path.shape[0], a, b
    own = np.eye(N, k=1, dtype=np.uint8)
    cdef unsigned char[:, ::1] wanted = own
    cdef const Py_ssize_t[::1] candidates = np.rint(np.linspace(0, N - 1, min(N, most))).astype(np.intp)
    for a in range(candidates.shape[0]):
        for b in range(a + 1, candidates.shape[0]):
            wanted[candidates[a], candidates[b]] = 1
    return cheapest_proven_chain(path, own, cost, proofs, stop, worth)


def joined(const double[:, ::1] path not None, cost, proofs, stop):
    """Return the same where only the ends are new: besides the path's own edges those from there, short ones first."""
    cdef Py_ssize_t N = path.shape[0], k
    cdef double reach
    cdef unsigned char[:, ::1] wanted
    for reach in (JOINT, INFINITY):
        own = np.eye(N, k=1, dtype=np.uint8)
        wanted = own
        for k in range(N):
            if distance(path, 0, k) < reach:
                wanted[0, k] = 1
            if distance(path, k, N - 1) < reach:
                wanted[k, N - 1] = 1
        found = cheapest_proven_chain(path, own, cost, proofs, stop)
        if found is not None:
            return found
    return None


def cheapest_proven_chain(
    const double[:, ::1] path not None, wanted, cost, EdgeProofs proofs not None, stop, double worth=INFINITY,
    known=None,
):
    """Return the cheapest chain of proven edges from the first to the last of `path: (N, n)`, or None.

    Edges lead to later way points, those that are `wanted: (N, N)`. An estimate above the share `worth` of the path's
    cost ends it. Edges that are `known: (N, N)` may be accepted without the margin, by default the path's own.
    """
    cdef Py_ssize_t k
    cdef double most, expected
    cdef list chain, refused
    if stop():
        return None
    points = np.asarray(path)
    found, samples = cost.terms.edge_costs(path, wanted, cost.robot.continuous)
    cdef double[:, ::1] costs = found
    cost.count(samples)
    most = worth * float(np.diagonal(found, 1).sum()) if worth < INFINITY else INFINITY
    known = np.eye(path.shape[0], k=1, dtype=np.intp) if known is None else known
    while not stop():
        chain = proofs.chained(path, costs, most, known)
        expected = 0.0
        for k in range(len(chain) - 1):
            expected += costs[<Py_ssize_t> chain[k], <Py_ssize_t> chain[k + 1]]
        if not expected <= most or expected == INFINITY:
            return None
        shorter = points[chain]
        refused = proofs.refused(shorter)
        if not refused:
            return shorter
        for k in refused:
            costs[<Py_ssize_t> chain[k], <Py_ssize_t> chain[k + 1]] = INFINITY
    return None
