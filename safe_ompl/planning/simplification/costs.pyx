"""The cost functional of a path, J = ∫ (1 + λ·CDF(q)²) ds and that of obstacles, with gradients; its descent.

Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way J is ℓ·mean_j f_j. With way points x_k it has
the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.
"""

from libc.math cimport INFINITY, M_PI, ceil, fabs, rint, sqrt

from safe_ompl.collision.proofs cimport DistanceBounds, Outcome, Required, Workspace, prove_edge
from safe_ompl.danger.static cimport PointDanger
from safe_ompl.robot.kinematics cimport EdgeTable, difference

from typing import NamedTuple

import numpy as np

from safe_ompl.collision.proofs import hinge_costs
from safe_ompl.common import InputError
from safe_ompl.danger.static import MAXIMUM

# Two Gauss points of a segment: exact to the third order.
cdef double OFFSET = 0.5 / sqrt(3.0)
cdef double FIRST = 0.5 - OFFSET
cdef double SECOND = 0.5 + OFFSET
# Lengths below this count as this [rad]; segments shorter than this share of the mean count as such a share.
cdef double TINY = 1e-12
cdef double SHORT = 0.1

# The cost of an edge is that of samples at most this far apart [rad], of which there are so many.
cdef double EDGE_SPACING = 0.8
cdef enum:
    FEWEST_SAMPLES = 2
    MOST_SAMPLES = 4


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


def at_arc_lengths(const double[:, ::1] points, const double[::1] arc, const double[::1] s):
    """Return the configurations (S, n) of a path (N, n) with arc lengths (N,) at `s: (S,)`; the ends' beyond them."""
    cdef Py_ssize_t N = points.shape[0], n = points.shape[1], S = s.shape[0], j, i, k = 0
    cdef double slope
    if not N or arc.shape[0] != N:
        raise InputError(f"a path needs as many arc lengths as way points, got {arc.shape[0]} and {N}")
    found = np.empty((S, n))
    cdef double[:, ::1] out = found
    for j in range(S):
        if s[j] < arc[k]:
            k = 0
        while k + 1 < N and s[j] >= arc[k + 1]:
            k += 1
        for i in range(n):
            out[j, i] = points[k, i]
            if k + 1 < N and s[j] > arc[k]:
                slope = (points[k + 1, i] - points[k, i]) / (arc[k + 1] - arc[k])
                out[j, i] += slope * (s[j] - arc[k])
    return found


def spread(path, double step):
    """Return configurations (S, n) of an unrolled path (N, n) at equal steps, no longer than `step`, and its length."""
    arc = arc_lengths(path)
    cdef double length = arc[len(arc) - 1]
    cdef Py_ssize_t count = 1 + <Py_ssize_t> (length / step)
    return at_arc_lengths(path, arc, np.arange(count + 1) * (length / count)), length


