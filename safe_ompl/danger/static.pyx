"""The static danger field of links at points, the danger of configurations, and their gradients (paper §3).

With levels x_m = k₁ w_m Σ_l φ_l(p_m) the danger is their maximum, their mean, or (1/β) log Σ_m exp(β x_m). Points are
columns (3, M), so that each coordinate is contiguous in memory. With `by_length` the weight of a link is its length ℓ.
Batched (SIMD) evaluation is in `lanes.pyx`.
"""

from cpython.pycapsule cimport PyCapsule_GetPointer
from libc.math cimport INFINITY, exp, fabs, log, sqrt
from libc.stdlib cimport free, malloc
from libc.string cimport memset

from safe_ompl.danger.skeleton cimport ZERO, HighLevels, LaneFunctions, PointRange, Points, half_square_difference
from safe_ompl.robot.kinematics cimport KeyPointTable

from importlib import import_module

import numpy as np
from numpy._core._multiarray_umath import __cpu_features__

from safe_ompl.common import InputError

MAXIMUM, MEAN, SOFTMAX = 0, 1, 2

_build = "lanes_v3" if __cpu_features__.get("AVX2") and __cpu_features__.get("FMA3") else "lanes"
try:
    _chosen = import_module(f"safe_ompl.danger.{_build}")
except ImportError:
    # Only x86 processors have two builds.
    _chosen = import_module("safe_ompl.danger.lanes")
lanes_module = _chosen.__name__
cdef const LaneFunctions *lanes = <const LaneFunctions *> PyCapsule_GetPointer(
    _chosen.functions, "safe_ompl.danger.LaneFunctions"
)

cdef enum:
    _MAXIMUM, _MEAN, _SOFTMAX
    # Panels of the mean danger on an edge are halved at most this many times.
    HALVINGS = 6
    # Largest initial number of panels. More would exceed the memory of a machine.
    MOST_PANELS = 1_000_000


cdef class SkeletonTable:
    """The skeleton of a robot, for compiled code.

    Parameters
    ----------
    keys : KeyPointTable
        The key points of the links, on the robot's joints.
    links : ndarray of intp, shape (L, 2)
        Indices of the key points at both ends of each link.
    by_length : bool
        Whether the weight of a link is its length.
    """

    def __init__(self, KeyPointTable keys not None, links, bint by_length):
        cdef const Py_ssize_t[:, ::1] ends = links
        if ends.shape[1] != 2 or (ends.shape[0] and not 0 <= links.min() <= links.max() < keys.K):
            raise InputError(f"links must be pairs of {keys.K} key points")
        self.keys, self.links = keys, links
        self.data.joints, self.data.m, self.data.keys, self.data.K = keys.joints.data, keys.joints.m, keys.data, keys.K
        self.data.links, self.data.L = &ends[0, 0] if ends.shape[0] else NULL, ends.shape[0]
        self.data.by_length = by_length

    def __reduce__(self):
        return SkeletonTable, (self.keys, self.links, self.data.by_length)


cdef class DangerPointTable:
    """M danger points, for compiled code.

    Parameters
    ----------
    columns : ndarray, shape (3, M)
        The points [m].
    point_weights : ndarray, shape (M,)
        k₁w, not negative.
    """

    def __init__(self, columns, point_weights):
        cdef const double[:, ::1] column = columns
        cdef const double[::1] point_weight = point_weights
        single = np.asarray(columns, dtype=np.float32, order="C")
        cdef const float[:, ::1] short = single
        cdef Py_ssize_t M = point_weight.shape[0]
        if column.shape[0] != 3 or column.shape[1] != M:
            raise InputError(f"danger points must have shape (3, {M}), got {np.shape(columns)}")
        self.columns, self.point_weights, self.single = columns, point_weights, single
        if M:
            self.data = Points(&column[0, 0], &point_weight[0], &short[0, 0], np.abs(single).max(), M)

    def __len__(self):
        return self.data.M

    def __reduce__(self):
        return DangerPointTable, (self.columns, self.point_weights)

    def some(self, chosen):
        """Return the table of the points with `chosen: (M,)`."""
        rows = np.flatnonzero(chosen)
        return DangerPointTable(np.ascontiguousarray(self.columns.take(rows, axis=1)), self.point_weights[rows])


