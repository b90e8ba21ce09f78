"""The kinetostatic danger field of moving link segments, in closed form (`docs/how-it-works.md` §8, §9).

The link a → b has the end velocities v_a, v_b; its point t ∈ [0, 1] the velocity v(t) = v_a + tD, D = v_b − v_a, and
ρ = p − a − tw is the ray to the field point p, w = b − a, ℓ = ‖w‖. Three integrals over the link make the field:

    φ = ∫ dt/‖ρ‖,    φ̇ = ∫ ρ·v/‖ρ‖³ dt = ∂φ/∂a·v_a + ∂φ/∂b·v_b,    I = ∫ ‖v‖/‖ρ‖² dt.

For I let ‖ρ‖² = ℓ²((t−s)² + h²) and ‖v‖² = c₀ + 2c₁t + c₂t² = c₂X², X² = (t−σ)² + g². With z = s + ih, m = σ − z,
E² = m² + g² = (m + ig)(m − ig), and t − σ = (u − 1/u)g/2

    A = ∫ dt/X = [log u]₀¹,    J = ∫ dt/(X(t−z)) = L/E,    L = [log(u − u₊) − log(u − u₋)]₀¹,    u± = (−m ± E)/g,
    I = (√c₂/ℓ²)(A + Im(E²J)/h).

u is real and u± is not, so no logarithm crosses its branch cut. u₊u₋ = −1 gives the smaller root without
cancellation. h, g and c₂ have lower bounds, which change the integrals by relative errors below 1e-8. They matter for
points on the extension of a link, for a link that rotates about a point of its own line, and for a link that hardly
rotates.

The maximum danger of many points needs the closed forms at few of them. Neighbouring points are grouped in balls. Let a
ball of radius r have a centre c at the distance D > r from a link, and let the points of the link be at most as fast as
V. Then every point p of the ball is at least D − r = R away from the link, and with U = φ(c)D/R

    φ(p) ≤ U,    φ̇(p) ≤ φ̇(c) + 2rVU/R²,    I(p) ≤ I(c) + 2rVU/R²,

because the gradient of 1/ρ² has a norm of at most 2/ρ³. Since ‖v(t)‖ ≤ (1−t)‖v_a‖ + t‖v_b‖ and 1/ρ² ≤ 1/(Dρ),

    I(c) ≤ [‖v_a‖ φ + (‖v_b‖ − ‖v_a‖)((d_b − d_a)/ℓ² + sφ)]/D,    s = (c − a)·w/ℓ²,

where d_a and d_b are the distances from the link's ends. A point is a ball of radius 0; then only I is a bound.
"""

from libc.math cimport INFINITY, atan2, copysign, fabs, hypot, log, log1p, sqrt
from libc.stdlib cimport free, malloc

from safe_ompl.danger.skeleton cimport SERIES, ZERO, PointRange, Skeleton, half_square_difference
from safe_ompl.danger.static cimport SkeletonTable, lanes, skeleton_of
from safe_ompl.robot.kinematics cimport key_point_velocities, move_joints, place_joints, place_key_points

from typing import NamedTuple

import numpy as np

from safe_ompl.common import InputError

# Lower bounds: of h relative to the distance from the segment, of c₂ relative to the squared speed, and of g.
cdef double BESIDE = 3e-5
cdef double TURNING = 1e-10
cdef double SHARP = 1e-9
# Relative rounding error of the closed forms.
cdef double CLOSED_FORM_ROUNDING = 1e-7
# Bounds are multiplied by this, because of rounding errors.
cdef double SLACK = 1 + 1e-7
# If (S² − ℓ²)/S² is below this, cancellation is too large, and the bound is infinite.
cdef double LOST = 1e-7
# Links shorter than this are treated as points [m].
cdef double SHORT = 1e-6
# Links that become longer by at most this, relative to their length and speed, count as rigid.
cdef double RIGID = 1e-9


cdef inline double _dot(const double *u, const double *v) noexcept nogil:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


cdef inline double _cross_norm(const double *u, const double *v) noexcept nogil:
    cdef double x = u[1] * v[2] - u[2] * v[1], y = u[2] * v[0] - u[0] * v[2], z = u[0] * v[1] - u[1] * v[0]
    return sqrt(x * x + y * y + z * z)


cdef inline void _subtract(const double *a, const double *b, double *out) noexcept nogil:
    """Compute a − b (3,)."""
    cdef Py_ssize_t x
    for x in range(3):
        out[x] = a[x] - b[x]


# φ = θ/ℓ, c = 2/(S² − ℓ²) and κ = (cS − φ)/ℓ².
cdef struct GradientTerms:
    double phi
    double c
    double kappa


cdef GradientTerms _gradient_terms(double length, double S, double half) noexcept nogil:
    """Return φ, c and κ. For short links κ is the series (2/S³) Σ_k 2k/(2k+1) y^(k−1), y = (ℓ/S)²."""
    cdef double c = 1.0 / half, phi, y = length / S, total = 0.0, power = 1.0
    cdef int k
    phi = log1p(length * (S + length) * c) / length
    y = y * y
    if y > SERIES:
        return GradientTerms(phi, c, (c * S - phi) / (length * length))
    for k in range(1, 10):
        total += 2.0 * k / (2 * k + 1) * power
        power *= y
    return GradientTerms(phi, c, 2.0 * total / (S * S * S))