def unrolled(const double[:, ::1] path, continuous):
    """Return the path (N, n) with continuous joints that do not jump where they wrap; the others stay as they are."""
    cdef Py_ssize_t N = path.shape[0], n = path.shape[1], k, i
    cdef const unsigned char[::1] wraps = np.ascontiguousarray(continuous, dtype=np.bool_).view(np.uint8)
    cdef double step
    if wraps.shape[0] != n:
        raise InputError(f"way points must have {wraps.shape[0]} joints, got {n}")
    found, turned = np.array(path), np.zeros(n)
    cdef double[:, ::1] points = found
    cdef double[::1] turns = turned
    for k in range(1, N):
        for i in range(n):
            step = difference(path[k - 1, i], path[k, i], wraps[i])
            turns[i] += rint((step - (path[k, i] - path[k - 1, i])) / (2 * M_PI))
            points[k, i] += 2 * M_PI * turns[i]
    return found


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

    cdef readonly PointDanger danger
    cdef readonly double weight
    cdef readonly object matrix, shift
    cdef const double[:, ::1] _matrix
    cdef const double[::1] _shift
    cdef Py_ssize_t m, n

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

    def by_planned_joints(self, const double[:, ::1] slopes):
        """Return derivatives (C, n) by the planned joints from those (C, m) by the model's joints."""
        cdef Py_ssize_t C = slopes.shape[0], c, i, j
        found = np.zeros((C, self.n))
        cdef double[:, ::1] out = found
        if slopes.shape[1] != self.m:
            raise InputError(f"derivatives must be by {self.m} joints, got {slopes.shape[1]}")
        for c in range(C):
            for i in range(self.n):
                for j in range(self.m):
                    out[c, i] += self._matrix[j, i] * slopes[c, j]
        return found

    def path_cost(self, const double[:, ::1] path, double step):
        """Return J of an unrolled path (N, n) by the trapezoidal rule, and from how many samples [rad] apart."""
        cdef double length, total = 0.0
        cdef const double[:, ::1] samples
        cdef Py_ssize_t B, k
        if path.shape[1] != self.n:
            raise InputError(f"way points must have {self.n} joints, got {path.shape[1]}")
        samples, length = spread(path, step)
        B = samples.shape[0]
        memory = np.empty(B * (self.m + 1))
        cdef double[::1] row = memory
        with nogil:
            self.write(&samples[0, 0], B, &row[B], NULL, &row[0])
            for k in range(B):
                total += (0.5 if k == 0 or k == B - 1 else 1.0) * (row[k] * row[k])
        return length * (1.0 + self.weight * total / (B - 1)), B

    def edge_costs(self, const double[:, ::1] path, wanted, continuous):
        """Return J (N, N) by the midpoint rule of edges between way points (N, n), and from how many samples.

        Of edges to earlier way points, and of those that are not `wanted: (N, N)`, it is ∞.
        """
        cdef Py_ssize_t N = path.shape[0], n = path.shape[1], a, b, i, s, total = 0, number
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
                step = min(max(ceil(costs[a, b] / EDGE_SPACING), <double> FEWEST_SAMPLES), <double> MOST_SAMPLES)
                numbers[a, b] = number = <Py_ssize_t> step
                for s in range(number):
                    for i in range(n):
                        samples[total, i] = path[a, i] + (s + 0.5) / number * difference(path[a, i], path[b, i], wraps[i])
                    total += 1
        memory = np.empty(total * (self.m + 1) + 1)
        cdef double[::1] danger = memory
        with nogil:
            self.write(&samples[0, 0], total, &danger[total], NULL, &danger[0])
            s = 0
            for a in range(N):
                for b in range(a + 1, N):
                    squares = 0.0
                    for i in range(numbers[a, b]):
                        squares += danger[s] * danger[s]
                        s += 1
                    costs[a, b] *= 1.0 + self.weight * squares / max(<Py_ssize_t> 1, numbers[a, b])
        return found, total


class QuadraticModel(NamedTuple):
    """Cost, and that of obstacles in it; gradient (N, n); about the Hessian, blocks (N, n, n), (N − 1, n, n) beside."""

    value: float
    near: float
    gradient: object
    blocks: object
    beside: object