cdef class PointDanger:
    """The danger of configurations at danger points.

    Parameters
    ----------
    skeleton : SkeletonTable
        The robot's links.
    points : DangerPointTable
        The points. Without points the danger is zero.
    kind : int
        `MAXIMUM`, `MEAN` or `SOFTMAX` of the levels.
    sharpness : float
        β of the softmax.
    """

    def __init__(self, SkeletonTable skeleton not None, DangerPointTable points not None, int kind, double sharpness):
        if kind not in (MAXIMUM, MEAN, SOFTMAX):
            raise InputError(f"there is no aggregate {kind}")
        self.skeleton, self.points, self.kind, self.sharpness = skeleton, points, kind, sharpness

    def __reduce__(self):
        return PointDanger, (self.skeleton, self.points, self.kind, self.sharpness)

    def values(self, const double[:, ::1] values):
        """Return the danger (B,) at joint values `values: (B, m)`."""
        return self._dangers(values, None)

    def values_and_gradients(self, const double[:, ::1] values):
        """Return the danger (B,) and its gradients (B, m) at `values: (B, m)`.

        Gradients are zero for points on a link.
        """
        gradients = np.zeros((values.shape[0], values.shape[1]))
        return self._dangers(values, gradients), gradients

    def _dangers(self, const double[:, ::1] values, double[:, ::1] gradients):
        cdef Py_ssize_t B = values.shape[0]
        found = np.zeros(B)
        cdef double[::1] out = found
        if values.shape[1] != self.skeleton.data.m:
            raise InputError(f"values must have {self.skeleton.data.m} columns, got {values.shape[1]}")
        if B:
            with nogil:
                self.write(&values[0, 0], B, &gradients[0, 0] if gradients is not None else NULL, &out[0])
        return found

    cdef int write(self, const double *values, Py_ssize_t B, double *gradients, double *out) except -1 nogil:
        """Write the danger (B,) at joint values (B, m), and its gradients (B, m) unless `gradients` is NULL."""
        cdef Py_ssize_t M = self.points.data.M, m = self.skeleton.data.m
        if M == 0:
            memset(out, 0, B * sizeof(double))
            if gradients != NULL:
                memset(gradients, 0, B * m * sizeof(double))
        elif self.kind == _MAXIMUM:
            if lanes.highest(&self.skeleton.data, values, B, &self.points.data, gradients, NULL, out):
                with gil:
                    raise MemoryError
        elif B:
            with gil:
                self._write_sums(
                    np.asarray(<double[:B, :m]> <double *> values), np.asarray(<double[:B]> out),
                    np.asarray(<double[:B, :m]> gradients) if gradients != NULL else None,
                )
        return 0

    def _write_sums(self, values, out, gradients):
        """Write the results of `write` for a mean or a softmax, to which all points contribute."""
        skeleton, places = self.skeleton, self.skeleton.keys.places(values)
        levels = link_fields(places, skeleton.links, self.points.columns, skeleton.data.by_length, True)[:, 0]
        levels = np.ascontiguousarray(levels * self.points.point_weights)
        if gradients is not None:
            weights = shares(levels, self.kind, self.sharpness) * self.points.point_weights
            chosen = np.tile(np.arange(self.points.data.M, dtype=np.intp), (len(values), 1))
            self._write_gradients(values, chosen, weights, gradients)
        out[:] = aggregates(levels, self.kind, self.sharpness)

    def _write_gradients(
        self, const double[:, ::1] values, const Py_ssize_t[:, ::1] chosen, const double[:, ::1] weights,
        double[:, ::1] out,
    ):
        """Write the gradients (B, m) of weighted sums of the fields at chosen points (B, J) at `values: (B, m)`."""
        cdef Py_ssize_t B = values.shape[0], J = chosen.shape[1], failed
        with nogil:
            failed = lanes.gradients(
                &self.skeleton.data, &values[0, 0], B, &self.points.data, &chosen[0, 0], &weights[0, 0], J, &out[0, 0]
            )
        if failed:
            raise MemoryError

    def high(self, const double[:, ::1] values, double share, double least=0.0):
        """Return the levels (M,) of points that reach a share of the maximum at one of `values: (B, m)`, else 0.

        Levels below `least` count as 0. Only for the `MAXIMUM`.
        """
        cdef Py_ssize_t B = values.shape[0], M = self.points.data.M, failed
        found, highest = np.zeros(M), np.empty(B)
        cdef double[::1] high = found
        cdef double[::1] out = highest
        cdef HighLevels others
        if values.shape[1] != self.skeleton.data.m:
            raise InputError(f"values must have {self.skeleton.data.m} columns, got {values.shape[1]}")
        if B and M:
            others = HighLevels(share, least, &high[0])
            with nogil:
                failed = lanes.highest(
                    &self.skeleton.data, &values[0, 0], B, &self.points.data, NULL, &others, &out[0]
                )
            if failed:
                raise MemoryError
        return found

    def high_levels(self, values, double least):
        """Return the levels (C,) ≥ `least` of points at `values: (1, m)`, and their gradients (C, m)."""
        if len(values) != 1:
            raise InputError(f"levels are of one configuration, got {len(values)}")
        high = self.high(values, 0.0, least)
        rows = np.flatnonzero(high > 0.0)
        gradients = np.zeros((len(rows), values.shape[1]))
        if len(rows):
            alike = np.repeat(values, len(rows), axis=0)
            self._write_gradients(alike, rows[:, None], self.points.point_weights[rows, None], gradients)
        return high[rows], gradients

    def mean(self, const double[:, ::1] ends, Py_ssize_t panels, double tolerance):
        """Return the mean danger on the straight motion between `ends: (2, m)`, and the number of evaluations.

        The mean is computed by Simpson's rule, at first on `panels` panels. On a panel, the trapezoidal rule with the
        same three values differs by |f₀ − 2f₁ + f₂|/12 from Simpson's rule. The panel is halved if this difference
        exceeds the relative tolerance times the mean.
        """
        cdef double mean = 0.0, total = 0.0, begin, length, f0, f1, f2
        cdef Py_ssize_t evaluations, k, half
        if ends.shape[0] != 2 or not 1 <= panels <= MOST_PANELS:
            raise InputError(f"two ends and 1 to {MOST_PANELS} panels are needed, got {ends.shape[0]} and {panels}")
        evaluations = 2 * panels + 1
        cdef double[::1] found = self._between(ends, np.arange(2 * panels + 1) / (2 * panels))
        # A panel is its beginning, its length, and the three values.
        rest = []
        for k in range(panels):
            f0, f1, f2 = found[2 * k], found[2 * k + 1], found[2 * k + 2]
            rest.append((<double> k / panels, 1.0 / panels, f0, f1, f2))
            mean += (f0 + 4.0 * f1 + f2) / (6 * panels)
        if not mean < INFINITY:
            return mean, evaluations
        while rest:
            rough, middles = [], []
            for begin, length, f0, f1, f2 in rest:
                if fabs(f0 - 2.0 * f1 + f2) <= 12.0 * tolerance * mean or length * panels < 1.5 / 2**HALVINGS:
                    total += length * (f0 + 4.0 * f1 + f2) / 6.0
                    continue
                for half in range(2):
                    middles.append(begin + (0.25 + 0.5 * half) * length)
                    rough.append((begin + 0.5 * half * length, 0.5 * length, f0, f1))
                    f0, f1 = f1, f2
            if not rough:
                break
            found = self._between(ends, np.array(middles))
            evaluations += len(rough)
            rest = [(*panel[:3], found[k], panel[3]) for k, panel in enumerate(rough)]
        return total, evaluations

    def _between(self, const double[:, ::1] ends, const double[::1] at):
        """Return the danger (B,) at fractions (B,) of the line between two `ends: (2, m)`."""
        cdef Py_ssize_t b, i
        places = np.empty((at.shape[0], ends.shape[1]))
        cdef double[:, ::1] place = places
        for b in range(at.shape[0]):
            for i in range(ends.shape[1]):
                place[b, i] = ends[0, i] + at[b] * (ends[1, i] - ends[0, i])
        return self.values(places)


