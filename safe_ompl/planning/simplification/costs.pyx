"""The cost functional of a path, J = ∫ (1 + λ·CDF(q)²) ds and that of obstacles, with gradients; its descent.

Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way J is ℓ·mean_j f_j. With way points x_k it has
the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.
"""

from libc.math cimport INFINITY, ceil, fabs, sqrt
from libc.stdlib cimport free, malloc
from libc.string cimport memcpy, memset

from safe_ompl.collision.proofs cimport add_hinge_costs, hinge_terms
from safe_ompl.danger.static cimport PointDanger
from safe_ompl.robot.kinematics cimport difference

import numpy as np

from safe_ompl.common import InputError
from safe_ompl.danger.static import MAXIMUM

# Two Gauss points of a segment: exact to the third order.
cdef double OFFSET = 0.5 / sqrt(3.0)
cdef double FIRST = 0.5 - OFFSET
cdef double SECOND = 0.5 + OFFSET
# Lengths below this count as this [rad]; segments shorter than this share of the mean count as such a share.
cdef double TINY = 1e-12
cdef double SHORT = 0.1

# Edges near obstacles are halved if they are longer than this [rad]. With shorter edges the descent converges slowly.
cdef double LONGEST_NEAR = 0.25

# The cost of an edge is that of samples at most this far apart [rad], of which there are so many.
cdef double EDGE_SPACING = 0.8
cdef enum:
    FEWEST_SAMPLES = 2
    MOST_SAMPLES = 4
    # More samples of a path would take more memory than a machine has.
    MOST_STEPS = 100_000_000


def arc_lengths(const double[:, ::1] path):
    """Return how far along an unrolled path (N, n) its way points are, (N,) [rad]."""
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1], k, i
    cdef double squared, step
    found = np.zeros(N)
    cdef double[::1] arc = found
    for k in range(1, N):
        squared = 0.0
        for i in range(n):
            step = path[k, i] - path[k - 1, i]
            squared += step * step
        arc[k] = arc[k - 1] + sqrt(squared)
    return found


def at_arc_lengths(const double[:, ::1] path, const double[::1] s):
    """Return the configurations (S, n) of an unrolled path (N, n) at arc lengths `s: (S,)`; the ends' beyond them."""
    found = np.empty((s.shape[0], path.shape[1]))
    cdef double[:, ::1] out = found
    if not path.shape[0]:
        raise InputError("a path needs a way point")
    if found.size:
        _write_at(path, &s[0], s.shape[0], &out[0, 0])
    return found


cdef void _write_at(const double[:, ::1] path, const double *s, Py_ssize_t S, double *out) noexcept nogil:
    """Write what `at_arc_lengths` returns."""
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1], j, i, k = 0
    cdef double begin = 0.0, end = distance(path, 0, 1) if N > 1 else 0.0, slope
    for j in range(S):
        # The segment that begins at way point k leads from arc length `begin` to `end`.
        if s[j] < begin:
            k, begin, end = 0, 0.0, distance(path, 0, 1)
        while k + 1 < N and s[j] >= end:
            k, begin = k + 1, end
            if k + 1 < N:
                end = begin + distance(path, k, k + 1)
        for i in range(n):
            out[n * j + i] = path[k, i]
            if k + 1 < N and s[j] > begin:
                slope = (path[k + 1, i] - path[k, i]) / (end - begin)
                out[n * j + i] += slope * (s[j] - begin)


cdef double length_of(const double[:, ::1] path) noexcept nogil:
    """Return how long an unrolled path (N, n) is [rad]."""
    cdef double length = 0.0
    cdef Py_ssize_t k
    for k in range(1, path.shape[0]):
        length += distance(path, k - 1, k)
    return length


cdef double distance(const double[:, ::1] path, Py_ssize_t a, Py_ssize_t b) noexcept nogil:
    cdef double squared = 0.0, step
    cdef Py_ssize_t i
    for i in range(path.shape[1]):
        step = path[b, i] - path[a, i]
        squared += step * step
    return sqrt(squared)


cdef Py_ssize_t _sample_count(const double[:, ::1] path, double length, double step) except -1:
    """Return how many samples there are on a path of some length, no farther apart than `step`, with both ends."""
    if not path.shape[0]:
        raise InputError("a path needs a way point")
    if not 0.0 <= length < MOST_STEPS * step:
        raise InputError(f"there must be less than {MOST_STEPS} steps of {step:g} in a path of length {length:g}")
    return 2 + <Py_ssize_t> (length / step)


cdef void _write_samples(const double[:, ::1] path, double length, Py_ssize_t S, double *s, double *out) noexcept nogil:
    """Write arc lengths (S,) and configurations (S, n) at equal steps along an unrolled path of some length."""
    cdef Py_ssize_t j
    for j in range(S):
        s[j] = j * (length / (S - 1))
    _write_at(path, s, S, out)