cdef void _kappa_slopes(
    double length, double S, double c, double kappa, double *by_S, double *by_length
) noexcept nogil:
    """Compute ∂κ/∂S and ∂κ/∂ℓ; for short links by the series (2/S³) Σ_k 2k(k − 1)/(2k + 1) y^(k−2)."""
    cdef double y = length / S, squared = length * length, slope = 0.0, power = 1.0
    cdef int k
    y = y * y
    if y > 0.01:
        # ∂φ/∂S = −c and ∂φ/∂ℓ = (cS − φ)/ℓ; ∂c/∂S = −c²S, ∂c/∂ℓ = c²ℓ
        by_S[0] = (2 * c - c * c * S * S) / squared
        by_length[0] = (c * c * length * S - kappa * length) / squared - 2 * kappa / length
        return
    for k in range(2, 10):
        slope += 2.0 * k * (k - 1) / (2 * k + 1) * power
        power *= y
    slope *= 2 / (S * S * S)
    by_S[0] = -(3 * kappa + 2 * y * slope) / S
    by_length[0] = 2 * slope * length / (S * S)


cdef struct Complex:
    double re
    double im


cdef inline Complex _times(Complex a, Complex b) noexcept nogil:
    return Complex(a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re)


cdef inline Complex _over(Complex a, Complex b) noexcept nogil:
    """Return a/b without overflow (Smith's algorithm)."""
    cdef double ratio, denominator
    if fabs(b.re) >= fabs(b.im):
        ratio = b.im / b.re
        denominator = b.re + b.im * ratio
        return Complex((a.re + a.im * ratio) / denominator, (a.im - a.re * ratio) / denominator)
    ratio = b.re / b.im
    denominator = b.re * ratio + b.im
    return Complex((a.re * ratio + a.im) / denominator, (a.im * ratio - a.re) / denominator)


cdef inline Complex _root(Complex z) noexcept nogil:
    """Return the principal square root (algorithm 312, CACM 1967)."""
    cdef double t
    if z.re == 0.0 and z.im == 0.0:
        return Complex(0.0, z.im)
    if z.re >= 0.0:
        t = sqrt((z.re + hypot(z.re, z.im)) * 0.5)
        return Complex(t, z.im / (2 * t))
    t = sqrt((-z.re + hypot(z.re, z.im)) * 0.5)
    return Complex(fabs(z.im) / (2 * t), copysign(t, z.im))


cdef inline double _square(Complex z) noexcept nogil:
    return z.re * z.re + z.im * z.im


cdef inline double _turn(Complex z, Complex w) noexcept nogil:
    """Return the angle from w to z."""
    return atan2(z.im * w.re - z.re * w.im, z.re * w.re + z.im * w.im)


# I, the moments M_k = ∫ t^k/(X·((t−s)²+h²)) dt for k = 0, 1, 2, and s, h, c₁, c₂, X(0), X(1).
cdef struct Isotropic:
    double value
    double M0
    double M1
    double M2
    double s
    double h
    double c1
    double c2
    double X0
    double X1


cdef Isotropic _isotropic(const double *u, const double *w, const double *va, const double *D) noexcept nogil:
    """Return I, the part of the field that depends on the speed and not on the direction of motion."""
    cdef double squared = max(_dot(w, w), ZERO), s = _dot(u, w) / squared, h = _cross_norm(u, w) / squared
    cdef double beyond = max(max(-s, s - 1.0), 0.0), c0, c1, c2, turning, sigma, area, g, x0, x1, r0, r1, u0, u1, A
    cdef double ratio, value, M0, M1, M2
    cdef Complex z, m, E, E1, E2, large, small, L, J, EL
    h = max(max(h, BESIDE * hypot(beyond, h)), ZERO)
    c0, c1 = _dot(va, va), _dot(va, D)
    turning = _dot(D, D)
    c2 = max(turning, TURNING * c0)
    if c2 <= 0.0:
        return Isotropic(0.0, 0.0, 0.0, 0.0, s, h, 0.0, 0.0, 0.0, 0.0)
    sigma = -c1 / c2
    area = _cross_norm(va, D)
    g = max(sqrt(area * area + c0 * (c2 - turning)) / c2, SHARP)
    x0, x1 = -sigma / g, (1.0 - sigma) / g
    r0, r1 = sqrt(x0 * x0 + 1), sqrt(x1 * x1 + 1)
    u0 = x0 + r0 if x0 > 0 else 1 / (r0 - x0)
    u1 = x1 + r1 if x1 > 0 else 1 / (r1 - x1)
    A = log(u1 / u0)
    z = Complex(s, h)
    m = Complex(sigma - z.re, -z.im)
    E1, E2 = _root(Complex(m.re, m.im + g)), _root(Complex(m.re, m.im - g))
    E = _times(E1, E2)
    if -m.re * E.re - m.im * E.im < 0:
        E = Complex(-E.re, -E.im)
    large = Complex((E.re - m.re) / g, (E.im - m.im) / g)
    small = _over(Complex(-1.0, 0.0), large)
    L = Complex(
        0.5 * log(
            _square(Complex(u1 - large.re, -large.im)) / _square(Complex(u0 - large.re, -large.im))
            * (_square(Complex(u0 - small.re, -small.im)) / _square(Complex(u1 - small.re, -small.im)))
        ),
        _turn(Complex(u1 - large.re, -large.im), Complex(u0 - large.re, -large.im))
        - _turn(Complex(u1 - small.re, -small.im), Complex(u0 - small.re, -small.im)),
    )
    J = _over(L, E) if E.re != 0 or E.im != 0 else Complex(0.0, 0.0)
    ratio = sqrt(c2) / squared
    EL = _times(E, L)
    value = ratio * (A + EL.im / h)
    M0, M1 = J.im / h, _times(z, J).im / h
    M2 = A + 2 * s * M1 - (s * s + h * h) * M0
    return Isotropic(value, M0, M1, M2, s, h, c1, c2, g * r0, g * r1)


