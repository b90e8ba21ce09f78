"""The static danger field of one link and of a skeleton at points, and its gradients.

Points are columns (3, M), so that runs of a coordinate lie side by side. With `by_length` a link weighs in proportion
to its length ℓ.
"""

from __future__ import annotations

from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, maker, part

ZERO = 1e-30  # [m] stands for a length of zero
ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative size of what is as good as zero
SERIES = 0.01  # (ℓ/S)² below which κ is summed as a series
_LN2 = 0.6931471805599453


_BLOCK = 128  # points at once: what is known of them stays in the nearest cache


class Block(NamedTuple):
    """A block of points: points (3, N), distances (K, N), θ (N,) of a link, and room for its logarithm.

    `bits` is the same memory as `mantissa`.
    """

    points: FloatArray
    distances: FloatArray
    theta: FloatArray
    mantissa: FloatArray
    bits: IntArray
    power: FloatArray


@maker
def new_block(keypoints: int) -> Block:
    """Return memory for so many key points; one serves all configurations, as it takes time to come by."""
    mantissa = np.empty(_BLOCK)
    return Block(
        np.empty((3, _BLOCK)), np.empty((keypoints, _BLOCK)), np.empty(_BLOCK), mantissa,
        mantissa.view(np.int64), np.empty(_BLOCK),
    )  # fmt: skip


class Skeleton(NamedTuple):
    """A skeleton at one configuration: places (K, 3) of key points, links (L, 2) between them, and their weighting.

    And working memory.
    """

    places: FloatArray
    links: IntArray
    by_length: bool
    block: Block


@part
def dot(u: FloatArray, v: FloatArray) -> float:
    """Return u·v."""
    return float(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


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
    if min(d1, d2) <= ROUNDING * max(d1, d2):
        return 0.0
    along, product = dot(u, v), d1 * d2
    if not along < 0:
        return product + along
    area = cross_norm(u, v)
    if area <= ROUNDING * product:
        return 0.0
    return area * area / (product - along)


_LANES = 16  # numbers that a processor works on at once, times what the compiler unrolls
NEAR = 1e3  # 2ℓ/(S − ℓ) above which the difference has lost too many digits


@part
def potentials(skeleton: Skeleton, points: FloatArray, begin: int, end: int, levels: FloatArray) -> None:
    """Write the field at points[:, begin:end]: of each link into `levels: (L, ·)`, eq. (7), or their sum, eq. (5).

    The sum is written where there is room for one row only. There may be room for more points than there are.
    """
    places, links = skeleton.places, skeleton.links
    block = skeleton.block
    for row in range(len(levels)):
        for j in range(end - begin):
            levels[row, j] = 0.0
    for first in range(begin, end, _BLOCK):
        number = min(_BLOCK, end - first)
        lanes = _rays(places, points, first, number, block)
        for link in range(len(links)):
            a, b = links[link, 0], links[link, 1]
            length = link_length(places, a, b)
            _angles(places, a, b, length, block, lanes)
            scale = 1.0 if skeleton.by_length else 1.0 / length
            row = link if len(levels) > 1 else 0
            for j in range(number):
                levels[row, first - begin + j] += scale * block.theta[j]


@part
def _rays(places: FloatArray, points: FloatArray, begin: int, number: int, block: Block) -> int:
    """Copy a block of points, and write their distances (K, ·) from all key points.

    The last point is repeated up to a whole number of lanes, which is returned: loops over what is left after these
    would take as long as many lanes together.
    """
    lanes = min(_BLOCK, (number + _LANES - 1) // _LANES * _LANES)
    copies, distances = block.points, block.distances
    for x in range(3):
        for j in range(number):
            copies[x, j] = points[x, begin + j]
        for j in range(number, lanes):
            copies[x, j] = copies[x, number - 1]
    for k in range(len(places)):
        x0, y0, z0 = places[k, 0], places[k, 1], places[k, 2]
        for j in range(lanes):
            dx, dy, dz = copies[0, j] - x0, copies[1, j] - y0, copies[2, j] - z0
            distances[k, j] = sqrt(dx * dx + dy * dy + dz * dz)
    return lanes


@part
def _angles(places: FloatArray, start: int, end: int, length: float, block: Block, number: int) -> None:
    """Write θ = log(1 + 2ℓ/(S − ℓ)) of a link at a block of points."""
    theta, distances = block.theta, block.distances
    near = 0
    for j in range(number):
        ratio = 2.0 * length / (distances[start, j] + distances[end, j] - length)
        theta[j] = ratio
        near += 0 if 0.0 <= ratio <= NEAR else 1
    if near:
        _restore_digits(places, start, end, length, block, number)
    log1p_each(theta, block.mantissa, block.bits, block.power, number)
    if near:
        _mark_contacts(start, end, block, number)


@part
def log1p_each(x: FloatArray, mantissa: FloatArray, bits: IntArray, power: FloatArray, number: int) -> None:
    """Replace so many of `x: (N,)`, 0 ≤ x < ∞, by log(1 + x), in loops that processors run by lanes.

    With 1 + x = 2ᵏ(1 + f), √½ ≤ 1 + f < √2, and s = f/(2 + f) it is k log 2 + 2 atanh s, for which a polynomial in s²
    is good to the last digits (fdlibm's `e_log.c`). f is x itself where k = 0: small x lose nothing.
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
def _restore_digits(places: FloatArray, start: int, end: int, length: float, block: Block, number: int) -> None:
    """Replace what cancels in 2ℓ/(S − ℓ) by ℓ (S + ℓ)/((S² − ℓ²)/2); 0 on the segment."""
    ratios, points = block.theta, block.points
    u, v = block.mantissa[:3], block.power[:3]
    for j in range(number):
        if not 0.0 <= ratios[j] <= NEAR:
            d1, d2 = block.distances[start, j], block.distances[end, j]
            for x in range(3):
                u[x], v[x] = points[x, j] - places[start, x], points[x, j] - places[end, x]
            half = half_gap(u, v, d1, d2)
            ratios[j] = length * (d1 + d2 + length) / half if half > 0.0 else 0.0


@part
def _mark_contacts(start: int, end: int, block: Block, number: int) -> None:
    """Let θ be infinite on the segment, and what is not a number stay none."""
    for j in range(number):
        S = block.distances[start, j] + block.distances[end, j]
        if not S >= 0.0:
            block.theta[j] = nan
        elif block.theta[j] == 0.0 and inf > S:
            block.theta[j] = inf


@part
def link_length(places: FloatArray, start: int, end: int) -> float:
    """Return ℓ > 0."""
    x = places[end, 0] - places[start, 0]
    y = places[end, 1] - places[start, 1]
    z = places[end, 2] - places[start, 2]
    return max(sqrt(x * x + y * y + z * z), ZERO)


@compiled
def link_fields(places: FloatArray, links: IntArray, points: FloatArray, by_length: bool, summed: bool) -> FloatArray:
    """Return the field of each link (B, L, M), or their sum (B, 1, M), which is CDF(p)."""
    rows, block = 1 if summed else len(links), new_block(places.shape[1])
    out = np.empty((len(places), rows, points.shape[1]))
    for b in range(len(places)):
        potentials(Skeleton(places[b], links, by_length, block), points, 0, out.shape[2], out[b])
    return out