def link_fields(
    const double[:, :, ::1] places, const Py_ssize_t[:, ::1] links, const double[:, ::1] columns, bint by_length,
    bint summed,
):
    """Return the field of each link (B, L, M) at points (3, M), or their sum (B, 1, M), which is CDF(p).

    `places: (B, K, 3)` are the key points, and links (L, 2) are pairs of their indices.
    """
    cdef Skeleton skeleton = skeleton_of(links, places, by_length)
    cdef Py_ssize_t B = places.shape[0], M = columns.shape[1], rows = 1 if summed else skeleton.L, b
    _check_columns(columns)
    found = np.zeros((B, rows, M))
    cdef double[:, :, ::1] out = found
    cdef PointRange points
    cdef void *memory = malloc(lanes.block_size(skeleton.K))
    if not memory:
        raise MemoryError
    if M and skeleton.L:
        points = PointRange(&columns[0, 0], M, 0, M)
        with nogil:
            for b in range(B):
                lanes.fields_at_points(&places[b, 0, 0], &skeleton, &points, &out[b, 0, 0], M, summed, memory)
    free(memory)
    return found


def link_distances(const double[:, :, ::1] places, const Py_ssize_t[:, ::1] links, const double[:, ::1] columns):
    """Return the distance [m] of each point (3, M) from each link (B, L, M) between key points `places: (B, K, 3)`."""
    cdef Py_ssize_t B = places.shape[0], L = links.shape[0], M = columns.shape[1], b, k, m, x
    cdef double w[3]
    cdef double squared, ux, uy, uz, t
    cdef const double *a
    cdef const double *end
    skeleton_of(links, places, False)
    _check_columns(columns)
    found = np.empty((B, L, M))
    cdef double[:, :, ::1] out = found
    with nogil:
        for b in range(B):
            for k in range(L):
                a, end = &places[b, links[k, 0], 0], &places[b, links[k, 1], 0]
                for x in range(3):
                    w[x] = end[x] - a[x]
                squared = max(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], ZERO)
                for m in range(M):
                    ux, uy, uz = columns[0, m] - a[0], columns[1, m] - a[1], columns[2, m] - a[2]
                    t = min(max((ux * w[0] + uy * w[1] + uz * w[2]) / squared, 0.0), 1.0)
                    ux, uy, uz = ux - t * w[0], uy - t * w[1], uz - t * w[2]
                    out[b, k, m] = sqrt(ux * ux + uy * uy + uz * uz)
    return found


