"""The danger field of a skeleton of link segments (Lacevic & Rocco 2013, §3), and the weights of the segments.

One link is the segment a → b. With u = p − a, v = p − b, S = ‖u‖ + ‖v‖ and ℓ = ‖b − a‖ its field at p is

    φ(p) = k₁ ∫₀¹ dt / ‖p − a − t(b − a)‖ = k₁ θ/ℓ,    θ = 2 atanh(ℓ/S) = log(1 + 2ℓ/(S − ℓ)),   eq. (4), (7)

so that every link weighs the same (`weighting="unit"`). Over arc length (`"length"`, eq. 1) it is k₁ θ.
The field of the robot is the sum over its links (5). On a segment it is +∞, and its gradient defined as zero.

Only S − ℓ cancels. Close to a segment it comes from S² − ℓ² = 2 (‖u‖‖v‖ + u·v) = 2 ‖u × v‖²/(‖u‖‖v‖ − u·v),
of which one form never does. With unit vectors e₁ = u/‖u‖, e₂ = v/‖v‖ the derivatives are

    ∂φ/∂p = −k₁c (e₁ + e₂),  ∂φ/∂a = k₁ (c e₁ − κ (b − a)),  ∂φ/∂b = k₁ (c e₂ + κ (b − a)),
    c = 2/(S² − ℓ²),   κ = (cS − θ/ℓ)/ℓ².

The loops are in `kernels/field.py` and, together with a robot's kinematics, in `kernels/danger.py`.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, UnknownNameError, finite_array
from safe_ompl.danger.kernels import field as kernel
from safe_ompl.robot import plain

Weighting: TypeAlias = Literal["unit", "length"]
WEIGHTINGS: tuple[Weighting, ...] = ("unit", "length")


class Segments:
    """Link segments as pairs of key points.

    Parameters
    ----------
    pairs : array_like of int, shape (L, 2)
        Key points at the two ends of each segment; together they form a tree, or several.
    lengths : array_like, shape (L,), optional
        The lengths of the segments [m] where they are the same at every configuration, as on a robot without
        prismatic joints.

    Attributes
    ----------
    pairs : ndarray, shape (L, 2)
    lengths : ndarray, shape (L,), or None

    Raises
    ------
    InputError
        If the pairs are not an (L ≥ 1, 2) array of integers ≥ 0, or are more than their key points; if the
        lengths are not L numbers ≥ 0.
    """

    __slots__ = ("lengths", "pairs")

    def __init__(self, pairs: ArrayLike, lengths: ArrayLike | None = None) -> None:
        self.pairs = _checked_pairs(pairs)
        ends = len(np.unique(self.pairs))
        if len(self.pairs) > ends:
            raise InputError(f"{len(self.pairs)} segments between {ends} key points do not form a tree")
        self.lengths = None if lengths is None else _checked_lengths(lengths, len(self.pairs))

    def __len__(self) -> int:
        return len(self.pairs)

    def __repr__(self) -> str:
        lengths = "" if self.lengths is None else f", lengths={self.lengths.tolist()}"
        return f"Segments({self.pairs.tolist()}{lengths})"


def check_weighting(weighting: str) -> None:
    """Raise `UnknownNameError` unless `weighting` is "unit" or "length"."""
    if weighting not in WEIGHTINGS:
        raise UnknownNameError("weighting", weighting, WEIGHTINGS)


def _checked_pairs(pairs: ArrayLike) -> IntArray:
    array = np.array(pairs, order="C")
    if array.ndim != 2 or array.shape[1] != 2 or not array.size or array.dtype.kind != "i" or array.min() < 0:
        raise InputError(f"segments must be pairs of key point indices, shape (L ≥ 1, 2), got {pairs!r}")
    return array.astype(np.intp)


def _checked_lengths(lengths: ArrayLike, number: int) -> FloatArray:
    checked = finite_array(lengths, (number,), "lengths of segments")
    if checked.min() < 0:
        raise InputError(f"lengths of segments must not be negative, got {checked.tolist()}")
    return checked


def columns(points: FloatArray) -> FloatArray:
    """Return points (M, 3) as (1, 3, M), points (B, M, 3) as (B, 3, M), the way kernels read them."""
    turned = points.T[None] if points.ndim == 2 else points.transpose(0, 2, 1)
    return plain(turned)


def field(
    keypoints: FloatArray,
    segments: Segments,
    points: FloatArray,
    *,
    weighting: Weighting = "unit",
    k1: float = 1.0,
) -> FloatArray:
    """Return the danger field of the robot at points, CDF(p) = Σ_l φ_l(p), eq. (5).

    Parameters
    ----------
    keypoints : ndarray, shape (B, K, 3)
        Key points of the skeleton at B configurations [m].
    segments : Segments
        The L link segments.
    points : ndarray, shape (M, 3) or (B, M, 3)
        Field points, the same or others for every configuration [m].
    weighting : {"unit", "length"}
        Integrate each link over t ∈ [0, 1] (eq. 4) or over its arc length (eq. 1).
    k1 : float
        Constant k₁ > 0 of the elementary field (6).

    Returns
    -------
    ndarray, shape (B, M)
        The field in k₁/m (`"unit"`) or k₁ (`"length"`); +inf on a segment.
    """
    check_weighting(weighting)
    total: FloatArray = kernel.fields(
        plain(keypoints), segments.pairs, columns(points), weighting == "length"
    )
    return total if k1 == 1.0 else k1 * total


def segment_fields(
    keypoints: FloatArray,
    segments: Segments,
    points: FloatArray,
    *,
    weighting: Weighting = "unit",
    k1: float = 1.0,
) -> FloatArray:
    """Return the field of every segment on its own, φ_l(p), (B, L, M), eq. (7); otherwise like `field`."""
    check_weighting(weighting)
    by_length = weighting == "length"
    fields: FloatArray = kernel.link_fields(plain(keypoints), segments.pairs, columns(points), by_length)
    return fields if k1 == 1.0 else k1 * fields


def segment_distances(keypoints: FloatArray, segments: Segments, points: FloatArray) -> FloatArray:
    """Return the distance of every point to every segment, (B, L, M) [m]; parameters as for `field`."""
    return kernel.link_distances(plain(keypoints), segments.pairs, columns(points))


def segment_bounds(fields: FloatArray, distances: FloatArray, displacement: FloatArray | float) -> FloatArray:
    """Return a proven upper bound of each segment's field after a motion, φ_l(q') ≤ φ_l(q) D_l/(D_l − δ_l).

    A point of the segment at distance ρ ≥ D from p that moves by at most δ < D stays at least ρ − δ away, and
    1/(ρ − δ) ≤ (1/ρ) D/(D − δ); the integral (4) inherits the bound. With `weighting="length"` it holds for
    segments that keep their length.

    Parameters
    ----------
    fields : ndarray, shape (B, L, M)
        Field of every segment, from `segment_fields`.
    distances : ndarray, shape (B, L, M)
        Distance of every point to every segment, from `segment_distances` [m].
    displacement : ndarray or float, broadcastable to (B, L, M)
        δ_l ≥ 0: neither end of the segment moves farther than this [m].

    Returns
    -------
    ndarray, shape (B, L, M)
        +inf where the segment may reach the point, δ_l ≥ D_l.
    """
    room = distances - displacement
    apart = room > 0
    growth = np.where(apart, distances / np.where(apart, room, 1.0), np.inf)
    return fields * growth


def workspace_gradient(
    keypoints: FloatArray,
    segments: Segments,
    points: FloatArray,
    *,
    weighting: Weighting = "unit",
    k1: float = 1.0,
) -> FloatArray:
    """Return the gradient of the field with respect to the points, ∂CDF/∂p = −Σ_l c_l (e₁ + e₂).

    Parameters as for `field`.

    Returns
    -------
    ndarray, shape (B, M, 3)
        Zero at points on a segment.
    """
    check_weighting(weighting)
    by_length = weighting == "length"
    return k1 * kernel.space_gradients(plain(keypoints), segments.pairs, columns(points), by_length)


def keypoint_gradient(
    keypoints: FloatArray,
    segments: Segments,
    points: FloatArray,
    weights: FloatArray,
    *,
    weighting: Weighting = "unit",
    k1: float = 1.0,
) -> FloatArray:
    """Return the gradient of Σ_m w_m CDF(p_m) with respect to the key points, the points held fixed.

    Parameters
    ----------
    keypoints, segments, points, weighting, k1
        As for `field`.
    weights : ndarray, shape (B, M)
        Factor w of each point's field: points with zero cost nothing. Points on a segment contribute nothing.

    Returns
    -------
    ndarray, shape (B, K, 3)
    """
    check_weighting(weighting)
    by_length = weighting == "length"
    return kernel.pulls(
        plain(keypoints), segments.pairs, columns(points), np.multiply(weights, k1, order="C"), by_length
    )


def vector_field(field: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the danger vectors CDF(p) ∇CDF(p)/‖∇CDF(p)‖, eq. (8).

    They point from p **towards** the robot: mapped through Jᵀ they push its links **away** from p.

    Parameters
    ----------
    field : ndarray, shape (…)
        Field at the points.
    gradient : ndarray, shape (…, 3)
        Its gradient with respect to the points.

    Returns
    -------
    ndarray, shape (…, 3)
        Zero where the gradient is zero.
    """
    norm = np.linalg.norm(gradient, axis=-1)
    scale = np.divide(field, norm, out=np.zeros_like(norm), where=norm > 0)
    vectors: FloatArray = gradient * scale[..., None]
    return vectors
