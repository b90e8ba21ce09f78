"""The cost of a path with two Gauss points on each of its segments: value, gradient and about the Hessian.

Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way it is ℓ·mean_j f_j. With way points x_k it has
the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled

_TINY = 1e-12  # [rad]
_OFFSET = 0.5 / sqrt(3.0)
FIRST, SECOND = 0.5 - _OFFSET, 0.5 + _OFFSET  # t_j: exact to the third order


@compiled
def nodes(path: FloatArray) -> FloatArray:
    """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
    out = np.empty((2 * len(path) - 2, path.shape[1]))
    for k in range(len(path) - 1):
        for i in range(path.shape[1]):
            delta = path[k + 1, i] - path[k, i]
            out[2 * k, i] = path[k, i] + FIRST * delta
            out[2 * k + 1, i] = path[k, i] + SECOND * delta
    return out


@compiled
def integrated(path: FloatArray, values: FloatArray, slopes: FloatArray) -> tuple[float, FloatArray]:
    """Return the cost of a path (N, n), and its gradient (N, n), from f (2N − 2,) and ∇f (2N − 2, n) at the nodes."""
    total, gradient = 0.0, np.zeros(path.shape)
    for k in range(len(path) - 1):
        squared = 0.0
        for i in range(path.shape[1]):
            squared += (path[k + 1, i] - path[k, i]) ** 2
        length, mean = sqrt(squared), 0.5 * (values[2 * k] + values[2 * k + 1])
        total += length * mean
        for i in range(path.shape[1]):
            stretch = mean / max(length, _TINY) * (path[k + 1, i] - path[k, i])
            before, after = 0.5 * length * slopes[2 * k, i], 0.5 * length * slopes[2 * k + 1, i]
            gradient[k, i] += SECOND * before + FIRST * after - stretch
            gradient[k + 1, i] += FIRST * before + SECOND * after + stretch
    return total, gradient


@compiled
def add_bends(
    path: FloatArray, rows: IntArray, bends: FloatArray, blocks: FloatArray, beside: FloatArray
) -> None:
    """Add to the Hessian of a path (N, n) what bends at its nodes, rows (C,), like Σ vvᵀ with v: (C, n).

    Its blocks (N, n, n) are on the diagonal, and (N − 1, n, n) right of them.
    """
    for c in range(len(rows)):
        k, t = rows[c] // 2, SECOND if rows[c] % 2 else FIRST
        squared = 0.0
        for i in range(path.shape[1]):
            squared += (path[k + 1, i] - path[k, i]) ** 2
        share = 0.5 * sqrt(squared)
        for a in range(path.shape[1]):
            for b in range(path.shape[1]):
                square = share * bends[c, a] * bends[c, b]
                blocks[k, a, b] += (1.0 - t) ** 2 * square
                blocks[k + 1, a, b] += t**2 * square
                beside[k, a, b] += t * (1.0 - t) * square
