"""The kinetostatic danger field of one moving link segment, in closed form (`docs/mathematics.md` §8).

The link a → b has the end velocities v_a, v_b; its point t ∈ [0, 1] the velocity v(t) = v_a + tD, D = v_b − v_a, and
ρ = p − a − tw is the ray to the field point p, w = b − a, ℓ = ‖w‖. Three integrals over the link make the field:

    φ = ∫ dt/‖ρ‖,    φ̇ = ∫ ρ·v/‖ρ‖³ dt = ∂φ/∂a·v_a + ∂φ/∂b·v_b,    I = ∫ ‖v‖/‖ρ‖² dt.

For I let ‖ρ‖² = ℓ²((t−s)² + h²) and ‖v‖² = c₀ + 2c₁t + c₂t² = c₂X², X² = (t−σ)² + g². With z = s + ih, m = σ − z,
E² = m² + g² = (m + ig)(m − ig), and t − σ = (u − 1/u)g/2

    A = ∫ dt/X = [log u]₀¹,    J = ∫ dt/(X(t−z)) = L/E,    L = [log(u − u₊) − log(u − u₋)]₀¹,    u± = (−m ± E)/g,
    I = (√c₂/ℓ²)(A + Im(E²J)/h).

u is real and u± is not, so that no logarithm crosses its branch cut; u₊u₋ = −1 gives the smaller root without
cancellation. h, g and c₂ have floors so small that they change the integrals by less than 1e-8 of themselves: beyond
the ends of a link's line, for a link that turns about a point of its own line, and for one that hardly turns.
"""

from __future__ import annotations

from math import atan2, hypot, inf, log, sqrt
from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, maker, part
from safe_ompl.danger.kernels.field import ZERO, cross_norm, dot, half_gap, slopes

_BESIDE = 3e-5  # floor of h, in distances from the segment
_TURNING = 1e-10  # floor of c₂, in squared speeds
_SHARP = 1e-9  # floor of g


@part
def _bends(length: float, S: float, c: float, kappa: float) -> tuple[float, float]:
    """Return ∂κ/∂S and ∂κ/∂ℓ of `slopes`; for short links by the series (2/S³) Σ_k 2k(k − 1)/(2k + 1) y^(k−2)."""
    y, squared = (length / S) ** 2, length * length
    if y > 0.01:
        # ∂φ/∂S = −c and ∂φ/∂ℓ = (cS − φ)/ℓ; ∂c/∂S = −c²S, ∂c/∂ℓ = c²ℓ
        by_S = (2 * c - c * c * S * S) / squared
        return by_S, (c * c * length * S - kappa * length) / squared - 2 * kappa / length
    slope, power = 0.0, 1.0
    for k in range(2, 10):
        slope += 2.0 * k * (k - 1) / (2 * k + 1) * power
        power *= y
    slope *= 2 / (S * S * S)
    return -(3 * kappa + 2 * y * slope) / S, 2 * slope * length / (S * S)


