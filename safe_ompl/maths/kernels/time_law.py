"""The fastest time law along a path, cell by cell, that keeps its limits everywhere between the grid points too.

With the arc length s(t) and x = ṡ² the joints have q̈ = q′s̈ + q″x. In a cell s̈ = a is constant, so that x is linear in
s, a = (x_end − x_start)/2h. Over the cell q′ and q″ stay in boxes; p·a + c·x is linear in each of p, c and x, so that
|q̈| ≤ limit holds throughout if it holds for all corners of the boxes at both ends of the cell.
"""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels.compiled import compiled, part

_HALVINGS = 60
_TIGHTER = 1e-10  # relative: limits are kept with what rounding adds


@part
def _next_range(
    x: float,
    h: float,
    slope_low: FloatArray,
    slope_high: FloatArray,
    bend_low: FloatArray,
    bend_high: FloatArray,
    limits: FloatArray,
    most: float,
) -> tuple[float, float]:
    """Return the interval of y = x_end that keeps |p (y−x)/2h + c {x, y}| ≤ limit; empty if low > high."""
    low, high = 0.0, most
    half = 0.5 / h
    for i in range(len(limits)):
        limit = limits[i] * (1 - _TIGHTER)
        for side in range(4):
            p = half * (slope_low[i] if side < 2 else slope_high[i])
            c = bend_low[i] if side % 2 == 0 else bend_high[i]
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
def fastest(
    sizes: FloatArray,
    slope_low: FloatArray,
    slope_high: FloatArray,
    bend_low: FloatArray,
    bend_high: FloatArray,
    limits: FloatArray,
    most: FloatArray,
) -> FloatArray:
    """Return the largest x = ṡ² (N+1,) at the grid points that starts and ends at rest.

    Backward, K_j is the largest x_j ≤ most_j from which some x_(j+1) ≤ K_(j+1) is reached; all smaller ones do as well,
    for the feasible (x_j, x_(j+1)) are a convex set with the origin in it. Forward, each x_(j+1) is the largest one.

    Parameters
    ----------
    sizes : (N,)
        h [rad]
    slope_low, slope_high, bend_low, bend_high : (N, n)
        Boxes of q′ and q″.
    limits : (n,)
        Accelerations.
    most : (N+1,)
        Bounds of x; zero at both ends.
    """
    N = len(sizes)
    reach = most.copy()
    for j in range(N - 1, -1, -1):
        cell = (slope_low[j], slope_high[j], bend_low[j], bend_high[j], limits, reach[j + 1])
        low, high = _next_range(most[j], sizes[j], *cell)
        if low <= high:
            continue
        good, bad = 0.0, most[j]
        for _ in range(_HALVINGS):
            middle = (good + bad) / 2
            low, high = _next_range(middle, sizes[j], *cell)
            if low <= high:
                good = middle
            else:
                bad = middle
        reach[j] = good
    x = np.zeros(N + 1)
    for j in range(N):
        cell = (slope_low[j], slope_high[j], bend_low[j], bend_high[j], limits, reach[j + 1])
        low, high = _next_range(x[j], sizes[j], *cell)
        x[j + 1] = max(high, 0.0)
    return x
