"""Continuous collision checking: lower bounds of distances of pairs of bodies, and motion bounds.

On the edge q(t) = q₁ + tΔ all points of body g are at most as fast as W_g = Σ_i R_gi·|Δ_i|. At t they are at most as
fast as V_g = |v| + |ω| r, with the velocity v of the centre of the bounding ball and its radius r. Their accelerations
are at most K_g = Σ_i R_gi w_i (w_i + 2 Σ_j<i w_j), w = |q′|, summed over the joints that move the body. While |x| ≤ h a
point moves by at most D = min(h W_g, h V_g + h² K_g/2) between t and t + x (Taylor). Two bodies of the robot, pair p,
approach each other by at most D = h W_p, with R_pi instead of R_gi. Let c_p be the distance that a pair must keep. The
pair is proven for the whole interval if its distance d_p at t is at least c_p + D.

A curve q(t) = Σ_k c_k t^k is Σ_k a_k x^k at t + x. While |x| ≤ h, joint i differs from q_i(t) by at most |x| v_i with
v_i = Σ_k≥1 |a_k,i| h^(k−1). So v is used instead of |Δ| for intervals of half-length up to h, w is a bound of |q′|
there, and R_gi |q″_i| is added to K_g. An edge is a curve of degree 1.

At the middle of an interval three bounds of d_p are tried, each only for the pairs that the bounds before do not prove:
that of the bounding balls; that of the ball of one body and the box of the other; and that of the supports of the
bodies along an axis n (`geometry.convex`), beginning with the pairs that are proven for the shortest time. The axis is
the vector from the box to the ball until a better axis is found. If a bound along n exceeds c_p by e > 0, a longer
interval is proven: bodies that move along the slab across n, or apart, approach each other only by accelerations, and
they keep c_p while e + x r − x²K/2 ≥ 0. In the frame of the joint that carries both bodies, r is a lower bound of the
rate at which the slab widens at t: n·v of the centres, minus the motion of the boxes' corners along n by rotation,
without balls. K is the sum of both bodies' bounds. So [t − s⁻, t + s⁺] is proven, with the least s⁻ and s⁺ of all
pairs. The parts before and after are handled in the same way, with only the pairs that are not proven for the whole
interval. The rounding errors of e, r, D and d_p, 1e-14 m, are below the margins in c_p. s is reduced, and D increased,
by a relative 1e-12.

Two points of the bodies give an upper bound of d_p. If this bound is at most the distance that the pair must keep,
without the margins in c_p, and the bodies are convex, then no proof is possible. The motion is refused at once, without
a query of coal.
"""

from libc.math cimport INFINITY, ceil, fabs, nextafter, sqrt
from libc.stdlib cimport free, malloc, realloc
from libc.string cimport memset

from safe_ompl.geometry.convex cimport (
    Body, Bodies, Bounds, Pose, Search, ShapeTable, Vector, begin_axis, beyond_box, distance_bounds, from_box,
    nearest_in_simplex, outer_bound, place_moving,
)
from safe_ompl.robot.kinematics cimport EdgeTable, Joint, JointTable, edge_between, move_joints, place_joints

from typing import NamedTuple

import numpy as np

from safe_ompl.collision.queries import DISTANCE_ERROR
from safe_ompl.common import InputError

# [m] Proofs require this much more than pairs must keep. coal errs by at most DISTANCE_ERROR, so it never calls a
# configuration of a proven motion too near, and a certificate of the motion can be issued. Rounding is far below.
ALLOWANCE = 2 * DISTANCE_ERROR

# Number of pairs per block of near obstacles.
BLOCK = 64

# A group has at most MOST_PAIRS pairs. The box about a group of at most FEW_PAIRS pairs is not compared, because the
# balls of its pairs take no longer. RUN groups have one ball about all of them, by which they are left out together.
# At most INTERVALS intervals of a motion wait to be proven. The SUSPECTS pairs that blocked motions last are compared
# first. A thread proves TOGETHER motions before it checks for Ctrl-C again.
cdef enum:
    MOST_PAIRS = 64
    FEW_PAIRS = 2 * LANES
    RUN = 8
    INTERVALS = 64
    SUSPECTS = 8
    TOGETHER = 256

# The first intervals are such that bodies move at most this far [m] in half of one. Shorter intervals need more bounds,
# longer ones make more pairs near; there are at most MOST_FIRST of them. Where there are more than CROWD pairs, too
# many would be near, so first intervals are shorter.
cdef double FIRST_MOTION = 0.45
cdef double MOST_FIRST = 8.0
cdef double CROWD = 25_000.0
# `ALLOWANCE` as a number of C.
cdef double _ALLOWANCE = ALLOWANCE
# Relative rounding of the length of an interval, and of how far bodies move.
cdef double ROUNDING = 1e-12
# Rounding of distances between balls about groups [m].
cdef double GROUP_ROUNDING = 1e-9
# Where joints would be beyond this, or faster, numbers could overflow, so nothing is proven.
cdef double LARGEST = 1e100

# Rows of how joints move at a place of a motion: q, v, q′, bounds of |q′| and |q″|, and Taylor's coefficients.
cdef enum:
    PLACE, SPEED, VELOCITY, FASTEST, ACCELERATION, TAYLOR
# Rows of what is known of pairs: kept from where, until where, along which axis (3 rows).
cdef enum:
    FROM, UNTIL, AXIS

GROUP = np.dtype(
    [
        # The pairs of one of the robot's bodies.
        ("begin", np.intp),
        ("end", np.intp),
        ("body", np.intp),
        # In the world, a ball that holds their obstacles. An infinite radius: none does, or these are no obstacles.
        ("centre", np.float64, (3,)),
        ("radius", np.float64),
        # Where the balls about these obstacles begin.
        ("lane", np.intp),
        # Consecutive groups of one body are a run, which is left out as a whole if the ball about it is far away. Its
        # first group has the length of the run in `run_from_here`, its last group in `run_to_here`; elsewhere both are
        # 1. Centre and radius are those of the ball about the run.
        ("run_from_here", np.intp),
        ("run_to_here", np.intp),
        ("run_centre", np.float64, (3,)),
        ("run_radius", np.float64),
    ],
    align=True,
)


class BoundsProof(NamedTuple):
    """The result of a proof by lower bounds of distances.

    If it is not all proven, `left` are the parts that are not, each from one fraction of the motion to another. `at` is
    a fraction at which a bound shows that some pair may be nearer than required; −1 if there is none. If the motion is
    `blocked`, some pair certainly is, and what is proven of the rest is not said.
    """

    proven: bool
    at: float
    left: list
    blocked: bool = False

    def covers(self, low, high):
        """Return whether the motion is proven between two fractions of it."""
        return not any(first < high and last > low for first, last in self.left)


class SomePairs(NamedTuple):
    """The bodies (K, 2) of pairs, and whether the shapes of both are exact (K,)."""

    bodies: object
    exact: object


_UNKNOWN = BoundsProof(False, -1.0, [[0.0, 1.0]])
_FREE = BoundsProof(True, -1.0, [])


cdef class Required:
    """Distances (P,) [m] that pairs must keep, including all margins."""

    def __init__(self, distances):
        self.distances = np.ascontiguousarray(distances, dtype=np.float64).copy()
        self.most = np.max(self.distances, initial=-np.inf)


cdef class Workspace:
    """Working memory of proofs; one proof at a time may use it."""

    def __dealloc__(self):
        free(self.bodies.pose)
        free(self.memory.rotations)
        free(self.memory.moves)
        free(self.memory.listed)

    cdef int make_room(self, Py_ssize_t m, Py_ssize_t degree) except -1:
        """Allocate memory for curves of a degree."""
        if degree > self.memory.degree:
            moves = <double *> realloc(self.memory.moves, max((TAYLOR + degree + 1) * m, 1) * sizeof(double))
            if not moves:
                raise MemoryError
            self.memory.moves, self.memory.degree = moves, degree
        return 0