def spread(const double[:, ::1] path, double step):
    """Return configurations (S, n) of an unrolled path (N, n) at equal steps, no longer than `step`, and its length."""
    cdef double length = length_of(path)
    cdef Py_ssize_t S = _sample_count(path, length, step)
    found = np.empty((S, path.shape[1]))
    cdef double[:, ::1] out = found
    cdef double[::1] s = np.empty(S)
    if found.size:
        _write_samples(path, length, S, &s[0], &out[0, 0])
    return found, length


def divided(const double[:, ::1] path, double spacing):
    """Return the same path (N', n), whose way points are at most `spacing` apart [rad]; (N, n) is unrolled."""
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1], k, i, place, parts, row = 0
    cdef double length = length_of(path), share
    if not N or not length < MOST_STEPS * spacing:
        raise InputError(f"a path of {N} way points and {length:g} rad cannot be divided at {spacing:g} rad")
    found = np.empty((N + <Py_ssize_t> (length / spacing) + 1, n))
    cdef double[:, ::1] out = found
    for k in range(N - 1):
        parts = max(1, <Py_ssize_t> ceil(distance(path, k, k + 1) / spacing))
        for place in range(parts):
            share = <double> place / parts
            for i in range(n):
                # The given way points stay exactly equal, without rounding.
                out[row, i] = path[k, i] + share * (path[k + 1, i] - path[k, i]) if place else path[k, i]
            row += 1
    for i in range(n):
        out[row, i] = path[N - 1, i]
    return found[: row + 1].copy()


def refined(const double[:, ::1] path, rows_near):
    """Return the same path (N', n) with halved edges near obstacles.

    `rows_near(Q)` returns the indices of the configurations of `Q: (B, n)` that are near obstacles.
    """
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1], k, i, B = N, row = 0, middle = N
    looked_at, found = np.empty((2, max(0, 2 * N - 1), n))
    cdef double[:, ::1] Q = looked_at
    cdef double[:, ::1] out = found
    looked_at[:N] = path
    for k in range(N - 1):
        if distance(path, k, k + 1) > LONGEST_NEAR:
            for i in range(n):
                Q[B, i] = 0.5 * (path[k + 1, i] + path[k, i])
            B += 1
    marks = np.zeros(B, np.uint8)
    marks[rows_near(looked_at[:B])] = True
    cdef const unsigned char[::1] near = marks
    for k in range(N):
        for i in range(n):
            out[row, i] = path[k, i]
        row += 1
        if k + 1 < N and distance(path, k, k + 1) > LONGEST_NEAR:
            if near[k] or near[k + 1] or near[middle]:
                for i in range(n):
                    out[row, i] = Q[middle, i]
                row += 1
            middle += 1
    return found[:row].copy()


