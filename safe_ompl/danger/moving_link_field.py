"""The kinetostatic danger field of a skeleton of moving link segments (Lacevic & Rocco, T-RO 2013).

A moving point source r at the distance ρ from p, with the velocity v, has the field

    k₁/‖ρ‖ + k₂ (γ ‖v‖/‖ρ‖² + ρ·v/‖ρ‖³),    ρ = p − r:

its static field, more of it the faster it is (γ), and more of it where it is headed. Over a link, whose points move
with v(t) = v_a + t(v_b − v_a), the integrals are closed (`safe_ompl.danger.kernels.kinetostatic`). The last one is the
rate of the static field, so that γ = 0 is the danger predicted k₂/k₁ seconds ahead; γ ≥ 1 keeps the whole no less than
the static field. They are exact to 1e-8 for points that are no farther than some twenty lengths from a link.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger.kernels import kinetostatic as kernel
from safe_ompl.danger.link_field import Segments, Weighting, check_weighting
from safe_ompl.robot import plain

_ZERO = 1e-30


class Terms(NamedTuple):
    """The parts of the field at points, each (B, M): static ∫1/‖ρ‖, directional ∫ρ·v/‖ρ‖³, isotropic ∫‖v‖/‖ρ‖²."""

    static: FloatArray
    directional: FloatArray
    isotropic: FloatArray


def terms(
    keypoints: FloatArray,
    velocities: FloatArray,
    segments: Segments,
    points: FloatArray,
    *,
    weighting: Weighting = "unit",
    isotropic: bool = True,
) -> Terms:
    """Return the three parts of the kinetostatic field, summed over the links.

    Parameters
    ----------
    keypoints, velocities : ndarray, shape (B, K, 3)
        Key points [m] and their velocities [m/s].
    segments : Segments
        The links.
    points : ndarray, shape (M, 3) or (B, M, 3)
        Field points [m].
    weighting : {"unit", "length"}
        As for `safe_ompl.danger.link_field.field`.
    isotropic : bool
        Whether the isotropic part is wanted; it is zero otherwise, and a third of the time is saved.

    Returns
    -------
    Terms
        +inf on a segment.
    """
    check_weighting(weighting)
    found = kernel.link_terms(
        plain(keypoints),
        plain(velocities),
        *_ends(segments),
        _rows(points),
        weighting == "length",
        isotropic,
    )
    return Terms(*found)


def gradients(
    keypoints: FloatArray,
    velocities: FloatArray,
    segments: Segments,
    points: FloatArray,
    weights: FloatArray,
    factors: tuple[float, float],
    *,
    weighting: Weighting = "unit",
) -> tuple[FloatArray, FloatArray]:
    """Return the gradients of Σ_m w_m (static + a·directional + b·isotropic)_m, the points held fixed.

    Parameters
    ----------
    keypoints, velocities, segments, points, weighting
        As for `terms`.
    weights : ndarray, shape (B, M)
        w; points on a segment contribute nothing.
    factors : (float, float)
        a and b [s].

    Returns
    -------
    two ndarrays, shape (B, K, 3)
        With respect to the key points, and to their velocities.
    """
    check_weighting(weighting)
    found = kernel.pulls(
        plain(keypoints),
        plain(velocities),
        *_ends(segments),
        _rows(points),
        plain(weights),
        float(factors[0]),
        float(factors[1]),
        weighting == "length",
    )
    return found[0], found[1]


def isotropic_bracket(
    keypoints: FloatArray, velocities: FloatArray, segments: Segments, points: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return proven bounds below and above the isotropic part of every link, (B, L, M), with unit weighting.

    Along a link (1−t)‖v_a‖ + t‖v_b‖ ≥ ‖v(t)‖ ≥ e·v(t) for any unit vector e, here that of the middle. Over a link

        ∫ (c₀ + c₁t)/‖ρ‖² dt = [c₁ ½ log(x² + h²) + (c₀ + c₁s)/h atan(x/h)]/ℓ²,    x = t − s from −s to 1 − s.

    Parameters
    ----------
    keypoints, velocities, segments
        As for `terms`.
    points : ndarray, shape (M, 3)
        Field points [m].

    Returns
    -------
    two ndarrays, shape (B, L, M)
    """
    i, j = segments.pairs.T
    va, vb = velocities[:, i], velocities[:, j]
    middle = (va + vb) / 2
    unit = middle / np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), _ZERO)
    lower = [(unit * v).sum(axis=2) for v in (va, vb)]
    upper = [np.linalg.norm(v, axis=2) for v in (va, vb)]
    axis = keypoints[:, j] - keypoints[:, i]
    squared = np.maximum((axis * axis).sum(axis=2), _ZERO**2)[..., None]
    rays = points - keypoints[:, i][:, :, None]  # (B, L, M, 3)
    s = np.einsum("blmx,blx->blm", rays, axis) / squared
    apart = np.maximum(np.linalg.norm(np.cross(rays, axis[:, :, None]), axis=3) / squared, _ZERO)

    def integral(c: list[FloatArray]) -> FloatArray:
        c0, c1 = c[0][..., None], (c[1] - c[0])[..., None]
        logs = 0.5 * (np.log((1 - s) ** 2 + apart**2) - np.log(s**2 + apart**2))
        angle = np.arctan2(apart, apart**2 - s * (1 - s))  # atan((1−s)/h) + atan(s/h)
        found: FloatArray = (c1 * logs + (c0 + c1 * s) / apart * angle) / squared
        return found

    return np.maximum(integral(lower), 0.0), integral(upper)


def _ends(segments: Segments) -> tuple[IntArray, IntArray]:
    start, end = np.ascontiguousarray(segments.pairs.T)
    return start, end


def _rows(points: FloatArray) -> FloatArray:
    """Return points (M, 3) or (B, M, 3) as (1 or B, M, 3), in C order."""
    return plain(points if points.ndim == 3 else points[None])