cdef class DistanceBounds:
    """Lower bounds of the distances of pairs of bodies, by the convex bodies that hold them.

    Every bound holds, whatever the configuration. Nothing is kept from one question to the next but which pairs blocked
    motions, and are looked at first: whether an edge is free is always decided alike. Threads may share it.

    Parameters
    ----------
    robot : Robot
        The robot, whose bodies are the first of the `bodies`.
    bodies : ConvexBodies
        The robot's bodies and, after them, the parts of obstacles where they are.
    pairs : ndarray of int, shape (P, 2)
        The pairs.
    radii : ndarray, shape (P, m)
        Displacement radii of the pairs by the joints of Pinocchio's model.
    counts : Counts
        What counts the places at which bounds are computed.
    """

    def __init__(self, robot, bodies, pairs, radii, counts):
        cdef Py_ssize_t P = len(pairs), m = robot.kinematics.table.m, own = len(robot.bounds.joint_radii)
        self.joints, self.shapes = robot.kinematics.table, bodies.table
        if np.shape(pairs) != (P, 2) or np.shape(radii) != (P, m):
            raise InputError(f"pairs and radii must have shape (P, 2) and (P, {m})")
        if P and not 0 <= pairs.min() <= pairs.max() < self.shapes.count:
            raise InputError(f"pairs must be of {self.shapes.count} bodies")
        if P and pairs[:, 0].max() >= own:
            raise InputError("the first body of each pair must be the robot's")
        exact = bodies.exact if bodies.bounded else np.zeros_like(bodies.exact)
        reaches = np.zeros((m, len(bodies.bodies)))
        reaches[:, :own] = robot.bounds.joint_radii.T
        self.exact = exact[pairs[:, 0]] & exact[pairs[:, 1]]
        self._counts, self._coupling, self._free = counts, robot.coupling, []
        numbers, certain = pairs.astype(np.uintp), np.where(self.exact, ALLOWANCE, np.inf)
        by_joint = np.array(radii.T, dtype=np.float64, order="C")
        self.pairs.count, self.pairs.m, self.pairs.own, self.pairs.joints = P, m, own, self.joints.data
        self.pairs.shape_count = self.shapes.count
        groups, balls = self._grouped(numbers)
        self.groups, self._kept = groups, (numbers, by_joint, reaches, certain, balls)
        self.pairs.bodies = <const size_t (*)[2]> _address(numbers)
        self.pairs.radii, self.pairs.reaches = <const double *> _address(by_joint), <const double *> _address(reaches)
        self.pairs.certain, self.pairs.balls = <const double *> _address(certain), <const double *> _address(balls)
        self.pairs.groups, self.pairs.group_count = <const Group *> _address(groups), len(groups)
        self.pairs.lanes = balls.shape[1]

    def _grouped(self, const size_t[:, ::1] pairs):
        """Return consecutive groups of pairs, and the balls about their obstacles.

        Of many obstacles few are near. Groups are of one body of the robot's each, and groups that are far away are
        left out at once. Of the balls about the obstacles of groups there are centres and radii, (4, ·), each group's
        rounded up to whole `LANES`.
        """
        cdef Py_ssize_t P = pairs.shape[0], own = self.pairs.own, begin, end = 0, lanes = 0, count = 0, g, k
        cdef Pose *poses = self.shapes.new_poses()
        centres, radii = np.zeros((P, 3)), np.zeros(P)
        cdef double[:, ::1] centre = centres
        cdef double[::1] radius = radii
        for k in range(P):
            centre[k, 0], centre[k, 1], centre[k, 2] = _centre(poses, pairs[k, 1])
            radius[k] = self.shapes.data.body[pairs[k, 1]].reach
        free(poses)
        found = np.zeros(P, GROUP)
        cdef Group[::1] group = found
        cdef bint meets
        while end < P:
            begin, meets = end, <Py_ssize_t> pairs[end, 1] >= own
            while end < min(P, begin + MOST_PAIRS) and (<Py_ssize_t> pairs[end, 1] >= own) == meets:
                if meets and pairs[end, 0] != pairs[begin, 0]:
                    break
                end += 1
            group[count].begin, group[count].end = begin, end
            group[count].body, group[count].lane, group[count].radius = pairs[begin, 0], lanes, INFINITY
            group[count].run_from_here = group[count].run_to_here = 1
            if meets:
                group[count].radius = _write_ball(
                    &centre[begin, 0], &radius[begin], end - begin, 3, 1, &group[count].centre[0]
                )
            count += 1
            lanes += (end - begin + LANES - 1) // LANES * LANES
        table = np.zeros((4, lanes))
        for g in range(count):
            begin, end, k = group[g].begin, group[g].end, group[g].lane
            table[:3, k : k + end - begin], table[3, k : k + end - begin] = centres[begin:end].T, radii[begin:end]
        end = 0
        while end < count:
            begin = end
            while end < min(count, begin + RUN) and group[end].body == group[begin].body:
                if (group[end].radius < INFINITY) != (group[begin].radius < INFINITY):
                    break
                end += 1
            self._run(group, begin, end)
        return found[:count].copy(), table

    cdef int _run(self, Group[::1] group, Py_ssize_t begin, Py_ssize_t end) except -1:
        """Compute the ball about the balls of the groups from `begin` to `end`."""
        cdef double middle[3]
        cdef Py_ssize_t g, x
        # From one group to the next all numbers are as far as the size of a group.
        cdef Py_ssize_t stride = sizeof(Group) // sizeof(double)
        cdef double wide = _write_ball(
            &group[begin].centre[0], &group[begin].radius, end - begin, stride, stride, middle
        )
        for g in range(begin, end):
            group[g].run_radius = wide
            for x in range(3):
                group[g].run_centre[x] = middle[x]
        group[begin].run_from_here = group[end - 1].run_to_here = end - begin
        return 0

    cdef Workspace workspace(self):
        """Return unused working memory."""
        cdef Workspace work
        cdef Py_ssize_t P = self.pairs.count, m = self.pairs.m, own = self.pairs.own, k
        try:
            return self._free.pop()
        except IndexError:
            pass
        work = Workspace()
        work.bodies = self.shapes.data
        work.bodies.pose = self.shapes.new_poses()
        cdef double *row = <double *> malloc((17 * m + 6 * (m + 1) + 3 * own + 6 * P + 2 * INTERVALS) * sizeof(double))
        cdef Py_ssize_t *numbers = <Py_ssize_t *> malloc((P + LANES + SUSPECTS + INTERVALS) * sizeof(Py_ssize_t))
        work.memory.rotations, work.memory.listed, work.memory.degree = row, numbers, -1
        if not row or not numbers:
            raise MemoryError
        work.memory.origins, work.memory.axes, work.memory.twists = row + 9 * m, row + 12 * m, row + 15 * m
        row += 15 * m + 6 * (m + 1)
        work.memory.W, work.memory.V, work.memory.K = row, row + own, row + 2 * own
        row += 3 * own
        work.memory.rates, work.memory.known, work.memory.left = row, row + P, row + 6 * P
        work.memory.edge = row + 6 * P + 2 * INTERVALS
        work.memory.suspects, work.memory.counts = numbers + P + LANES, numbers + P + LANES + SUSPECTS
        work.memory.suspect_count = min(SUSPECTS, P)
        for k in range(work.memory.suspect_count):
            work.memory.suspects[k] = k
        memset(work.memory.twists, 0, 6 * sizeof(double))
        work.make_room(m, 1)
        return work

    @property
    def bounded(self):
        """Whether all bodies are bounded; otherwise there are no lower bounds."""
        return self.shapes.bounded

    def of(self, Q, pairs, double enough):
        """Return lower bounds (B, K) [m] of the distances of the pairs with indices (K,), at `Q: (B, n)`.

        A bound is not improved any more once it is at least `enough` [m], or once it is clear that it cannot be.
        """
        bounds = np.full((len(Q), len(pairs)), -np.inf)
        if self.bounded and bounds.size:
            self._write_bounds(self._values(Q), self._kept[0][pairs], enough, bounds)
            self._counts.bound_queries += len(Q)
        return bounds

    def _write_bounds(
        self, const double[:, ::1] values, const size_t[:, ::1] pairs, double enough, double[:, ::1] bounds
    ):
        """Compute lower bounds (B, K) [m] of the distances of pairs (K, 2) of bodies at `values: (B, m)`."""
        self._check_places(values, pairs, pairs.shape[0])
        cdef Workspace work = self.workspace()
        cdef Py_ssize_t row, p
        with nogil:
            for row in range(values.shape[0]):
                _place(&self.pairs, work, &values[row, 0] if values.shape[1] else NULL)
                for p in range(pairs.shape[0]):
                    bounds[row, p] = _lower_bound(&work.bodies, &work.memory.search, pairs[p, 0], pairs[p, 1], enough)
        self._free.append(work)

    def clearances(self, Q, double enough):
        """Return lower bounds (B,) [m] of the least distance from obstacles at `Q: (B, n)`, at most `enough` [m].

        Where bodies are apart they are tight to a few percent; −∞ where nothing is known.
        """
        found = np.full(len(Q), -np.inf)
        cdef double[::1] out = found
        cdef const double[:, ::1] values
        cdef Workspace work
        cdef Py_ssize_t row
        if self.bounded:
            values, work = self._values(Q), self.workspace()
            with nogil:
                for row in range(values.shape[0]):
                    _place(&self.pairs, work, &values[row, 0] if values.shape[1] else NULL)
                    out[row] = _clearance(&self.pairs, work, enough)
            self._free.append(work)
            self._counts.bound_queries += len(Q)
        return found

    def nearer(self, q, const double[::1] margins, double largest):
        """Return the pairs that may be nearer than their margins (P,) [m] at `q: (n,)`. If True, the last surely is.

        No margin is above the largest. Then no others were looked at. What bounds decide coal would decide alike.
        """
        cdef const double[::1] values = self._values(q)
        cdef Py_ssize_t number
        cdef bint surely = False
        if margins.shape[0] != self.pairs.count or values.shape[0] != self.pairs.m:
            raise InputError(f"there must be a margin for each of {self.pairs.count} pairs")
        found = np.empty(self.pairs.count, dtype=np.intp)
        cdef Py_ssize_t[::1] near = found
        if self.pairs.count == 0:
            return found, False
        cdef Workspace work = self.workspace()
        with nogil:
            number = _near_pairs(
                &self.pairs, work, &values[0] if values.shape[0] else NULL, &margins[0], largest, &near[0], &surely
            )
        self._free.append(work)
        return found[:number], surely

    def near(self, Q, some, double within, *, bint least=False):
        """Return which of `some` pairs are nearer than a distance [m] at `Q: (B, n)`, (C, 10), row by row.

        Of each there are row, pair, distance, nearest point of the first body in the frame of the joint that carries it
        [m], unit normal from the second body to the first one in the world, and offset, the abscissa of the second
        one's nearest point along it [m]. The distance of bodies that overlap is −∞, and nothing else is known then. Of
        pairs that are not exact there is only a lower bound of the distance, less the error of coal's distances. If
        only the `least` distance is wanted, pairs are left out that are farther apart than an exact one before them.
        """
        if not self.bounded:
            found = np.full((len(Q) * len(some.exact), 10), -np.inf)
            found[:, :2] = np.indices((len(Q), len(some.exact))).reshape(2, -1).T
            return found
        # A search without a limit is for distances; the caller counts these as distance queries.
        self._counts.bound_queries += len(Q) if within < np.inf else 0
        return self._nearest(self._values(Q), some.bodies, some.exact, within, DISTANCE_ERROR, least)

    def _nearest(
        self, const double[:, ::1] values, const size_t[:, ::1] pairs, exact, double within, double error, bint least
    ):
        cdef const unsigned char[::1] known = np.ascontiguousarray(exact, dtype=np.bool_).view(np.uint8)
        cdef Py_ssize_t K = pairs.shape[0], row, p, number = 0
        self._check_places(values, pairs, known.shape[0])
        cdef Workspace work = self.workspace()
        found, first_axes = np.empty((64, 10)), np.zeros((K, 3))
        cdef double[:, ::1] table = found
        cdef double[:, ::1] axes = first_axes
        for row in range(values.shape[0]):
            with nogil:
                _place(&self.pairs, work, &values[row, 0] if values.shape[1] else NULL)
            for p in range(K):
                if number == table.shape[0]:
                    found = np.concatenate([found, np.empty_like(found)])
                    table = found
                if _nearest_points(
                    work, pairs[p, 0], pairs[p, 1], known[p], &axes[p, 0], within, error, &table[number, 0]
                ):
                    table[number, 0], table[number, 1] = row, p
                    if least and known[p]:
                        within = min(within, table[number, 2])
                    number += 1
        self._free.append(work)
        return found[:number].copy()

    cdef int _check_places(self, const double[:, ::1] values, const size_t[:, ::1] pairs, Py_ssize_t K) except -1:
        """Raise InputError unless values (B, m) are of the joints, and K pairs of two bodies each."""
        cdef Py_ssize_t p
        if values.shape[1] != self.pairs.m:
            raise InputError(f"values must be of {self.pairs.m} joints, got {values.shape[1]}")
        if pairs.shape[0] != K or pairs.shape[1] != 2:
            raise InputError(f"pairs must have shape ({K}, 2), got ({pairs.shape[0]}, {pairs.shape[1]})")
        for p in range(K):
            if not (pairs[p, 0] < <size_t> self.pairs.own and pairs[p, 1] < <size_t> self.pairs.shape_count):
                raise InputError(f"pair {p} must be of the robot's {self.pairs.own} bodies and all {self.shapes.count}")
        return 0

    def some(self, pairs):
        """Return the pairs with indices (K,) in the form that `near` needs."""
        return SomePairs(self._kept[0][pairs], self.exact[pairs])

    def prove(self, curve, Required required not None, double floor):
        """Try to prove a motion of coefficients c_k (n,), q(t) = Σ_k c_k t^k, t in [0, 1].

        The required distances contain `ALLOWANCE`. The proof stops at an interval that is not proven if no body moves
        by more than the floor [m] in half of it.
        """
        if not self.bounded:
            return _UNKNOWN
        first, *others = curve
        coupling = self._coupling
        return self._proof(
            np.array([coupling.values(first), *(coupling.motions(other) for other in others)]), required, floor
        )

    def prove_edge(self, start, end, EdgeTable limits not None, Required required not None, double floor):
        """Try to prove the straight motion between two configurations (n,); None if one is not within the limits."""
        cdef Workspace work
        cdef Outcome outcome
        cdef Py_ssize_t n = limits.n
        cdef const double[::1] first = np.ascontiguousarray(start, dtype=np.float64)
        cdef const double[::1] last = np.ascontiguousarray(end, dtype=np.float64)
        if first.shape[0] != n or last.shape[0] != n:
            raise InputError(f"configurations must have {n} joints")
        self._check(required, limits.m)
        if not self.bounded:
            return _UNKNOWN if limits.hold(first) and limits.hold(last) else None
        work = self.workspace()
        with nogil:
            outcome = prove_edge(
                &self.pairs, work, &first[0], &last[0], limits,
                &required.distances[0] if self.pairs.count else NULL, required.most, floor,
            )
        found = None if outcome.places == 0 and outcome.number < 0 else self._result(work, outcome)
        self._free.append(work)
        return found

    def _proof(self, const double[:, ::1] curve, Required required, double floor):
        """Compute the result of `prove` for coefficients (d + 1, m) of the joints of Pinocchio's model."""
        cdef Py_ssize_t degree = curve.shape[0] - 1
        cdef Outcome outcome
        if degree < 1:
            raise InputError("a motion must have a start and a way at least")
        self._check(required, curve.shape[1])
        cdef Workspace work = self.workspace()
        work.make_room(self.pairs.m, degree)
        with nogil:
            outcome = prove_curve(
                &self.pairs, work, &curve[0, 0] if self.pairs.m else NULL, degree,
                &required.distances[0] if self.pairs.count else NULL, required.most, floor,
            )
        found = self._result(work, outcome)
        self._free.append(work)
        return found

    cdef object _result(self, Workspace work, Outcome outcome):
        """Return the proof, and count the configurations at which bounds were computed."""
        cdef Py_ssize_t k
        self._counts.bound_queries += outcome.places
        if outcome.number == 0:
            return _FREE
        left = _UNKNOWN.left
        if outcome.number > 0:
            left = [[work.memory.left[2 * k], work.memory.left[2 * k + 1]] for k in range(outcome.number)]
        return BoundsProof(False, outcome.at, left, outcome.number < 0)

    cdef int _check(self, Required required, Py_ssize_t joints) except -1:
        if required.distances.shape[0] != self.pairs.count:
            raise InputError(f"there must be a distance for each of {self.pairs.count} pairs")
        if joints != self.pairs.m:
            raise InputError(f"motions must be of {self.pairs.m} joints, got {joints}")
        return 0

    def prove_many(self, curves, Required required not None, double floor, int workers=1):
        """Return the results (E,) of `prove` for coefficients `curves: (E, d + 1, m)` of the model's joints.

        That is 1 of those that are proven, −1 of those that are blocked, 0 of others. Each of the workers is a thread.
        """
        found = np.zeros(len(curves), np.intp)
        if not self.bounded or not len(curves):
            return found
        parts = [slice(k, k + TOGETHER) for k in range(0, len(curves), TOGETHER)]

        def prove(some):
            return self._prove_all(curves[some], required, floor, found[some])

        if workers == 1 or len(parts) == 1:
            self._counts.bound_queries += sum(map(prove, parts))
        else:
            from concurrent.futures import ThreadPoolExecutor  # few need it

            with ThreadPoolExecutor(workers) as pool:
                self._counts.bound_queries += sum(pool.map(prove, parts))
        return found

    def _prove_all(self, const double[:, :, ::1] curves, Required required, double floor, Py_ssize_t[::1] found):
        """Compute the results of `prove_many`. Return the number of configurations at which bounds were computed."""
        cdef Py_ssize_t degree = curves.shape[1] - 1, k, places = 0, suspects
        cdef Outcome outcome
        if degree < 1:
            raise InputError("a motion must have a start and a way at least")
        self._check(required, curves.shape[2])
        cdef Workspace work = self.workspace()
        work.make_room(self.pairs.m, degree)
        # Different pairs block the edges of a batch, so testing the last blocking pair first would only cost time.
        suspects, work.memory.suspect_count = work.memory.suspect_count, 0
        with nogil:
            for k in range(curves.shape[0]):
                outcome = prove_curve(
                    &self.pairs, work, &curves[k, 0, 0] if self.pairs.m else NULL, degree,
                    &required.distances[0] if self.pairs.count else NULL, required.most, floor,
                )
                found[k] = 1 if outcome.number == 0 else min(outcome.number, 0)
                places += outcome.places
        work.memory.suspect_count = suspects
        self._free.append(work)
        return places

    def _values(self, Q):
        return np.ascontiguousarray(self._coupling.values(Q), dtype=np.float64)