# φ, φ̇ and I.
cdef struct Terms:
    double phi
    double rate
    double spread


cdef Terms _link_terms(
    const double *u, const double *v, const double *w, const double *va, const double *vb, const double *D,
    bint isotropic,
) noexcept nogil:
    """Return φ, φ̇ and I (0 if not wanted) of one link, with u = p − a and v = p − b; infinity on the link."""
    cdef double d1 = sqrt(_dot(u, u)), d2 = sqrt(_dot(v, v)), half = half_square_difference(u, v, d1, d2), length, rate
    cdef GradientTerms terms
    if half <= 0.0 or d1 == 0.0 or d2 == 0.0:
        return Terms(INFINITY, INFINITY, INFINITY)
    length = max(sqrt(_dot(w, w)), ZERO)
    terms = _gradient_terms(length, d1 + d2, half)
    rate = terms.c * (_dot(u, va) / d1 + _dot(v, vb) / d2) + terms.kappa * _dot(w, D)
    return Terms(terms.phi, rate, _isotropic(u, w, va, D).value if isotropic else 0.0)


cdef Terms _link_sums(
    const double *places, const double *velocities, const Skeleton *s, const double *point, bint isotropic
) noexcept nogil:
    """Return Σφ, Σφ̇ and ΣI (0 if not wanted) over the links at a point (3,), for key points (K, 3).

    The values are infinite on a link.
    """
    cdef double w[3]
    cdef double D[3]
    cdef double u[3]
    cdef double v[3]
    cdef const double *a
    cdef const double *b
    cdef const double *va
    cdef const double *vb
    cdef Terms sums = Terms(0.0, 0.0, 0.0), terms
    cdef double scale
    cdef Py_ssize_t k
    for k in range(s.L):
        a, b = places + 3 * s.links[2 * k], places + 3 * s.links[2 * k + 1]
        va, vb = velocities + 3 * s.links[2 * k], velocities + 3 * s.links[2 * k + 1]
        _subtract(b, a, w)
        _subtract(vb, va, D)
        _subtract(point, a, u)
        _subtract(point, b, v)
        terms = _link_terms(u, v, w, va, vb, D, isotropic)
        if terms.phi == INFINITY:
            return Terms(INFINITY, INFINITY, INFINITY)
        scale = max(sqrt(_dot(w, w)), ZERO) if s.by_length else 1.0
        sums.phi, sums.rate = sums.phi + scale * terms.phi, sums.rate + scale * terms.rate
        sums.spread += scale * terms.spread
    return sums


cdef int _check(const double[:, :, ::1] places, const double[:, :, ::1] velocities) except -1:
    cdef Py_ssize_t B = places.shape[0], K = places.shape[1]
    if velocities.shape[0] != B or velocities.shape[1] != K or velocities.shape[2] != 3:
        raise InputError(f"velocities must have the shape of the places, ({B}, {K}, 3)")
    return 0


# A skeleton in motion.
cdef struct Motion:
    const Skeleton *skeleton
    # Key points [m] and their velocities [m/s], (K, 3).
    const double *places
    const double *velocities
    # Factors of φ̇ and of I [s].
    double ahead
    double spread


def link_terms(
    const double[:, :, ::1] places, const double[:, :, ::1] velocities, const Py_ssize_t[:, ::1] links,
    const double[:, ::1] points, bint by_length, bint isotropic,
):
    """Return φ, φ̇ and I (0 unless wanted) summed over the links, (3, B, M), at points (M, 3).

    Places and velocities of the key points are (B, K, 3), and links (L, 2) are pairs of these.
    """
    cdef Py_ssize_t B = places.shape[0], M = points.shape[0], b, m
    cdef Skeleton skeleton = skeleton_of(links, places, by_length)
    cdef Terms found
    _check(places, velocities)
    terms = np.zeros((3, B, M))
    cdef double[:, :, ::1] out = terms
    if points.shape[1] != 3:
        raise InputError("points must have shape (M, 3)")
    if not skeleton.L:
        return terms
    with nogil:
        for b in range(B):
            for m in range(M):
                found = _link_sums(&places[b, 0, 0], &velocities[b, 0, 0], &skeleton, &points[m, 0], isotropic)
                out[0, b, m], out[1, b, m], out[2, b, m] = found.phi, found.rate, found.spread
    return terms


