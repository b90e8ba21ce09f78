"""Proven lower bounds of the distance between convex hulls, and between a moving robot and sets that grow.

For any unit vector u the distance of two hulls A and B is at least min_A a·u − max_B b·u. Gilbert's algorithm computes
a good u. z is a point of A − B, and w is the point of A − B with the least z·w. The next z is the point of the segment
from z to w that is nearest to the origin. ‖z‖ is an upper bound of the distance, and z·w/‖z‖ a lower bound. So whether
a distance is larger than a given length is mostly decided after one or two steps.
"""

from libc.math cimport INFINITY, sqrt
from libc.stdlib cimport free, malloc

from typing import NamedTuple

import numpy as np

from safe_ompl.common import InputError

cdef enum:
    STEPS = 60
# The distance along a separating axis may be smaller than the largest one by this [m].
cdef double COARSE = 1e-3
# Bounds that are nearer than this to the distance are not improved [m].
cdef double CLOSE = 1e-5
# Bound of the rounding errors of the heights of vertices [m].
cdef double ROUNDING = 1e-9


# Frames of the m joints at the centres of N cells, and bounds of the motion of the G bodies in each cell [m].
cdef struct Frames:
    const double *rotations
    const double *origins
    const double *travel
    Py_ssize_t N
    Py_ssize_t m


# Reach sets of M bodies: points, index of the first point of each body, radii, and growth g₀ + g₁t; see `ReachSets`.
cdef struct Sets:
    const double *points
    const Py_ssize_t *first
    const double *radii
    const double *growth
    Py_ssize_t count


# The squared path speeds up to which contact is allowed, by cell, body and set, for the first `bearing` sets.
cdef struct Borne:
    const double *squares
    const double *most
    Py_ssize_t bearing


# The W windows of a motion: the cells of the robot (W,), and the latest times at which it leaves them (W,) [s].
cdef struct Windows:
    const Py_ssize_t *at
    const double *until
    Py_ssize_t count


# `MarginQuery` for compiled code.
cdef struct MarginLimits:
    double left
    double enough
    double close
    bint stop_at_first


# The least margin of a motion [m], and where it is.
cdef struct Worst:
    double margin
    Py_ssize_t window, body, who


cdef double hull_gap(
    const double *first, Py_ssize_t firsts, const double *second, Py_ssize_t seconds, double *start, double wanted,
    double close, bint decide
) noexcept nogil:
    """Return a lower bound, at least 0, of the distance between the hulls of two sets of points.

    `first: (A, 3)` and `second: (B, 3)` are the points [m]. The search begins at `start: (3,)`, a point of first −
    second, and leaves the direction of the bound there. The search ends if the distance is proven to be at least
    `wanted` [m], or, with `decide`, if it is less; otherwise when both bounds differ by at most `close` [m].
    """
    cdef double z0 = start[0], z1 = start[1], z2 = start[2], best = 0.0
    cdef double squared, length, least, most, along, d0, d1, d2, across, step
    cdef Py_ssize_t k, i, j, _
    for _ in range(STEPS):
        squared = z0 * z0 + z1 * z1 + z2 * z2
        length = sqrt(squared)
        if length <= close or (decide and length < wanted) or length - best <= close:
            return best
        least, i = INFINITY, 0
        for k in range(firsts):
            along = first[3 * k] * z0 + first[3 * k + 1] * z1 + first[3 * k + 2] * z2
            if along < least:
                least, i = along, k
        most, j = -INFINITY, 0
        for k in range(seconds):
            along = second[3 * k] * z0 + second[3 * k + 1] * z1 + second[3 * k + 2] * z2
            if along > most:
                most, j = along, k
        if least - most > best * length:
            best = (least - most) / length
            start[0], start[1], start[2] = z0 / length, z1 / length, z2 / length
        if best >= wanted:
            return best
        d0 = first[3 * i] - second[3 * j] - z0
        d1 = first[3 * i + 1] - second[3 * j + 1] - z1
        d2 = first[3 * i + 2] - second[3 * j + 2] - z2
        across = d0 * d0 + d1 * d1 + d2 * d2
        if across <= 0.0:
            return best
        step = min(1.0, -(z0 * d0 + z1 * d1 + z2 * d2) / across)
        if step <= 0.0:
            return best
        z0, z1, z2 = z0 + step * d0, z1 + step * d1, z2 + step * d2
    return best