def bound_reaches(
    ShapeTable shapes not None, double[:, ::1] lower not None, double[:, ::1] upper not None, double distance
):
    """Decide which of K parts of obstacles can come nearer than a distance [m] to the reaches of M moving bodies.

    The first M bodies are the reaches, followed by the parts. `lower` and `upper: (K, M)` hold what is known of their
    distances [m]. Where that does not decide, a lower bound is computed, and both are updated; where bodies are not
    finite, nothing is known. Returned are the parts and reaches (C, 2) of which a new bound is below the distance.
    """
    cdef Py_ssize_t K = lower.shape[0], M = lower.shape[1], k, m, count = 0
    cdef Bodies bodies = shapes.data
    cdef Search search
    cdef double found
    cdef bint bounded = shapes.bounded
    if upper.shape[0] != K or upper.shape[1] != M or K + M > shapes.count:
        raise InputError(f"bounds must be of {shapes.count} bodies at most, got {K} parts and {M} reaches")
    below = np.empty((K * M, 2), np.intp)
    cdef Py_ssize_t[:, ::1] near = below
    bodies.pose = shapes.new_poses()
    with nogil:
        for k in range(K):
            for m in range(M):
                if not lower[k, m] < distance <= upper[k, m]:
                    continue
                found = _lower_bound(&bodies, &search, m, M + k, distance) if bounded else -INFINITY
                lower[k, m] = max(lower[k, m], found)
                if found < distance:
                    # Of these only this bound is known.
                    upper[k, m] = nextafter(distance, 0.0)
                    near[count, 0], near[count, 1] = k, m
                    count += 1
    free(bodies.pose)
    return below[:count]


