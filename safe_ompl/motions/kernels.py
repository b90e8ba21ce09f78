"""Kernels of motions in time: stopping thresholds, the fastest time law, and driving along a path cell by cell.

Symbols and proofs are those of `docs/mathematics.md` §9. The stop from (s, ṡ) stays on the path. The faster it begins,
or the farther on in its cell, the longer it takes, for at the same ṡ it is at a place where β is no larger; what allows
V stays true when V falls. At the end of the path, and in corners that are no blends, the robot stops: V² ≤ 2 Σ β h up
to there.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray, compiled, part

_HALVINGS = 50


@part
def _stopping_time(x: float, first: int, sizes: FloatArray, brakes: FloatArray) -> float:
    """Return how long the stop from ṡ² = x takes that begins in a cell, at its end: the longest one from there."""
    time, brake = 0.0, brakes[first]
    for k in range(first + 1, len(sizes)):
        brake = min(brake, brakes[k])
        after = x - 2 * brake * sizes[k]
        if after <= 0:
            return float(time + sqrt(x) / brake)
        time += 2 * sizes[k] / (sqrt(x) + sqrt(after))
        x = after
    return float(time + sqrt(x) / brake)


@part
def _latest(first: int, last: int, sizes: FloatArray, weakest: FloatArray) -> float:
    """Return the time of the stop from the start of cell `first` that ends at the end of cell `last`."""
    x, time = 0.0, 0.0
    for k in range(last, first - 1, -1):
        before = x + 2 * weakest[k] * sizes[k]
        time += 2 * sizes[k] / (sqrt(x) + sqrt(before))
        x = before
    return float(time)


@compiled
def stopping_speeds(
    sizes: FloatArray, brakes: FloatArray, times: FloatArray, harmless: FloatArray, caps: FloatArray, ends: IntArray
) -> tuple[FloatArray, IntArray, IntArray, BoolArray]:
    """Return the largest ṡ (N,) of each cell; for which of M bodies, and in which cell, it is bounded (−1: none).

    Last comes whether (N,) u bounds it, rather than τ: `times` and `harmless`, (N, M) each. Of cells `brakes` are b,
    `caps` what ṡ keeps to for other reasons, `ends` the cells behind which the robot next stops in any case.
    """
    N, M = times.shape
    speeds, slow = caps.copy(), np.zeros(N, np.bool_)
    body, where = np.empty(N, np.intp), np.empty(N, np.intp)
    body[:] = where[:] = -1
    weakest = np.empty(N)  # β
    for j in range(N):
        room, brake = 0.0, brakes[max(j - 1, 0)]  # the stop may begin just before
        for k in range(j, ends[j] + 1):
            brake = min(brake, brakes[k])
            room += 2 * brake * sizes[k]
            if room >= speeds[j] ** 2:
                break
        speeds[j] = min(speeds[j], sqrt(room))
        gone = 0.0  # R_k
        for k in range(j, ends[j] + 1):
            if k > j + 1:
                gone += 2 * weakest[k - 1] * sizes[k - 1]
            if k > j and speeds[j] ** 2 <= gone:
                break
            speeds[j] = min(speeds[j], sqrt(gone + caps[k] ** 2))
            weakest[k] = min(weakest[k - 1], brakes[k]) if k > j else brakes[k]
            latest = inf
            for m in range(M):
                limit = times[k, m]
                square = gone + harmless[k, m] ** 2
                if speeds[j] ** 2 <= square:
                    continue
                if latest == inf:
                    latest = _latest(j, k, sizes, weakest)
                if latest <= limit:
                    continue
                good, bad = 0.0, speeds[j]
                if limit > 0:
                    if _stopping_time(bad * bad, j, sizes, brakes) <= limit:
                        continue
                    for _ in range(_HALVINGS):
                        middle = 0.5 * (good + bad)
                        if _stopping_time(middle * middle, j, sizes, brakes) <= limit:
                            good = middle
                        else:
                            bad = middle
                speeds[j], body[j], where[j] = max(good, sqrt(square)), m, k
                slow[j] = harmless[k, m] > 0 and square > good * good
    return speeds, body, where, slow


@compiled
def spread(edges: FloatArray, radii: FloatArray, stops: IntArray, values: FloatArray, width: float) -> FloatArray:
    """Return the least (N, m) of the values of all cells by whose radius a cell is reached.

    Cells do not reach beyond `stops`, corners in which the robot stops. At a distance d a value counts as
    max(value, d/width), unless the width is infinite.
    """
    N, n = values.shape
    least = values.copy()
    corner = np.zeros(N + 1)
    corner[stops] = 1.0
    for k in range(N):
        for step in (-1, 1):
            j = k + step
            while 0 <= j < N and corner[j if step > 0 else j + 1] == 0.0:
                away = edges[j] - edges[k + 1] if step > 0 else edges[k] - edges[j + 1]
                if away > radii[k]:
                    break
                for i in range(n):
                    value = values[k, i] if width == inf else max(values[k, i], away / width)
                    least[j, i] = min(least[j, i], value)
                j += step
    return least


_LAW_HALVINGS = 60
_TIGHTER = 1e-10  # relative: limits are kept with what rounding adds


class Boxes(NamedTuple):
    """Boxes of q′ and q″ over N cells, each (N, n)."""

    slope_low: FloatArray
    slope_high: FloatArray
    bend_low: FloatArray
    bend_high: FloatArray


@part
def next_range(
    x: float, h: float, boxes: Boxes, k: int, limits: FloatArray, most: float, least: float
) -> tuple[float, float]:
    """Return the interval of y = x_end of cell k that keeps |p (y−x)/2h + c {x, y}| ≤ limit; empty if low > high."""
    low, high = least, most
    half = 0.5 / h
    for i in range(len(limits)):
        limit = limits[i] * (1 - _TIGHTER)
        for side in range(4):
            p = half * (boxes.slope_low[k, i] if side < 2 else boxes.slope_high[k, i])
            c = boxes.bend_low[k, i] if side % 2 == 0 else boxes.bend_high[k, i]
            for end in range(2):
                # of end 0: p·y + (c − p)·x; of end 1: (p + c)·y − p·x
                factor = p if end == 0 else p + c
                rest = (c - p) * x if end == 0 else -p * x
                if factor > 1e-14:
                    high = min(high, (limit - rest) / factor)
                    low = max(low, (-limit - rest) / factor)
                elif factor < -1e-14:
                    high = min(high, (-limit - rest) / factor)
                    low = max(low, (limit - rest) / factor)
                elif abs(rest) > limit:
                    return 1.0, 0.0
    return low, high


@compiled
def fastest(sizes: FloatArray, boxes: Boxes, limits: FloatArray, most: FloatArray) -> FloatArray:
    """Return the largest x = ṡ² (N+1,) at the grid points that ends at rest, with x ≤ `most: (N+1,)`.

    Backward, K_j is the largest x_j ≤ most_j from which some x_(j+1) ≤ K_(j+1) is reached; all smaller ones do as well,
    for the feasible (x_j, x_(j+1)) are a convex set with the origin in it. Forward, each x_(j+1) is the largest one.
    """
    N = len(sizes)
    reach = most.copy()
    for j in range(N - 1, -1, -1):
        low, high = next_range(most[j], sizes[j], boxes, j, limits, reach[j + 1], 0.0)
        if low <= high:
            continue
        good, bad = 0.0, most[j]
        for _ in range(_LAW_HALVINGS):
            middle = (good + bad) / 2
            low, high = next_range(middle, sizes[j], boxes, j, limits, reach[j + 1], 0.0)
            if low <= high:
                good = middle
            else:
                bad = middle
        reach[j] = good
    x = np.zeros(N + 1)
    x[0] = reach[0]
    for j in range(N):
        low, high = next_range(x[j], sizes[j], boxes, j, limits, reach[j + 1], 0.0)
        x[j + 1] = max(high, 0.0)
    return x


_NOWHERE = 1e-12  # [rad]
_REST = 1e-14  # [rad²/s²] slower than this it stands
_LINE = 1e-9  # relative: nearer to the ceiling than this is on it


@compiled
def ceilings(sizes: FloatArray, squares: FloatArray, brakes: FloatArray, stops: IntArray) -> FloatArray:
    """Return c (N + 1,) at the ends of cells: from ṡ² ≤ c every stop of the path, at edges `stops`, is reached.

    In a cell ṡ² keeps to X, `squares`, and |s̈| to b, `brakes`; before s_(j+1) it is c_(j+1) + 2b_j (s_(j+1) − s).
    """
    N = len(sizes)
    found = np.zeros(N + 1)
    for j in range(N - 1, -1, -1):
        for stop in stops:
            if stop == j + 1:
                found[j + 1] = 0.0
        found[j] = min(squares[j], found[j + 1] + 2 * brakes[j] * sizes[j])
        if j:
            found[j] = min(found[j], squares[j - 1])
    return found


@compiled
def drive(
    edges: FloatArray,
    squares: FloatArray,
    brakes: FloatArray,
    ceiling: FloatArray,
    s: float,
    x: float,
    push: float,
    tick: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Return a motion of one tick [s] from (s, ṡ² = x), and the stop after it: cells (W,), s, x and t (W + 1,).

    In the tick it accelerates by `push`·b, −1 ≤ push ≤ 1, as far as X and the ceiling let it; then by −b until it
    stands. W is 0 if it stands already, and stays so.
    """
    N = len(brakes)
    most = 4 * N + 8
    cells = np.empty(most, dtype=np.intp)
    S, X, T = np.empty(most + 1), np.empty(most + 1), np.empty(most + 1)
    S[0], X[0], T[0] = s, x, 0.0
    n, t = 0, 0.0
    k, ticking = 0, True
    while k < N - 1 and edges[k + 1] <= s:
        k += 1
    while k < N and n < most:
        h = edges[k + 1] - s
        if h <= _NOWHERE:
            k += 1
            continue
        b = brakes[k]
        along, y = h, 0.0
        if ticking:
            line = ceiling[k + 1] + 2 * b * h
            a = push * b
            if x >= line * (1 - _LINE):
                a = -b
                y = min(ceiling[k + 1], x)
            elif a > 0.0 and x >= squares[k] * (1 - _LINE):
                a = 0.0
                along = max(min(h, h - (x - ceiling[k + 1]) / (2 * b)), 0.0)
                y = x
            else:
                if a + b > 0.0:
                    along = min(along, (line - x) / (2 * (a + b)))
                if a > 0.0:
                    along = min(along, (squares[k] - x) / (2 * a))
                elif a < 0.0:
                    along = min(along, x / (-2 * a))
                y = max(x + 2 * a * along, 0.0)
                if a < 0.0 and along == x / (-2 * a):
                    y = 0.0
        else:
            along = min(h, x / (2 * b))
            y = x - 2 * b * along
            if y < _REST:
                y = 0.0
        speeds = sqrt(x) + sqrt(max(y, 0.0))
        if speeds <= 0.0 or along <= 0.0:
            if not ticking or speeds <= 0.0:
                break
            along, y = min(_NOWHERE, h), x
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
        S[n], X[n], T[n] = s, x, t
        if not ticking and x <= 0.0:
            break
    return cells[:n].copy(), S[: n + 1].copy(), X[: n + 1].copy(), T[: n + 1].copy()