@part
def _isotropic(
    u: FloatArray, w: FloatArray, va: FloatArray, D: FloatArray
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """I, the moments M_k = ∫ t^k/(X·((t−s)²+h²)) dt for k = 0, 1, 2, and s, h, c₀, c₁, c₂, X(0), X(1)."""
    squared = max(dot(w, w), ZERO)
    s = dot(u, w) / squared
    h = cross_norm(u, w) / squared
    beyond = max(-s, s - 1.0, 0.0)
    h = max(h, _BESIDE * hypot(beyond, h), ZERO)
    c0, c1 = dot(va, va), dot(va, D)
    turning = dot(D, D)
    c2 = max(turning, _TURNING * c0)
    if c2 <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, s, h, 0.0, 0.0, 0.0, 0.0, 0.0
    sigma = -c1 / c2
    area = cross_norm(va, D)
    g = max(sqrt(area * area + c0 * (c2 - turning)) / c2, _SHARP)
    x0, x1 = -sigma / g, (1.0 - sigma) / g
    r0, r1 = sqrt(x0 * x0 + 1), sqrt(x1 * x1 + 1)
    u0 = x0 + r0 if x0 > 0 else 1 / (r0 - x0)
    u1 = x1 + r1 if x1 > 0 else 1 / (r1 - x1)
    A = log(u1 / u0)
    z = complex(s, h)
    m = sigma - z
    E = np.sqrt(m + 1j * g) * np.sqrt(m - 1j * g)
    if (-m * E.conjugate()).real < 0:
        E = -E
    large = (E - m) / g
    small = -1 / large
    L = complex(
        0.5 * log(_square(u1 - large) / _square(u0 - large) * (_square(u0 - small) / _square(u1 - small))),
        _turn(u1 - large, u0 - large) - _turn(u1 - small, u0 - small),
    )
    J = L / E if E != 0 else 0j
    ratio = sqrt(c2) / squared
    value = ratio * (A + (E * L).imag / h)
    M0, M1 = J.imag / h, (z * J).imag / h
    M2 = A + 2 * s * M1 - (s * s + h * h) * M0
    return value, M0, M1, M2, s, h, c0, c1, c2, g * r0, g * r1


@part
def difference(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write a − b (3,)."""
    for x in range(3):
        out[x] = a[x] - b[x]


@part
def _square(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


@part
def _turn(z: complex, w: complex) -> float:
    """Return the angle from w to z."""
    return atan2(z.imag * w.real - z.real * w.imag, z.real * w.real + z.imag * w.imag)


@part
def link_parts(
    u: FloatArray, v: FloatArray, w: FloatArray, va: FloatArray, vb: FloatArray, D: FloatArray, isotropic: bool
) -> tuple[float, float, float]:
    """Return φ, φ̇ and I (0 unless wanted) of one link, u = p − a and v = p − b; +inf on the link."""
    d1, d2 = sqrt(dot(u, u)), sqrt(dot(v, v))
    half = half_gap(u, v, d1, d2)
    if half <= 0.0 or d1 == 0.0 or d2 == 0.0:
        return inf, inf, inf
    length = max(sqrt(dot(w, w)), ZERO)
    phi, c, kappa = slopes(length, d1 + d2, half)
    rate = c * (dot(u, va) / d1 + dot(v, vb) / d2) + kappa * dot(w, D)
    return phi, rate, _isotropic(u, w, va, D)[0] if isotropic else 0.0


@maker
def link_sums(
    places: FloatArray, velocities: FloatArray, links: IntArray, by_length: bool, point: FloatArray, isotropic: bool
) -> tuple[float, float, float]:
    """Return Σφ, Σφ̇ and ΣI (0 unless wanted) over the links at a point (3,), of key points (K, 3); +inf on a link."""
    w, D, u, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    fields, rates, spreads = 0.0, 0.0, 0.0
    for k in range(len(links)):
        i, j = links[k, 0], links[k, 1]
        difference(places[j], places[i], w)
        difference(velocities[j], velocities[i], D)
        difference(point, places[i], u)
        difference(point, places[j], v)
        phi, rate, iso = link_parts(u, v, w, velocities[i], velocities[j], D, isotropic)
        if phi == inf:
            return inf, inf, inf
        scale = max(sqrt(dot(w, w)), ZERO) if by_length else 1.0
        fields, rates, spreads = fields + scale * phi, rates + scale * rate, spreads + scale * iso
    return fields, rates, spreads


@compiled
def link_terms(
    keypoints: FloatArray, velocities: FloatArray, links: IntArray, points: FloatArray, by_length: bool, isotropic: bool
) -> FloatArray:
    """Return φ, φ̇ and I summed over the links (L, 2), (3, B, M); points (M, 3)."""
    out = np.empty((3, len(keypoints), len(points)))
    for b in range(len(keypoints)):
        for m in range(len(points)):
            found = link_sums(keypoints[b], velocities[b], links, by_length, points[m], isotropic)
            out[0, b, m], out[1, b, m], out[2, b, m] = found
    return out


@compiled
def pulls(
    keypoints: FloatArray,
    velocities: FloatArray,
    links: IntArray,
    points: FloatArray,
    weights: FloatArray,
    ahead: float,
    spread: float,
    by_length: bool,
) -> FloatArray:
    """Return the gradients of Σ_m w_m (φ + ahead·φ̇ + spread·I) by key points and by their velocities."""
    B, M = weights.shape
    out = np.zeros((2, B, keypoints.shape[1], 3))
    w, D, u, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for b in range(B):
        fields = points[b if len(points) > 1 else 0]
        for k in range(len(links)):
            i, j = links[k, 0], links[k, 1]
            start, end, va, vb = keypoints[b, i], keypoints[b, j], velocities[b, i], velocities[b, j]
            difference(end, start, w)
            difference(vb, va, D)
            length = max(sqrt(dot(w, w)), ZERO)
            scale = length if by_length else 1.0
            for p in range(M):
                difference(fields[p], start, u)
                difference(fields[p], end, v)
                d1, d2 = sqrt(dot(u, u)), sqrt(dot(v, v))
                half = half_gap(u, v, d1, d2)
                if half <= 0.0 or d1 == 0.0 or d2 == 0.0:
                    continue
                weight = scale * weights[b, p]
                S = d1 + d2
                phi, c, kappa = slopes(length, S, half)
                kappa_S, kappa_length = _bends(length, S, c, kappa)
                # φ̇ and, as the Hessian is symmetric, its gradient: how ∂φ/∂a, ∂φ/∂b change while the ends move
                speed1, speed2 = -dot(u, va) / d1, -dot(v, vb) / d2
                growth = dot(w, D) / length
                c_rate = -c * c * (S * (speed1 + speed2) - length * growth)
                kappa_rate = kappa_S * (speed1 + speed2) + kappa_length * growth
                rate = -c * (speed1 + speed2) + kappa * length * growth
                iso = 0.0
                if spread != 0.0:
                    iso, M0, M1, M2, s, h, _, c1, c2, X0, X1 = _isotropic(u, w, va, D)
                    root, squared = sqrt(c2), length * length
                    if c2 > 0.0:
                        # f = ‖v‖, f' = (c₁ + c₂t)/f; P_k = ∫ 2f (t−s)^k/((t−s)²+h²)² dt
                        at0, at1 = root * X0 / (s * s + h * h), root * X1 / ((1 - s) * (1 - s) + h * h)
                        G = iso * squared
                        drift = (c1 * M0 + c2 * M1) / root
                        P1 = at0 - at1 + drift
                        swing = (c1 * M1 + c2 * M2) / root - s * drift
                        P0 = (at1 * (1 - s) + at0 * s + G - swing) / (h * h)
                        P2 = 2 * G - h * h * P0
                        for x in range(3):
                            n = u[x] - s * w[x]
                            far = (n * (s * P0 + P1) - w[x] * (s * P1 + P2)) / (squared * squared)
                            near = (n * P0 - w[x] * P1) / (squared * squared) - far
                            by_c1 = M1 / root / squared
                            push = (M0 / root * va[x]) / squared + by_c1 * D[x]
                            swirl = by_c1 * va[x] + (M2 / root * D[x]) / squared
                            out[0, b, i, x] += weight * spread * near
                            out[0, b, j, x] += weight * spread * far
                            out[1, b, i, x] += weight * spread * (push - swirl)
                            out[1, b, j, x] += weight * spread * swirl
                whole = phi + ahead * rate + spread * iso
                for x in range(3):
                    e1, e2 = u[x] / d1, v[x] / d2
                    e1_rate = (-va[x] - e1 * speed1) / d1
                    e2_rate = (-vb[x] - e2 * speed2) / d2
                    stretch_rate = kappa_rate * w[x] + kappa * D[x]
                    at_a, at_b = c * e1 - kappa * w[x], c * e2 + kappa * w[x]
                    a_rate = c_rate * e1 + c * e1_rate - stretch_rate
                    b_rate = c_rate * e2 + c * e2_rate + stretch_rate
                    out[0, b, i, x] += weight * (at_a + ahead * a_rate)
                    out[0, b, j, x] += weight * (at_b + ahead * b_rate)
                    out[1, b, i, x] += weight * ahead * at_a
                    out[1, b, j, x] += weight * ahead * at_b
                    if by_length:
                        grown = weights[b, p] * whole * w[x] / length
                        out[0, b, i, x] -= grown
                        out[0, b, j, x] += grown
    return out


# ------------------------------------------------------------------------------------------- cells of a motion


_ROUNDING = 1e-7  # relative, of closed forms


class CellMotions(NamedTuple):
    """N cells of a motion by s: key points and velocities (N, K, 3) at the centres, bounds V and A (N, K) in the cells.

    Also half their lengths h (N,), and how fast links may become longer with s, `strokes: (N,)`.
    """

    keypoints: FloatArray
    velocities: FloatArray
    speeds: FloatArray
    accelerations: FloatArray
    halves: FloatArray
    strokes: FloatArray


@compiled
def cell_bounds(
    cells: CellMotions,
    links: IntArray,
    points: FloatArray,
    gamma: float,
    by_length: bool,
    rates: FloatArray,
    enough: FloatArray,
) -> FloatArray:
    """Return upper bounds of φ and of φ′ + γI over cells, (2, N, M), summed over links; +inf where p may be reached.

    See `docs/mathematics.md` §9. A cell is a piece of a curve q(s), half of it h long on either side of its centre.
    There no point of a link moves by more than V with s, nor with more than A along s (‖x′‖ ≤ V, ‖x″‖ ≤ A). With D the
    distance of p from the link at the centre no point of the link is nearer to p than R = D − Vh in the cell, so that
    its field is below U = φD/R. As 1/ρ² and 1/ρ³ are below 1/Rρ and 1/R²ρ there, and as ∇²(1/ρ) has the eigenvalues
    2/ρ³ and −1/ρ³,

        |φ″| ≤ B,    |I′| ≤ B,    B = U (2V²/R² + A/R),    for φ′ = ∫ρ·x′/ρ³ and I = ∫‖x′‖/ρ² by s,

        φ ≤ min(U, φ + h|φ′| + h²B/2),    φ′ + γI ≤ φ′ + γI + (1 + γ) h B,    both sides' right at the centre,

    and whatever the motion, φ′ + γI ≤ (1 + γ) U V/R. Most danger points of a scene are so far away that the last bound
    is enough, or even φ ≤ U ≤ 1/R: they take no closed forms.

    Links are (L, 2), points (M, 3), rates ṡ (N,). Where φ + ṡ(φ′ + γI) is no larger than `enough: (M,)` by a cheaper
    bound, this bound stands.
    """
    keypoints, velocities = cells.keypoints, cells.velocities
    speeds, accelerations, strokes = cells.speeds, cells.accelerations, cells.strokes
    N, M = len(keypoints), len(points)
    out = np.zeros((2, N, M))
    w, D, u, v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for b in range(N):
        h = cells.halves[b]
        for p in range(M):
            for detail in range(3):
                level, push = 0.0, 0.0
                for k in range(len(links)):
                    i, j = links[k, 0], links[k, 1]
                    difference(keypoints[b, j], keypoints[b, i], w)
                    difference(points[p], keypoints[b, i], u)
                    squared = dot(w, w)
                    t = dot(u, w) / max(squared, ZERO)
                    t = min(1.0, max(0.0, t))
                    away = sqrt((u[0] - t * w[0]) ** 2 + (u[1] - t * w[1]) ** 2 + (u[2] - t * w[2]) ** 2)
                    V, A = max(speeds[b, i], speeds[b, j]), max(accelerations[b, i], accelerations[b, j])
                    near = away - V * h
                    if near <= 0.0:
                        level, push = inf, inf
                        break
                    field, most = 1 / near, 1 / near
                    swift = (1 + gamma) * most * V / near
                    if detail > 0:
                        va, vb = velocities[b, i], velocities[b, j]
                        difference(vb, va, D)
                        difference(points[p], keypoints[b, j], v)
                        phi, rate, iso = link_parts(u, v, w, va, vb, D, detail == 2 and gamma > 0)
                        most = min(most, phi * away / near)
                        bend = most * (2 * V * V / (near * near) + A / near)
                        field = min(most, phi + h * abs(rate) + h * h * bend / 2)
                        swift = (1 + gamma) * most * V / near
                        if detail == 2 or gamma == 0:
                            size = abs(rate) + gamma * iso
                            swift = min(swift, rate + gamma * iso + (1 + gamma) * h * bend + _ROUNDING * size)
                    low = high = 1.0
                    if by_length:
                        low, high = max(0.0, sqrt(squared) - strokes[b] * h), sqrt(squared) + strokes[b] * h
                    level += high * field
                    push += swift * (high if swift > 0 else low)
                out[0, b, p] = level * (1 + _ROUNDING)
                out[1, b, p] = push
                if level == inf or (detail == 1 and gamma == 0):
                    break
                if out[0, b, p] + rates[b] * push <= enough[p]:
                    break
    return out