cdef void *_address(array):
    """Return a pointer to the first number of an array."""
    return <void *> <size_t> array.ctypes.data


cdef (double, double, double) _centre(const Pose *poses, size_t g) noexcept nogil:
    return poses[g].centre[0], poses[g].centre[1], poses[g].centre[2]


cdef double _write_ball(
    const double *centres, const double *radii, Py_ssize_t count, Py_ssize_t centre_stride, Py_ssize_t radius_stride,
    double *middle,
) noexcept nogil:
    """Compute the centre (3,) of a ball that contains the balls. Return its radius."""
    cdef double widest = 0.0, x, y, z
    cdef Py_ssize_t k, i
    cdef const double *centre
    for i in range(3):
        middle[i] = 0.0
        for k in range(count):
            middle[i] += centres[centre_stride * k + i] / count
    for k in range(count):
        centre = centres + centre_stride * k
        x, y, z = centre[0] - middle[0], centre[1] - middle[1], centre[2] - middle[2]
        widest = max(widest, sqrt(x * x + y * y + z * z) + radii[radius_stride * k])
    return widest + GROUP_ROUNDING


cdef inline void _place(const Pairs *pairs, Workspace work, const double *values) noexcept nogil:
    """Compute the frames of the joints and the poses of the robot's bodies at joint values (m,)."""
    cdef Memory *memory = &work.memory
    place_joints(pairs.joints, pairs.m, values, memory.rotations, memory.origins, memory.axes)
    place_moving(work.bodies.body, pairs.own, work.bodies.pose, memory.rotations, memory.origins)


cdef inline double _lower_bound(
    const Bodies *bodies, Search *search, Py_ssize_t a, Py_ssize_t b, double enough
) noexcept nogil:
    """Return a lower bound [m] of the distance of two bodies; −∞ instead of NaN."""
    cdef double lower = outer_bound(bodies, a, b, enough, search.axis)
    if lower < enough:
        lower = max(lower, distance_bounds(bodies, a, b, search, enough, enough, False).lower)
    return lower if lower == lower else -INFINITY


cdef inline bint _is_far(
    const double *centre, double radius, const Body *body, const Pose *pose, double enough
) noexcept nogil:
    """Return whether a ball is at least `enough` [m] away from the ball about a body."""
    cdef double x = pose.centre[0] - centre[0], y = pose.centre[1] - centre[1], z = pose.centre[2] - centre[2]
    cdef double apart = enough + body.reach + radius
    return x * x + y * y + z * z >= apart * apart


