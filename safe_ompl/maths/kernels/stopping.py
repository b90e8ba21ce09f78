"""The largest speeds along a path from which the robot stops in time, whatever happens, proven for whole cells.

The stop from (s, ṡ) stays on the path and never brakes harder than it began: from cell j on it decelerates by
β_k = min(b_j … b_k) in cell k. It must never be in a cell k later than τ_k after it began, or be slow enough there. The
faster it begins, or the farther on in its cell, the longer such a stop takes, for at the same ṡ it is at a place where
β is no larger; with b_k alone a fast one, that is out of a weakly braked cell sooner, may be the shorter one.

The latest instant in cell k, of all stops from cell j no faster than V, is

    min(T_stop(V), T_jk),    T_jk: the stop from s_j that ends at the end of cell k.

Slower stops end before that; faster ones have left the cell by then. The cell is reached only if V² > R_k, the ṡ² that
braking takes away from the end of cell j to the start of cell k, and with ṡ² ≤ V² − R_k. So V is allowed if for every k

    T_jk ≤ τ_k,    or    V² ≤ R_k + u_k²,    or    T_stop(V) ≤ τ_k,

u_k the speed that is harmless in the cell. All three stay true when V falls. At the end of the path, and in corners
that are no blends, the robot stops: it never is so fast that it could not stop before, V² ≤ 2 Σ β h up to there.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled, part

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
    sizes: FloatArray,
    brakes: FloatArray,
    times: FloatArray,
    harmless: FloatArray,
    caps: FloatArray,
    ends: IntArray,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the largest ṡ (N,) of each cell, and for which of the M bodies and in which cell it is bounded (−1: none).

    Parameters
    ----------
    sizes, brakes : (N,)
        Lengths of the cells and decelerations b > 0.
    times : (N, M)
        τ of each cell for each of M bodies that may come [s].
    harmless : (N, M)
        u of each.
    caps : (N,)
        ṡ is no larger for other reasons.
    ends : (N,)
        The cell behind which the robot next stops in any case.
    """
    N, M = times.shape
    speeds, body, where = caps.copy(), np.full(N, -1), np.full(N, -1)
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
    return speeds, body, where