def space_gradients(
    const double[:, :, ::1] places, const Py_ssize_t[:, ::1] links, const double[:, ::1] columns, bint by_length
):
    """Return ∂CDF/∂p = −Σ_l c_l (e₁ + e₂) (B, M, 3) at points (3, M); zero on a segment."""
    cdef Py_ssize_t B = places.shape[0], L = links.shape[0], M = columns.shape[1], b, k, m, x
    cdef const double *start
    cdef const double *end
    cdef double u[3]
    cdef double v[3]
    cdef double d1, d2, half, scale
    skeleton_of(links, places, by_length)
    _check_columns(columns)
    found = np.zeros((B, M, 3))
    cdef double[:, :, ::1] out = found
    with nogil:
        for b in range(B):
            for m in range(M):
                for k in range(L):
                    start, end = &places[b, links[k, 0], 0], &places[b, links[k, 1], 0]
                    for x in range(3):
                        u[x], v[x] = columns[x, m] - start[x], columns[x, m] - end[x]
                    d1 = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
                    d2 = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
                    half = half_square_difference(u, v, d1, d2)
                    if half <= 0.0:
                        for x in range(3):
                            out[b, m, x] = 0.0
                        break
                    scale = _length(start, end) / half if by_length else 1.0 / half
                    for x in range(3):
                        out[b, m, x] -= scale * (u[x] / d1 + v[x] / d2)
    return found


cdef double _length(const double *a, const double *b) noexcept nogil:
    """Return ℓ > 0."""
    cdef double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2]
    return max(sqrt(x * x + y * y + z * z), ZERO)


cdef Skeleton skeleton_of(const Py_ssize_t[:, ::1] links, const double[:, :, ::1] places, bint by_length) except *:
    """Return a skeleton without joints of links (L, 2) between key points at `places: (B, K, 3)`."""
    cdef Py_ssize_t L = links.shape[0], K = places.shape[1], k
    if links.shape[1] != 2:
        raise InputError(f"links must be pairs of key points, got {links.shape[1]} of them")
    if places.shape[2] != 3:
        raise InputError(f"places must have shape (B, K, 3), got {places.shape[2]} coordinates")
    for k in range(L):
        if not (0 <= links[k, 0] < K and 0 <= links[k, 1] < K):
            raise InputError(f"link {k} leads from key point {links[k, 0]} to {links[k, 1]}; there are {K}")
    cdef Skeleton skeleton = Skeleton(NULL, 0, NULL, K, NULL, L, by_length)
    if L:
        skeleton.links = &links[0, 0]
    return skeleton


cdef int _check_columns(const double[:, ::1] columns) except -1:
    if columns.shape[0] != 3:
        raise InputError(f"points must have shape (3, M), got {columns.shape[0]} coordinates")
    return 0


