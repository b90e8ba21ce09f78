"""Velocities along a curve, cell by cell: limits for people, the fastest time law, execution, stops, and derivatives.

Symbols and proofs are those of `docs/how-it-works.md` §9. The stop from (s, ṡ) stays on the path. A stop takes longer
if it begins faster, or farther on in its cell, because at the same ṡ it is then at a place where β is no larger. A
constraint that allows V also allows smaller V. At the end of the path, and at corners without blends, the robot stops:
V² ≤ 2 Σ β h up to there.
"""

from libc.math cimport INFINITY, fabs, sqrt

import numpy as np

from safe_ompl.common import InputError

cdef enum:
    # Bisections of a velocity limit, down to double precision.
    LIMIT_HALVINGS = 50
    # Limit of Newton steps to ṡ² in the fastest law. 2 to 4 are needed; each step reaches another pair of constraints.
    NEWTON_STEPS = 60
# A Newton step decreases ṡ² by at least this share, so that rounding cannot stall it.
cdef double LEAST_STEP = 1e-14
# Acceleration limits are tightened by this share, which exceeds the rounding errors.
cdef double TIGHTER = 1e-10
# A smaller coefficient of ṡ² gives no bound.
cdef double NO_FACTOR = 1e-14
# An edge of a cell counts as reached within this distance [rad].
cdef double REACHED = 1e-12
# With a smaller ṡ² the robot is at rest [rad²/s²].
cdef double AT_REST = 1e-14
# ṡ² counts as on a limit if it is below the limit by at most this share of the limit.
cdef double ON_LIMIT = 1e-9
# Rounding error of a few operations, relative to the sum of the coefficients.
cdef double ROUNDING = 16.0 * 2.0**-52


# Ranges of q′ and q″ over N cells, each (N, n).
cdef struct Derivatives:
    const double *dq_ds_low
    const double *dq_ds_high
    const double *d2q_ds2_low
    const double *d2q_ds2_high
    Py_ssize_t n


# An interval of ṡ² at the end of a cell, and the derivatives of its ends with respect to ṡ² at the start. The interval
# is empty if low > high.
cdef struct Range:
    double low
    double high
    double low_rate
    double high_rate


def stopping_speeds(
    const double[::1] sizes, const double[::1] brakes, const double[:, ::1] times, const double[:, ::1] harmless,
    const double[::1] velocity_limits, const Py_ssize_t[::1] ends,
):
    """Return the largest ṡ (N,) of each cell; the index among M bodies and the cell that bound it (−1: none).

    The last result (N,) tells whether u bounds ṡ, rather than τ: `harmless` and `times`, (N, M) each. For the cells,
    `brakes` are b, `velocity_limits` other limits of ṡ, and `ends` the cells after which the robot next stops.
    """
    cdef Py_ssize_t N = times.shape[0], M = times.shape[1], j, k, m, _
    cdef double room, brake, gone, latest, limit, square, good, bad, middle
    _check_limbs(sizes, times, harmless, ends)
    _check_rows("brakes", brakes.shape[0], N)
    _check_rows("velocity_limits", velocity_limits.shape[0], N)
    found, bodies, places = np.array(velocity_limits), np.full(N, -1, np.intp), np.full(N, -1, np.intp)
    is_slow = np.zeros(N, np.bool_)
    cdef double[::1] speeds = found
    cdef Py_ssize_t[::1] body = bodies
    cdef Py_ssize_t[::1] where = places
    cdef unsigned char[::1] slow = is_slow.view(np.uint8)
    cdef double[::1] weakest = np.empty(N)  # β
    with nogil:
        for j in range(N):
            # The stop may begin just before the cell.
            room, brake = 0.0, brakes[max(j - 1, 0)]
            for k in range(j, ends[j] + 1):
                brake = min(brake, brakes[k])
                room += 2 * brake * sizes[k]
                if room >= speeds[j] * speeds[j]:
                    break
            speeds[j] = min(speeds[j], sqrt(room))
            gone = 0.0  # R_k
            for k in range(j, ends[j] + 1):
                if k > j + 1:
                    gone += 2 * weakest[k - 1] * sizes[k - 1]
                if k > j and speeds[j] * speeds[j] <= gone:
                    break
                speeds[j] = min(speeds[j], sqrt(gone + velocity_limits[k] * velocity_limits[k]))
                weakest[k] = min(weakest[k - 1], brakes[k]) if k > j else brakes[k]
                latest = INFINITY
                for m in range(M):
                    limit = times[k, m]
                    square = gone + harmless[k, m] * harmless[k, m]
                    if speeds[j] * speeds[j] <= square:
                        continue
                    if latest == INFINITY:
                        latest = _latest(j, k, &sizes[0], &weakest[0])
                    if latest <= limit:
                        continue
                    good, bad = 0.0, speeds[j]
                    if limit > 0:
                        if _stopping_time(bad * bad, j, N, &sizes[0], &brakes[0]) <= limit:
                            continue
                        for _ in range(LIMIT_HALVINGS):
                            middle = 0.5 * (good + bad)
                            if _stopping_time(middle * middle, j, N, &sizes[0], &brakes[0]) <= limit:
                                good = middle
                            else:
                                bad = middle
                    speeds[j], body[j], where[j] = max(good, sqrt(square)), m, k
                    slow[j] = harmless[k, m] > 0 and square > good * good
    return found, bodies, places, is_slow