# Danger (B,) and obstacle cost (B,) at B Gauss points, their gradients (B, m), and what bends the latter, (C, m).
cdef struct AtNodes:
    const double *danger
    const double *slopes
    const double *near
    const double *pushes
    const double *bends


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

    cdef readonly DangerTerms terms
    cdef readonly object carriers, near, hinges
    cdef object _joints
    cdef const double[:, ::1] _near

    def __init__(self, DangerTerms terms not None, carriers, near, hinges):
        self.terms, self.carriers, self.near, self.hinges = terms, carriers, near, hinges
        self._joints, self._near = terms.danger.skeleton.keys.joints, near

    def model(self, const double[:, ::1] path, danger=None, slopes=None):
        """Return the model of the cost of an unrolled path (N, n), by two Gauss points on each segment.

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the densities
        add is their Gauss-Newton part; so the whole is positive. Danger (B,) and its gradients (B, m) at the Gauss
        points may be known.
        """
        cdef Py_ssize_t N = path.shape[0], n = path.shape[1]
        if n != self.terms.n or N < 2:
            raise InputError(f"a path needs two way points of {self.terms.n} joints each at least")
        blocks, beside, gradient = np.zeros((N, n, n)), np.zeros((N - 1, n, n)), np.zeros((N, n))
        value, near = self._integrated(path, danger, slopes, gradient, blocks, beside)[:2]
        return QuadraticModel(value, near, gradient, blocks, beside)

    def _integrated(self, const double[:, ::1] path, danger, slopes, double[:, ::1] gradient, blocks, beside):
        """Return the cost of a path (N, n), the part of it that obstacles are, and danger and slopes at its nodes.

        The gradient (N, n) is written. Unless they are None, about the Hessian is added to blocks (N, n, n), and
        (N − 1, n, n) beside them.
        """
        cdef Py_ssize_t N = path.shape[0], n = path.shape[1], m = self.terms.m, B = 2 * N - 2
        cdef double value, close = 0.0
        cdef bint known = danger is not None
        nodes, joints = np.empty((B, n)), np.empty((B, m))
        cdef double[:, ::1] node = nodes
        cdef double[:, ::1] joint = joints
        if not known:
            danger, slopes = np.empty(B), np.zeros((B, m))
        cdef double[::1] level = danger
        cdef double[:, ::1] slope = slopes
        if level.shape[0] != B or slope.shape[0] != B or slope.shape[1] != m:
            raise InputError(f"the danger must be known at {B} Gauss points")
        _write_gauss_points(&path[0, 0], N, n, &node[0, 0])
        with nogil:
            self.terms.write(
                &node[0, 0], B, &joint[0, 0], NULL if known else &slope[0, 0], NULL if known else &level[0]
            )
        near, pushes, bends = hinge_costs(self._joints, joints, self.carriers, self.near, self.hinges)
        cdef double[::1] nears = near
        cdef double[:, ::1] push = pushes
        cdef double[:, ::1] bend = bends
        cdef AtNodes found = AtNodes(&level[0], &slope[0, 0], &nears[0], &push[0, 0], NULL)
        if bend.shape[0]:
            found.bends = &bend[0, 0]
        lengths = np.zeros(N - 1)
        cdef double[::1] length = lengths
        cdef double[:, :, ::1] block
        cdef double[:, :, ::1] side
        value = _integrate(&path[0, 0], N, n, self.terms, &found, &gradient[0, 0], &length[0], &close)
        if blocks is not None:
            block, side = blocks, beside
            _add_curvature(self, N, n, &found, &length[0], value, &block[0, 0, 0], &side[0, 0, 0])
        return value, close, danger, slopes

    def retreat_step(self, const double[:, ::1] Q, double reference, double excess_weight, double onset, double longest):
        """Return what `Q: (1, n)` costs, the danger with which it is compared, 0: its own, and the best step from there.

        The cost is that of obstacles, and of danger w Σ_m (CDF(p_m)/reference − onset)₊². The step is no longer than
        `longest` [rad].
        """
        cdef DangerTerms terms = self.terms
        cdef Py_ssize_t m = terms.m, c
        cdef double cost, excess
        values, own = np.empty((1, m)), np.zeros(1)
        slopes = np.zeros((1, m))
        cdef double[:, ::1] value = values
        cdef double[:, ::1] slope = slopes
        cdef double[::1] levels = own
        terms.write(&Q[0, 0], 1, &value[0, 0], NULL, NULL)
        near, pushes, bends = hinge_costs(self._joints, values, self.carriers, self.near, self.hinges)
        maximum = terms.danger.kind == MAXIMUM
        if reference == 0.0 or not maximum:
            terms.danger.write(&value[0, 0], 1, &slope[0, 0], &levels[0])
        reference = own[0] if reference == 0.0 else reference
        cost = near[0]
        if cost == 0.0 or not 0.0 < reference < INFINITY:
            own, slopes = own[:0], slopes[:0]
        elif maximum:
            own, slopes = terms.danger.high_levels(values, onset * reference)
        gradient, rises = terms.by_planned_joints(pushes)[0], terms.by_planned_joints(slopes)
        for c in range(len(own)):
            excess = max(0.0, own[c] / reference - onset)
            cost += excess_weight * excess * excess
            gradient += 2.0 * excess_weight * excess * rises[c] / reference
            rises[c] *= sqrt(2.0 * excess_weight) / reference if excess > 0.0 else 0.0
        return cost, reference, _bounded_step(gradient, np.concatenate([terms.by_planned_joints(bends), rises]), longest)


