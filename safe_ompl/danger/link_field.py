"""The danger field of a skeleton of link segments (Lacevic & Rocco 2013, §3), and the weights of the segments.

One link is the segment a → b. With u = p − a, v = p − b, S = ‖u‖ + ‖v‖ and ℓ = ‖b − a‖ its field at p is

    φ(p) = k₁ ∫₀¹ dt / ‖p − a − t(b − a)‖ = k₁ θ/ℓ,    θ = 2 atanh(ℓ/S) = log(1 + 2ℓ/(S − ℓ)),   eq. (4), (7)

so that every link weighs the same (`weighting="unit"`). Over arc length (`"length"`, eq. 1) it is k₁ θ.
The field of the robot is the sum over its links (5). On a segment it is +∞, and its gradient defined as zero.

Only S − ℓ cancels. Close to a segment it comes from S² − ℓ² = 2 (‖u‖‖v‖ + u·v) = 2 ‖u × v‖²/(‖u‖‖v‖ − u·v),
of which one form never does. With unit vectors e₁ = u/‖u‖, e₂ = v/‖v‖ the derivatives are

    ∂φ/∂p = −k₁c (e₁ + e₂),  ∂φ/∂a = k₁ (c e₁ − κ (b − a)),  ∂φ/∂b = k₁ (c e₂ + κ (b − a)),
    c = 2/(S² − ℓ²),   κ = (cS − θ/ℓ)/ℓ².

The loops are in `kernels/field.py` and, together with a robot's kinematics, in `kernels/danger.py`. Here k₁ = 1, key
points are (B, K, 3) [m], `links: (L, 2)` are pairs of them, and points (M, 3) [m].
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger.kernels import field as kernel
from safe_ompl.robot import plain

Weighting: TypeAlias = Literal["unit", "length"]
WEIGHTINGS: tuple[Weighting, ...] = ("unit", "length")


def columns(points: FloatArray) -> FloatArray:
    """Return points (M, 3) as (3, M), the way kernels read them."""
    return plain(points.T)


def field(keypoints: FloatArray, links: IntArray, points: FloatArray, weighting: Weighting = "unit") -> FloatArray:
    """Return the field of the robot at points, CDF(p) = Σ_l φ_l(p), eq. (5), (B, M); +inf on a segment."""
    return kernel.link_fields(plain(keypoints), links, columns(points), weighting == "length", True)[:, 0]


def segment_fields(
    keypoints: FloatArray, links: IntArray, points: FloatArray, weighting: Weighting = "unit"
) -> FloatArray:
    """Return the field of every segment on its own, φ_l(p), (B, L, M), eq. (7)."""
    return kernel.link_fields(plain(keypoints), links, columns(points), weighting == "length", False)


def segment_distances(keypoints: FloatArray, links: IntArray, points: FloatArray) -> FloatArray:
    """Return the distance of every point to every segment, (B, L, M) [m]."""
    return kernel.link_distances(plain(keypoints), links, columns(points))


def segment_bounds(fields: FloatArray, distances: FloatArray, displacement: FloatArray | float) -> FloatArray:
    """Return a proven upper bound of each segment's field after a motion, φ_l(q') ≤ φ_l(q) D_l/(D_l − δ_l), (B, L, M).

    A point of the segment at distance ρ ≥ D from p that moves by at most δ < D stays at least ρ − δ away, and
    1/(ρ − δ) ≤ (1/ρ) D/(D − δ); the integral (4) inherits the bound. With `weighting="length"` it holds for
    segments that keep their length. Neither end of a segment moves farther than the displacement δ_l ≥ 0 [m]. +inf
    where the segment may reach the point, δ_l ≥ D_l.
    """
    room = distances - displacement
    apart = room > 0
    growth = np.where(apart, distances / np.where(apart, room, 1.0), np.inf)
    return fields * growth


def vectors(keypoints: FloatArray, links: IntArray, points: FloatArray, weighting: Weighting = "unit") -> FloatArray:
    """Return the danger vectors CDF(p) ∇CDF(p)/‖∇CDF(p)‖, eq. (8), (B, M, 3), at points.

    They point from p **towards** the robot: mapped through Jᵀ they push its links **away** from p. Zero where the
    gradient is zero.
    """
    slopes = kernel.space_gradients(plain(keypoints), links, columns(points), weighting == "length")
    norm = np.linalg.norm(slopes, axis=-1)
    values = field(keypoints, links, points, weighting)
    scale = np.divide(values, norm, out=np.zeros_like(norm), where=norm > 0)
    found: FloatArray = slopes * scale[..., None]
    return found