cdef double _stopping_time(
    double x, Py_ssize_t first, Py_ssize_t N, const double *sizes, const double *brakes
) noexcept nogil:
    """Return the duration of the stop from ṡ² = x at the end of cell `first`, the longest stop from there."""
    cdef double time = 0.0, brake = brakes[first], after
    cdef Py_ssize_t k
    for k in range(first + 1, N):
        brake = min(brake, brakes[k])
        after = x - 2 * brake * sizes[k]
        if after <= 0:
            break
        time += 2 * sizes[k] / (sqrt(x) + sqrt(after))
        x = after
    return time + sqrt(x) / brake


cdef double _latest(Py_ssize_t first, Py_ssize_t last, const double *sizes, const double *weakest) noexcept nogil:
    """Return the time of the stop from the start of cell `first` that ends at the end of cell `last`."""
    cdef double x = 0.0, time = 0.0, before
    cdef Py_ssize_t k
    for k in range(last, first - 1, -1):
        before = x + 2 * weakest[k] * sizes[k]
        time += 2 * sizes[k] / (sqrt(x) + sqrt(before))
        x = before
    return time


def spread(
    const double[::1] edges, const double[::1] radii, const Py_ssize_t[::1] stops, const double[:, ::1] values,
    double width,
):
    """Return the least (N, m) of the values of all cells whose radius reaches a cell.

    Cells do not reach beyond `stops`, which are corners at which the robot stops. At a distance d a value counts as
    max(value, d/width), unless the width is infinite.
    """
    cdef Py_ssize_t N = values.shape[0], n = values.shape[1], k, j, i, step
    cdef double away, value
    _check_rows("radii", radii.shape[0], N)
    _check_rows("edges", edges.shape[0], N + 1)
    _check_indices("stops", stops, N + 1)
    found, corners = np.array(values), np.zeros(N + 1, np.uint8)
    cdef double[:, ::1] least = found
    cdef unsigned char[::1] corner = corners
    for k in range(stops.shape[0]):
        corner[stops[k]] = True
    with nogil:
        for k in range(N):
            for step in range(-1, 2, 2):
                j = k + step
                while 0 <= j < N and not corner[j if step > 0 else j + 1]:
                    away = edges[j] - edges[k + 1] if step > 0 else edges[k] - edges[j + 1]
                    if away > radii[k]:
                        break
                    for i in range(n):
                        value = values[k, i] if width == INFINITY else max(values[k, i], away / width)
                        least[j, i] = min(least[j, i], value)
                    j += step
    return found


cdef Range _next_range(
    double x, double h, const Derivatives *boxes, Py_ssize_t k, const double *limits, double most, double least
) noexcept nogil:
    """Return the interval of y = x_end of cell k that keeps |p (y−x)/2h + c {x, y}| ≤ limit."""
    cdef Range found = Range(least, most, 0.0, 0.0)
    cdef double half = 0.5 / h, limit, p, c, factor, rate, rest, above, below
    cdef Py_ssize_t i, at
    cdef int side, end
    for i in range(boxes.n):
        limit, at = limits[i] * (1 - TIGHTER), boxes.n * k + i
        for side in range(4):
            p = half * (boxes.dq_ds_low[at] if side < 2 else boxes.dq_ds_high[at])
            c = boxes.d2q_ds2_low[at] if side % 2 == 0 else boxes.d2q_ds2_high[at]
            for end in range(2):
                # At the start of the cell p·y + (c − p)·x is bounded, at its end (p + c)·y − p·x.
                factor = p if end == 0 else p + c
                rate = c - p if end == 0 else -p
                rest = rate * x
                if fabs(factor) <= NO_FACTOR:
                    if fabs(rest) > limit:
                        return Range(fabs(rest), limit, fabs(rate), 0.0)
                    continue
                above, below = (limit - rest) / factor, (-limit - rest) / factor
                if factor < 0.0:
                    above, below = below, above
                if above < found.high:
                    found.high, found.high_rate = above, -rate / factor
                if below > found.low:
                    found.low, found.low_rate = below, -rate / factor
    return found