cdef double _integrate(
    const double *path, Py_ssize_t N, Py_ssize_t n, DangerTerms terms, const AtNodes *found, double *gradient,
    double *lengths, double *close,
) noexcept nogil:
    """Return the cost of a path (N, n), and write its gradient (N, n), the part that obstacles are, and lengths."""
    cdef const double *matrix = &terms._matrix[0, 0]
    cdef double rate = 2.0 * terms.weight, total = 0.0, mean, steepness, stretch, step
    cdef Py_ssize_t m = terms.m, k, i, j, b, side
    cdef double first, second
    for i in range(N * n):
        gradient[i] = 0.0
    for k in range(N - 1):
        lengths[k] = 0.0
        for i in range(n):
            step = path[n * (k + 1) + i] - path[n * k + i]
            lengths[k] += step * step
        lengths[k] = sqrt(lengths[k])
        mean = 1.0
        for side in range(2):
            b = 2 * k + side
            mean += 0.5 * (0.5 * rate * (found.danger[b] * found.danger[b]) + found.near[b])
            close[0] += 0.5 * lengths[k] * found.near[b]
        total += lengths[k] * mean
        for i in range(n):
            first = second = 0.0
            for j in range(m):
                steepness = rate * found.danger[2 * k] * found.slopes[m * 2 * k + j] + found.pushes[m * 2 * k + j]
                first += 0.5 * lengths[k] * steepness * matrix[n * j + i]
            b = 2 * k + 1
            for j in range(m):
                steepness = rate * found.danger[b] * found.slopes[m * b + j] + found.pushes[m * b + j]
                second += 0.5 * lengths[k] * steepness * matrix[n * j + i]
            stretch = mean / max(lengths[k], TINY) * (path[n * (k + 1) + i] - path[n * k + i])
            gradient[n * k + i] += SECOND * first + FIRST * second - stretch
            gradient[n * (k + 1) + i] += FIRST * first + SECOND * second + stretch
    return total


cdef int _add_curvature(
    Densities densities, Py_ssize_t N, Py_ssize_t n, const AtNodes *found, const double *lengths, double total,
    double *blocks, double *beside,
) except -1:
    """Add about the Hessian of the cost of a path to blocks (N, n, n), and (N − 1, n, n) beside them."""
    cdef DangerTerms terms = densities.terms
    cdef const double *matrix = &terms._matrix[0, 0]
    cdef Py_ssize_t m = terms.m, C = densities._near.shape[0], k, i, j, c, b
    cdef double rate = 2.0 * terms.weight, whole = 0.0, stiffness, t, square, each
    cdef double[::1] bend = np.zeros(n)
    cdef bint of_danger
    with nogil:
        for k in range(N - 1):
            whole += lengths[k]
        whole = max(whole, TINY)
        for k in range(N - 1):
            stiffness = total / whole / max(lengths[k], SHORT * whole / (N - 1))
            for i in range(n):
                blocks[n * n * k + n * i + i] += stiffness
                blocks[n * n * (k + 1) + n * i + i] += stiffness
                beside[n * n * k + n * i + i] -= stiffness
        for c in range(2 * N - 2 + C):
            of_danger = c < 2 * N - 2
            b = c if of_danger else <Py_ssize_t> densities._near[c - (2 * N - 2), 0]
            k, t = b // 2, SECOND if b % 2 else FIRST
            for i in range(n):
                bend[i] = 0.0
            for j in range(m):
                each = sqrt(rate) * found.slopes[m * b + j] if of_danger else found.bends[m * (c - (2 * N - 2)) + j]
                for i in range(n):
                    bend[i] += each * matrix[n * j + i]
            for i in range(n):
                for j in range(n):
                    square = 0.5 * lengths[k] * bend[i] * bend[j]
                    blocks[n * n * k + n * i + j] += (1.0 - t) * (1.0 - t) * square
                    blocks[n * n * (k + 1) + n * i + j] += t * t * square
                    beside[n * n * k + n * i + j] += t * (1.0 - t) * square
    return 0


cdef enum:
    NEWTON_STEPS = 30
# Relative precision of the length of a step; less of the curvature, or of the slope per radian, is as good as none.
cdef double PRECISION = 1e-9
cdef double FLAT = 1e-9