def chords(
    const double[:, :, ::1] first, const double[:, :, ::1] last, double h, const double[::1] speed,
    const double[::1] acceleration, const double[::1] lengths,
):
    """Return the ends (2, M) of straight lines that lie above Σ_l length_l·u_l(t) throughout an interval.

    `first` and `last` are fields and distances (2, L, M) at the interval's ends. Segments l whose points move smoothly
    for a time h, with speed at most V (L,) and acceleration at most A (L,), have the unit-weighted fields u = ∫₀¹
    dτ/ρ_τ at a point p. The factors `lengths` (L,) are 1, or upper bounds of the lengths. For each u the lower of two
    bounds is taken. From the nearer end no point moves farther than δ = Vh/2, so u ≤ U = max u·D/(D − δ) over both ends
    (`segment_bounds`), which is a constant. Along a curve 1/ρ has the second derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³
    − a/ρ², because ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥
    −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak the second bound needs a fifth of the
    intervals. The lines are infinite where a segment may reach the point.
    """
    cdef Py_ssize_t L = first.shape[1], M = first.shape[2], k, m
    cdef double half, u1, u2, d1, d2, left, right, level, nearest, rise, ratio
    cdef bint bent
    if first.shape[0] != 2 or last.shape[0] != 2 or last.shape[1] != L or last.shape[2] != M:
        raise InputError("fields and distances at both ends must have the same shape (2, L, M)")
    if speed.shape[0] != L or acceleration.shape[0] != L or lengths.shape[0] != L:
        raise InputError(f"speeds, accelerations and lengths must be of {L} links")
    found = np.zeros((2, M))
    cdef double[:, ::1] out = found
    with nogil:
        for k in range(L):
            half = speed[k] * h / 2
            for m in range(M):
                u1, u2, d1, d2 = first[0, k, m], last[0, k, m], first[1, k, m], last[1, k, m]
                left, right = d1 - half, d2 - half
                if left > 0 and right > 0:
                    level = max(u1 * (d1 / left), u2 * (d2 / right))
                    nearest = (left + right) / 2
                    ratio = speed[k] / nearest
                    rise = level * (ratio * ratio + acceleration[k] / nearest) * (h * h / 8)
                    bent = max(u1, u2) + rise < level
                    out[0, m] += lengths[k] * (u1 + rise if bent else level)
                    out[1, m] += lengths[k] * (u2 + rise if bent else level)
                else:
                    out[0, m] = out[1, m] = INFINITY
    return found


def aggregates(const double[:, ::1] levels, int kind, double sharpness):
    """Return the danger (B,) for levels (B, M ≥ 1)."""
    cdef Py_ssize_t B = levels.shape[0], M = levels.shape[1], b, m
    cdef double peak, total
    found = np.zeros(B)
    cdef double[::1] out = found
    if not M:
        return found
    for b in range(B):
        total, peak = 0.0, levels[b, _highest(levels, b)]
        if kind == _MEAN:
            for m in range(M):
                total += levels[b, m]
            out[b] = total / M
        elif kind == _MAXIMUM:
            out[b] = peak
        else:
            for m in range(M):
                total += 1.0 if levels[b, m] == peak else exp(sharpness * (levels[b, m] - peak))
            out[b] = peak + log(total) / sharpness
    return found


def shares(const double[:, ::1] levels, int kind, double sharpness):
    """Return the derivatives (B, M) of the danger with respect to levels (B, M ≥ 1)."""
    cdef Py_ssize_t B = levels.shape[0], M = levels.shape[1], b, m, best
    cdef double peak, total
    found = np.zeros((B, M))
    cdef double[:, ::1] out = found
    if not M:
        return found
    for b in range(B):
        best = _highest(levels, b)
        if kind == _MEAN:
            for m in range(M):
                out[b, m] = 1.0 / M
        elif kind == _MAXIMUM:
            out[b, best] = 1.0
        else:
            peak, total = levels[b, best], 0.0
            for m in range(M):
                out[b, m] = 1.0 if levels[b, m] == peak else exp(sharpness * (levels[b, m] - peak))
                total += out[b, m]
            for m in range(M):
                out[b, m] /= total
    return found


cdef Py_ssize_t _highest(const double[:, ::1] levels, Py_ssize_t b) noexcept nogil:
    """Return the index of the largest of the levels (M ≥ 1,) in a row, or of the first NaN."""
    cdef Py_ssize_t best = 0, m
    for m in range(levels.shape[1]):
        if levels[b, m] != levels[b, m]:
            return m
        if levels[b, m] > levels[b, best]:
            best = m
    return best