def fastest(const double[::1] sizes, boxes, const double[::1] limits, const double[::1] most):
    """Return the largest x = ṡ² (N+1,) at the grid points that ends at rest, with x ≤ `most: (N+1,)`.

    `boxes` are the ranges of q′ and q″, (N, n) each, of `safe_ompl.motions.Boxes`; `limits: (n,)` are acceleration
    limits.

    In the backward pass, K_j is the largest x_j ≤ most_j from which some x_(j+1) ≤ K_(j+1) can be reached. All smaller
    x_j are feasible as well, because the feasible (x_j, x_(j+1)) are a convex set that contains the origin. In the
    forward pass, each x_(j+1) is the largest feasible one. The length of the interval of x_(j+1), negative if the
    interval is empty, is a concave, piecewise linear function of x_j. So Newton's method decreases to K_j and ends
    there.
    """
    cdef Py_ssize_t N = sizes.shape[0], j, _
    cdef Derivatives derivatives
    cdef Range next_x
    cdef double lack
    _write_boxes(boxes, N, limits.shape[0], &derivatives)
    _check_rows("most", most.shape[0], N + 1)
    found, reached = np.zeros(N + 1), np.array(most)
    cdef double[::1] x = found
    cdef double[::1] reach = reached
    with nogil:
        for j in range(N - 1, -1, -1):
            for _ in range(NEWTON_STEPS):
                next_x = _next_range(reach[j], sizes[j], &derivatives, j, &limits[0], reach[j + 1], 0.0)
                if next_x.low <= next_x.high:
                    break
                lack = (next_x.low - next_x.high) / (next_x.low_rate - next_x.high_rate)
                reach[j] = max(min(reach[j] - lack, reach[j] * (1 - LEAST_STEP)), 0.0)
            else:
                reach[j] = 0.0
        x[0] = reach[0]
        for j in range(N):
            next_x = _next_range(x[j], sizes[j], &derivatives, j, &limits[0], reach[j + 1], 0.0)
            x[j + 1] = max(next_x.high, 0.0)
    return found


cdef int _write_boxes(boxes, Py_ssize_t N, Py_ssize_t n, Derivatives *found) except -1:
    """Set pointers to the ranges of N cells and n joints. The arrays must outlive `found`."""
    cdef const double[:, ::1] box
    cdef const double *begin[4]
    cdef Py_ssize_t k
    if len(boxes) != 4:
        raise InputError(f"boxes must be four arrays, got {len(boxes)}")
    for k in range(4):
        box = boxes[k]
        if box.shape[0] != N or box.shape[1] != n:
            raise InputError(f"boxes must have shape ({N}, {n}), got ({box.shape[0]}, {box.shape[1]})")
        begin[k] = &box[0, 0] if N * n else NULL
    found.dq_ds_low, found.dq_ds_high, found.d2q_ds2_low, found.d2q_ds2_high = begin
    found.n = n
    return 0


def ceilings(
    const double[::1] sizes, const double[::1] squared_limits, const double[::1] brakes, const Py_ssize_t[::1] stops
):
    """Return c (N + 1,) at the edges of cells: from ṡ² ≤ c the robot can stop at every required stop, at edges `stops`.

    In a cell ṡ² is limited by X, `squared_limits`, and |s̈| by b, `brakes`. Before s_(j+1) the ceiling is c_(j+1) +
    2b_j (s_(j+1) − s).
    """
    cdef Py_ssize_t N = sizes.shape[0], j, k
    _check_rows("squared_limits", squared_limits.shape[0], N)
    _check_rows("brakes", brakes.shape[0], N)
    most = np.zeros(N + 1)
    cdef double[::1] found = most
    with nogil:
        for j in range(N - 1, -1, -1):
            for k in range(stops.shape[0]):
                if stops[k] == j + 1:
                    found[j + 1] = 0.0
            found[j] = min(squared_limits[j], found[j + 1] + 2 * brakes[j] * sizes[j])
            if j:
                found[j] = min(found[j], squared_limits[j - 1])
    return most