def gauss_points(const double[:, ::1] path):
    """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1]
    found = np.empty((max(0, 2 * N - 2), n))
    cdef double[:, ::1] out = found
    if N > 1 and n:
        _write_gauss_points(&path[0, 0], N, n, &out[0, 0])
    return found


cdef void _write_gauss_points(const double *path, Py_ssize_t N, Py_ssize_t n, double *out) noexcept nogil:
    cdef Py_ssize_t b, i
    cdef const double *row
    cdef double t
    for b in range(2 * N - 2):
        t, row = SECOND if b % 2 else FIRST, path + n * (b // 2)
        for i in range(n):
            out[n * b + i] = row[i] + t * (row[n + i] - row[i])


cdef class DangerTerms:
    """The part of J that danger is: λ·CDF(q)² for configurations of the planned joints.

    Parameters
    ----------
    danger : PointDanger
        The danger.
    weight : float
        λ.
    matrix, shift : ndarray, shapes (m, n) and (m,)
        The values of the model's joints are matrix·q + shift.
    """

    def __init__(self, PointDanger danger not None, double weight, matrix, shift):
        self.danger, self.weight, self.matrix, self.shift = danger, weight, matrix, shift
        self._matrix, self._shift = matrix, shift
        self.m, self.n = self._matrix.shape[0], self._matrix.shape[1]
        if self._shift.shape[0] != self.m or danger.skeleton.data.m != self.m:
            raise InputError(f"matrix and shift must be of the model's {danger.skeleton.data.m} joints")

    cdef int write(self, const double *Q, Py_ssize_t B, double *values, double *slopes, double *danger) except -1 nogil:
        """Write the joints' values (B, m) and the danger (B,) at `Q: (B, n)`, and slopes (B, m) unless NULL."""
        cdef Py_ssize_t b, j, i
        for b in range(B):
            for j in range(self.m):
                values[self.m * b + j] = self._shift[j]
                for i in range(self.n):
                    values[self.m * b + j] += self._matrix[j, i] * Q[self.n * b + i]
        return self.danger.write(values, B, slopes, danger) if danger != NULL else 0

    cdef void write_by_planned_joints(self, const double *slopes, Py_ssize_t C, double *out) noexcept nogil:
        """Write derivatives (C, n) by the planned joints from those (C, m) by the model's joints."""
        cdef Py_ssize_t c, i, j
        for c in range(C):
            for i in range(self.n):
                out[self.n * c + i] = 0.0
                for j in range(self.m):
                    out[self.n * c + i] += self._matrix[j, i] * slopes[self.m * c + j]

    cdef double cost_along(self, const double[:, ::1] path, double step, Py_ssize_t *samples) except? -1:
        """Return J of an unrolled path (N, n) by the trapezoidal rule; write from how many samples.

        Samples are `step` [rad] apart.
        """
        cdef double length = length_of(path), total = 0.0
        cdef Py_ssize_t B = _sample_count(path, length, step), k
        cdef double *Q
        cdef double *values
        cdef double *danger
        if path.shape[1] != self.n:
            raise InputError(f"way points must have {self.n} joints, got {path.shape[1]}")
        Q = <double *> malloc(B * (self.n + self.m + 2) * sizeof(double))
        if not Q:
            raise MemoryError
        values, danger = Q + B * self.n, Q + B * (self.n + self.m)
        try:
            _write_samples(path, length, B, danger + B, Q)
            self.write(Q, B, values, NULL, danger)
            for k in range(B):
                total += (0.5 if k == 0 or k == B - 1 else 1.0) * (danger[k] * danger[k])
        finally:
            free(Q)
        samples[0] = B
        return length * (1.0 + self.weight * total / (B - 1))

    def edge_costs(self, const double[:, ::1] path, wanted, continuous):
        """Return J (N, N) by the midpoint rule of edges between way points (N, n), and from how many samples.

        Of edges to earlier way points, and of those that are not `wanted: (N, N)`, it is ∞.
        """
        cdef Py_ssize_t N = path.shape[0], n = path.shape[1], a, b, i, s, _, total = 0, number
        cdef const unsigned char[:, ::1] asked = np.ascontiguousarray(wanted, dtype=np.bool_).view(np.uint8)
        cdef const unsigned char[::1] wraps = np.ascontiguousarray(continuous, dtype=np.bool_).view(np.uint8)
        cdef double squares, step
        if n != self.n or wraps.shape[0] != n or asked.shape[0] != N or asked.shape[1] != N:
            raise InputError(f"way points must have {self.n} joints, and edges be wanted for each two of them")
        found, counts = np.full((N, N), INFINITY), np.zeros((N, N), np.intp)
        rows = np.empty((MOST_SAMPLES * np.count_nonzero(wanted) + 1, n))
        cdef double[:, ::1] costs = found
        cdef Py_ssize_t[:, ::1] numbers = counts
        cdef double[:, ::1] samples = rows
        for a in range(N):
            for b in range(a + 1, N):
                if not asked[a, b]:
                    continue
                squares = 0.0
                for i in range(n):
                    step = difference(path[a, i], path[b, i], wraps[i])
                    squares += step * step
                costs[a, b] = sqrt(squares)
                # In this order of its arguments max() makes the fewest samples of NaN.
                step = min(max(<double> FEWEST_SAMPLES, ceil(costs[a, b] / EDGE_SPACING)), <double> MOST_SAMPLES)
                numbers[a, b] = number = <Py_ssize_t> step
                for s in range(number):
                    for i in range(n):
                        step = difference(path[a, i], path[b, i], wraps[i])
                        samples[total, i] = path[a, i] + (s + 0.5) / number * step
                    total += 1
        memory = np.empty(total * (self.m + 1) + 1)
        cdef double[::1] danger = memory
        with nogil:
            self.write(&samples[0, 0], total, &danger[total], NULL, &danger[0])
            s = 0
            for a in range(N):
                for b in range(a + 1, N):
                    squares = 0.0
                    for _ in range(numbers[a, b]):
                        squares += danger[s] * danger[s]
                        s += 1
                    costs[a, b] *= 1.0 + self.weight * squares / max(<Py_ssize_t> 1, numbers[a, b])
        return found, total


cdef class PricedPath:
    """A path of N way points, and what it costs: the cost of obstacles in it, the gradient, danger at B Gauss points.

    Attributes
    ----------
    value, near : float
        The cost by the Gauss points, and the part of it that obstacles are.
    cost : float
        J of the whole path that this is a part of, by samples of it; 0 unless it is set.
    blocks, beside : ndarray, shapes (N, n, n) and (N − 1, n, n)
        About the Hessian, blocks on its diagonal and right of them; None unless `Densities.model` made them.
    path, gradient : ndarray, shape (N, n)
    danger, slopes : ndarray, shapes (B,) and (B, m)
        The danger, and its gradients by the model's joints.
    """

    def __cinit__(self, path, Py_ssize_t m):
        cdef double[:, ::1] rows = np.array(path, dtype=np.float64, order="C")
        cdef Py_ssize_t N = rows.shape[0], n = rows.shape[1], B = 2 * N - 2
        if N < 2 or n < 1 or m < 1:
            raise InputError(f"a path needs at least two way points and one joint, got {N} of {n}")
        cdef double[:, ::1] gradient = np.zeros((N, n))
        cdef double[::1] danger = np.zeros(B)
        cdef double[:, ::1] slopes = np.zeros((B, m))
        self.path, self.gradient, self.danger, self.slopes = rows.base, gradient.base, danger.base, slopes.base
        self._path, self._gradient, self._danger, self._slopes = (
            &rows[0, 0], &gradient[0, 0], &danger[0], &slopes[0, 0]
        )
        self.N, self.n, self.m = N, n, m
        self._nodes = <double *> malloc((B * n + 2 * B * m + B + N + 15 * m) * sizeof(double))
        if not self._nodes:
            raise MemoryError
        self._values = self._nodes + B * n
        self._obstacle_slopes = self._values + B * m
        self._nears = self._obstacle_slopes + B * m
        self._lengths = self._nears + B
        self._frames = self._lengths + N

    def __dealloc__(self):
        free(self._nodes)


