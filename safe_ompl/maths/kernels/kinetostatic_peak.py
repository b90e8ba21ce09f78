"""The largest kinetostatic danger of many points, where cheap bounds settle most of them.

Of a link whose points are no nearer to p than d, and no faster than V, the field is below 1/d, and both its rate and
its isotropic part below V/d²: points that stay below others need neither logarithms nor roots of complex numbers.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import compiled
from safe_ompl.maths.kernels.kinetostatic import link_parts

_ZERO = 1e-30


@compiled
def highest(
    keypoints: FloatArray,
    velocities: FloatArray,
    start: IntArray,
    end: IntArray,
    points: FloatArray,
    weights: FloatArray,
    ahead: float,
    spread: float,
    by_length: bool,
) -> FloatArray:
    """Return max_m w_m Σ (φ + ahead·φ̇ + spread·I)_m over the links, (B,); points (1 or B, M, 3), weights (M,)."""
    B, M = len(keypoints), points.shape[1]
    found = np.empty(B)
    bounds = np.empty(M)
    w, D, u, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for b in range(B):
        fields = points[b if len(points) > 1 else 0]
        bounds[:] = 0.0
        for k in range(len(start)):
            i, j = start[k], end[k]
            wx = keypoints[b, j, 0] - keypoints[b, i, 0]
            wy = keypoints[b, j, 1] - keypoints[b, i, 1]
            wz = keypoints[b, j, 2] - keypoints[b, i, 2]
            squared = max(wx * wx + wy * wy + wz * wz, _ZERO)
            scale = sqrt(squared) if by_length else 1.0
            fast = 0.0
            for side in (i, j):
                x, y, z = velocities[b, side, 0], velocities[b, side, 1], velocities[b, side, 2]
                fast = max(fast, x * x + y * y + z * z)
            fast = (ahead + spread) * sqrt(fast)
            for p in range(M):
                ux = fields[p, 0] - keypoints[b, i, 0]
                uy = fields[p, 1] - keypoints[b, i, 1]
                uz = fields[p, 2] - keypoints[b, i, 2]
                t = min(1.0, max(0.0, (ux * wx + uy * wy + uz * wz) / squared))
                square = (ux - t * wx) ** 2 + (uy - t * wy) ** 2 + (uz - t * wz) ** 2
                bounds[p] += scale * (1 / sqrt(square) + fast / square) if square > 0 else inf
        best = -inf
        first = 0
        for p in range(M):
            bounds[p] *= weights[p]
            if bounds[p] > bounds[first]:
                first = p
        for turn in range(-1, M):
            p = first if turn < 0 else turn
            if turn == first or bounds[p] <= best:
                continue
            total = 0.0
            for k in range(len(start)):
                i, j = start[k], end[k]
                va, vb = velocities[b, i], velocities[b, j]
                for x in range(3):
                    w[x] = keypoints[b, j, x] - keypoints[b, i, x]
                    D[x] = vb[x] - va[x]
                    u[x] = fields[p, x] - keypoints[b, i, x]
                    v[x] = fields[p, x] - keypoints[b, j, x]
                phi, rate, iso = link_parts(u, v, w, va, vb, D, spread > 0)
                scale = sqrt(max(w[0] * w[0] + w[1] * w[1] + w[2] * w[2], _ZERO)) if by_length else 1.0
                total += inf if phi == inf else scale * (phi + ahead * rate + spread * iso)
            best = max(best, weights[p] * total)
        found[b] = best
    return found