cdef void ball_about(const double *points, Py_ssize_t count, double *ball) noexcept nogil:
    """Compute the mean of the points, and the largest distance of a point from the mean."""
    cdef double m0 = 0.0, m1 = 0.0, m2 = 0.0, far = 0.0, x, y, z
    cdef Py_ssize_t k
    for k in range(count):
        m0, m1, m2 = m0 + points[3 * k] / count, m1 + points[3 * k + 1] / count, m2 + points[3 * k + 2] / count
    for k in range(count):
        x, y, z = points[3 * k] - m0, points[3 * k + 1] - m1, points[3 * k + 2] - m2
        far = max(far, x * x + y * y + z * z)
    ball[0], ball[1], ball[2], ball[3] = m0, m1, m2, sqrt(far)


class MarginQuery(NamedTuple):
    """The accuracy with which the least margin of a motion is computed.

    Parameters
    ----------
    left : float
        The distance that must be left [m].
    enough : float
        Margins above this need not be known [m].
    close : float
        The least margin is found within this [m]. 0: only whether the margin is negative.
    stop_at_first : bool
        Whether the search ends at the first negative margin.
    """

    left: float
    enough: float
    close: float
    stop_at_first: bool


cdef class BodyHulls:
    """The hulls of the G moving bodies of a robot, in the frames of their joints.

    Parameters
    ----------
    carriers : ndarray of intp, shape (G,)
        The joint that carries each body, from 0.
    vertices : ndarray, shape (V, 3)
        The vertices of all hulls, one hull after the other [m].
    first_vertex : ndarray of intp, shape (G + 1,)
        Where the vertices of each hull begin. No hull is empty.
    pads : ndarray, shape (G,)
        By how much each body is wider than its hull [m].
    middles, extents : ndarray, shapes (G, 3) and (G,)
        Balls about the hulls [m].

    Raises
    ------
    InputError
        If the tables do not fit together.
    """

    cdef readonly object carriers, vertices, first_vertex, pads, middles, extents
    cdef readonly Py_ssize_t count
    cdef const Py_ssize_t *_carriers
    cdef const Py_ssize_t *_first
    cdef const double *_vertices
    cdef const double *_pads
    cdef const double *_middles
    cdef const double *_extents
    cdef Py_ssize_t _joints

    def __init__(
        self, const Py_ssize_t[::1] carriers, const double[:, ::1] vertices, const Py_ssize_t[::1] first_vertex,
        const double[::1] pads, const double[:, ::1] middles, const double[::1] extents
    ):
        cdef Py_ssize_t G = carriers.shape[0], g
        _check_lists(first_vertex, vertices, "first_vertex", "vertices")
        if first_vertex.shape[0] != G + 1:
            raise InputError(f"first_vertex must have {G + 1} numbers for {G} bodies")
        if pads.shape[0] != G or extents.shape[0] != G or middles.shape[0] != G or middles.shape[1] != 3:
            raise InputError(f"pads, extents and middles must have shapes ({G},), ({G},) and ({G}, 3)")
        self.count, self._joints = G, 0
        for g in range(G):
            if carriers[g] < 0:
                raise InputError(f"body {g} is carried by joint {carriers[g]}")
            self._joints = max(self._joints, carriers[g] + 1)
        self.carriers, self.vertices, self.first_vertex = (
            np.asarray(carriers), np.asarray(vertices), np.asarray(first_vertex)
        )
        self.pads, self.middles, self.extents = np.asarray(pads), np.asarray(middles), np.asarray(extents)
        self._first = &first_vertex[0]
        self._carriers = &carriers[0] if G else NULL
        self._vertices = &vertices[0, 0] if vertices.shape[0] else NULL
        self._pads = &pads[0] if G else NULL
        self._middles = &middles[0, 0] if G else NULL
        self._extents = &extents[0] if G else NULL

    def __reduce__(self):
        return BodyHulls, (
            self.carriers, self.vertices, self.first_vertex, self.pads, self.middles, self.extents
        )

    cdef Frames _frames(self, cells, Py_ssize_t count, bint moving) except *:
        """Check and return the frames of at least this many cells; `moving`: whether bodies move within the cells."""
        cdef const double[:, :, :, ::1] rotations
        cdef const double[:, :, ::1] origins
        cdef const double[:, ::1] travel
        cdef Frames found
        rotations, origins, travel = cells
        cdef Py_ssize_t N = rotations.shape[0], m = rotations.shape[1]
        if rotations.shape[2] != 3 or rotations.shape[3] != 3 or origins.shape[2] != 3:
            raise InputError("frames must have shapes (N, m, 3, 3) and (N, m, 3)")
        if N < count or origins.shape[0] != N or origins.shape[1] != m or m < self._joints:
            raise InputError(f"frames must be those of {count} cells and {self._joints} joints at least")
        if moving and (travel.shape[0] != N or travel.shape[1] != self.count):
            raise InputError(f"travel must have shape ({N}, {self.count})")
        found.N, found.m = N, m
        found.rotations = &rotations[0, 0, 0, 0] if N and m else NULL
        found.origins = &origins[0, 0, 0] if N and m else NULL
        found.travel = &travel[0, 0] if moving and N and self.count else NULL
        return found

    def gaps(self, const Py_ssize_t[::1] at, const double[::1] until, borne, cells, sets, query):
        """Return the least margin between a robot and everything that moves, over the windows of a motion.

        The margin min (distance − growth − travel − left) [m] is a lower bound; it is negative if nothing is proven.
        Also returned are the window, the body of the robot and the set, −1 if there is none. The robot is in the cells
        `at: (W,)` of a path until the times `until: (W,)` [s] at the latest. The `query` is a `MarginQuery`.

        `cells` are the frames of `CellFrames`, `sets` the arrays of `ReachSets`. `borne` has the largest ṡ² of the
        windows (W,), and the largest ṡ² (N, G, M) of cell, body and set up to which contact is allowed. Two bodies that
        may touch at the speed of a window need no distance there. The last array is empty if no contact is allowed;
        contact with sets beyond its end is not allowed.
        """
        cdef Frames frames = self._frames(cells, _past_last(at), True)
        cdef Sets moving = _sets(sets)
        cdef Borne contact = self._borne(borne, at.shape[0], frames.N)
        cdef Windows windows = Windows(NULL, NULL, at.shape[0])
        cdef MarginLimits limits
        cdef Worst found
        cdef double *memory
        limits.left, limits.enough, limits.close, limits.stop_at_first = query
        if until.shape[0] != at.shape[0]:
            raise InputError("until must have one time for each window")
        memory = _work(&moving)
        with nogil:
            if windows.count:
                windows.at, windows.until = &at[0], &until[0]
            found = self._least(&windows, &contact, &frames, &moving, memory, &limits)
            free(memory)
        return found.margin, found.window, found.body, found.who

    def cell_gaps(
        self, const Py_ssize_t[::1] at, borne, cells, sets, double left, double far, double close
    ):
        """Return the least margin (W,) [m] in each cell at the time of the measurement; as `gaps`.

        More than `far` need not be known, and what is less but within `close` [m].
        """
        cdef Frames frames = self._frames(cells, _past_last(at), True)
        cdef Sets moving = _sets(sets)
        cdef Borne contact = self._borne(borne, at.shape[0], frames.N)
        cdef Py_ssize_t W = at.shape[0], w
        cdef MarginLimits limits = MarginLimits(left + far, 0.0, close, False)
        cdef Windows window
        cdef double now = 0.0
        cdef double *memory
        margins = np.empty(W)
        cdef double[::1] found = margins
        memory = _work(&moving)
        with nogil:
            for w in range(W):
                window = Windows(&at[w], &now, 1)
                found[w] = min(self._least(&window, &contact, &frames, &moving, memory, &limits).margin, 0.0) + far
                contact.squares += 1
            free(memory)
        return margins

    cdef Borne _borne(self, borne, Py_ssize_t W, Py_ssize_t N) except *:
        cdef const double[::1] squares
        cdef const double[:, :, ::1] most
        cdef Borne found
        squares, most = borne
        if squares.shape[0] != W:
            raise InputError("contact is borne at one speed for each window")
        found.squares, found.most, found.bearing = &squares[0] if W else NULL, NULL, 0
        if most.shape[0]:
            if most.shape[0] != N or most.shape[1] != self.count:
                raise InputError(f"speeds at which contact is borne must have shape ({N}, {self.count}, …)")
            found.bearing = most.shape[2]
            found.most = &most[0, 0, 0] if self.count and most.shape[2] else NULL
        return found

    cdef Worst _least(
        self, const Windows *windows, const Borne *borne, const Frames *frames, const Sets *sets, double *memory,
        const MarginLimits *limits
    ) noexcept nogil:
        """Compute the result of `gaps`."""
        cdef Worst worst = Worst(INFINITY, -1, -1, -1)
        cdef Py_ssize_t G = self.count, S = sets.count, w, k, g, s, p, x, a, b
        cdef double *local = memory
        cdef double *balls = local + 3 * sets.first[S]
        cdef double *grown = balls + 4 * S
        cdef const double *R
        cdef const double *o
        cdef const double *c
        cdef const double *ball
        cdef double delta[3]
        cdef double c0, c1, c2, v0, v1, v2, need, far, apart, wanted, gap
        cdef double enough = limits.enough, close = limits.close
        cdef bint decide = close == 0.0
        for s in range(S):
            ball_about(sets.points + 3 * sets.first[s], sets.first[s + 1] - sets.first[s], balls + 4 * s)
        for w in range(windows.count):
            k = windows.at[w]
            for s in range(S):
                grown[s] = sets.radii[s] + sets.growth[2 * s] + windows.until[w] * sets.growth[2 * s + 1]
            for g in range(G):
                R = frames.rotations + 9 * (k * frames.m + self._carriers[g])
                o = frames.origins + 3 * (k * frames.m + self._carriers[g])
                c = self._middles + 3 * g
                c0 = o[0] + R[0] * c[0] + R[1] * c[1] + R[2] * c[2]
                c1 = o[1] + R[3] * c[0] + R[4] * c[1] + R[5] * c[2]
                c2 = o[2] + R[6] * c[0] + R[7] * c[1] + R[8] * c[2]
                for s in range(S):
                    if s < borne.bearing and borne.squares[w] <= borne.most[(k * G + g) * borne.bearing + s]:
                        continue
                    ball = balls + 4 * s
                    need = grown[s] + frames.travel[k * G + g] + limits.left + self._pads[g]
                    v0, v1, v2 = c0 - ball[0], c1 - ball[1], c2 - ball[2]
                    far = sqrt(v0 * v0 + v1 * v1 + v2 * v2)
                    apart = far - ball[3] - self._extents[g] - need
                    if apart < min(worst.margin, enough):
                        a, b = sets.first[s], sets.first[s + 1]
                        for p in range(a, b):
                            v0 = sets.points[3 * p] - o[0]
                            v1 = sets.points[3 * p + 1] - o[1]
                            v2 = sets.points[3 * p + 2] - o[2]
                            for x in range(3):
                                local[3 * p + x] = R[x] * v0 + R[3 + x] * v1 + R[6 + x] * v2
                        for x in range(3):
                            delta[x] = c[x] - (
                                R[x] * (ball[0] - o[0]) + R[3 + x] * (ball[1] - o[1]) + R[6 + x] * (ball[2] - o[2])
                            )
                        wanted = max(need, 0.0) if decide else min(worst.margin, enough) + need
                        gap = hull_gap(
                            self._vertices + 3 * self._first[g], self._first[g + 1] - self._first[g], local + 3 * a,
                            b - a, delta, wanted, max(close, CLOSE), decide
                        )
                        apart = max(apart, gap - need)
                    if apart < worst.margin:
                        worst = Worst(apart, w, g, s)
                        if limits.stop_at_first and worst.margin < 0.0:
                            return worst
        return worst

    def separating_axes(self, cells, sets, double far):
        """Return directions (G, M, 3) from sets to bodies, and lower bounds (G, M) of the distances along them [m].

        The robot is in the middle of the first cell; sets and bodies are without radii, growth and pads. Bounds of more
        than `far` [m] need not be known: they are infinite.
        """
        cdef Frames frames = self._frames(cells, 1, False)
        cdef Sets moving = _sets(sets)
        cdef Py_ssize_t G = self.count, S = moving.count, g, s, v, x, points
        cdef const double *R
        cdef const double *o
        cdef const double *own
        cdef double own_ball[4]
        cdef double ball[4]
        cdef double *axis
        directions, bounds = np.zeros((G, S, 3)), np.full((G, S), np.inf)
        cdef double[:, :, ::1] axes = directions
        cdef double[:, ::1] apart = bounds
        cdef double *hull = <double *> malloc(max(3 * self._first[G], 1) * sizeof(double))
        if not hull:
            raise MemoryError
        with nogil:
            for g in range(G):
                R = frames.rotations + 9 * self._carriers[g]
                o = frames.origins + 3 * self._carriers[g]
                own, points = self._vertices + 3 * self._first[g], self._first[g + 1] - self._first[g]
                for v in range(points):
                    for x in range(3):
                        hull[3 * v + x] = (
                            o[x] + R[3 * x] * own[3 * v] + R[3 * x + 1] * own[3 * v + 1]
                            + R[3 * x + 2] * own[3 * v + 2]
                        )
                ball_about(hull, points, own_ball)
                for s in range(S):
                    ball_about(moving.points + 3 * moving.first[s], moving.first[s + 1] - moving.first[s], ball)
                    axis = &axes[g, s, 0]
                    for x in range(3):
                        axis[x] = own_ball[x] - ball[x]
                    if sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]) - own_ball[3] - ball[3] < far:
                        apart[g, s] = hull_gap(
                            hull, points, moving.points + 3 * moving.first[s], moving.first[s + 1] - moving.first[s],
                            axis, INFINITY, COARSE, False
                        )
            free(hull)
        return directions, bounds

    def chords_ahead(
        self, cells, const double[:, :, ::1] axes, const double[:, ::1] apart, const double[::1] curvatures
    ):
        """Return which bodies (G, M) are apart from sets and do not approach them along `separating_axes`.

        The robot moves from the first cell to the second. Let a vertex be `start` ≥ 0 ahead of the foremost vertex in
        the first cell, and `end` ≥ 0 in the second, up to rounding. The vertex does not approach the set if
        √start + √end ≥ √curvature, with the bounds of curvature `curvatures: (G,)` [m].
        """
        cdef Frames frames = self._frames(cells, 2, False)
        cdef Py_ssize_t G = self.count, S = apart.shape[1], g, s, k, v, points
        cdef const double *R
        cdef const double *o
        cdef const double *u
        cdef const double *hull
        cdef double least[2]
        cdef double at, x, y, z, start, end
        cdef bint recedes
        if not apart.shape[0] == axes.shape[0] == curvatures.shape[0] == G or axes.shape[1] != S or axes.shape[2] != 3:
            raise InputError(f"axes, bounds and curvatures must be those of {G} bodies and {S} sets")
        ahead = np.zeros((G, S), dtype=np.bool_)
        cdef unsigned char[:, ::1] found = ahead.view(np.uint8)
        cdef Py_ssize_t V = self._first[G]
        cdef double *heights = <double *> malloc(max(2 * V, 1) * sizeof(double))
        if not heights:
            raise MemoryError
        with nogil:
            for g in range(G):
                hull, points = self._vertices + 3 * self._first[g], self._first[g + 1] - self._first[g]
                for s in range(S):
                    if not 0.0 < apart[g, s] < INFINITY:
                        continue
                    least[0] = least[1] = INFINITY
                    u = &axes[g, s, 0]
                    for k in range(2):
                        R = frames.rotations + 9 * (k * frames.m + self._carriers[g])
                        o = frames.origins + 3 * (k * frames.m + self._carriers[g])
                        at = o[0] * u[0] + o[1] * u[1] + o[2] * u[2]
                        x = R[0] * u[0] + R[3] * u[1] + R[6] * u[2]
                        y = R[1] * u[0] + R[4] * u[1] + R[7] * u[2]
                        z = R[2] * u[0] + R[5] * u[1] + R[8] * u[2]
                        for v in range(points):
                            heights[k * V + v] = at + hull[3 * v] * x + hull[3 * v + 1] * y + hull[3 * v + 2] * z
                            least[k] = min(least[k], heights[k * V + v])
                    recedes, v = least[1] - least[0] + ROUNDING >= 0.0, 0
                    while recedes and v < points:
                        start, end = heights[v] - least[0], heights[V + v] - least[0] + ROUNDING
                        recedes, v = sqrt(start) + sqrt(end) >= sqrt(curvatures[g]), v + 1
                    found[g, s] = recedes
            free(heights)
        return ahead


