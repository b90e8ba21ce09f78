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

from safe_ompl.common import (
    Counts,
    FloatArray,
    InputError,
    IntArray,
    UnknownNameError,
    configuration,
    configurations,
    finite_array,
    positive,
)
from safe_ompl.danger.kernels import field as kernel
from safe_ompl.robot import Robot, plain

Weighting: TypeAlias = Literal["unit", "length"]
WEIGHTINGS: tuple[Weighting, ...] = ("unit", "length")


class Segments:
    """Link segments as pairs (L, 2) of key points, which together form a tree, or several.

    Their lengths (L,) [m] are given where they are the same at every configuration, as on a robot without prismatic
    joints. Raises InputError if the pairs are not an (L ≥ 1, 2) array of integers ≥ 0, or are more than their key
    points; if the lengths are not L numbers ≥ 0.
    """

    __slots__ = ("lengths", "pairs")

    def __init__(self, pairs: ArrayLike, lengths: ArrayLike | None = None) -> None:
        array = np.array(pairs, order="C")
        is_list = array.ndim == 2 and array.shape[1] == 2 and array.size > 0 and array.dtype.kind == "i"
        if not is_list or array.min() < 0:
            raise InputError(f"segments must be pairs of key point indices, shape (L ≥ 1, 2), got {pairs!r}")
        self.pairs: IntArray = array.astype(np.intp)
        ends = len(np.unique(self.pairs))
        if len(self.pairs) > ends:
            raise InputError(f"{len(self.pairs)} segments between {ends} key points do not form a tree")
        self.lengths: FloatArray | None = None
        if lengths is not None:
            self.lengths = finite_array(lengths, (len(self.pairs),), "lengths of segments")
            if self.lengths.min() < 0:
                raise InputError(f"lengths of segments must not be negative, got {self.lengths.tolist()}")

    def __len__(self) -> int:
        return len(self.pairs)

    def __repr__(self) -> str:
        lengths = "" if self.lengths is None else f", lengths={self.lengths.tolist()}"
        return f"Segments({self.pairs.tolist()}{lengths})"


def by_length(weighting: str) -> bool:
    """Return whether `weighting` is "length"; raise `UnknownNameError` if it is not "unit" either."""
    if weighting not in WEIGHTINGS:
        raise UnknownNameError("weighting", weighting, WEIGHTINGS)
    return weighting == "length"


def columns(points: FloatArray) -> FloatArray:
    """Return points (M, 3) as (1, 3, M), points (B, M, 3) as (B, 3, M), the way kernels read them."""
    return plain(points.T[None] if points.ndim == 2 else points.transpose(0, 2, 1))


def field(
    keypoints: FloatArray, segments: Segments, points: FloatArray, *, weighting: Weighting = "unit", k1: float = 1.0
) -> FloatArray:
    """Return the danger field of the robot at points, CDF(p) = Σ_l φ_l(p), eq. (5), (B, M).

    Parameters
    ----------
    keypoints : ndarray, shape (B, K, 3)
        Key points of the skeleton at B configurations [m].
    segments : Segments
        The L link segments.
    points : ndarray, shape (M, 3) or (B, M, 3)
        Field points, the same or others for every configuration [m].
    weighting : {"unit", "length"}
        Integrate each link over t ∈ [0, 1] (eq. 4), in k₁/m, or over its arc length (eq. 1), in k₁; +inf on a segment.
    k1 : float
        Constant k₁ > 0 of the elementary field (6).
    """
    total: FloatArray = kernel.link_fields(*_arrays(keypoints, segments, points), by_length(weighting), True)[:, 0]
    return total if k1 == 1.0 else k1 * total


