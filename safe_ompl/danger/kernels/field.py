"""The static danger field of one link and of a skeleton at points, and its gradients.

Points are columns (3, M), so that runs of a coordinate lie side by side. With `by_length` a link weighs in proportion
to its length ℓ.
"""

from __future__ import annotations

from math import inf, nan, sqrt
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, maker, part

ZERO = 1e-30  # [m] stands for a length of zero
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative size of what is as good as zero
_SERIES = 0.01  # (ℓ/S)² below which κ is summed as a series
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
def slopes(length: float, S: float, half: float) -> tuple[float, float, float]:
    """Return φ = θ/ℓ, c = 2/(S² − ℓ²) and κ = (cS − φ)/ℓ² = (2/S³) Σ_k 2k/(2k+1) y^(k−1), y = (ℓ/S)²."""
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


@part
def ray(skeleton: Skeleton, points: FloatArray, m: int, key: int, out: FloatArray) -> float:
    """Write the ray (3,) from a key point to p_m, and return its length."""
    for x in range(3):
        out[x] = points[x, m] - skeleton.places[key, x]
    return norm(out)


_LANES = 16  # numbers that a processor works on at once, times what the compiler unrolls
_NEAR = 1e3  # 2ℓ/(S − ℓ) above which the difference has lost too many digits


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
        near += 0 if 0.0 <= ratio <= _NEAR else 1
    if near:
        _restore_digits(places, start, end, length, block, number)
    _log1p_each(theta, block.mantissa, block.bits, block.power, number)
    if near:
        _mark_contacts(start, end, block, number)


@part
def _log1p_each(x: FloatArray, mantissa: FloatArray, bits: IntArray, power: FloatArray, number: int) -> None:
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
        if not 0.0 <= ratios[j] <= _NEAR:
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
def potential(skeleton: Skeleton, points: FloatArray, m: int, room: FloatArray) -> float:
    """Return the field at p_m, in all digits what `potentials` writes; `room: (4, L)` is for the work."""
    places, links, theta, mantissa = skeleton.places, skeleton.links, room[0], room[1]
    x, y, z = points[0, m], points[1, m], points[2, m]
    for link in range(len(links)):
        a, b = links[link, 0], links[link, 1]
        dx, dy, dz = x - places[a, 0], y - places[a, 1], z - places[a, 2]
        first = sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = x - places[b, 0], y - places[b, 1], z - places[b, 2]
        length = link_length(places, a, b)
        theta[link] = 2.0 * length / (first + sqrt(dx * dx + dy * dy + dz * dz) - length)
        room[3, link] = 1.0 if skeleton.by_length else 1.0 / length
        if not 0.0 <= theta[link] <= _NEAR:
            potentials(skeleton, points, m, m + 1, room[3:])
            return float(room[3, 0])
    _log1p_each(theta, mantissa, mantissa.view(np.int64), room[2], len(links))
    total = 0.0
    for link in range(len(links)):
        total += room[3, link] * theta[link]
    return total


_FINE = 2.0**-24  # half a unit in the last place of float32


@part
def ceilings(skeleton: Skeleton, points: FloatArray, reach: float, distances: Any, out: FloatArray) -> None:
    """Write upper bounds (M,) of CDF(p) at points (3, M) in single precision, an eighth of the work of `potentials`.

    As log(1 + r) ≤ r (6 + r)/(6 + 4r), and r = 2ℓ/g with the gap g = S − ℓ, the field of a link is no larger than
    2 (3g + ℓ)/(g (3g + 4ℓ)); it falls with g. No coordinate of a point or key point is larger than `reach`. So each
    difference of two coordinates is off by 3u reach at most, u = 2⁻²⁴, the distance of two points by
    √3·3u reach + 4u·√12 reach < 20u reach, and S − ℓ by less than 64u reach, by which the gap is taken too small. What
    comes after that has relative errors of less than 16u, and u more for each link. The `distances: (K, M)` are room.
    """
    places, links, M, single = skeleton.places, skeleton.links, points.shape[1], np.float32
    for k in range(len(places)):
        x, y, z = single(places[k, 0]), single(places[k, 1]), single(places[k, 2])
        for m in range(M):
            dx, dy, dz = points[0, m] - x, points[1, m] - y, points[2, m] - z
            distances[k, m] = np.sqrt(dx * dx + dy * dy + dz * dz)
    for m in range(M):
        out[m] = single(0.0)
    two, three = single(2.0 * (1.0 + (32.0 + len(links)) * _FINE)), single(3.0)
    least, infinite = single(1e-18), single(inf)
    error = single(64.0 * _FINE * reach)
    for link in range(len(links)):
        a, b = links[link, 0], links[link, 1]
        length = single(link_length(places, a, b))
        taken = length + error
        weight = two * (length if skeleton.by_length else single(1.0))
        for m in range(M):
            gap = distances[a, m] + distances[b, m] - taken
            wide = three * gap + length
            bound = weight * wide / (gap * (wide + three * length))
            out[m] += bound if gap > least else infinite


@part
def link_length(places: FloatArray, start: int, end: int) -> float:
    """Return ℓ > 0."""
    x = places[end, 0] - places[start, 0]
    y = places[end, 1] - places[start, 1]
    z = places[end, 2] - places[start, 2]
    return max(sqrt(x * x + y * y + z * z), ZERO)


# ------------------------------------------------------------------------------------------------- gradients


@part
def add_pull(skeleton: Skeleton, points: FloatArray, m: int, weight: float, forces: FloatArray) -> None:
    """Add the gradient of weight·CDF(p_m) by the key points to `forces: (K, 3)`; nothing where p_m is on a segment.

    ∂φ/∂a = c e₁ − κ (b − a),  ∂φ/∂b = c e₂ + κ (b − a); by arc length ℓ times that, and ∓φ (b − a)/ℓ.
    """
    places, links = skeleton.places, skeleton.links
    pulls, u, v = skeleton.block.distances, skeleton.block.mantissa[:3], skeleton.block.power[:3]
    for k in range(len(links)):
        start, end = links[k, 0], links[k, 1]
        d1, d2 = ray(skeleton, points, m, start, u), ray(skeleton, points, m, end, v)
        length, half = link_length(places, start, end), half_gap(u, v, d1, d2)
        if half <= 0.0:
            return
        phi, c, kappa = slopes(length, d1 + d2, half)
        scale = weight
        if skeleton.by_length:
            scale *= length
            kappa += phi / (length * length)
        for x in range(3):
            stretch = kappa * (places[end, x] - places[start, x])
            pulls[k, x] = scale * (c * u[x] / d1 - stretch)
            pulls[k, 3 + x] = scale * (c * v[x] / d2 + stretch)
    for k in range(len(links)):
        for x in range(3):
            forces[links[k, 0], x] += pulls[k, x]
            forces[links[k, 1], x] += pulls[k, 3 + x]


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