cdef inline Py_ssize_t _near_in_group(
    const Pairs *pairs, const Group *group, const Body *body, const Pose *pose, double enough, Py_ssize_t *near
) noexcept nogil:
    """List the pairs of a group whose balls may be less than `enough` [m] apart. Return their number.

    The body and its pose are that of the robot in all of them. Where the group is none of obstacles all pairs are
    written. There must be room for `LANES` numbers more.
    """
    cdef Py_ssize_t count = group.end - group.begin, number = 0, block, first, k
    cdef const double *balls = pairs.balls + group.lane
    cdef Py_ssize_t lanes = pairs.lanes
    cdef double x, y, z, far, a, b, c, reach
    cdef bint hits[LANES]
    cdef Vector way
    if not group.radius < INFINITY:
        for k in range(count):
            near[k] = group.begin + k
        return count
    if _is_far(group.centre, group.radius, body, pose, enough):
        return 0
    # Many small obstacles are within the ball about a long body, and few of them are near the body.
    if count > FEW_PAIRS:
        way, far = from_box(body, pose, group.centre), enough + group.radius
        if way.x * way.x + way.y * way.y + way.z * way.z >= far * far:
            return 0
    x, y, z, far = pose.centre[0], pose.centre[1], pose.centre[2], enough + body.reach
    for block in range((count + LANES - 1) // LANES):
        first = LANES * block
        for k in range(LANES):
            a, b, c = x - balls[first + k], y - balls[lanes + first + k], z - balls[2 * lanes + first + k]
            reach = far + balls[3 * lanes + first + k]
            hits[k] = not a * a + b * b + c * c >= reach * reach
        for k in range(min(<Py_ssize_t> LANES, count - first)):
            near[number] = group.begin + first + k
            number += hits[k]
    return number


cdef Py_ssize_t _near_pairs(
    const Pairs *pairs, Workspace work, const double *values, const double *margins, double largest, Py_ssize_t *near,
    bint *surely,
) noexcept nogil:
    """List the pairs (P,) that may be nearer than their margins (P,) [m]. Return their number.

    The search ends at a pair that certainly is, which `surely` tells: its two bodies are known exactly. A pair is apart
    if a lower bound of its distance is more than its margin by the allowance.
    """
    cdef Bodies *bodies = &work.bodies
    cdef Search *search = &work.memory.search
    cdef Py_ssize_t *some = work.memory.listed
    cdef Py_ssize_t g = 0, number = 0, k, p, A, B
    cdef double spare = _ALLOWANCE, most = largest + spare, enough
    cdef const Group *group
    cdef Bounds found
    _place(pairs, work, values)
    while g < pairs.group_count:
        group, A = &pairs.groups[g], pairs.groups[g].body
        if group.run_from_here > 1 and _is_far(
            group.run_centre, group.run_radius, &bodies.body[A], &bodies.pose[A], most
        ):
            g += group.run_from_here
            continue
        g += 1
        for k in range(_near_in_group(pairs, group, &bodies.body[A], &bodies.pose[A], most, some)):
            p = some[k]
            A, B, enough = pairs.bodies[p][0], pairs.bodies[p][1], margins[p] + spare
            if bodies.body[A].reach < INFINITY and bodies.body[B].reach < INFINITY:
                if outer_bound(bodies, A, B, enough, search.axis) >= enough:
                    continue
                found = distance_bounds(bodies, A, B, search, enough, margins[p], False)
                if found.lower >= enough:
                    continue
                if pairs.certain[p] < INFINITY and found.upper <= margins[p]:
                    near[number] = p
                    surely[0] = True
                    return number + 1
            near[number] = p
            number += 1
    return number


cdef double _clearance(const Pairs *pairs, Workspace work, double enough) noexcept nogil:
    """Return a lower bound [m], at most `enough`, of the least distance between placed bodies and obstacles."""
    cdef Bodies *bodies = &work.bodies
    cdef Search *search = &work.memory.search
    cdef Py_ssize_t *some = work.memory.listed
    cdef Py_ssize_t g, k, A, B
    cdef const Group *group
    cdef double lower
    for g in range(pairs.group_count):
        group, A = &pairs.groups[g], pairs.groups[g].body
        if group.radius < INFINITY:
            for k in range(_near_in_group(pairs, group, &bodies.body[A], &bodies.pose[A], enough, some)):
                B = pairs.bodies[some[k]][1]
                if outer_bound(bodies, A, B, enough, search.axis) < enough:
                    lower = distance_bounds(bodies, A, B, search, enough, 0.0, False).lower
                    enough = min(enough, lower if lower == lower else -INFINITY)
    return enough


cdef bint _nearest_points(
    Workspace work, Py_ssize_t A, Py_ssize_t B, bint exact, double *axis, double within, double error, double *found
) noexcept nogil:
    """Write the row (10,) of `DistanceBounds.near` for a pair of bodies. Return whether the pair is near."""
    cdef Bodies *bodies = &work.bodies
    cdef Search *search = &work.memory.search
    cdef const double *a = bodies.pose[A].centre
    cdef const double *b = bodies.pose[B].centre
    cdef double enough = within if exact else within + error
    cdef double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2], distance
    cdef double far = enough + bodies.body[A].reach + bodies.body[B].reach
    cdef Vector way
    cdef Bounds bounds
    cdef Py_ssize_t k
    if x * x + y * y + z * z >= far * far:
        return False
    way, far = beyond_box(&bodies.body[B], &bodies.pose[B], a), enough + bodies.body[A].reach
    if way.x * way.x + way.y * way.y + way.z * way.z >= far * far:
        return False
    way = from_box(&bodies.body[B], &bodies.pose[B], a)
    distance = sqrt(way.x * way.x + way.y * way.y + way.z * way.z) - bodies.body[A].reach
    for k in range(3):
        search.axis[k] = axis[k]
    if axis[0] == 0.0 and axis[1] == 0.0 and axis[2] == 0.0:
        begin_axis(search.axis, way, x, y, z)
    bounds = distance_bounds(bodies, A, B, search, enough, -INFINITY if exact else enough, True)
    for k in range(3):
        axis[k] = search.axis[k]
    if bounds.lower >= enough:
        return False
    found[2] = max(distance, bounds.lower) - error
    if exact:
        found[2] = bounds.lower if bounds.upper > -INFINITY else -INFINITY
        if bounds.upper > -INFINITY:
            _write_witness(&bodies.body[A], search, bounds, &work.memory, found + 3)
    return True


cdef void _write_witness(
    const Body *body, Search *search, Bounds bounds, const Memory *memory, double *found
) noexcept nogil:
    """Write (7,) nearest point of the first body, normal and offset, by the simplex of its distance from the second."""
    cdef Vector way
    cdef int corners = nearest_in_simplex(search.simplex, bounds.corners, &way), corner
    cdef double length = sqrt(way.x * way.x + way.y * way.y + way.z * way.z), x, y, z
    cdef double shares[3]
    cdef Py_ssize_t k, joint = body.joint - 1
    cdef const double *R
    found[3], found[4], found[5], found[6] = way.x / length, way.y / length, way.z / length, -bounds.upper
    _shares_of_corners(search.simplex, corners, way, shares)
    for k in range(3):
        found[k] = -body.ball * found[3 + k]
        for corner in range(corners):
            found[k] += shares[corner] * search.simplex[corner][3 + k]
        found[6] += found[3 + k] * found[k]
    if joint >= 0:
        R = memory.rotations + 9 * joint
        x = found[0] - memory.origins[3 * joint]
        y = found[1] - memory.origins[3 * joint + 1]
        z = found[2] - memory.origins[3 * joint + 2]
        for k in range(3):
            found[k] = R[k] * x + R[3 + k] * y + R[6 + k] * z


cdef void _shares_of_corners(double (*S)[6], int corners, Vector way, double *shares) noexcept nogil:
    """Compute the barycentric coordinates (3,) of a point between up to three corners of a simplex."""
    cdef double ux = S[1][0] - S[0][0], uy = S[1][1] - S[0][1], uz = S[1][2] - S[0][2], vx, vy, vz, uv, vv, vp, area
    cdef double px = way.x - S[0][0], py = way.y - S[0][1], pz = way.z - S[0][2]
    cdef double uu = ux * ux + uy * uy + uz * uz, up = ux * px + uy * py + uz * pz
    shares[0], shares[1], shares[2] = 1.0, 0.0, 0.0
    if corners == 2:
        shares[1] = up / uu
    elif corners == 3:
        vx, vy, vz = S[2][0] - S[0][0], S[2][1] - S[0][1], S[2][2] - S[0][2]
        uv, vv, vp = ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz, vx * px + vy * py + vz * pz
        area = uu * vv - uv * uv
        shares[1], shares[2] = (vv * up - uv * vp) / area, (uu * vp - uv * up) / area
    shares[0] = 1.0 - shares[1] - shares[2]


def hinge_costs(
    JointTable joints not None, const double[:, ::1] values, const Py_ssize_t[::1] carriers, const double[:, ::1] near,
    const double[:, ::1] hinges,
):
    """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² (B,), its gradients (B, m), and vectors v (C, m) of Gauss-Newton.

    Σ vvᵀ approximates the Hessian. d_c = x·n_c − b_c is the distance of each of C points of bodies from a plane, at
    the row of `values: (B, m)` of the joints for which it was found; `near: (C, 10)` is what `DistanceBounds.near`
    returns, of pairs whose first bodies are carried by joints with Pinocchio's numbers, `carriers: (K,)`. Pairs in
    contact do not count. The `hinges: (H, 2)` are D > 0 [m] and w. As in CHOMP and TrajOpt.
    """
    cdef Py_ssize_t m = joints.m, B = values.shape[0], C = near.shape[0]
    if values.shape[1] != m:
        raise InputError(f"values must have {m} columns, got {values.shape[1]}")
    cdef HingeTerms terms = hinge_terms(joints, B, carriers, near, hinges)
    costs, gradients, vectors = np.zeros(B), np.zeros((B, m)), np.zeros((C, m))
    cdef double[::1] cost = costs
    cdef double[:, ::1] gradient = gradients
    cdef double[:, ::1] vector = vectors
    cdef double *frames
    if C and m:
        frames = <double *> malloc(15 * m * sizeof(double))
        if not frames:
            raise MemoryError
        with nogil:
            add_hinge_costs(
                joints.data, m, &values[0, 0], &terms, frames, &cost[0], &gradient[0, 0], &vector[0, 0]
            )
        free(frames)
    return costs, gradients, vectors