cdef class Densities:
    """What J and the cost of obstacles are near a path.

    Parameters
    ----------
    terms : DangerTerms
        The danger.
    carriers : ndarray of intp, shape (K,)
        Pinocchio's numbers of the joints that carry the first bodies of K pairs.
    near : ndarray, shape (C, 10)
        What `DistanceBounds.near` returns of these pairs at the path's Gauss points.
    hinges : ndarray, shape (H, 2)
        Distances [m] at which obstacles begin to count, and weights.
    """

    def __init__(self, DangerTerms terms not None, carriers, near, hinges):
        cdef Py_ssize_t c
        self.terms, self.carriers, self.near, self.hinges = terms, carriers, near, hinges
        self._joints = terms.danger.skeleton.keys.joints
        self._carriers, self._near, self._hinges = carriers, near, hinges
        self._rows = 0
        if self._near.shape[1] != 10:
            raise InputError("near pairs must have 10 columns")
        for c in range(self._near.shape[0]):
            # Whole numbers above are not all numbers of C.
            if not 0.0 <= self._near[c, 0] < 2.0**53:
                raise InputError(f"near pair {c} is of a configuration that there is not")
            self._rows = max(self._rows, 1 + <Py_ssize_t> self._near[c, 0])
        self._obstacle_terms = hinge_terms(self._joints, self._rows, self._carriers, self._near, self._hinges)

    cdef int check(self, Py_ssize_t n, Py_ssize_t rows) except -1:
        """Raise InputError if configurations (rows, n) are of other joints, or fewer than those with near pairs."""
        if n != self.terms.n or rows < self._rows:
            raise InputError(f"costs are of {self.terms.n} joints at {self._rows} or more places, got {n} at {rows}")
        return 0

    cdef void add_near(
        self, const double *values, double *frames, double *costs, double *gradients, double *vectors
    ) noexcept nogil:
        """Add what obstacles cost (B,) at values (B, m) of the joints; see `add_hinge_costs`."""
        if self._obstacle_terms.near_count and self._obstacle_terms.hinge_count:
            add_hinge_costs(
                self._joints.data, self.terms.m, values, &self._obstacle_terms, frames, costs, gradients, vectors
            )

    cdef int price(self, PricedPath at, bint known, double *vectors) except -1 nogil:
        """Write a path's cost and, unless NULL, vectors (C, m) of its second derivatives. Its danger may be known."""
        cdef Py_ssize_t B = 2 * at.N - 2, m = at.m
        _write_gauss_points(at._path, at.N, at.n, at._nodes)
        if not known:
            memset(at._slopes, 0, B * m * sizeof(double))
        self.terms.write(
            at._nodes, B, at._values, NULL if known else at._slopes, NULL if known else at._danger
        )
        memset(at._obstacle_slopes, 0, B * m * sizeof(double))
        memset(at._nears, 0, B * sizeof(double))
        self.add_near(at._values, at._frames, at._nears, at._obstacle_slopes, vectors)
        _integrate(at, self.terms)
        return 0

    def model(self, path):
        """Return the model of the cost of an unrolled path (N, n), by two Gauss points on each segment.

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the densities
        add is their Gauss-Newton part; so the whole is positive.
        """
        return self.priced(path, None)

    cdef PricedPath priced(self, const double[:, ::1] path, PricedPath known):
        """Return what `model` does; the danger at the Gauss points of the path may be known."""
        cdef PricedPath at = PricedPath(path, self.terms.m)
        cdef Py_ssize_t N = at.N, n = at.n, B = 2 * N - 2
        self.check(n, B)
        if known is not None and (known.N != N or known.m != at.m):
            raise InputError(f"the danger must be known at {B} Gauss points")
        if known is not None:
            memcpy(at._danger, known._danger, B * sizeof(double))
            memcpy(at._slopes, known._slopes, B * at.m * sizeof(double))
        at.blocks, at.beside = np.zeros((N, n, n)), np.zeros((N - 1, n, n))
        cdef double[:, :, ::1] block = at.blocks
        cdef double[:, :, ::1] side = at.beside
        cdef double[:, ::1] vector = np.zeros((self._near.shape[0] + 1, at.m))
        cdef double[::1] curvature_vector = np.zeros(n)
        with nogil:
            self.price(at, known is not None, &vector[0, 0])
            _add_curvature(self, at, &vector[0, 0], &curvature_vector[0], &block[0, 0, 0], &side[0, 0, 0])
        return at

    def retreat_step(
        self, const double[:, ::1] Q, double reference, double excess_weight, double onset, double longest
    ):
        """Return the cost of `Q: (1, n)`, the danger to which it is compared (0: its own), and the best step from Q.

        The cost is that of obstacles, and of danger w Σ_m (CDF(p_m)/reference − onset)₊². The step is no longer than
        `longest` [rad].
        """
        cdef DangerTerms terms = self.terms
        cdef Py_ssize_t m = terms.m, n = terms.n, C = self._near.shape[0], L, c, i
        cdef double cost = 0.0, excess
        self.check(Q.shape[1], Q.shape[0])
        values, own, slopes = np.empty((1, m)), np.zeros(1), np.zeros((1, m))
        cdef double[:, ::1] value = values
        cdef double[:, ::1] slope = slopes
        cdef double[::1] levels = own
        cdef double[:, ::1] obstacle_slope = np.zeros((1, m))
        cdef double[:, ::1] vector = np.zeros((C + 1, m))
        cdef double[::1] frames = np.empty(15 * m)
        terms.write(&Q[0, 0], 1, &value[0, 0], NULL, NULL)
        self.add_near(&value[0, 0], &frames[0], &cost, &obstacle_slope[0, 0], &vector[0, 0])
        maximum = terms.danger.kind == MAXIMUM
        if reference == 0.0 or not maximum:
            terms.danger.write(&value[0, 0], 1, &slope[0, 0], &levels[0])
        reference = own[0] if reference == 0.0 else reference
        if cost == 0.0 or not 0.0 < reference < INFINITY:
            own, slopes = own[:0], slopes[:0]
        elif maximum:
            own, slopes = terms.danger.high_levels(values, onset * reference)
        levels, slope, L = own, slopes, len(own)
        gradients, curvature_vectors = np.zeros(n), np.zeros((C + L, n))
        cdef double[::1] gradient = gradients
        cdef double[:, ::1] curvature_vector = curvature_vectors
        terms.write_by_planned_joints(&obstacle_slope[0, 0], 1, &gradient[0])
        if C:
            terms.write_by_planned_joints(&vector[0, 0], C, &curvature_vector[0, 0])
        if L:
            terms.write_by_planned_joints(&slope[0, 0], L, &curvature_vector[C, 0])
        for c in range(L):
            excess = max(0.0, levels[c] / reference - onset)
            cost += excess_weight * excess * excess
            for i in range(n):
                gradient[i] += 2.0 * excess_weight * excess * curvature_vector[C + c, i] / reference
                curvature_vector[C + c, i] *= sqrt(2.0 * excess_weight) / reference if excess > 0.0 else 0.0
        return cost, reference, bounded_step(gradients, curvature_vectors, longest)


