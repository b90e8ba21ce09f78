"""Cholesky's factor of a positive matrix of blocks on the diagonal and beside it, kept as a band.

Row i of the band holds the entries (i, i − w) … (i, i) of the lower triangle, w = 2n − 1 for blocks (n, n).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels.compiled import compiled


@compiled
def factored(blocks: FloatArray, beside: FloatArray) -> FloatArray:
    """Return the factor's band (N·n, 2n) of a matrix with blocks (N, n, n), and (N − 1, n, n) right of them."""
    count, n = blocks.shape[:2]
    w = 2 * n - 1
    band = np.zeros((count * n, 2 * n))
    for k in range(count):
        for a in range(n):
            row = band[k * n + a]
            for b in range(a + 1):
                row[w + b - a] = blocks[k, a, b]
            if k > 0:
                for b in range(n):
                    row[w - n + b - a] = beside[k - 1, b, a]
    for i in range(len(band)):
        for j in range(max(0, i - w), i + 1):
            rest = band[i, j - i + w]
            for k in range(max(0, i - w), j):
                rest -= band[i, k - i + w] * band[j, k - j + w]
            band[i, j - i + w] = sqrt(rest) if i == j else rest / band[j, w]
    return band


@compiled
def solved(band: FloatArray, right: FloatArray) -> FloatArray:
    """Return x with L Lᵀ x = `right: (N·n,)`, L given by its band (N·n, 2n)."""
    w, x = band.shape[1] - 1, right.copy()
    for i in range(len(x)):
        for j in range(max(0, i - w), i):
            x[i] -= band[i, j - i + w] * x[j]
        x[i] /= band[i, w]
    for i in range(len(x) - 1, -1, -1):
        x[i] /= band[i, w]
        for j in range(max(0, i - w), i):
            x[j] -= band[i, j - i + w] * x[i]
    return x