cdef HingeTerms hinge_terms(
    JointTable joints, Py_ssize_t B, const Py_ssize_t[::1] carriers, const double[:, ::1] near,
    const double[:, ::1] hinges,
) except *:
    """Return pointers to the arrays, which the caller keeps.

    Raises InputError unless near pairs are of B configurations and of pairs that joints of the robot carry.
    """
    cdef HingeTerms terms
    if near.shape[1] != 10 or hinges.shape[1] != 2:
        raise InputError("near pairs must have 10 columns, and hinges 2")
    _check_near(joints, B, carriers[:, None], near)
    terms.near_count, terms.hinge_count = near.shape[0], hinges.shape[0]
    terms.carriers = &carriers[0] if carriers.shape[0] else NULL
    terms.near = &near[0, 0] if near.shape[0] else NULL
    terms.hinges = &hinges[0, 0] if hinges.shape[0] else NULL
    return terms


cdef int _check_near(
    JointTable joints, Py_ssize_t B, const Py_ssize_t[:, :] carriers, const double[:, ::1] near
) except -1:
    """Raise InputError unless near pairs are of B configurations and of pairs that joints of the robot carry."""
    cdef Py_ssize_t c, side
    for c in range(near.shape[0]):
        if not (0 <= near[c, 0] < B and 0 <= near[c, 1] < carriers.shape[0]):
            raise InputError(f"near pair {c} is of a configuration or a pair that there is not")
        for side in range(carriers.shape[1]):
            if not 0 <= carriers[<Py_ssize_t> near[c, 1], side] <= joints.m:
                raise InputError(f"pair {near[c, 1]:g} is carried by a joint that there is not")
    return 0


cdef void add_hinge_costs(
    const Joint *joints, Py_ssize_t m, const double *values, const HingeTerms *terms, double *frames, double *costs,
    double *gradients, double *vectors,
) noexcept nogil:
    """Add `hinge_costs` (B,) and gradients (B, m), and write vectors (C, m) unless NULL; `frames: (15 m,)` is memory.

    Of vectors only those numbers are written that are not 0.
    """
    cdef Py_ssize_t c, b, i, x, h, placed = -1
    cdef double distance, rate, curvature, lack, slope
    cdef const double *near = terms.near
    cdef const double *hinges = terms.hinges
    cdef double *origin = frames + 9 * m
    cdef double *axis = frames + 12 * m
    cdef const double *p
    cdef const double *normal
    cdef double place[3]
    for c in range(terms.near_count):
        p, normal = near + 10 * c + 3, near + 10 * c + 6
        b, i = <Py_ssize_t> near[10 * c], terms.carriers[<Py_ssize_t> near[10 * c + 1]] - 1
        if not near[10 * c + 2] > 0.0:
            continue
        if b != placed:
            place_joints(joints, m, values + m * b, frames, origin, axis)
            placed = b
        _write_place(frames, m, i, p, place)
        distance = -near[10 * c + 9]
        for x in range(3):
            distance += place[x] * normal[x]
        rate, curvature = 0.0, 0.0
        for h in range(terms.hinge_count):
            lack = 1.0 - distance / hinges[2 * h]
            if lack > 0.0:
                costs[b] += hinges[2 * h + 1] * lack * lack
                rate -= 2.0 * hinges[2 * h + 1] / hinges[2 * h] * lack
                curvature += 2.0 * hinges[2 * h + 1] / (hinges[2 * h] * hinges[2 * h])
        while i >= 0 and curvature > 0.0:
            slope = _slope(&joints[i], origin + 3 * i, axis + 3 * i, place, normal)
            gradients[m * b + i] += rate * slope
            if vectors != NULL:
                vectors[m * c + i] = sqrt(curvature) * slope
            i = joints[i].parent - 1


cdef inline void _write_place(
    const double *frames, Py_ssize_t m, Py_ssize_t joint, const double *p, double *place
) noexcept nogil:
    """Write the place in the world of a point p in the frame of a joint, of `frames: (15 m,)`; −1 is the world."""
    cdef const double *frame
    cdef Py_ssize_t x
    for x in range(3):
        place[x] = p[x]
        if joint >= 0:
            frame = frames + 9 * joint + 3 * x
            place[x] = frames[9 * m + 3 * joint + x] + frame[0] * p[0] + frame[1] * p[1] + frame[2] * p[2]


cdef inline double _slope(
    const Joint *joint, const double *origin, const double *axis, const double *place, const double *normal
) noexcept nogil:
    """Return the velocity of a point along a normal per unit velocity of a joint that carries the point."""
    cdef double slope = 0.0, turning
    cdef Py_ssize_t x, y, z
    for x in range(3):
        y, z = (x + 1) % 3, (x + 2) % 3
        turning = axis[y] * (place[z] - origin[z]) - axis[z] * (place[y] - origin[y])
        slope += normal[x] * (axis[x] if joint.slides else turning)
    return slope


def distance_gradients(
    JointTable joints not None, const double[:, ::1] values, const Py_ssize_t[:, ::1] carriers,
    const double[:, ::1] near,
):
    """Return the gradients (C, m) of the distances of near pairs, at the row of `values: (B, m)` of each.

    `near: (C, 10)` is what `DistanceBounds.near` returns, of pairs whose bodies are carried by joints with Pinocchio's
    numbers, `carriers: (K, 2)`.
    """
    cdef Py_ssize_t m = joints.m, C = near.shape[0], c, i, x, side, placed = -1
    cdef const double *normal
    cdef double place[3]
    cdef double *frames
    if values.shape[1] != m or carriers.shape[1] != 2 or near.shape[1] != 10:
        raise InputError(f"values must have {m} columns, carriers 2, and near pairs 10")
    _check_near(joints, values.shape[0], carriers, near)
    gradients = np.zeros((C, m))
    cdef double[:, ::1] gradient = gradients
    if not (C and m):
        return gradients
    frames = <double *> malloc(15 * m * sizeof(double))
    if not frames:
        raise MemoryError
    for c in range(C):
        if <Py_ssize_t> near[c, 0] != placed:
            placed = <Py_ssize_t> near[c, 0]
            place_joints(joints.data, m, &values[placed, 0], frames, frames + 9 * m, frames + 12 * m)
        normal = &near[c, 6]
        _write_place(frames, m, carriers[<Py_ssize_t> near[c, 1], 0] - 1, &near[c, 3], place)
        # The second body's point is at the distance behind that of the first one.
        for side in range(2):
            i = carriers[<Py_ssize_t> near[c, 1], side] - 1
            while i >= 0:
                gradient[c, i] += (1 - 2 * side) * _slope(
                    &joints.data[i], frames + 9 * m + 3 * i, frames + 12 * m + 3 * i, place, normal
                )
                i = joints.data[i].parent - 1
            for x in range(3):
                place[x] -= near[c, 2] * normal[x]
    free(frames)
    return gradients


# The inputs of a proof, and its working memory.
cdef struct Proof:
    const Pairs *pairs
    const Bodies *bodies
    Memory *memory
    const double *required
    double most


cdef double _write_rates(const Proof *proof) noexcept nogil:
    """Compute W and K of bodies, and W of self-collision pairs. Return the largest W of a body.

    Processors run the loops over bodies and pairs by lanes. V takes how fast bodies turn meanwhile.
    """
    cdef const Pairs *pairs = proof.pairs
    cdef Py_ssize_t m = pairs.m, own = pairs.own, P = pairs.count, i, g, k, p
    cdef double *W = proof.memory.W
    cdef double *turning = proof.memory.V
    cdef double *K = proof.memory.K
    cdef double *rates = proof.memory.rates
    cdef const double *moves = proof.memory.moves
    cdef const double *reaches
    cdef const double *radii
    cdef double widest = 0.0, speed, fastest, acceleration, turns
    cdef Py_ssize_t G = proof.pairs.shape_count
    for g in range(own):
        W[g], turning[g], K[g] = 0.0, 0.0, 0.0
    for i in range(m):
        speed, fastest, acceleration = moves[SPEED * m + i], moves[FASTEST * m + i], moves[ACCELERATION * m + i]
        turns = 0.0 if pairs.joints[i].slides else fastest
        reaches = pairs.reaches + G * i
        for g in range(own):
            W[g] += reaches[g] * speed
            K[g] += reaches[g] * (fastest * (fastest + 2.0 * turning[g]) + acceleration)
            turning[g] += turns if reaches[g] > 0.0 else 0.0
    for g in range(own):
        widest = max(widest, W[g])
    for k in range(pairs.group_count):
        if not pairs.groups[k].radius < INFINITY:
            for p in range(pairs.groups[k].begin, pairs.groups[k].end):
                rates[p] = 0.0
            for i in range(m):
                radii, speed = pairs.radii + P * i, moves[SPEED * m + i]
                for p in range(pairs.groups[k].begin, pairs.groups[k].end):
                    rates[p] += radii[p] * speed
    return widest