def _arrays(keypoints: FloatArray, segments: Segments, points: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
    return plain(keypoints), segments.pairs, columns(points)


def segment_fields(
    keypoints: FloatArray, segments: Segments, points: FloatArray, *, weighting: Weighting = "unit"
) -> FloatArray:
    """Return the field of every segment on its own, φ_l(p) with k₁ = 1, (B, L, M), eq. (7); else like `field`."""
    return kernel.link_fields(*_arrays(keypoints, segments, points), by_length(weighting), False)


def segment_distances(keypoints: FloatArray, segments: Segments, points: FloatArray) -> FloatArray:
    """Return the distance of every point to every segment, (B, L, M) [m]; parameters as for `field`."""
    return kernel.link_distances(*_arrays(keypoints, segments, points))


def segment_bounds(fields: FloatArray, distances: FloatArray, displacement: FloatArray | float) -> FloatArray:
    """Return a proven upper bound of each segment's field after a motion, φ_l(q') ≤ φ_l(q) D_l/(D_l − δ_l), (B, L, M).

    A point of the segment at distance ρ ≥ D from p that moves by at most δ < D stays at least ρ − δ away, and
    1/(ρ − δ) ≤ (1/ρ) D/(D − δ); the integral (4) inherits the bound. With `weighting="length"` it holds for
    segments that keep their length. Fields and distances [m] are those of `segment_fields` and `segment_distances`;
    neither end of a segment moves farther than the displacement δ_l ≥ 0 [m]. +inf where the segment may reach the
    point, δ_l ≥ D_l.
    """
    room = distances - displacement
    apart = room > 0
    growth = np.where(apart, distances / np.where(apart, room, 1.0), np.inf)
    return fields * growth


def workspace_gradient(
    keypoints: FloatArray, segments: Segments, points: FloatArray, *, weighting: Weighting = "unit"
) -> FloatArray:
    """Return the gradient of the field by the points, ∂CDF/∂p = −Σ_l c_l (e₁ + e₂), (B, M, 3), with k₁ = 1.

    Zero at points on a segment. Parameters as for `field`.
    """
    return kernel.space_gradients(*_arrays(keypoints, segments, points), by_length(weighting))


def vector_field(field: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the danger vectors CDF(p) ∇CDF(p)/‖∇CDF(p)‖, eq. (8), (…, 3), of a field (…) and its gradient (…, 3).

    They point from p **towards** the robot: mapped through Jᵀ they push its links **away** from p. Zero where the
    gradient is zero.
    """
    norm = np.linalg.norm(gradient, axis=-1)
    scale = np.divide(field, norm, out=np.zeros_like(norm), where=norm > 0)
    vectors: FloatArray = gradient * scale[..., None]
    return vectors


class RobotField:
    """The field of a robot's link segments at any points of its workspace, CDF(p; q) = Σ_l k₁ ∫ dt/‖p − r_t‖.

    Weighting and k₁ are those of `field`; evaluations are counted in `counts`. Raises InputError if the robot has no
    links, `weighting` is unknown, or `k1` is not positive.
    """

    def __init__(
        self, robot: Robot, weighting: Weighting = "unit", k1: float = 1.0, counts: Counts | None = None
    ) -> None:
        self._by_length = by_length(weighting)
        if not len(robot.segments):
            raise InputError(f"{robot.name!r} has no link of any length for a danger; give a tip beyond its joints")
        self.robot = robot
        self.weighting = weighting
        self.k1 = positive(k1, "k1")
        self.counts = Counts() if counts is None else counts
        # The lengths are None where a prismatic joint may change them.
        self.segments = Segments(robot.segments, _constant_lengths(robot))

    def field(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the field CDF(p), (M,), of the robot at `q: (n,)` at any `points: (M, 3)` [m], unweighted.

        Raises
        ------
        InputError
            If `q` or `points` has the wrong shape or is not finite; so do the other methods of this kind.
        """
        values: FloatArray = self._field(*self._scene(q, points))[0]
        return values

    def workspace_gradient(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the gradient ∇_p CDF(p), (M, 3), of the field at `points: (M, 3)` [m]; zero on a segment."""
        return self._workspace_gradient(*self._scene(q, points))

    def vector(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the vector field (8), (M, 3), at `points: (M, 3)` [m]: CDF(p) long, towards the robot."""
        return self._vector(*self._scene(q, points))

    def count(self, configurations: FloatArray, points: FloatArray) -> None:
        """Count an evaluation of the points (…, M, 3) at every configuration, (B, …)."""
        self.counts.field_configurations += len(configurations)
        self.counts.field_points += len(configurations) * points.shape[-2]

    def _single(self, q: ArrayLike) -> FloatArray:
        return configuration(q, self.robot.n)[None]

    def _batch(self, Q: ArrayLike) -> FloatArray:
        return configurations(Q, self.robot.n)

    def _scene(self, q: ArrayLike, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return key points (1, K, 3) and field points (M, 3), and count them."""
        keypoints = self.robot.keypoints_batch(self._single(q))
        checked = finite_array(points, (None, 3), "points")
        self.count(keypoints, checked)
        return keypoints, checked

    def _field(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        return field(keypoints, self.segments, points, weighting=self.weighting, k1=self.k1)

    def _workspace_gradient(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        gradient = workspace_gradient(keypoints, self.segments, points, weighting=self.weighting)
        return (self.k1 * gradient).reshape(-1, 3)

    def _vector(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        return vector_field(self._field(keypoints, points)[0], self._workspace_gradient(keypoints, points))


def _constant_lengths(robot: Robot) -> FloatArray | None:
    """Return the lengths (L,) [m] of the segments, or None where a prismatic joint may change them."""
    if robot.joint_prismatic.any():
        return None
    start, end = robot.keypoints(np.zeros(robot.n))[robot.segments.T]
    lengths: FloatArray = np.linalg.norm(end - start, axis=-1)
    return lengths
