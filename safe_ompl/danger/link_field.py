"""The danger field of a skeleton of link segments (Lacevic & Rocco 2013, §3), and danger points.

One link is the segment a → b. With u = p − a, v = p − b, S = ‖u‖ + ‖v‖ and ℓ = ‖b − a‖ its field at p is

    φ(p) = k₁ ∫₀¹ dt / ‖p − a − t(b − a)‖ = k₁ θ/ℓ,    θ = 2 atanh(ℓ/S) = log(1 + 2ℓ/(S − ℓ)),   eq. (4), (7)

so that every link has the same weight (`weighting="unit"`). Over arc length (`"length"`, eq. 1) it is k₁ θ. The field
of the robot is the sum over its links (5). On a segment it is +∞, and its gradient is defined as zero.

Only S − ℓ suffers from cancellation. Close to a segment it is computed from S² − ℓ² = 2 (‖u‖‖v‖ + u·v) = 2 ‖u ×
v‖²/(‖u‖‖v‖ − u·v), of which one form never cancels. With unit vectors e₁ = u/‖u‖, e₂ = v/‖v‖ the derivatives are

    ∂φ/∂p = −k₁c (e₁ + e₂),  ∂φ/∂a = k₁ (c e₁ − κ (b − a)),  ∂φ/∂b = k₁ (c e₂ + κ (b − a)),
    c = 2/(S² − ℓ²),   κ = (cS − θ/ℓ)/ℓ².

The loops are in `static.pyx`, and in `lanes.pyx` for several points or configurations at once. Here k₁ = 1, key points
are (B, K, 3) [m], `links: (L, 2)` are pairs of their indices, and points are (M, 3) [m].
"""

from __future__ import annotations

from collections.abc import Sized
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, finite_array
from safe_ompl.danger import static
from safe_ompl.robot import plain

Weighting: TypeAlias = Literal["unit", "length"]
WEIGHTINGS: tuple[Weighting, ...] = ("unit", "length")
# Largest number of danger points in a group.
_GROUP = 64


def columns(points: FloatArray) -> FloatArray:
    """Return points (M, 3) as contiguous columns (3, M), the layout of the kernels."""
    return plain(points.T)


def field(keypoints: FloatArray, links: IntArray, points: FloatArray, weighting: Weighting = "unit") -> FloatArray:
    """Return the field of the robot at points, CDF(p) = Σ_l φ_l(p), eq. (5), (B, M); +inf on a segment."""
    return static.link_fields(plain(keypoints), links, columns(points), weighting == "length", True)[:, 0]


def segment_fields(
    keypoints: FloatArray, links: IntArray, points: FloatArray, weighting: Weighting = "unit"
) -> FloatArray:
    """Return the field of each segment, φ_l(p), (B, L, M), eq. (7)."""
    return static.link_fields(plain(keypoints), links, columns(points), weighting == "length", False)


def segment_distances(keypoints: FloatArray, links: IntArray, points: FloatArray) -> FloatArray:
    """Return the distance of every point to every segment, (B, L, M) [m]."""
    return static.link_distances(plain(keypoints), links, columns(points))


def segment_bounds(fields: FloatArray, distances: FloatArray, displacement: FloatArray | float) -> FloatArray:
    """Return a proven upper bound of each segment's field after a motion, φ_l(q') ≤ φ_l(q) D_l/(D_l − δ_l), (B, L, M).

    A point of the segment at distance ρ ≥ D from p that moves by at most δ < D stays at least ρ − δ away, and 1/(ρ − δ)
    ≤ (1/ρ) D/(D − δ). The bound holds under the integral (4). With `weighting="length"` it holds for segments of
    constant length. Neither end of a segment moves farther than the displacement δ_l ≥ 0 [m]. The bound is +inf where
    the segment may reach the point, δ_l ≥ D_l.
    """
    room = distances - displacement
    apart = room > 0
    growth = np.where(apart, distances / np.where(apart, room, 1.0), np.inf)
    return fields * growth


def vectors(keypoints: FloatArray, links: IntArray, points: FloatArray, weighting: Weighting = "unit") -> FloatArray:
    """Return the danger vectors CDF(p) ∇CDF(p)/‖∇CDF(p)‖, eq. (8), (B, M, 3), at points.

    They point from p **towards** the robot. Mapped through Jᵀ they push its links **away** from p. They are zero where
    the gradient is zero.
    """
    slopes = static.space_gradients(plain(keypoints), links, columns(points), weighting == "length")
    norm = np.linalg.norm(slopes, axis=-1)
    values = field(keypoints, links, points, weighting)
    scale = np.divide(values, norm, out=np.zeros_like(norm), where=norm > 0)
    found: FloatArray = slopes * scale[..., None]
    return found


class Groups(NamedTuple):
    """M ≥ 1 danger points in G groups.

    `columns` (3, M + G): the points, then a centre of each group. `point_weights` (M,): k₁w of the points. `begins`
    (G + 1,): the first point of each group, and the end of the last group. `radii` (G,) [m]: about the centres.
    `heaviest` (G,): largest point weight of each group.
    """

    columns: FloatArray
    point_weights: FloatArray
    begins: IntArray
    radii: FloatArray
    heaviest: FloatArray


class DangerPoints:
    """Danger points (M, 3) [m] with weights (M,) > 0 (None: 1). A point weight is a weight times k₁.

    Read-only. Raises InputError if points or weights have the wrong shape, are not finite, or weights are not positive.
    """

    def __init__(self, points: ArrayLike, weights: ArrayLike | None, k1: float) -> None:
        if isinstance(points, Sized) and not len(points):
            points = np.zeros((0, 3))
        self.points = finite_array(points, (None, 3), "danger points")
        self.points.setflags(write=False)
        self.weights = None if weights is None else finite_array(weights, (len(self.points),), "danger weights")
        if self.weights is not None:
            if not (self.weights > 0).all():
                bad = self.weights[self.weights <= 0].tolist()
                raise InputError(f"danger weights must be positive, got {bad}; leave out the others")
            self.weights.setflags(write=False)
        point_weights = k1 * (np.ones(len(self.points)) if self.weights is None else self.weights)
        self.table = static.DangerPointTable(columns(self.points), point_weights)

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def groups(self) -> Groups:
        """The points in groups of neighbours with equal weights. There must be at least one point."""
        points, point_weights = self.points, self.table.point_weights
        waiting, groups = ([np.flatnonzero(point_weights == value) for value in np.unique(point_weights)], [])
        while waiting:
            rows = waiting.pop()
            if len(rows) <= _GROUP:
                groups.append(rows)
                continue
            longest = np.ptp(points[rows], axis=0).argmax()
            rows = rows[np.argsort(points[rows, longest], kind="stable")]
            waiting += [rows[: len(rows) // 2], rows[len(rows) // 2 :]]
        centres = np.array([points[rows].mean(axis=0) for rows in groups])
        radii = [
            np.linalg.norm(points[rows] - centre, axis=1).max() for rows, centre in zip(groups, centres, strict=True)
        ]
        order, begins = np.concatenate(groups), np.cumsum([0, *map(len, groups)], dtype=np.intp)
        heaviest = np.array([point_weights[rows[0]] for rows in groups])
        places = np.concatenate([points[order], centres])
        return Groups(columns(places), point_weights[order], begins, np.array(radii) * (1 + 1e-12), heaviest)
