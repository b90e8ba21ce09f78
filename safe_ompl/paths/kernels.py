"""Kernels of the path cost: Gauss points, value, gradient and Hessian, Cholesky's factor of a chain of blocks, chains.

Row i of the band holds the entries (i, i − w) … (i, i) of the lower triangle, w = 2n − 1 for blocks (n, n).

Of a segment Δ of length ℓ = ‖Δ‖ with nodes at the shares t_j of its way it is ℓ·mean_j f_j. With way points x_k it has
the gradients mean f·Δ/ℓ + ℓ·mean_j t_j ∇f_j at its end and −mean f·Δ/ℓ + ℓ·mean_j (1 − t_j) ∇f_j at its start.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled


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
def add_bends(path: FloatArray, rows: IntArray, bends: FloatArray, blocks: FloatArray, beside: FloatArray) -> None:
    """Add to the Hessian's blocks on and beside the diagonal what bends at nodes, rows (C,), like Σ vvᵀ: v (C, n)."""
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


@compiled
def chained(costs: FloatArray) -> IntArray:
    """Return what comes before each node (N,) on the cheapest way to it, by the costs (N, N) of edges to later ones."""
    best, before = np.zeros(len(costs)), np.zeros(len(costs), np.int64)
    for j in range(1, len(costs)):
        best[j] = best[0] + costs[0, j]
        for i in range(1, j):
            if best[i] + costs[i, j] < best[j]:
                best[j], before[j] = best[i] + costs[i, j], i
    return before


@compiled
def arc_lengths(steps: FloatArray) -> FloatArray:
    """Return how far along a path its way points are, (N,) [rad], by the steps (N − 1, n) between them."""
    arc = np.zeros(len(steps) + 1)
    for k in range(len(steps)):
        squared = 0.0
        for i in range(steps.shape[1]):
            squared += steps[k, i] ** 2
        arc[k + 1] = arc[k] + sqrt(squared)
    return arc


@compiled
def at_arc_lengths(points: FloatArray, arc: FloatArray, s: FloatArray) -> FloatArray:
    """Return the configurations (S, n) of a path (N, n) with arc lengths (N,) at `s: (S,)`; the ends' beyond them."""
    out, k = np.empty((len(s), points.shape[1])), 0
    for j in range(len(s)):
        if s[j] < arc[k]:
            k = 0
        while k + 1 < len(arc) and s[j] >= arc[k + 1]:
            k += 1
        out[j] = points[k]
        if k + 1 < len(arc) and s[j] > arc[k]:
            for i in range(points.shape[1]):
                slope = (points[k + 1, i] - points[k, i]) / (arc[k + 1] - arc[k])
                out[j, i] += slope * (s[j] - arc[k])
    return out
