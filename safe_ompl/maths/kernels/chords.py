"""Lines above the field of moving links between two configurations (`safe_ompl.maths.bounds`), summed over links."""

from __future__ import annotations

from math import inf

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels.compiled import compiled


@compiled
def chords(
    first_fields: FloatArray,
    first_distances: FloatArray,
    last_fields: FloatArray,
    last_distances: FloatArray,
    h: float,
    speed: FloatArray,
    acceleration: FloatArray,
    lengths: FloatArray,
) -> FloatArray:
    """Return the ends (2, M) of lines above Σ_l length_l·u_l(t): fields and distances (L, M), bounds of motion (L,).

    Of each link the lower of U = max u·D/(D − δ) at both ends, δ = Vh/2, and the chord raised by
    U (V²/D̲² + A/D̲) h²/8, D̲ = (D₁ + D₂ − Vh)/2.
    """
    L, M = first_fields.shape
    out = np.zeros((2, M))
    for k in range(L):
        half, weight = speed[k] * h / 2, lengths[k]
        for m in range(M):
            u1, u2 = first_fields[k, m], last_fields[k, m]
            left, right = first_distances[k, m] - half, last_distances[k, m] - half
            if left > 0 and right > 0:
                level = max(u1 * (first_distances[k, m] / left), u2 * (last_distances[k, m] / right))
                nearest = (left + right) / 2
                rise = level * ((speed[k] / nearest) ** 2 + acceleration[k] / nearest) * (h * h / 8)
                bent = max(u1, u2) + rise < level
                out[0, m] += weight * (u1 + rise if bent else level)
                out[1, m] += weight * (u2 + rise if bent else level)
            else:
                out[0, m] = out[1, m] = inf
    return out
