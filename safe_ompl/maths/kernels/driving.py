"""Motions along a path for one tick, and the stop after it, cell by cell at constant acceleration.

In cell j the path speed keeps to x = ṡ² ≤ X_j and the path acceleration to |s̈| ≤ b_j. Every stop of the path is reached
if x ≤ c(s), the ceiling, which falls by 2b_j before it: c(s) = c_(j+1) + 2b_j (s_(j+1) − s).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled

_NOWHERE = 1e-12  # [rad]
_REST = 1e-14  # [rad²/s²] slower than this it stands
_LINE = 1e-9  # relative: nearer to the ceiling than this is on it


@compiled
def ceilings(sizes: FloatArray, squares: FloatArray, brakes: FloatArray, stops: IntArray) -> FloatArray:
    """Return c (N + 1,) at the ends of the cells, 0 at the end of the path and where it stops.

    Parameters
    ----------
    sizes, squares, brakes : (N,)
        Lengths h of the cells, X and b.
    stops : (K,)
        Ends of cells where the robot stops in any case.
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
    """Return a motion of one tick from (s, ṡ² = x), and the stop after it: cells (W,), s, x and t (W + 1,).

    In the tick it accelerates by `push`·b, −1 ≤ push ≤ 1, as far as X and the ceiling let it; then by −b until it
    stands. W is 0 if it stands already, and stays so.

    Parameters
    ----------
    edges, ceiling : (N + 1,)
        Ends of the cells, and c there.
    squares, brakes : (N,)
        X and b.
    s, x : float
        Where it begins, and ṡ².
    push : float
        Share of b.
    tick : float
        [s]
    """
    N = len(brakes)
    most = 4 * N + 8
    cells = np.empty(most, dtype=np.intp)
    S, X, T = np.empty(most + 1), np.empty(most + 1), np.empty(most + 1)
    S[0], X[0], T[0] = s, x, 0.0
    n, t = 0, 0.0
    k = min(max(int(np.searchsorted(edges, s, side="right")) - 1, 0), N - 1)
    ticking = True
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