def _bounded_step(const double[::1] gradient, const double[:, ::1] vectors, double longest):
    """Return the step s (n,), no longer than `longest`, that minimises g·s + ½ sᵀHs, H = Σ vvᵀ of vectors (C, n).

    It is −(H + λ1)⁻¹g with the least λ ≥ 0 that makes it short enough, which Newton's method on 1/‖s(λ)‖ finds from
    below in a few steps (Moré & Sorensen 1983).
    """
    cdef Py_ssize_t n = gradient.shape[0], i, j, k, c, trial
    cdef double curvature = 0.0, slope = 0.0, shift, rest, length, square
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
    for trial in range(NEWTON_STEPS if slope > 0.0 else 0):
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
    IDLE_STEPS = 2
# A step must bring this share of the fall that the gradient promises (Armijo). A step may be longer than the last one by
# the factor GROWTH; one that fails is shortened to between SHORTEST and LONGEST of it.
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

    Attributes
    ----------
    path : ndarray, shape (N, n)
        Where the descent is.
    danger, slopes : ndarray, shapes (2N − 2,) and (2N − 2, m)
        The danger and its gradients at the Gauss points of the path, once a step was taken.
    evaluations : int
        How often the cost was evaluated since the descent was resumed.
    """

    cdef readonly object path, danger, slopes
    cdef readonly Py_ssize_t evaluations
    cdef object _gradient, _band, _steps, _changes, _products
    cdef Densities _densities
    cdef const unsigned char[::1] _moving
    cdef double _cost, _size
    cdef Py_ssize_t _remembered, _idle, _n

    def __init__(self, moving):
        self._moving = np.ascontiguousarray(moving, dtype=np.bool_).view(np.uint8)
        self._size = 1.0

    def resume(self, Densities densities not None, path, model):
        """Go on from a path near the last one, or with another model of the cost, without what was known of it."""
        moving = np.asarray(self._moving).view(np.bool_)
        N, n = path.shape
        if N != len(moving):
            raise InputError(f"the path must have {len(moving)} way points, got {N}")
        self._densities, self.path, self._n = densities, np.array(path), n
        self._gradient = model.gradient * moving[:, None]
        self._band = _factored(model.blocks, model.beside, self._moving)
        self.danger, self.slopes = np.empty(2 * N - 2), np.empty((2 * N - 2, densities.terms.m))
        self._cost, self._idle, self.evaluations = model.value, 0, 0
        if self._steps is None:
            self._steps, self._changes = np.empty((MEMORY, N, n)), np.empty((MEMORY, N, n))
            self._products = np.empty(MEMORY)

    def descend(self, lower, upper, Py_ssize_t most, double largest, double idle):
        """Take so many steps within the limits (n,); return whether more are not worthwhile.

        That is where no step lowers the cost, or the last ones did by less than a share `idle`. In a step no joint
        moves farther than `largest`.
        """
        cdef double before, value = 0.0, slope, longest, size, bend, share
        cdef Py_ssize_t step, trial
        cdef bint lowered
        for step in range(most):
            before, lowered = self._cost, False
            while not lowered:
                direction, slope, longest = self._direction()
                size = min(min(1.0, largest / longest), GROWTH * self._size) if slope < 0.0 else 0.0
                for trial in range(TRIALS if slope < 0.0 else 0):
                    path = np.minimum(np.maximum(self.path + size * direction, lower), upper)
                    gradient = np.empty_like(path)
                    value, _, danger, slopes = self._densities._integrated(path, None, None, gradient, None, None)
                    self.evaluations += 1
                    if value < before + SUFFICIENT * size * slope:
                        self._cost, self._size, lowered = value, size, True
                        self._accept(path, gradient, danger, slopes)
                        break
                    bend = value - before - size * slope
                    share = SHORTEST
                    if bend < INFINITY:
                        share = min(LONGEST, max(SHORTEST, -0.5 * size * slope / bend))
                    size *= share
                if not lowered:
                    if self._remembered == 0:
                        return True
                    # What is remembered may be of another part of the path's surroundings.
                    self._remembered = 0
            self._idle = self._idle + 1 if before - value < idle * before else 0
            if self._idle == IDLE_STEPS:
                return True
        return False

    def _accept(self, path, gradient, danger, slopes):
        """Go on to a path with a gradient (N, n), and remember the step; danger and slopes are those at its nodes."""
        cdef Py_ssize_t row = self._remembered % MEMORY, N = self._moving.shape[0], n = self._n, k, i
        cdef double product = 0.0, slope
        cdef double[:, ::1] new = path
        cdef double[:, ::1] new_gradient = gradient
        cdef double[:, ::1] old = self.path
        cdef double[:, ::1] old_gradient = self._gradient
        cdef double[:, :, ::1] steps = self._steps
        cdef double[:, :, ::1] changes = self._changes
        for k in range(N):
            for i in range(n):
                slope = new_gradient[k, i] if self._moving[k] else 0.0
                steps[row, k, i] = new[k, i] - old[k, i]
                changes[row, k, i] = slope - old_gradient[k, i]
                product += steps[row, k, i] * changes[row, k, i]
                old[k, i], old_gradient[k, i] = new[k, i], slope
        self.danger, self.slopes = danger, slopes
        self._products[row] = product
        if product > LEAST_PRODUCT:
            self._remembered += 1

    def _direction(self):
        """Return x = −H⁻¹∇J (N, n) with the Hessian H that the remembered steps make of L Lᵀ; ∇J·x, and largest |x|."""
        cdef double[:, ::1] band = self._band
        cdef double[::1] products = self._products
        cdef double[:, :, ::1] steps = self._steps
        cdef double[:, :, ::1] changes = self._changes
        found = self._gradient.copy()
        cdef double[:, ::1] rows = found
        cdef const double[:, ::1] gradient = self._gradient
        cdef double *x = &rows[0, 0]
        cdef const double *g = &gradient[0, 0]
        cdef const double *step
        cdef const double *change
        cdef double shares[MEMORY]
        cdef double share, slope = 0.0, largest = 0.0
        cdef Py_ssize_t w = band.shape[1] - 1, size = rows.shape[0] * rows.shape[1], remembered = self._remembered
        cdef Py_ssize_t age, row, i, j
        with nogil:
            for age in range(min(remembered, <Py_ssize_t> MEMORY)):
                row, share = (remembered - 1 - age) % MEMORY, 0.0
                step, change = &steps[row, 0, 0], &changes[row, 0, 0]
                for i in range(size):
                    share += step[i] * x[i]
                shares[row] = share / products[row]
                for i in range(size):
                    x[i] -= shares[row] * change[i]
            for i in range(size):
                for j in range(max(<Py_ssize_t> 0, i - w), i):
                    x[i] -= band[i, j - i + w] * x[j]
                x[i] /= band[i, w]
            for i in range(size - 1, -1, -1):
                x[i] /= band[i, w]
                for j in range(max(<Py_ssize_t> 0, i - w), i):
                    x[j] -= band[i, j - i + w] * x[i]
            for age in range(min(remembered, <Py_ssize_t> MEMORY) - 1, -1, -1):
                row, share = (remembered - 1 - age) % MEMORY, 0.0
                step, change = &steps[row, 0, 0], &changes[row, 0, 0]
                for i in range(size):
                    share += change[i] * x[i]
                for i in range(size):
                    x[i] += (shares[row] - share / products[row]) * step[i]
            for i in range(size):
                x[i] = -x[i]
                slope += x[i] * g[i]
                largest = max(largest, fabs(x[i]))
        return found, slope, largest


def _factored(const double[:, :, ::1] blocks, const double[:, :, ::1] beside, const unsigned char[::1] moving):
    """Return the factor's band (N·n, 2n) of a matrix with blocks (N, n, n), and (N − 1, n, n) right of them.

    Row i of a band holds the entries (i, i − w) … (i, i) of the lower triangle, w = 2n − 1. Rows and columns of way
    points that are not `moving: (N,)` are those of the unit matrix.
    """
    cdef Py_ssize_t N = blocks.shape[0], n = blocks.shape[1], w = 2 * n - 1, k, a, b, i, j
    cdef double rest
    if beside.shape[0] != N - 1 or beside.shape[1] != n or moving.shape[0] != N or blocks.shape[2] != n:
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


# ---------------------------------------------------------------------------------------------------------- shortcuts

# Of edges between way points: whether bounds were looked at, and whether the edge is proven.
cdef enum:
    UNKNOWN
    LOOKED_AT
    PROVEN


def chained(const double[:, ::1] costs):
    """Return what comes before each node (N,) on the cheapest way to it, by the costs (N, N) of edges to later ones."""
    cdef Py_ssize_t N = costs.shape[0]
    found, values = np.zeros(N, np.intp), np.zeros(N)
    cdef Py_ssize_t[::1] before = found
    cdef double[::1] best = values
    if costs.shape[1] != N:
        raise InputError("costs must be of each two way points")
    if N:
        _chain(&costs[0, 0], N, &best[0], &before[0])
    return found


cdef void _chain(const double *costs, Py_ssize_t N, double *best, Py_ssize_t *before) noexcept nogil:
    cdef Py_ssize_t i, j
    best[0] = 0.0
    for j in range(1, N):
        best[j], before[j] = best[0] + costs[j], 0
        for i in range(1, j):
            if best[i] + costs[N * i + j] < best[j]:
                best[j], before[j] = best[i] + costs[N * i + j], i


def prove_edges(
    DistanceBounds bounds not None, EdgeTable limits not None, Required required not None, double floor,
    const double[:, ::1] starts, const double[:, ::1] ends,
):
    """Return which edges between `starts` and `ends: (E, n)` bounds prove to be free, and at how many places."""
    cdef Py_ssize_t E = starts.shape[0], n = limits.n, k, places = 0
    cdef Outcome outcome
    if starts.shape[1] != n or ends.shape[1] != n or ends.shape[0] != E:
        raise InputError(f"edges must be between as many configurations of {n} joints")
    bounds._check(required, limits.m)
    found = np.zeros(E, np.bool_)
    cdef unsigned char[::1] free_ = found.view(np.uint8)
    if not bounds.bounded:
        return found, 0
    cdef Workspace work = bounds.workspace()
    with nogil:
        for k in range(E):
            outcome = prove_edge(
                &bounds.pairs, work, &starts[k, 0], &ends[k, 0], limits,
                &required.distances[0] if bounds.pairs.count else NULL, required.most, floor,
            )
            free_[k], places = outcome.number == 0, places + outcome.places
    bounds._free.append(work)
    return found, places


def weeded_chain(
    DistanceBounds bounds not None, EdgeTable limits not None, Required required not None, double floor,
    double[:, ::1] costs, Py_ssize_t[:, ::1] known, double most, const double[:, ::1] path,
):
    """Return what comes before each way point of `path: (N, n)` on the cheapest way to it, and at how many places.

    Edges on the way to the last way point that are certainly blocked get infinite costs (N, N) first, but for those
    that are `known: (N, N)`, and unless the way costs more than `most`. Edges that are looked at become known: 2 as
    proven ones, else 1.
    """
    cdef Py_ssize_t N = path.shape[0], n = limits.n, i, j, places = 0
    cdef double total
    cdef bint refused = True
    cdef Outcome outcome
    if path.shape[1] != n or costs.shape[0] != N or costs.shape[1] != N or known.shape[0] != N or known.shape[1] != N:
        raise InputError(f"way points must have {n} joints, and there must be a cost for each two of {N} way points")
    bounds._check(required, limits.m)
    found, values = np.zeros(N, np.intp), np.zeros(N)
    cdef Py_ssize_t[::1] before = found
    cdef double[::1] best = values
    if not bounds.bounded or not N:
        return chained(costs), 0
    cdef Workspace work = bounds.workspace()
    with nogil:
        while refused:
            _chain(&costs[0, 0], N, &best[0], &before[0])
            total, refused, j = 0.0, False, N - 1
            while j > 0:
                total += costs[before[j], j]
                j = before[j]
            j = N - 1 if total <= most and total < INFINITY else 0
            while j > 0:
                i = before[j]
                if known[i, j] == UNKNOWN:
                    known[i, j] = LOOKED_AT
                    outcome = prove_edge(
                        &bounds.pairs, work, &path[i, 0], &path[j, 0], limits,
                        &required.distances[0] if bounds.pairs.count else NULL, required.most, floor,
                    )
                    places += outcome.places
                    if outcome.number == 0:
                        known[i, j] = PROVEN
                    elif outcome.number < 0:
                        costs[i, j], refused = INFINITY, True
                j = i
    bounds._free.append(work)
    return found, places
