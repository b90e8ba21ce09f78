"""The field of one link and its slopes at one point (`safe_ompl.maths.field`), for kernels to build on."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.compiled import part

ZERO = 1e-30  # [m] stands for a length of zero
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative size of what is as good as zero
_SERIES = 0.01  # (ℓ/S)² below which κ is summed as a series
_LN2 = 0.6931471805599453


@part
def dot(u: FloatArray, v: FloatArray) -> float:
    """Return u·v."""
    return float(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


@part
def norm(u: FloatArray) -> float:
    """Return ‖u‖."""
    return sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])


@part
def cross_norm(u: FloatArray, v: FloatArray) -> float:
    """Return ‖u × v‖."""
    x = u[1] * v[2] - u[2] * v[1]
    y = u[2] * v[0] - u[0] * v[2]
    z = u[0] * v[1] - u[1] * v[0]
    return sqrt(x * x + y * y + z * z)


@part
def half_gap(u: FloatArray, v: FloatArray, d1: float, d2: float) -> float:
    """Return (S² − ℓ²)/2 = ‖u‖‖v‖ + u·v = ‖u × v‖²/(‖u‖‖v‖ − u·v), without cancellation; zero on the segment."""
    if min(d1, d2) <= _ROUNDING * max(d1, d2):
        return 0.0
    along, product = dot(u, v), d1 * d2
    if not along < 0:
        return product + along
    area = cross_norm(u, v)
    if area <= _ROUNDING * product:
        return 0.0
    return area * area / (product - along)


@part
def log1p_each(x: FloatArray, mantissa: FloatArray, bits: IntArray, power: FloatArray, number: int) -> None:
    """Replace so many of `x: (N,)`, 0 ≤ x < ∞, by log(1 + x), in loops that processors run by lanes.

    With 1 + x = 2ᵏ(1 + f), √½ ≤ 1 + f < √2, and s = f/(2 + f) it is k log 2 + 2 atanh s, for which a polynomial in s²
    is good to the last digits (fdlibm's `e_log.c`). f is x itself where k = 0: small x lose nothing.

    The rest is room (N,) for 1 + f and k; `bits` is the same memory as `mantissa`.
    """
    for j in range(number):
        mantissa[j] = 1.0 + x[j]
    for j in range(number):
        k = (bits[j] - 0x3FE6A09E00000000) >> 52
        bits[j] -= k << 52
        power[j] = float(k)
    for j in range(number):
        f = x[j] if power[j] == 0.0 else mantissa[j] - 1.0
        s = f / (2.0 + f)
        z = s * s
        series = 1.531383769920937332e-01 + z * 1.479819860511658591e-01
        series = 2.222219843214978396e-01 + z * (1.818357216161805012e-01 + z * series)
        series = 3.999999999940941908e-01 + z * (2.857142874366239149e-01 + z * series)
        series = z * (6.666666666666735130e-01 + z * series)
        x[j] = power[j] * _LN2 + s * (2.0 + series)


@part
def slopes(length: float, S: float, half: float) -> tuple[float, float, float]:
    """Return φ = θ/ℓ, c = 2/(S² − ℓ²) and κ = (cS − φ)/ℓ² = (2/S³) Σ_k 2k/(2k+1) y^(k−1), y = (ℓ/S)²."""
    if half <= 0.0:
        return inf, inf, inf
    c = 1.0 / half
    phi = np.log1p(length * (S + length) * c) / length
    y = (length / S) ** 2
    if y > _SERIES:
        return phi, c, (c * S - phi) / (length * length)
    total, power = 0.0, 1.0
    for k in range(1, 10):
        total += 2.0 * k / (2 * k + 1) * power
        power *= y
    return phi, c, 2.0 * total / (S * S * S)