cdef void _integrate(PricedPath at, DangerTerms terms) noexcept nogil:
    """Write the cost of a path, the part that obstacles are, the gradient (N, n), and the lengths of the segments."""
    cdef const double *matrix = &terms._matrix[0, 0]
    cdef const double *path = at._path
    cdef double *gradient = at._gradient
    cdef const double *danger = at._danger
    cdef const double *slopes = at._slopes
    cdef const double *obstacle_slopes = at._obstacle_slopes
    cdef double rate = 2.0 * terms.weight, total = 0.0, near = 0.0, mean, steepness, stretch, step, length
    cdef Py_ssize_t N = at.N, n = at.n, m = at.m, k, i, j, b, side
    cdef double first, second
    for i in range(N * n):
        gradient[i] = 0.0
    for k in range(N - 1):
        length = 0.0
        for i in range(n):
            step = path[n * (k + 1) + i] - path[n * k + i]
            length += step * step
        at._lengths[k] = length = sqrt(length)
        mean = 1.0
        for side in range(2):
            b = 2 * k + side
            mean += 0.5 * (0.5 * rate * (danger[b] * danger[b]) + at._nears[b])
            near += 0.5 * length * at._nears[b]
        total += length * mean
        for i in range(n):
            first = second = 0.0
            b = 2 * k
            for j in range(m):
                steepness = rate * danger[b] * slopes[m * b + j] + obstacle_slopes[m * b + j]
                first += 0.5 * length * steepness * matrix[n * j + i]
            b = 2 * k + 1
            for j in range(m):
                steepness = rate * danger[b] * slopes[m * b + j] + obstacle_slopes[m * b + j]
                second += 0.5 * length * steepness * matrix[n * j + i]
            stretch = mean / max(length, TINY) * (path[n * (k + 1) + i] - path[n * k + i])
            gradient[n * k + i] += SECOND * first + FIRST * second - stretch
            gradient[n * (k + 1) + i] += FIRST * first + SECOND * second + stretch
    at.value, at.near = total, near