def drive(
    const double[::1] edges, const double[::1] squared_limits, const double[::1] brakes, const double[::1] ceiling,
    double s, double x, double acceleration_share, double tick,
):
    """Return a motion of one tick [s] from (s, ṡ² = x), and the stop after it: cells (W,), s, x and t (W + 1,).

    During the tick the path acceleration is `acceleration_share`·b, a share from −1 to 1, as far as X and the ceiling
    permit. Afterwards it is −b until the robot is at rest. W is 0 if the robot is at rest and stays so.
    """
    cdef Py_ssize_t N = brakes.shape[0], most = 4 * N + 8, n = 0, k = 0
    cdef bint ticking = True
    cdef double t = 0.0, h, b, along, y, line, a, speeds, span, rest, v
    _check_rows("squared_limits", squared_limits.shape[0], N)
    _check_rows("edges", edges.shape[0], N + 1)
    _check_rows("ceiling", ceiling.shape[0], N + 1)
    visited, states = np.empty(most, dtype=np.intp), np.empty((3, most + 1))
    cdef Py_ssize_t[::1] cells = visited
    cdef double[:, ::1] state = states
    state[0, 0], state[1, 0], state[2, 0] = s, x, 0.0
    with nogil:
        while k < N - 1 and edges[k + 1] <= s:
            k += 1
        while k < N and n < most:
            h = edges[k + 1] - s
            if h <= REACHED:
                k += 1
                continue
            b = brakes[k]
            along, y = h, 0.0
            if ticking:
                line = ceiling[k + 1] + 2 * b * h
                a = acceleration_share * b
                if x >= line * (1 - ON_LIMIT):
                    a = -b
                    y = min(ceiling[k + 1], x)
                elif a > 0.0 and x >= squared_limits[k] * (1 - ON_LIMIT):
                    a = 0.0
                    along = max(min(h, h - (x - ceiling[k + 1]) / (2 * b)), 0.0)
                    y = x
                else:
                    if a + b > 0.0:
                        along = min(along, (line - x) / (2 * (a + b)))
                    if a > 0.0:
                        along = min(along, (squared_limits[k] - x) / (2 * a))
                    elif a < 0.0:
                        along = min(along, x / (-2 * a))
                    y = max(x + 2 * a * along, 0.0)
                    if a < 0.0 and along == x / (-2 * a):
                        y = 0.0
            else:
                along = min(h, x / (2 * b))
                y = x - 2 * b * along
                if y < AT_REST:
                    y = 0.0
            speeds = sqrt(x) + sqrt(max(y, 0.0))
            if speeds <= 0.0 or along <= 0.0:
                if not ticking or speeds <= 0.0:
                    break
                along, y = min(REACHED, h), x
                speeds = 2 * sqrt(x)
            span = 2 * along / speeds
            if ticking and t + span >= tick:
                rest = tick - t
                a = (y - x) / (2 * along)
                v = max(sqrt(x) + a * rest, 0.0)
                along, y, span = min(along, rest * (sqrt(x) + v) / 2), v * v, rest
                ticking = False
            s, x, t = s + along, max(y, 0.0), t + span
            cells[n] = k
            n += 1
            state[0, n], state[1, n], state[2, n] = s, x, t
            if not ticking and x <= 0.0:
                break
    states = states[:, : n + 1].copy()
    return visited[:n].copy(), states[0], states[1], states[2]


cdef inline double _braked(
    double x, Py_ssize_t k, const double *sizes, const Derivatives *boxes, const double *limits
) noexcept nogil:
    """Return x at the end of cell k for a stop that enters with x; negative if the stop ends within the cell."""
    cdef Range found = _next_range(x, sizes[k], boxes, k, limits, x, -INFINITY)
    return found.low if found.low <= found.high else x