def gradients(
    const double[:, :, ::1] places, const double[:, :, ::1] velocities, const Py_ssize_t[:, ::1] links,
    const double[:, :, ::1] points, const double[:, ::1] weights, double ahead, double spread, bint by_length,
):
    """Return the gradients of Σ_m w_m (φ + ahead·φ̇ + spread·I) by key points and by their velocities, (2, B, K, 3).

    Places and velocities of the key points are (B, K, 3), links (L, 2) pairs of these, points (B or 1, M, 3), and
    weights (B, M).
    """
    cdef Py_ssize_t B = weights.shape[0], M = weights.shape[1], b, k, p
    cdef Skeleton skeleton = skeleton_of(links, places, by_length)
    cdef Motion motion = Motion(&skeleton, NULL, NULL, ahead, spread)
    _check(places, velocities)
    if places.shape[0] != B or points.shape[0] not in (1, B) or points.shape[1] != M or points.shape[2] != 3:
        raise InputError(f"points must have shape (1 or {B}, {M}, 3), as the weights have rows and columns")
    found = np.zeros((2, B, places.shape[1], 3))
    cdef double[:, :, :, ::1] out = found
    with nogil:
        for b in range(B):
            for k in range(skeleton.L):
                motion.places, motion.velocities = &places[b, 0, 0], &velocities[b, 0, 0]
                for p in range(M):
                    _add_gradients(
                        &motion, k, &points[b if points.shape[0] > 1 else 0, p, 0], weights[b, p], &out[0, b, 0, 0],
                        &out[1, b, 0, 0],
                    )
    return found