cdef void _add_curvature(
    Densities densities, PricedPath at, const double *vectors, double *curvature_vector, double *blocks, double *beside
) noexcept nogil:
    """Add about the Hessian of the cost of a path to blocks (N, n, n), and (N − 1, n, n) beside them.

    Vectors (C, m) give the second derivatives of the costs of near pairs; `curvature_vector: (n,)` is memory.
    """
    cdef const double *matrix = &densities.terms._matrix[0, 0]
    cdef Py_ssize_t N = at.N, n = at.n, m = at.m, C = densities._near.shape[0], k, i, j, c, b
    cdef double rate = 2.0 * densities.terms.weight, whole = 0.0, stiffness, t, square, each
    cdef bint of_danger
    for k in range(N - 1):
        whole += at._lengths[k]
    whole = max(whole, TINY)
    for k in range(N - 1):
        stiffness = at.value / whole / max(at._lengths[k], SHORT * whole / (N - 1))
        for i in range(n):
            blocks[n * n * k + n * i + i] += stiffness
            blocks[n * n * (k + 1) + n * i + i] += stiffness
            beside[n * n * k + n * i + i] -= stiffness
    for c in range(2 * N - 2 + C):
        of_danger = c < 2 * N - 2
        b = c if of_danger else <Py_ssize_t> densities._near[c - (2 * N - 2), 0]
        k, t = b // 2, SECOND if b % 2 else FIRST
        for i in range(n):
            curvature_vector[i] = 0.0
        for j in range(m):
            each = sqrt(rate) * at._slopes[m * b + j] if of_danger else vectors[m * (c - (2 * N - 2)) + j]
            for i in range(n):
                curvature_vector[i] += each * matrix[n * j + i]
        for i in range(n):
            for j in range(n):
                square = 0.5 * at._lengths[k] * curvature_vector[i] * curvature_vector[j]
                blocks[n * n * k + n * i + j] += (1.0 - t) * (1.0 - t) * square
                blocks[n * n * (k + 1) + n * i + j] += t * t * square
                beside[n * n * k + n * i + j] += t * (1.0 - t) * square


cdef enum:
    NEWTON_STEPS = 30
# Relative precision of the length of a step; less of the curvature, or of the slope per radian, is as good as none.
cdef double PRECISION = 1e-9
cdef double FLAT = 1e-9


def bounded_step(const double[::1] gradient, const double[:, ::1] vectors, double longest):
    """Return the step s (n,), no longer than `longest`, that minimises g·s + ½ sᵀHs, H = Σ vvᵀ of vectors (C, n).

    It is −(H + λ1)⁻¹g with the least λ ≥ 0 that makes it short enough, which Newton's method on 1/‖s(λ)‖ finds from
    below in a few steps (Moré & Sorensen 1983).
    """
    cdef Py_ssize_t n = gradient.shape[0], i, j, k, c, _
    cdef double curvature = 0.0, slope = 0.0, shift, rest, length, square
    if vectors.shape[1] != n:
        raise InputError(f"vectors must have {n} columns, as the gradient, got {vectors.shape[1]}")
    hessian, factor, found, other = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.empty(n)
    cdef double[:, ::1] H = hessian
    cdef double[:, ::1] L = factor
    cdef double[::1] step = found
    cdef double[::1] across = other
    for i in range(n):
        for j in range(n):
            for c in range(vectors.shape[0]):
                H[i, j] += vectors[c, i] * vectors[c, j]
        curvature, slope = curvature + H[i, i], slope + gradient[i] * gradient[i]
    shift = FLAT * max(curvature, sqrt(slope))
    for _ in range(NEWTON_STEPS if slope > 0.0 else 0):
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
        length = square = 0.0
        for i in range(n):
            length += step[i] * step[i]
        length = sqrt(length)
        if length <= (1.0 + PRECISION) * longest:
            break
        for i in range(n):
            across[i] = step[i]
            for k in range(i):
                across[i] -= L[i, k] * across[k]
            across[i] /= L[i, i]
            square += across[i] * across[i]
        shift += (length / longest - 1.0) * (length * length) / square
    return found


# ------------------------------------------------------------------------------------------------------------ descent

# Pairs of steps and changes of the gradient that are remembered.
cdef enum:
    MEMORY = 6
    TRIALS = 6
    # Steps that save little in a row end a round; one alone may have met a kink of the danger.
    IDLE_STEPS = 2
    # Steps between two looks at the clock.
    AT_ONCE = 4
# A step must bring this share of the fall that the gradient promises (Armijo). A step may be longer than the last one
# by the factor GROWTH; one that fails is shortened to between SHORTEST and LONGEST of it.
cdef double SUFFICIENT = 1e-4
cdef double GROWTH = 2.0
cdef double SHORTEST = 0.1
cdef double LONGEST = 0.5
# A pair whose product is below this says nothing of the curvature.
cdef double LEAST_PRODUCT = 1e-10