def squared_velocities_of_stop(
    Py_ssize_t first, Py_ssize_t last, const double[::1] sizes, boxes, const double[::1] limits
):
    """Return x at the edges from the start of cell `first`, where x = 1, until x ≤ 0 or the end of cell `last`."""
    cdef Py_ssize_t N = sizes.shape[0], n = 1, k
    cdef Derivatives derivatives
    _write_boxes(boxes, N, limits.shape[0], &derivatives)
    if not (0 <= first and last < N):
        raise InputError(f"there are {N} cells, and none from {first} to {last}")
    squared = np.empty(max(last - first, -1) + 2)
    cdef double[::1] found = squared
    found[0] = 1.0
    with nogil:
        for k in range(first, last + 1):
            found[n] = _braked(found[n - 1], k, &sizes[0], &derivatives, &limits[0])
            n += 1
            if found[n - 1] <= 0.0:
                break
    return squared[:n].copy()


def time_left(
    const double[::1] sizes, boxes, const double[::1] limits, const Py_ssize_t[::1] ends, const double[:, ::1] times,
    const double[:, ::1] harmless,
):
    """Return for each cell j the least τ_km − T_jk (N,) with its limb m, cell k and √x, and the durations T of stops.

    The motion is next at rest after cells `ends: (N,)`; `times` and `harmless`, (N, M), are τ [s] and u of each limb.
    """
    cdef Py_ssize_t N = times.shape[0], M = times.shape[1], j, k, m
    cdef double x, y, span
    cdef Derivatives derivatives
    _write_boxes(boxes, N, limits.shape[0], &derivatives)
    _check_limbs(sizes, times, harmless, ends)
    least, limbs, cells = np.full(N, np.inf), np.full(N, -1, np.intp), np.full(N, -1, np.intp)
    entries, durations = np.zeros(N), np.empty(N)
    cdef double[::1] left = least
    cdef double[::1] rates = entries
    cdef double[::1] spans = durations
    cdef Py_ssize_t[::1] limb = limbs
    cdef Py_ssize_t[::1] where = cells
    with nogil:
        for j in range(N):
            x, y, span = 1.0, 1.0, sizes[j]
            for k in range(j, ends[j] + 1):
                if k > j:
                    y = _braked(x, k, &sizes[0], &derivatives, &limits[0])
                    if y > 0.0:
                        span += 2 * sizes[k] / (sqrt(x) + sqrt(y))
                    else:
                        span += 2 * sizes[k] * sqrt(x) / (x - y)
                for m in range(M):
                    if times[k, m] - span < left[j] and x > harmless[k, m] * harmless[k, m]:
                        left[j], limb[j], where[j], rates[j] = times[k, m] - span, m, k, sqrt(x)
                x = y
                if x <= 0.0:
                    break
            spans[j] = span
    return least, limbs, cells, entries, durations


def derivatives(
    const double[::1] times, const double[:, :, ::1] coefficients, const Py_ssize_t[::1] pieces, const double[::1] s
):
    """Return the values (4, S, n) of polynomials (K, d + 1, n) and of three derivatives at s (S,), on given pieces.

    Piece k is a polynomial in (s − t_k)/(t_{k+1} − t_k), with `times: (K + 1,)`.
    """
    cdef Py_ssize_t S = s.shape[0], n = coefficients.shape[2], degree = coefficients.shape[1] - 1, j, k, i, power
    cdef double span, u, q, first, second, third
    _check_pieces(times, coefficients, pieces)
    _check_rows("pieces", pieces.shape[0], S)
    out = np.zeros((4, S, n))
    cdef double[:, :, ::1] found = out
    with nogil:
        for j in range(S):
            k = pieces[j]
            span = times[k + 1] - times[k]
            u = (s[j] - times[k]) / span
            for i in range(n):
                q, first, second, third = coefficients[k, degree, i], 0.0, 0.0, 0.0
                for power in range(degree - 1, -1, -1):
                    third, second, first = third * u + second, second * u + first, first * u + q
                    q = q * u + coefficients[k, power, i]
                found[0, j, i], found[1, j, i] = q, first / span
                found[2, j, i], found[3, j, i] = 2.0 * second / (span * span), 6.0 * third / (span * (span * span))
    return out