_EPS = 2.0**-52
_ROUNDING = 16.0 * _EPS  # what each of a few steps may round, relative to the sum of the coefficients


@compiled
def derivatives(times: FloatArray, coefficients: FloatArray, pieces: IntArray, s: FloatArray) -> FloatArray:
    """Return the values (4, S, n) of polynomials (K, d + 1, n) and of their derivatives at s (S,), each in a piece.

    Piece k has powers of (s − t_k)/(t_{k+1} − t_k), with `times: (K + 1,)`.
    """
    S, n, degree = len(s), coefficients.shape[2], coefficients.shape[1] - 1
    found = np.zeros((4, S, n))
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
            found[2, j, i], found[3, j, i] = 2.0 * second / span**2, 6.0 * third / span**3
    return found


@compiled
def derivative_ranges(
    times: FloatArray, coefficients: FloatArray, pieces: IntArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return bounds (3, N, n), low and high, of the first three derivatives in cells between `edges: (N + 1,)`.

    They are the least and the largest Bernstein coefficients in each cell, with what rounding adds; cells lie in
    `pieces: (N,)`, as `derivatives` has them.
    """
    N, n, degree = len(pieces), coefficients.shape[2], coefficients.shape[1] - 1
    low, high, held = np.zeros((3, N, n)), np.zeros((3, N, n)), np.empty(degree + 1)
    for j in range(N):
        k = pieces[j]
        span = times[k + 1] - times[k]
        first, width = (edges[j] - times[k]) / span, (edges[j + 1] - edges[j]) / span
        for i in range(n):
            for power in range(degree + 1):
                held[power] = coefficients[k, power, i]
            for power in range(degree):  # powers of u − first
                for p in range(degree - 1, power - 1, -1):
                    held[p] += first * held[p + 1]
            for order in range(1, min(degree, 3) + 1):
                # Of the derivative by (u − first)/width: its powers p have the factor (p + order)!/p!.
                last, size = degree - order, 0.0
                for p in range(last + 1):
                    factor = 1.0
                    for f in range(order):
                        factor *= p + order - f
                    size += factor * abs(coefficients[k, p + order, i])
                least, most = inf, -inf
                for point in range(last + 1):
                    value, ratio, scale = 0.0, 1.0, 1.0
                    for p in range(point + 1):
                        factor = 1.0
                        for f in range(order):
                            factor *= p + order - f
                        value += ratio * factor * scale * held[p + order]
                        scale *= width
                        if p < point:
                            ratio *= (point - p) / (last - p)
                    least, most = min(least, value), max(most, value)
                error = _ROUNDING * (last + 3) * size
                low[order - 1, j, i] = (least - error) / span**order
                high[order - 1, j, i] = (most + error) / span**order
    return low, high