# Angular velocity of a body, and velocity of its centre.
cdef struct Twist:
    Vector angular
    Vector linear


cdef inline Twist _velocities(const Proof *proof, Py_ssize_t g, Py_ssize_t frame) noexcept nogil:
    """Return the velocity of a body relative to the link of a joint."""
    cdef const double *c = proof.bodies.pose[g].centre
    cdef const double *twist = proof.memory.twists + 6 * proof.bodies.body[g].joint
    cdef const double *base = proof.memory.twists + 6 * frame
    cdef double x = twist[0] - base[0], y = twist[1] - base[1], z = twist[2] - base[2]
    cdef double u = twist[3] - base[3], v = twist[4] - base[4], w = twist[5] - base[5]
    return Twist(
        Vector(x, y, z),
        Vector(u + y * c[2] - z * c[1], v + z * c[0] - x * c[2], w + x * c[1] - y * c[0]),
    )


cdef inline double _moved(const Proof *proof, Py_ssize_t p, double half) noexcept nogil:
    """Return a bound of how much the bodies of a pair approach each other within `half` of a point of the motion."""
    cdef Memory *memory = proof.memory
    cdef Py_ssize_t A = proof.pairs.bodies[p][0], B = proof.pairs.bodies[p][1]
    cdef double rate = (
        memory.rates[p] if proof.pairs.own > B else min(memory.W[A], memory.V[A] + 0.5 * half * memory.K[A])
    )
    return half * rate * (1.0 + ROUNDING)


# Proven lengths before and after a point of the motion, as shares of the motion.
cdef struct Reach:
    double before
    double after


cdef Reach _kept(const Proof *proof, Py_ssize_t p, double spare) noexcept nogil:
    """Return the proven lengths of a pair whose distance along the axis exceeds the required one by `spare` [m]."""
    cdef const Joint *joints = proof.pairs.joints
    cdef const Body *body
    cdef Memory *memory = proof.memory
    cdef const double *axis = memory.search.axis
    cdef Py_ssize_t m = proof.pairs.m, A = proof.pairs.bodies[p][0], B = proof.pairs.bodies[p][1]
    cdef Py_ssize_t frame = 0, last = 0, side, g, k, i
    cdef bint both = proof.pairs.own > B
    cdef double even, length, a, b, c, along = 0.0, spread = 0.0, acceleration, turning, reach, fastest, x, y, z
    cdef double before, after
    cdef const Pose *pose
    cdef Twist twist
    if not spare > 0.0:
        return Reach(0.0, 0.0)
    even = spare / (memory.rates[p] if both else memory.W[A]) * (1.0 - ROUNDING)
    # An obstacle that is a solid of cells: the bound is along many axes.
    if proof.bodies.body[B].levels > 0:
        even = max(even, _until(spare, -memory.V[A], memory.K[A]))
        return Reach(even, even)
    # The joint that carries both: parents have lower numbers.
    if both:
        frame, last = proof.bodies.body[A].joint, proof.bodies.body[B].joint
    while frame != last:
        frame, last = joints[max(frame, last) - 1].parent, min(frame, last)
    length = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    a, b, c = axis[0] / length, axis[1] / length, axis[2] / length
    acceleration = 0.0 if both else memory.K[A]
    for side in range(2 if both else 1):
        g = proof.pairs.bodies[p][side]
        pose, body, turning = &proof.bodies.pose[g], &proof.bodies.body[g], 0.0
        twist = _velocities(proof, g, frame)
        along += (1 - 2 * side) * (a * twist.linear.x + b * twist.linear.y + c * twist.linear.z)
        # n × ω
        x, y, z = (
            b * twist.angular.z - c * twist.angular.y,
            c * twist.angular.x - a * twist.angular.z,
            a * twist.angular.y - b * twist.angular.x,
        )
        for k in range(3):
            spread += (body.extent[k] - body.ball) * fabs(
                pose.rotation[0][k] * x + pose.rotation[1][k] * y + pose.rotation[2][k] * z
            )
        for i in range(frame, body.joint if both else 0):
            reach, fastest = proof.pairs.reaches[proof.pairs.shape_count * i + g], memory.moves[FASTEST * m + i]
            if reach > 0.0:
                acceleration += reach * (fastest * (fastest + 2.0 * turning) + memory.moves[ACCELERATION * m + i])
                turning += 0.0 if joints[i].slides else fastest
    before, after = _until(spare, -along - spread, acceleration), _until(spare, along - spread, acceleration)
    return Reach(max(even, before), max(even, after))


cdef inline double _until(double spare, double rate, double acceleration) noexcept nogil:
    """Return the largest s with spare + rate s − acceleration s²/2 ≥ 0."""
    cdef double root = sqrt(rate * rate + 2.0 * acceleration * spare)
    return ((rate + root) / acceleration if rate > 0.0 else 2.0 * spare / (root - rate)) * (1.0 - ROUNDING)


cdef Py_ssize_t _list_near(const Proof *proof, double half) noexcept nogil:
    """List the pairs that the balls about bodies and about groups do not prove. Return their number."""
    cdef const Pairs *pairs = proof.pairs
    cdef const Body *bodies = proof.bodies.body
    cdef const Pose *poses = proof.bodies.pose
    cdef Py_ssize_t *listed = proof.memory.listed
    cdef Py_ssize_t number = 0, turn = 0, A, B, p
    cdef const Group *group
    cdef double enough
    while turn < pairs.group_count:
        group = &pairs.groups[pairs.group_count - 1 - turn]
        A = group.body
        turn += 1
        if group.radius < INFINITY:
            enough = proof.most + _moved(proof, group.begin, half)
            if group.run_to_here > 1 and _is_far(group.run_centre, group.run_radius, &bodies[A], &poses[A], enough):
                turn += group.run_to_here - 1
                continue
            number += _near_in_group(pairs, group, &bodies[A], &poses[A], enough, listed + number)
            continue
        for p in range(group.begin, group.end):
            A, B = pairs.bodies[p][0], pairs.bodies[p][1]
            enough = proof.required[p] + half * proof.memory.rates[p] * (1.0 + ROUNDING)
            listed[number] = p
            number += not _is_far(poses[B].centre, bodies[B].reach, &bodies[A], &poses[A], enough)
    return number


# Proven lengths before and after a point; a pair that is too near, or −1; the number of listed pairs.
cdef struct Half:
    Reach reach
    Py_ssize_t pair
    Py_ssize_t listed


cdef Half _half_length(const Proof *proof, double t, double half, Py_ssize_t number, bint fresh) noexcept nogil:
    """Return the proven lengths before and after t, at most `half`, a pair that is too near, and the listed pairs.

    Of the first so many pairs of the list those that are not proven for all of the interval come to the front. Of
    `fresh` ones nothing is known. Both lengths are 0 if the bound of that pair's distance is not above what it must
    keep, and −1 if it is certain that the pair is too near.
    """
    cdef const Pairs *pairs = proof.pairs
    cdef Memory *memory = proof.memory
    cdef double *axis = memory.search.axis
    cdef double *first = memory.known + FROM * pairs.count
    cdef double *last = memory.known + UNTIL * pairs.count
    cdef double *axes = memory.known + AXIS * pairs.count
    cdef Py_ssize_t *listed = memory.listed
    cdef Py_ssize_t left = 0, done = 0, k, p, worst, A, B, x
    cdef double before = half, after = half, enough, lower, back, on, shortest, longer, least, nothing, even
    cdef Reach kept
    cdef Bounds found
    for k in range(number):
        p = listed[k]
        if not fresh and first[p] <= t - half and t + half <= last[p]:
            continue
        enough = proof.required[p] + _moved(proof, p, half)
        lower = outer_bound(proof.bodies, pairs.bodies[p][0], pairs.bodies[p][1], enough, axis)
        if lower >= enough:
            continue
        kept = _kept(proof, p, lower - proof.required[p])
        if kept.before >= half and kept.after >= half:
            continue
        first[p], last[p] = t - kept.before, t + kept.after
        for x in range(3):
            axes[3 * p + x] = axis[x]
        listed[left], listed[k] = listed[k], listed[left]
        left += 1
    while True:
        worst, shortest = -1, INFINITY
        for k in range(done, left):
            p = listed[k]
            back, on = t - first[p], last[p] - t
            if (back < before or on < after) and min(back, on) < shortest:
                worst, shortest = k, min(back, on)
        if worst < 0:
            return Half(Reach(before, after), -1, left)
        p = listed[worst]
        A, B = pairs.bodies[p][0], pairs.bodies[p][1]
        for x in range(3):
            axis[x] = axes[3 * p + x]
        back, on, longer = t - first[p], last[p] - t, max(before, after)
        enough, least = proof.required[p] + _moved(proof, p, longer), proof.required[p] - pairs.certain[p]
        found = distance_bounds(proof.bodies, A, B, &memory.search, enough, least, False)
        if not (back > 0.0 or found.lower > proof.required[p]):
            # The upper bound is −∞ where hulls overlap, and so is the right side where bodies are within theirs.
            nothing = -1.0 if found.upper < least else 0.0
            return Half(Reach(nothing, nothing), listed[worst], left)
        kept = _kept(proof, p, found.lower - proof.required[p])
        # The comparison is independent of rounding errors.
        even = longer if found.lower >= enough else 0.0
        back, on = max(max(back, kept.before), even), max(max(on, kept.after), even)
        first[p], last[p] = t - back, t + on
        before, after = min(before, back), min(after, on)
        listed[worst], listed[done] = listed[done], listed[worst]
        done += 1


