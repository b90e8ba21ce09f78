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
    if min(d1, d2) <= ROUNDING * max(d1, d2):
        return 0.0
    along, product = dot(u, v), d1 * d2
    if not along < 0:
        return product + along
    area = cross_norm(u, v)
    if area <= ROUNDING * product:
        return 0.0
    return area * area / (product - along)


@part
def slopes(length: float, S: float, half: float) -> tuple[float, float, float]:
    """Return φ = θ/ℓ, c = 2/(S² − ℓ²) and κ = (cS − φ)/ℓ² = (2/S³) Σ_k 2k/(2k+1) y^(k−1), y = (ℓ/S)²."""
    c = 1.0 / half
    phi = np.log1p(length * (S + length) * c) / length
    y = (length / S) ** 2
    if y > SERIES:
        return phi, c, (c * S - phi) / (length * length)
    total, power = 0.0, 1.0
    for k in range(1, 10):
        total += 2.0 * k / (2 * k + 1) * power
        power *= y
    return phi, c, 2.0 * total / (S * S * S)


@part
def ray(skeleton: Skeleton, points: FloatArray, m: int, key: int, out: FloatArray) -> float:
    """Write the ray (3,) from a key point to p_m, and return its length."""
    for x in range(3):
        out[x] = points[x, m] - skeleton.places[key, x]
    return norm(out)


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


@maker
def _space_slope(skeleton: Skeleton, points: FloatArray, m: int, out: FloatArray) -> None:
    """Write ∂CDF/∂p = −Σ_l c_l (e₁ + e₂) at p_m (3,); zero on a segment."""
    links, u, v = skeleton.links, np.empty(3), np.empty(3)
    out[:] = 0.0
    for k in range(len(links)):
        start, end = links[k, 0], links[k, 1]
        d1, d2 = ray(skeleton, points, m, start, u), ray(skeleton, points, m, end, v)
        half = half_gap(u, v, d1, d2)
        if half <= 0.0:
            out[:] = 0.0
            return
        scale = link_length(skeleton.places, start, end) / half if skeleton.by_length else 1.0 / half
        for x in range(3):
            out[x] -= scale * (u[x] / d1 + v[x] / d2)


# ---------------------------------------- batches: of skeletons (B, K, 3) and points (3, M), for Python


@compiled
def link_fields(places: FloatArray, links: IntArray, points: FloatArray, by_length: bool, summed: bool) -> FloatArray:
    """Return the field of each link (B, L, M), or their sum (B, 1, M), which is CDF(p)."""
    rows, block = 1 if summed else len(links), new_block(places.shape[1])
    out = np.empty((len(places), rows, points.shape[1]))
    for b in range(len(places)):
        potentials(Skeleton(places[b], links, by_length, block), points, 0, out.shape[2], out[b])
    return out


@compiled
def link_distances(places: FloatArray, links: IntArray, points: FloatArray) -> FloatArray:
    """Return the distance of each point from each link (B, L, M)."""
    B, L, M = len(places), len(links), points.shape[1]
    out, w = np.empty((B, L, M)), np.empty(3)
    for b in range(B):
        for k in range(L):
            a, end = places[b, links[k, 0]], places[b, links[k, 1]]
            for x in range(3):
                w[x] = end[x] - a[x]
            squared = max(dot(w, w), ZERO)
            for m in range(M):
                ux, uy, uz = points[0, m] - a[0], points[1, m] - a[1], points[2, m] - a[2]
                t = min(max((ux * w[0] + uy * w[1] + uz * w[2]) / squared, 0.0), 1.0)
                ux, uy, uz = ux - t * w[0], uy - t * w[1], uz - t * w[2]
                out[b, k, m] = sqrt(ux * ux + uy * uy + uz * uz)
    return out


@compiled
def space_gradients(places: FloatArray, links: IntArray, points: FloatArray, by_length: bool) -> FloatArray:
    """Return ∂CDF/∂p (B, M, 3)."""
    out, block = np.empty((len(places), points.shape[1], 3)), new_block(places.shape[1])
    for b in range(len(places)):
        skeleton = Skeleton(places[b], links, by_length, block)
        for m in range(points.shape[1]):
            _space_slope(skeleton, points, m, out[b, m])
    return out


class Ends(NamedTuple):
    """What is known of segments at one end of an interval: fields and distances, (L, M)."""

    fields: FloatArray
    distances: FloatArray


@compiled
def chords(
    first: Ends, last: Ends, h: float, speed: FloatArray, acceleration: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Return the ends (2, M) of straight lines that lie above Σ_l length_l·u_l(t) throughout an interval.

    Segments l whose points move smoothly for a time h, none faster than V (L,) or with more acceleration than A (L,),
    have the unit-weighted fields u = ∫₀¹ dτ/ρ_τ at a point p. They are multiplied by 1, or at least by their lengths
    (L,). Of two bounds of each u the lower one is taken. Seen from the nearer end no point moves farther than δ = Vh/2,
    so u ≤ U = max u·D/(D − δ) over both ends (`segment_bounds`): a level line. And along a curve 1/ρ has the second
    derivative vᵀ∇²(1/ρ)v + ∇(1/ρ)·a ≥ −v²/ρ³ − a/ρ², for ∇²(1/ρ) has the eigenvalues 2/ρ³ and −1/ρ³. As ρ never falls
    below D̲ = (D₁ + D₂ − Vh)/2, u'' ≥ −U(V²/D̲² + A/D̲), and u stays below the chord from u₁ to u₂ raised by

        U (V²/D̲² + A/D̲) h²/8.

    The first bound is linear in h, the second quadratic: near a smooth peak it needs a fifth of the intervals. The
    lines are infinite where a segment may reach the point.
    """
    L, M = first.fields.shape
    out = np.zeros((2, M))
    for k in range(L):
        half, weight = speed[k] * h / 2, lengths[k]
        for m in range(M):
            u1, u2, d1, d2 = (first.fields[k, m], last.fields[k, m], first.distances[k, m], last.distances[k, m])
            left, right = d1 - half, d2 - half
            if left > 0 and right > 0:
                level = max(u1 * (d1 / left), u2 * (d2 / right))
                nearest = (left + right) / 2
                rise = level * ((speed[k] / nearest) ** 2 + acceleration[k] / nearest) * (h * h / 8)
                bent = max(u1, u2) + rise < level
                out[0, m] += weight * (u1 + rise if bent else level)
                out[1, m] += weight * (u2 + rise if bent else level)
            else:
                out[0, m] = out[1, m] = inf
    return out