cdef Py_ssize_t _past_last(const Py_ssize_t[::1] at) except -1:
    """Return the least number of cells that the indices need."""
    cdef Py_ssize_t w, most = 0
    for w in range(at.shape[0]):
        if at[w] < 0:
            raise InputError(f"there is no cell {at[w]}")
        most = max(most, at[w] + 1)
    return most


cdef int _check_lists(const Py_ssize_t[::1] first, const double[:, ::1] points, str what, str of) except -1:
    """Raise InputError unless the indices increase from 0 to the number of points."""
    cdef Py_ssize_t k, last = first.shape[0] - 1
    if last < 0 or first[0] != 0 or first[last] != points.shape[0] or points.shape[1] != 3:
        raise InputError(f"{what} must lead from 0 to the number of {of} (…, 3)")
    for k in range(last):
        if not first[k] < first[k + 1]:
            raise InputError(f"list {k} of {of} is empty")
    return 0


cdef Sets _sets(sets) except *:
    cdef const double[:, ::1] points, growth
    cdef const Py_ssize_t[::1] first
    cdef const double[::1] radii
    cdef Sets found
    points, first, radii, growth = sets
    cdef Py_ssize_t S = radii.shape[0]
    _check_lists(first, points, "first_point", "points")
    if first.shape[0] != S + 1 or growth.shape[0] != S or growth.shape[1] != 2:
        raise InputError(f"first_point and growth must have shapes ({S + 1},) and ({S}, 2)")
    found.count, found.first = S, &first[0]
    found.points = &points[0, 0] if S else NULL
    found.radii = &radii[0] if S else NULL
    found.growth = &growth[0, 0] if S else NULL
    return found


cdef double *_work(const Sets *sets) except NULL:
    """Allocate memory for the points of sets in the frame of a joint, balls about the sets, and their growth."""
    cdef double *memory = <double *> malloc(max(3 * sets.first[sets.count] + 5 * sets.count, 1) * sizeof(double))
    if not memory:
        raise MemoryError
    return memory