def derivative_ranges(
    const double[::1] times, const double[:, :, ::1] coefficients, const Py_ssize_t[::1] pieces,
    const double[::1] edges,
):
    """Return lower and upper bounds (3, N, n) of the first three derivatives in cells between `edges: (N + 1,)`.

    The bounds are the least and the largest Bernstein coefficients in each cell, widened by rounding errors. `pieces:
    (N,)` are the pieces of the cells, as in `derivatives`.
    """
    cdef Py_ssize_t N = pieces.shape[0], n = coefficients.shape[2], degree = coefficients.shape[1] - 1
    cdef Py_ssize_t j, k, i, power, p, order, last, point
    cdef double span, first, width, size, least, most, value, ratio, scale, error, divisor
    _check_pieces(times, coefficients, pieces)
    _check_rows("edges", edges.shape[0], N + 1)
    bounds, memory = np.zeros((2, 3, N, n)), np.empty(degree + 1)
    cdef double[:, :, :, ::1] bound = bounds
    cdef double[::1] held = memory
    with nogil:
        for j in range(N):
            k = pieces[j]
            span = times[k + 1] - times[k]
            first, width = (edges[j] - times[k]) / span, (edges[j + 1] - edges[j]) / span
            for i in range(n):
                for power in range(degree + 1):
                    held[power] = coefficients[k, power, i]
                # Powers of u become powers of u − first.
                for power in range(degree):
                    for p in range(degree - 1, power - 1, -1):
                        held[p] += first * held[p + 1]
                divisor = 1.0
                for order in range(1, min(degree, 3) + 1):
                    divisor = span if order == 1 else span * span if order == 2 else span * (span * span)
                    last, size = degree - order, 0.0
                    for p in range(last + 1):
                        size += _factor(p, order) * fabs(coefficients[k, p + order, i])
                    least, most = INFINITY, -INFINITY
                    for point in range(last + 1):
                        value, ratio, scale = 0.0, 1.0, 1.0
                        for p in range(point + 1):
                            value += ratio * _factor(p, order) * scale * held[p + order]
                            scale *= width
                            if p < point:
                                ratio *= <double> (point - p) / <double> (last - p)
                        least, most = min(least, value), max(most, value)
                    error = ROUNDING * (last + 3) * size
                    bound[0, order - 1, j, i] = (least - error) / divisor
                    bound[1, order - 1, j, i] = (most + error) / divisor
    return bounds[0], bounds[1]


cdef inline double _factor(Py_ssize_t p, Py_ssize_t order) noexcept nogil:
    """Return (p + order)!/p!, the factor of power p of (u − first)/width in a derivative of the given order."""
    cdef double factor = 1.0
    cdef Py_ssize_t f
    for f in range(order):
        factor *= p + order - f
    return factor


cdef int _check_limbs(
    const double[::1] sizes, const double[:, ::1] times, const double[:, ::1] harmless, const Py_ssize_t[::1] ends
) except -1:
    """Raise InputError unless sizes and ends have N cells, and both tables have the same shape."""
    cdef Py_ssize_t N = times.shape[0]
    _check_rows("sizes", sizes.shape[0], N)
    _check_rows("harmless", harmless.shape[0], N)
    _check_rows("ends", ends.shape[0], N)
    if harmless.shape[1] != times.shape[1]:
        raise InputError(f"times and harmless must be of the same limbs, got {times.shape[1]} and {harmless.shape[1]}")
    return _check_indices("ends", ends, N)


cdef int _check_pieces(
    const double[::1] times, const double[:, :, ::1] coefficients, const Py_ssize_t[::1] pieces
) except -1:
    """Raise InputError unless times match the pieces, powers exist, and all piece indices are valid."""
    cdef Py_ssize_t K = coefficients.shape[0]
    if times.shape[0] != K + 1 or coefficients.shape[1] < 1:
        raise InputError(f"{K} pieces need powers and {K + 1} times, got {coefficients.shape[1]} and {times.shape[0]}")
    return _check_indices("pieces", pieces, K)


cdef int _check_indices(str name, const Py_ssize_t[::1] indices, Py_ssize_t count) except -1:
    """Raise InputError unless all indices are at least 0 and below `count`."""
    cdef Py_ssize_t k
    for k in range(indices.shape[0]):
        if not 0 <= indices[k] < count:
            raise InputError(f"{name}[{k}] must be from 0 to {count - 1}, got {indices[k]}")
    return 0


cdef int _check_rows(str name, Py_ssize_t rows, Py_ssize_t wanted) except -1:
    """Raise InputError unless an array has a row for each cell or edge."""
    if rows != wanted:
        raise InputError(f"{name} must have {wanted} rows, got {rows}")
    return 0