cdef void _add_gradients(
    const Motion *motion, Py_ssize_t link, const double *point, double point_weight, double *by_places,
    double *by_velocities
) noexcept nogil:
    """Add the gradients of the weighted field of a link at a point (3,) by key points and their velocities (K, 3)."""
    cdef const Skeleton *s = motion.skeleton
    cdef Py_ssize_t i = 3 * s.links[2 * link], j = 3 * s.links[2 * link + 1]
    cdef const double *a = motion.places + i
    cdef const double *b = motion.places + j
    cdef const double *va = motion.velocities + i
    cdef const double *vb = motion.velocities + j
    cdef double *by_a = by_places + i
    cdef double *by_b = by_places + j
    cdef double *by_va = by_velocities + i
    cdef double *by_vb = by_velocities + j
    cdef double ahead = motion.ahead, spread = motion.spread
    cdef bint by_length = s.by_length
    cdef double w[3]
    cdef double D[3]
    cdef double u[3]
    cdef double v[3]
    cdef double length, d1, d2, half, weight, S, speed1, speed2, growth, c_rate, kappa_rate, rate, whole, squared, root
    cdef double by_S, by_l, e1, e2, e1_rate, e2_rate, stretch_rate, at_a, at_b, a_rate, b_rate, grown
    cdef double at0, at1, G, drift, P0, P1, P2, moment, n, far, near, by_c1, by_both, by_end
    cdef GradientTerms terms
    cdef Isotropic iso = Isotropic(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    cdef Py_ssize_t x
    _subtract(b, a, w)
    _subtract(vb, va, D)
    length = max(sqrt(_dot(w, w)), ZERO)
    _subtract(point, a, u)
    _subtract(point, b, v)
    d1, d2 = sqrt(_dot(u, u)), sqrt(_dot(v, v))
    half = half_square_difference(u, v, d1, d2)
    if half <= 0.0 or d1 == 0.0 or d2 == 0.0:
        return
    weight = (length if by_length else 1.0) * point_weight
    S = d1 + d2
    terms = _gradient_terms(length, S, half)
    _kappa_slopes(length, S, terms.c, terms.kappa, &by_S, &by_l)
    # φ̇ and, as the Hessian is symmetric, its gradient: how ∂φ/∂a, ∂φ/∂b change while the ends move
    speed1, speed2 = -_dot(u, va) / d1, -_dot(v, vb) / d2
    growth = _dot(w, D) / length
    c_rate = -terms.c * terms.c * (S * (speed1 + speed2) - length * growth)
    kappa_rate = by_S * (speed1 + speed2) + by_l * growth
    rate = -terms.c * (speed1 + speed2) + terms.kappa * length * growth
    if spread != 0.0:
        iso = _isotropic(u, w, va, D)
        root, squared = sqrt(iso.c2), length * length
        if iso.c2 > 0.0:
            # f = ‖v‖, f' = (c₁ + c₂t)/f; P_k = ∫ 2f (t−s)^k/((t−s)²+h²)² dt
            at0 = root * iso.X0 / (iso.s * iso.s + iso.h * iso.h)
            at1 = root * iso.X1 / ((1 - iso.s) * (1 - iso.s) + iso.h * iso.h)
            G = iso.value * squared
            drift = (iso.c1 * iso.M0 + iso.c2 * iso.M1) / root
            P1 = at0 - at1 + drift
            moment = (iso.c1 * iso.M1 + iso.c2 * iso.M2) / root - iso.s * drift
            P0 = (at1 * (1 - iso.s) + at0 * iso.s + G - moment) / (iso.h * iso.h)
            P2 = 2 * G - iso.h * iso.h * P0
            for x in range(3):
                n = u[x] - iso.s * w[x]
                far = (n * (iso.s * P0 + P1) - w[x] * (iso.s * P1 + P2)) / (squared * squared)
                near = (n * P0 - w[x] * P1) / (squared * squared) - far
                by_c1 = iso.M1 / root / squared
                by_both = (iso.M0 / root * va[x]) / squared + by_c1 * D[x]
                by_end = by_c1 * va[x] + (iso.M2 / root * D[x]) / squared
                by_a[x] += weight * spread * near
                by_b[x] += weight * spread * far
                by_va[x] += weight * spread * (by_both - by_end)
                by_vb[x] += weight * spread * by_end
    whole = terms.phi + ahead * rate + spread * iso.value
    for x in range(3):
        e1, e2 = u[x] / d1, v[x] / d2
        e1_rate = (-va[x] - e1 * speed1) / d1
        e2_rate = (-vb[x] - e2 * speed2) / d2
        stretch_rate = kappa_rate * w[x] + terms.kappa * D[x]
        at_a, at_b = terms.c * e1 - terms.kappa * w[x], terms.c * e2 + terms.kappa * w[x]
        a_rate = c_rate * e1 + terms.c * e1_rate - stretch_rate
        b_rate = c_rate * e2 + terms.c * e2_rate + stretch_rate
        by_a[x] += weight * (at_a + ahead * a_rate)
        by_b[x] += weight * (at_b + ahead * b_rate)
        by_va[x] += weight * ahead * at_a
        by_vb[x] += weight * ahead * at_b
        if by_length:
            grown = point_weight * whole * w[x] / length
            by_a[x] -= grown
            by_b[x] += grown


class CellMotions(NamedTuple):
    """Motions of the K key points of a skeleton in N cells, which are pieces of a curve q(s).

    Parameters
    ----------
    places, velocities : ndarray, shape (N, K, 3)
        Key points [m], and their derivatives by s, at the centres of the cells.
    speeds, accelerations : ndarray, shape (N, K)
        Bounds V and A of the first and the second derivative of the key points by s in the cells.
    halves : ndarray, shape (N,)
        Half the lengths of the cells, h.
    strokes : ndarray, shape (N,)
        How fast links may become longer with s.
    rates : ndarray, shape (N,)
        Factors of φ′ + γI in the danger: bounds of ṡ in the cells [1/s] times k₂/k₁ [s].
    """

    places: object
    velocities: object
    speeds: object
    accelerations: object
    halves: object
    strokes: object
    rates: object


# `CellMotions` of one cell.
cdef struct CellMotion:
    const Skeleton *skeleton
    const double *places
    const double *velocities
    const double *speeds
    const double *accelerations
    double half
    double stroke


def cell_bounds(
    cells, const Py_ssize_t[:, ::1] links, const double[:, ::1] points, double gamma, bint by_length,
    const double[::1] enough,
):
    """Return upper bounds of φ and of φ′ + γI over cells, (2, N, M), summed over links; +inf where p may be reached.

    See `docs/how-it-works.md` §9. A cell is a piece of a curve q(s), half of it h long on either side of its centre.
    There no point of a link moves by more than V with s, nor with more than A along s (‖x′‖ ≤ V, ‖x″‖ ≤ A). With D the
    distance of p from the link at the centre no point of the link is nearer to p than R = D − Vh in the cell, so that
    its field is below U = φD/R. As 1/ρ² and 1/ρ³ are below 1/Rρ and 1/R²ρ there, and as ∇²(1/ρ) has the eigenvalues
    2/ρ³ and −1/ρ³,

        |φ″| ≤ B,    |I′| ≤ B,    B = U (2V²/R² + A/R),    for φ′ = ∫ρ·x′/ρ³ and I = ∫‖x′‖/ρ² by s,

        φ ≤ min(U, φ + h|φ′| + h²B/2),    φ′ + γI ≤ φ′ + γI + (1 + γ) h B,    both sides' right at the centre,

    and whatever the motion, φ′ + γI ≤ (1 + γ) U V/R. Most danger points of a scene are so far away that the last bound
    is enough, or even φ ≤ U ≤ 1/R: they take no closed forms.

    Parameters
    ----------
    cells : CellMotions
        Motions of the key points in N cells.
    links : ndarray of intp, shape (L, 2)
        Which key points links lead from and to.
    points : ndarray, shape (M, 3)
        Danger points [m].
    gamma : float
        γ.
    by_length : bool
        Whether a link weighs in proportion to its length.
    enough : ndarray, shape (M,)
        Where φ + ṡ(φ′ + γI) is no larger than this by a cheaper bound, this bound stands.
    """
    cdef const double[:, :, ::1] places = cells.places, velocities = cells.velocities
    cdef const double[:, ::1] speeds = cells.speeds, accelerations = cells.accelerations
    cdef const double[::1] halves = cells.halves, strokes = cells.strokes, rates = cells.rates
    cdef Py_ssize_t N = places.shape[0], M = points.shape[0], K = places.shape[1], b, p
    cdef Skeleton skeleton = skeleton_of(links, places, by_length)
    cdef CellMotion cell
    cdef int detail
    cdef double level, coefficient
    _check(places, velocities)
    if speeds.shape[0] != N or speeds.shape[1] != K or accelerations.shape[0] != N or accelerations.shape[1] != K:
        raise InputError(f"speeds and accelerations must have shape ({N}, {K})")
    if halves.shape[0] != N or strokes.shape[0] != N or rates.shape[0] != N:
        raise InputError(f"halves, strokes and rates must be of {N} cells")
    if points.shape[1] != 3 or enough.shape[0] != M:
        raise InputError("points must have shape (M, 3), and there must be a level for each")
    found = np.zeros((2, N, M))
    cdef double[:, :, ::1] out = found
    if not K:
        return found
    with nogil:
        for b in range(N):
            cell = CellMotion(
                &skeleton, &places[b, 0, 0], &velocities[b, 0, 0], &speeds[b, 0], &accelerations[b, 0], halves[b],
                strokes[b],
            )
            for p in range(M):
                for detail in range(3):
                    level = coefficient = 0.0
                    _add_cell_bounds(&cell, &points[p, 0], gamma, detail, &level, &coefficient)
                    out[0, b, p] = level * (1 + CLOSED_FORM_ROUNDING)
                    out[1, b, p] = coefficient
                    if level == INFINITY or (detail == 1 and gamma == 0):
                        break
                    if out[0, b, p] + rates[b] * coefficient <= enough[p]:
                        break
    return found


cdef void _add_cell_bounds(
    const CellMotion *cell, const double *point, double gamma, int detail, double *level, double *coefficient
) noexcept nogil:
    """Add the bounds of all links in a cell. With more detail they are tighter and take longer."""
    cdef const Skeleton *s = cell.skeleton
    cdef const double *places = cell.places
    cdef const double *velocities = cell.velocities
    cdef double h = cell.half, stroke = cell.stroke
    cdef double w[3]
    cdef double D[3]
    cdef double u[3]
    cdef double v[3]
    cdef double squared, t, away, V, A, near, field, most, swift, curvature, size, low, high, x, y, z
    cdef Py_ssize_t k, i, j
    cdef Terms terms
    for k in range(s.L):
        i, j = s.links[2 * k], s.links[2 * k + 1]
        _subtract(places + 3 * j, places + 3 * i, w)
        _subtract(point, places + 3 * i, u)
        squared = _dot(w, w)
        t = _dot(u, w) / max(squared, ZERO)
        t = min(1.0, max(0.0, t))
        x, y, z = u[0] - t * w[0], u[1] - t * w[1], u[2] - t * w[2]
        away = sqrt(x * x + y * y + z * z)
        V, A = max(cell.speeds[i], cell.speeds[j]), max(cell.accelerations[i], cell.accelerations[j])
        near = away - V * h
        if near <= 0.0:
            level[0] = coefficient[0] = INFINITY
            return
        field = most = 1 / near
        swift = (1 + gamma) * most * V / near
        if detail > 0:
            _subtract(velocities + 3 * j, velocities + 3 * i, D)
            _subtract(point, places + 3 * j, v)
            terms = _link_terms(
                u, v, w, velocities + 3 * i, velocities + 3 * j, D, detail == 2 and gamma > 0
            )
            most = min(most, terms.phi * away / near)
            curvature = most * (2 * V * V / (near * near) + A / near)
            field = min(most, terms.phi + h * fabs(terms.rate) + h * h * curvature / 2)
            swift = (1 + gamma) * most * V / near
            if detail == 2 or gamma == 0:
                size = fabs(terms.rate) + gamma * terms.spread
                swift = min(
                    swift,
                    terms.rate + gamma * terms.spread + (1 + gamma) * h * curvature + CLOSED_FORM_ROUNDING * size,
                )
        low = high = 1.0
        if s.by_length:
            low, high = max(0.0, sqrt(squared) - stroke * h), sqrt(squared) + stroke * h
        level[0] += high * field
        coefficient[0] += swift * (high if swift > 0 else low)


# Balls with centres in the columns (3, stride) from `offset` on; radii NULL: points. `tops` holds the largest point
# weight of each ball, and `bounds` receives upper bounds of the danger.
cdef struct Balls:
    const double *columns
    Py_ssize_t stride
    Py_ssize_t offset
    const double *radii
    const double *tops
    double *bounds


# Working memory of `_bound`.
cdef struct BoundMemory:
    # Fields of the links, and of the key points distances [m] and ρ·v/‖ρ‖ [m/s], (L + 2K, width).
    double *rows
    # Largest number of balls or points that are bounded at once.
    Py_ssize_t width
    # Memory of `LaneFunctions.fields_at_points`.
    void *of_lanes


cdef void _bound(
    const Motion *motion, const Balls *balls, Py_ssize_t begin, Py_ssize_t end, const BoundMemory *memory
) noexcept nogil:
    """Compute upper bounds of the danger of consecutive balls or points."""
    cdef const Skeleton *s = motion.skeleton
    cdef const double *places = motion.places
    cdef const double *velocities = motion.velocities
    cdef const double *columns = balls.columns
    cdef double ahead = motion.ahead, spread = motion.spread
    cdef double *rows = memory.rows
    cdef Py_ssize_t width = memory.width
    cdef double *distances = rows + width * s.L
    cdef double *heading = distances + width * s.K
    cdef double *bounds = balls.bounds + begin
    cdef double *d
    cdef double *e
    cdef double *turn
    cdef double *lead
    cdef const double *fields
    cdef Py_ssize_t first_column = balls.offset + begin, count = end - begin, k, g, c, i, j, x
    cdef PointRange centres = PointRange(columns, balls.stride, first_column, balls.offset + end)
    cdef double px, py, pz, vx, vy, vz, ux, uy, uz, distance, squared, growth, first, last, w, length, swift, per_square
    cdef double scale, faster, d1, d2, phi, S, half, level, along, q, t, near, far
    cdef bint stretches
    lanes.fields_at_points(places, s, &centres, rows, width, False, memory.of_lanes)
    for k in range(s.K):
        px, py, pz = places[3 * k], places[3 * k + 1], places[3 * k + 2]
        vx, vy, vz = velocities[3 * k], velocities[3 * k + 1], velocities[3 * k + 2]
        for g in range(count):
            c = first_column + g
            ux, uy, uz = columns[c] - px, columns[balls.stride + c] - py, columns[2 * balls.stride + c] - pz
            distance = sqrt(ux * ux + uy * uy + uz * uz)
            distances[width * k + g] = distance
            heading[width * k + g] = (ux * vx + uy * vy + uz * vz) / distance
    for g in range(count):
        bounds[g] = 0.0
    for k in range(s.L):
        i, j = s.links[2 * k], s.links[2 * k + 1]
        squared = growth = first = last = 0.0
        for x in range(3):
            w = places[3 * j + x] - places[3 * i + x]
            squared += w * w
            growth += w * (velocities[3 * j + x] - velocities[3 * i + x])
            first += velocities[3 * i + x] * velocities[3 * i + x]
            last += velocities[3 * j + x] * velocities[3 * j + x]
        first, last, length = sqrt(first), sqrt(last), sqrt(max(squared, ZERO))
        swift, per_square = max(first, last), 1.0 / max(squared, ZERO)
        if length < SHORT:
            first, last, growth, per_square = swift, swift, 0.0, 0.0
        stretches = fabs(growth) > RIGID * length * swift
        scale, faster = length if s.by_length else 1.0, last - first
        d, e, fields = distances + width * i, distances + width * j, rows + width * k
        turn, lead = heading + width * i, heading + width * j
        for g in range(count):
            d1, d2 = d[g], e[g]
            phi, S = fields[g] / scale, d1 + d2
            half = 0.5 * (S - length) * (S + length)
            level = phi + ahead * (turn[g] + lead[g]) / half
            if stretches:
                level += ahead * growth * (S / half - phi) * per_square
            bounds[g] += scale * level if half > LOST * S * S else INFINITY
        if balls.radii == NULL and spread == 0.0:
            continue
        for g in range(count):
            d1, d2, phi = d[g], e[g], fields[g] / scale
            along = 0.5 * (d1 * d1 + squared - d2 * d2)
            q = along * per_square
            t = min(max(q, 0.0), 1.0)
            distance = sqrt(max(d1 * d1 - t * (2.0 * along - t * squared), 0.0))
            level = spread * (first * phi + faster * ((d2 - d1) * per_square + q * phi)) / distance
            if balls.radii != NULL:
                near = distance - balls.radii[begin + g]
                far = balls.radii[begin + g] / near
                level += phi * far + 2.0 * (ahead + spread) * swift * phi * distance * far / (near * near)
                level = level if near > 0.0 else INFINITY
            bounds[g] += scale * level
    for g in range(count):
        level = max(bounds[g], 0.0) * balls.tops[begin + g] * SLACK
        # ∞ − ∞ or 0·∞ where a point may be on a link.
        bounds[g] = level if level == level else INFINITY


cdef Py_ssize_t _highest(const double *bounds, Py_ssize_t begin, Py_ssize_t end) noexcept nogil:
    cdef Py_ssize_t best = begin, g
    for g in range(begin, end):
        if bounds[g] > bounds[best]:
            best = g
    return best


def highest(
    SkeletonTable skeleton not None, const double[:, ::1] values, const double[:, ::1] rates, groups, double ahead,
    double spread,
):
    """Return the maximum danger weight·Σ(φ + ahead·φ̇ + spread·I) (B,), and the indices of the points (B,).

    Besides them places and velocities of the key points (B, K, 3). Joints have `values` and `rates` (B, m); `ahead` and
    `spread` are in seconds. The `groups` are M ≥ 1 danger points in G groups: columns (3, M + G), the points and a
    centre of each group; point weights k₁w (M,); where the groups begin, and the last group ends, (G + 1,); radii (G,)
    [m] about the centres; largest point weights (G,).
    """
    cdef const double[:, ::1] columns = groups.columns
    cdef const double[::1] point_weights = groups.point_weights
    cdef const Py_ssize_t[::1] begins = groups.begins
    cdef const double[::1] radii = groups.radii
    cdef const double[::1] heaviest = groups.heaviest
    cdef const Skeleton *s = &skeleton.data
    cdef Py_ssize_t B = values.shape[0], m = s.m, K = s.K, M = point_weights.shape[0]
    cdef Py_ssize_t G = radii.shape[0], most = G, g, b
    if values.shape[1] != m or rates.shape[1] != m or rates.shape[0] != B:
        raise InputError(f"values and rates must have {m} columns, and as many rows")
    if columns.shape[0] != 3 or columns.shape[1] != M + G or begins.shape[0] != G + 1 or heaviest.shape[0] != G:
        raise InputError("the groups' tables must be of the same points and groups")
    if not M or not K or begins[0] != 0 or begins[G] != M:
        raise InputError("there must be a key point and a danger point, and groups must hold all of these")
    for g in range(G):
        if begins[g] > begins[g + 1]:
            raise InputError(f"group {g} ends before it begins")
        most = max(most, begins[g + 1] - begins[g])
    levels, chosen, motions = np.empty(B), np.empty(B, dtype=np.intp), np.empty((2, B, K, 3))
    cdef double[::1] out = levels
    cdef Py_ssize_t[::1] best = chosen
    cdef double[:, :, :, ::1] moving = motions
    cdef double *room = <double *> malloc(
        ((s.L + 2 * K) * most + G + M + 21 * m) * sizeof(double) + lanes.block_size(K)
    )
    if not room:
        raise MemoryError
    cdef double *bounds = room + (s.L + 2 * K) * most
    cdef double *frames = bounds + G + M
    cdef BoundMemory memory = BoundMemory(room, most, frames + 21 * m)
    cdef Balls balls = Balls(&columns[0, 0], M + G, M, &radii[0], &heaviest[0], bounds)
    cdef Balls alone = Balls(&columns[0, 0], M + G, 0, NULL, &point_weights[0], bounds + G)
    cdef Motion motion = Motion(s, NULL, NULL, ahead, spread)
    with nogil:
        for b in range(B):
            motion.places, motion.velocities = &moving[0, b, 0, 0], &moving[1, b, 0, 0]
            place_joints(s.joints, m, &values[b, 0] if m else NULL, frames, frames + 9 * m, frames + 12 * m)
            place_key_points(s.keys, K, frames, frames + 9 * m, &moving[0, b, 0, 0])
            move_joints(s.joints, m, &rates[b, 0] if m else NULL, frames + 9 * m, frames + 12 * m, frames + 15 * m)
            key_point_velocities(s.keys, K, frames + 15 * m, &moving[0, b, 0, 0], &moving[1, b, 0, 0])
            out[b] = _highest_level(&motion, &balls, &alone, &begins[0], G, &memory, &best[b])
    free(room)
    return levels, chosen, motions[0], motions[1]


cdef double _highest_level(
    const Motion *motion, Balls *balls, Balls *alone, const Py_ssize_t *begins, Py_ssize_t G,
    const BoundMemory *memory, Py_ssize_t *best,
) noexcept nogil:
    """Return the maximum danger at one configuration, and write the index of the point."""
    cdef Py_ssize_t group, first, last, point, x
    cdef double peak = -INFINITY, level
    cdef double place[3]
    cdef Terms terms
    best[0] = 0
    _bound(motion, balls, 0, G, memory)
    while True:
        group = _highest(balls.bounds, 0, G)
        if balls.bounds[group] <= peak:
            return peak
        balls.bounds[group] = -INFINITY
        first, last = begins[group], begins[group + 1]
        _bound(motion, alone, first, last, memory)
        while True:
            point = _highest(alone.bounds, first, last)
            if alone.bounds[point] <= peak:
                break
            alone.bounds[point] = -INFINITY
            for x in range(3):
                place[x] = alone.columns[alone.stride * x + point]
            terms = _link_sums(motion.places, motion.velocities, motion.skeleton, place, motion.spread > 0)
            level = INFINITY
            if terms.phi != INFINITY:
                level = alone.tops[point] * (terms.phi + motion.ahead * terms.rate + motion.spread * terms.spread)
            if level > peak:
                best[0], peak = point, level