cdef bint _is_too_near(const Proof *proof, Py_ssize_t p) noexcept nogil:
    """Return whether a pair is certainly nearer than its required distance at a point of the motion."""
    cdef double required = proof.required[p], least = required - proof.pairs.certain[p]
    cdef Py_ssize_t A = proof.pairs.bodies[p][0], B = proof.pairs.bodies[p][1]
    cdef Search *search = &proof.memory.search
    cdef Bounds found
    if outer_bound(proof.bodies, A, B, required, search.axis) >= required:
        return False
    found = distance_bounds(proof.bodies, A, B, search, required, least, False)
    return not found.lower > required and found.upper < least


cdef void _suspect(Memory *memory, Py_ssize_t pair) noexcept nogil:
    """Move a pair to the front of the suspects. A new pair replaces the last suspect."""
    cdef Py_ssize_t place = 0, k
    while place < memory.suspect_count - 1 and memory.suspects[place] != pair:
        place += 1
    for k in range(place, 0, -1):
        memory.suspects[k] = memory.suspects[k - 1]
    if memory.suspect_count > 0:
        memory.suspects[0] = pair


cdef void _curve_at(
    const double *curve, Py_ssize_t degree, Py_ssize_t m, double t, double half, double *moves
) noexcept nogil:
    """Compute the joint values at t, and bounds of the joints' motion within `half` of t.

    The rows of `moves: (6 + d, m)` are the joints, v, q′ at t, bounds of |q′| and |q″|, and a_0 … a_d.
    """
    cdef Py_ssize_t i, j, k
    cdef double *taylor = moves + TAYLOR * m
    cdef double speed, fastest, bend, rise
    for i in range(m):
        for k in range(degree + 1):
            taylor[k * m + i] = curve[k * m + i]
        for k in range(degree):
            for j in range(degree - 1, k - 1, -1):
                taylor[j * m + i] += t * taylor[(j + 1) * m + i]
        speed, fastest, bend = 0.0, 0.0, 0.0
        for k in range(degree, 0, -1):
            rise = fabs(taylor[k * m + i])
            speed, fastest = rise + half * speed, k * rise + half * fastest
            if k > 1:
                bend = k * (k - 1) * rise + half * bend
        moves[PLACE * m + i], moves[SPEED * m + i], moves[VELOCITY * m + i] = taylor[i], speed, taylor[m + i]
        moves[FASTEST * m + i], moves[ACCELERATION * m + i] = fastest, bend


cdef Outcome prove_curve(
    const Pairs *pairs, Workspace work, const double *curve, Py_ssize_t degree, const double *required, double most,
    double floor,
) noexcept nogil:
    """Try to prove the motion with coefficients `curve: (d + 1, m)` for t in [0, 1]. Stop at the first failure.

    Pair p must keep c_p, `required: (P,)`, with all allowances in it, none of them above `most`. The proof stops at an
    interval in whose halves no body moves by more than the floor [m], and where more than `INTERVALS` would wait.
    Intervals that are not proven are left in the workspace, which must have room for the degree. Pairs that blocked
    motions before are suspected, and looked at first. Where a suspect is certainly too near the others are not looked
    at: no proof could find the motion free, so whether it is never depends on what is suspected.

    The outcome has how many intervals are not proven; 0: the motion is proven; −1: some pair is certainly too near.
    """
    cdef Memory *memory = &work.memory
    cdef Proof proof = Proof(pairs, &work.bodies, memory, required, most)
    cdef Py_ssize_t m = pairs.m, number, count, places = 0, k, i, g
    cdef double *moves = memory.moves
    cdef double *left = memory.left
    cdef double widest, crowd, low, high, t, longest, half, wide
    cdef bint fresh, earlier
    cdef Twist twist
    cdef Half found
    cdef int turn
    _curve_at(curve, degree, m, 0.5, 0.5, moves)
    widest = _write_rates(&proof)
    crowd = max(1.0, pairs.count / CROWD)
    wide = max(1.0, min(min(ceil(0.5 * crowd * widest / FIRST_MOTION), crowd * MOST_FIRST), <double> (INTERVALS // 2)))
    number = <Py_ssize_t> wide
    for k in range(INTERVALS):
        memory.counts[k] = -1
    for k in range(number):
        left[2 * k], left[2 * k + 1] = <double> k / number, <double> (k + 1) / number
    while number > 0:
        low, high, count = left[2 * number - 2], left[2 * number - 1], memory.counts[number - 1]
        t, longest, fresh = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + ROUNDING), count < 0
        _curve_at(curve, degree, m, t, longest, moves)
        for i in range(m):
            if not fabs(moves[PLACE * m + i]) + moves[FASTEST * m + i] + moves[ACCELERATION * m + i] < LARGEST:
                return Outcome(number, -1.0, places)
        _place(pairs, work, moves + PLACE * m)
        if degree > 1:
            widest = _write_rates(&proof)
        places += 1
        if fresh:
            for k in range(memory.suspect_count):
                if _is_too_near(&proof, memory.suspects[k]):
                    _suspect(memory, memory.suspects[k])
                    return Outcome(-1, t, places)
        move_joints(pairs.joints, m, moves + VELOCITY * m, memory.origins, memory.axes, memory.twists + 6)
        for g in range(pairs.own):
            twist = _velocities(&proof, g, 0)
            memory.V[g] = sqrt(
                twist.linear.x * twist.linear.x + twist.linear.y * twist.linear.y + twist.linear.z * twist.linear.z
            ) + proof.bodies.body[g].reach * sqrt(
                twist.angular.x * twist.angular.x + twist.angular.y * twist.angular.y
                + twist.angular.z * twist.angular.z
            )
        if fresh:
            count = _list_near(&proof, longest)
        found = _half_length(&proof, t, longest, count, fresh)
        half = min(found.reach.before, found.reach.after)
        if half < 0.0:
            _suspect(memory, found.pair)
            return Outcome(-1, t, places)
        # The interval is as short as floating point numbers allow.
        if half < longest and (half * widest < floor or number == INTERVALS or t == low or t == high):
            return Outcome(number, -1.0 if half > 0.0 else t, places)
        number -= 1
        # The part in which these bodies approach each other is checked next, because there the motion may be blocked.
        for turn in range(2):
            earlier = (turn == 0) == (found.reach.after <= found.reach.before)
            if (found.reach.before if earlier else found.reach.after) < longest:
                if earlier:
                    left[2 * number], left[2 * number + 1] = low, t - found.reach.before
                else:
                    left[2 * number], left[2 * number + 1] = t + found.reach.after, high
                memory.counts[number] = found.listed
                number += 1
    return Outcome(0, -1.0, places)


cdef Outcome prove_edge(
    const Pairs *pairs, Workspace work, const double *start, const double *end, EdgeTable limits,
    const double *required, double most, double floor,
) noexcept nogil:
    """Return the result of `prove_curve` for the straight motion between two configurations (n,).

    −1 at no place is also said where one of them is not within the limits.
    """
    if not edge_between(limits, start, end, work.memory.edge):
        return Outcome(-1, -1.0, 0)
    return prove_curve(pairs, work, work.memory.edge, 1, required, most, floor)