cdef class Walk:
    """L-BFGS descent of a path over its way points (N, n) (Nocedal & Wright, alg. 7.4 and 7.5).

    The first Hessian of every step is a chain of springs between way points, as in CHOMP (Ratliff et al. 2009), and the
    Gauss-Newton part of the densities: blocks on and beside the diagonal, solved in O(N). A step that does not lower
    the cost is shortened to where a parabola has its minimum.

    Parameters
    ----------
    lower, upper : ndarray, shape (n,)
        Limits of the joints.
    """

    def __init__(self, lower, upper):
        self._lower, self._upper = lower, upper

    @property
    def here(self):
        """Where the descent is, a `PricedPath`; once a step was taken with the danger at its Gauss points."""
        return self._place()

    @property
    def cost(self):
        """The cost of the path."""
        return self._place().value

    cdef PricedPath _place(self):
        """Return the path, with what it costs; raise InputError if there is none, or a restart failed."""
        if self._densities is None:
            raise InputError("a descent needs a path: call restart first")
        return self._here

    def restart(self, Densities densities not None, PricedPath at not None, held=None):
        """Begin anew from a path; way points that are `held: (N,)` stay where they are, and so do the ends."""
        self._densities = None
        moving = np.ones(at.N, np.uint8)
        if held is not None:
            moving[held] = 0
        moving[[0, -1]] = 0
        self._moving, self._size, self._remembered = moving, 1.0, 0
        self._steps, self._changes = np.empty((MEMORY, at.N, at.n)), np.empty((MEMORY, at.N, at.n))
        self._direction = np.empty((at.N, at.n))
        self.resume(densities, at)

    def resume(self, Densities densities not None, PricedPath at not None):
        """Go on from a path near the last one, or with another model of the cost, without what was known of it.

        What is remembered of the steps so far stays.
        """
        cdef Py_ssize_t N = self._steps.shape[1], n = self._steps.shape[2], k, i
        self._densities = None
        if at.N != N or at.n != n:
            raise InputError(f"the path must have shape ({N}, {n}), got ({at.N}, {at.n})")
        if self._lower.shape[0] != n or self._upper.shape[0] != n:
            raise InputError(f"way points must have {self._lower.shape[0]} joints, got {n}")
        densities.check(n, 2 * N - 2)
        self._here, self._next = PricedPath(at.path, densities.terms.m), PricedPath(at.path, densities.terms.m)
        self._here.value, self._here.near = at.value, at.near
        for k in range(N):
            for i in range(n):
                self._here._gradient[n * k + i] = at._gradient[n * k + i] if self._moving[k] else 0.0
        self._band = factored(at.blocks, at.beside, self._moving)
        if self._band.shape[0] != N * n:
            raise InputError(f"blocks must be of {n} joints")
        self._densities, self._idle, self.evaluations = densities, 0, 0

    def descend(self, stop, Py_ssize_t most, double largest, double idle):
        """Take up to so many steps, until it is time to stop; return whether more are not worthwhile.

        That is where no step lowers the cost, or the last ones did by less than a share `idle`, or `stop()` says so. In
        a step no joint moves farther than `largest`.
        """
        cdef Py_ssize_t done = 0
        cdef bint settled = False
        self._place()
        while done < most and not settled:
            if stop():
                return True
            with nogil:
                settled = self._take_steps(min(<Py_ssize_t> AT_ONCE, most - done), largest, idle)
            done += AT_ONCE
        return settled

    def direction(self):
        """Return the way (N, n) that a step is a part of, −H⁻¹∇J; ∇J·x, and the largest |x|."""
        cdef double slope, largest
        self._place()
        slope = self._write_direction(&largest)
        return np.array(self._direction), slope, largest

    cdef int _take_steps(self, Py_ssize_t most, double largest, double idle) except -1 nogil:
        """Take so many steps; return whether more are not worthwhile."""
        cdef double before, slope, longest, size, second_derivative, share
        cdef Py_ssize_t _
        cdef bint lowered
        for _ in range(most):
            before, lowered = self._here.value, False
            while not lowered:
                slope = self._write_direction(&longest)
                size = min(min(1.0, largest / longest), GROWTH * self._size) if slope < 0.0 else 0.0
                for _ in range(TRIALS if slope < 0.0 else 0):
                    self._go(size)
                    self._densities.price(self._next, False, NULL)
                    self.evaluations += 1
                    if self._next.value < before + SUFFICIENT * size * slope:
                        self._size, lowered = size, True
                        self._accept()
                        break
                    second_derivative = self._next.value - before - size * slope
                    share = SHORTEST
                    if second_derivative < INFINITY:
                        share = min(LONGEST, max(SHORTEST, -0.5 * size * slope / second_derivative))
                    size *= share
                if not lowered:
                    if self._remembered == 0:
                        return True
                    # What is remembered may be of another part of the path's surroundings.
                    self._remembered = 0
            self._idle = self._idle + 1 if before - self._here.value < idle * before else 0
            if self._idle == IDLE_STEPS:
                return True
        return False

    cdef void _go(self, double size) noexcept nogil:
        """Write the path to which a share of the direction leads, within the limits."""
        cdef Py_ssize_t n = self._here.n, k, i
        for k in range(self._here.N):
            for i in range(n):
                self._next._path[n * k + i] = min(
                    max(self._here._path[n * k + i] + size * self._direction[k, i], self._lower[i]), self._upper[i]
                )

    cdef void _accept(self) noexcept nogil:
        """Go on to the next path, and remember the step."""
        cdef Py_ssize_t row = self._remembered % MEMORY, n = self._here.n, k, i, at
        cdef double product = 0.0
        cdef double *path = self._next._path
        cdef double *gradient = self._next._gradient
        for k in range(self._here.N):
            for i in range(n):
                at = n * k + i
                if not self._moving[k]:
                    gradient[at] = 0.0
                self._steps[row, k, i] = path[at] - self._here._path[at]
                self._changes[row, k, i] = gradient[at] - self._here._gradient[at]
                product += self._steps[row, k, i] * self._changes[row, k, i]
        with gil:
            self._here, self._next = self._next, self._here
        self._products[row] = product
        if product > LEAST_PRODUCT:
            self._remembered += 1

    cdef double _write_direction(self, double *largest) noexcept nogil:
        """Write x = −H⁻¹∇J (N, n) with the Hessian H that the remembered steps make of L Lᵀ, and the largest |x|.

        Return ∇J·x.
        """
        cdef double *x = &self._direction[0, 0]
        cdef const double *gradient = self._here._gradient
        cdef const double *step
        cdef const double *change
        cdef double shares[MEMORY]
        cdef double share, slope = 0.0
        cdef Py_ssize_t size = self._here.N * self._here.n, w = self._band.shape[1] - 1, remembered = self._remembered
        cdef Py_ssize_t age, row, i, j
        for i in range(size):
            x[i] = gradient[i]
        for age in range(min(remembered, <Py_ssize_t> MEMORY)):
            row, share = (remembered - 1 - age) % MEMORY, 0.0
            step, change = &self._steps[row, 0, 0], &self._changes[row, 0, 0]
            for i in range(size):
                share += step[i] * x[i]
            shares[row] = share / self._products[row]
            for i in range(size):
                x[i] -= shares[row] * change[i]
        for i in range(size):
            for j in range(max(<Py_ssize_t> 0, i - w), i):
                x[i] -= self._band[i, j - i + w] * x[j]
            x[i] /= self._band[i, w]
        for i in range(size - 1, -1, -1):
            x[i] /= self._band[i, w]
            for j in range(max(<Py_ssize_t> 0, i - w), i):
                x[j] -= self._band[i, j - i + w] * x[i]
        for age in range(min(remembered, <Py_ssize_t> MEMORY) - 1, -1, -1):
            row, share = (remembered - 1 - age) % MEMORY, 0.0
            step, change = &self._steps[row, 0, 0], &self._changes[row, 0, 0]
            for i in range(size):
                share += change[i] * x[i]
            for i in range(size):
                x[i] += (shares[row] - share / self._products[row]) * step[i]
        largest[0] = 0.0
        for i in range(size):
            x[i] = -x[i]
            slope += x[i] * gradient[i]
            largest[0] = max(largest[0], fabs(x[i]))
        return slope


def factored(const double[:, :, ::1] blocks, const double[:, :, ::1] beside, const unsigned char[::1] moving):
    """Return the factor's band (N·n, 2n) of a matrix with blocks (N, n, n), and (N − 1, n, n) right of them.

    Row i of a band holds the entries (i, i − w) … (i, i) of the lower triangle, w = 2n − 1. Rows and columns of way
    points that are not `moving: (N,)` are those of the unit matrix.
    """
    cdef Py_ssize_t N = blocks.shape[0], n = blocks.shape[1], w = 2 * n - 1, k, a, b, i, j
    cdef double rest
    if np.shape(blocks) != (N, n, n) or np.shape(beside) != (N - 1, n, n) or moving.shape[0] != N:
        raise InputError(f"blocks must be of {N} way points of {n} joints")
    found = np.zeros((N * n, 2 * n))
    cdef double[:, ::1] band = found
    with nogil:
        for k in range(N):
            for a in range(n):
                if not moving[k]:
                    band[k * n + a, w] = 1.0
                    continue
                for b in range(a + 1):
                    band[k * n + a, w + b - a] = blocks[k, a, b]
                if k > 0 and moving[k - 1]:
                    for b in range(n):
                        band[k * n + a, w - n + b - a] = beside[k - 1, b, a]
        for i in range(N * n):
            for j in range(max(<Py_ssize_t> 0, i - w), i + 1):
                rest = band[i, j - i + w]
                for k in range(max(<Py_ssize_t> 0, i - w), j):
                    rest -= band[i, k - i + w] * band[j, k - j + w]
                band[i, j - i + w] = sqrt(rest) if i == j else rest / band[j, w]
    return found
