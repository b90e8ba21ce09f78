"""The danger field of a skeleton of link segments (Lacevic & Rocco 2013, §3).

One link is the segment a → b. With u = p − a, v = p − b, S = ‖u‖ + ‖v‖ and ℓ = ‖b − a‖ its field at p is

    φ(p) = k₁ ∫₀¹ dt / ‖p − a − t(b − a)‖ = k₁ θ/ℓ,    θ = 2 atanh(ℓ/S) = log(1 + 2ℓ/(S − ℓ)),   eq. (4), (7)

so that every link weighs the same (`weighting="unit"`). Over arc length (`"length"`, eq. 1) it is k₁ θ.
The field of the robot is the sum over its links (5). On a segment it is +∞, and its gradient defined as zero.

Only S − ℓ cancels. Close to a segment it comes from S² − ℓ² = 2 (‖u‖‖v‖ + u·v) = 2 ‖u × v‖²/(‖u‖‖v‖ − u·v),
of which one form never does. The derivatives need only θ and ℓ: with unit vectors e₁ = u/‖u‖, e₂ = v/‖v‖

    ∂φ/∂p = −k₁c (e₁ + e₂),  ∂φ/∂a = k₁ (c e₁ − κ (b − a)),  ∂φ/∂b = k₁ (c e₂ + κ (b − a)),
    c = 2/(S² − ℓ²) = (cosh θ − 1)/ℓ²,   κ = (cS − θ/ℓ)/ℓ² = (sinh θ − θ)/ℓ³;

with `"length"` c = (cosh θ − 1)/ℓ and κ = sinh θ/ℓ². Arrays are structures of arrays, (3, …, B, M) for B
configurations and M points: long contiguous runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, IntArray, finite_array
from safe_ompl.errors import InputError, UnknownNameError

Weighting: TypeAlias = Literal["unit", "length"]
WEIGHTINGS: tuple[Weighting, ...] = ("unit", "length")

_BLOCK = 1 << 16  # numbers in the temporaries of one block: half a megabyte stays in the cache
_VALUES, _GRADIENTS = 3, 6  # arrays (U, B, M) that a block needs
_NEAR = 2e5  # 2ℓ/(S − ℓ) above which the difference has lost too many digits
_FAR = 1e-3  # 2ℓ/(S − ℓ) below which log(1 + …) would
_SMALL = 0.1  # θ below which sinh θ − θ is summed as a series
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative size of what is as good as zero
_ZERO = 1e-30  # [m] stands for a length of zero


class Segments:
    """Link segments as pairs of key points, prepared for repeated evaluation.

    Parameters
    ----------
    pairs : array_like of int, shape (L, 2)
        Key points at the two ends of each segment; together they form a tree, or several.
    lengths : array_like, shape (L,), optional
        The lengths of the segments [m] where they are the same at every configuration, as on a robot without
        prismatic joints: a quarter of the time of a small evaluation goes into measuring them.

    Attributes
    ----------
    pairs : ndarray, shape (L, 2)
    used : ndarray, shape (U,)
        Key points that are an end of some segment.
    start, end : ndarray, shape (L,)
        Where in `used` the ends of each segment are.
    adjacency, incidence : ndarray, shape (U, L)
        1 at both ends of each segment; −1 at its start and 1 at its end.
    lengths : ndarray, shape (L, 1, 1), or None

    Raises
    ------
    InputError
        If the pairs are not an (L ≥ 1, 2) array of integers ≥ 0, or are more than their key points; if the
        lengths are not L numbers ≥ 0.
    """

    __slots__ = ("adjacency", "end", "incidence", "lengths", "pairs", "start", "used")

    def __init__(self, pairs: ArrayLike, lengths: ArrayLike | None = None) -> None:
        self.pairs = _checked_pairs(pairs)
        self.used, places = np.unique(self.pairs, return_inverse=True)
        if len(self.pairs) > len(self.used):
            raise InputError(
                f"{len(self.pairs)} segments between {len(self.used)} key points do not form a tree"
            )
        self.start, self.end = np.ascontiguousarray(places.reshape(-1, 2).T)
        corners = np.eye(len(self.used))
        self.adjacency: FloatArray = (corners[self.end] + corners[self.start]).T
        self.incidence: FloatArray = (corners[self.end] - corners[self.start]).T
        self.lengths = None if lengths is None else _checked_lengths(lengths, len(self.pairs))

    def __len__(self) -> int:
        return len(self.pairs)

    def __repr__(self) -> str:
        lengths = "" if self.lengths is None else f", lengths={self.lengths.ravel().tolist()}"
        return f"Segments({self.pairs.tolist()}{lengths})"


def check_weighting(weighting: str) -> None:
    """Raise `UnknownNameError` unless `weighting` is "unit" or "length"."""
    if weighting not in WEIGHTINGS:
        raise UnknownNameError("weighting", weighting, WEIGHTINGS)


# ---------------------------------------------------------------------------------------------------- values


def field(
    keypoints: FloatArray,
    segments: Segments,
    points: FloatArray,
    *,
    weighting: Weighting = "unit",
    k1: float = 1.0,
) -> FloatArray:
    """Return the danger field of the robot at points, CDF(p) = Σ_l φ_l(p), eq. (5).

    The distance to a key point is computed once, whatever the number of segments that end there.

    Parameters
    ----------
    keypoints : ndarray, shape (B, K, 3)
        Key points of the skeleton at B configurations [m].
    segments : Segments
        The L link segments.
    points : ndarray, shape (M, 3) or (B, M, 3)
        Field points, the same or others for every configuration [m]. Fortran order is fastest.
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
    rows, columns = len(keypoints), points.shape[-2]
    if 0 < rows * columns <= _block_size(segments, _VALUES):
        total: FloatArray = np.add.reduce(_potentials(keypoints, segments, points, weighting), 0)
    else:
        total = np.empty((rows, columns))
        for i, j in _blocks(rows, columns, _block_size(segments, _VALUES)):
            np.add.reduce(
                _potentials(keypoints[i], segments, _part(points, i, j), weighting), 0, out=total[i, j]
            )
    if k1 != 1.0:
        total *= k1
    return total


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
    return k1 * np.moveaxis(_potentials(keypoints, segments, points, weighting), 0, 1)


def segment_distances(keypoints: FloatArray, segments: Segments, points: FloatArray) -> FloatArray:
    """Return the distance of every point to every segment, (B, L, M) [m]; parameters as for `field`."""
    ends = _ends(keypoints, segments)
    axis = _axes(ends, segments)
    u = _columns(points) - ends.take(segments.start, 1)
    along = np.clip(_dot(u, axis) / np.maximum(_dot(axis, axis), _ZERO), 0.0, 1.0)
    return np.moveaxis(_norm(u - along * axis), 0, 1)


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


# ------------------------------------------------------------------------------------------------- gradients


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
    out = np.empty((len(keypoints), points.shape[-2], 3))
    for i, j in _blocks(len(out), out.shape[1], _block_size(segments, _GRADIENTS)):
        rays = _rays(keypoints[i], segments, _part(points, i, j))
        pull, _ = _slopes(rays, weighting)
        out[i, j] = -k1 * np.einsum("iubm,ubm->bmi", rays.vectors, _per_end(segments, pull) / rays.distances)
    return out


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

    Where only one point matters, pass that one alone for each configuration: `points: (B, 1, 3)`,
    `weights: (B, 1)`.

    Parameters
    ----------
    keypoints, segments, points, weighting, k1
        As for `field`.
    weights : ndarray, shape (B, M)
        Factor w of each point's field. Points on a segment contribute nothing.

    Returns
    -------
    ndarray, shape (B, K, 3)
    """
    check_weighting(weighting)
    out = np.zeros(keypoints.shape)
    for i, j in _blocks(len(out), weights.shape[1], _block_size(segments, _GRADIENTS)):
        rays = _rays(keypoints[i], segments, _part(points, i, j))
        pull, stretch = _slopes(rays, weighting)
        w = k1 * weights[i, j]
        approach = np.einsum("iubm,ubm->iub", rays.vectors, _per_end(segments, pull * w) / rays.distances)
        extension = segments.incidence @ (rays.axes[..., 0] * np.einsum("lbm,bm->lb", stretch, w))
        out[i, segments.used] += (approach + extension).transpose(2, 1, 0)
    return out


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


# ------------------------------------------------------------------------------------ one block of the field


class _Rays(NamedTuple):
    """What the derivatives are made of; θ = 0 at points on a segment, so that these have none."""

    vectors: FloatArray  # (3, U, B, M) from each end to each point
    distances: FloatArray  # (U, B, M) their norms; 1 instead of 0
    axes: FloatArray  # (3, L, B, 1) b − a
    lengths: FloatArray  # (L, B, 1) ℓ
    theta: FloatArray  # (L, B, M) θ


def _potentials(
    keypoints: FloatArray, segments: Segments, points: FloatArray, weighting: Weighting
) -> FloatArray:
    """Return φ_l(p)/k₁, (L, B, M)."""
    ends, p = _ends(keypoints, segments), _columns(points)
    lengths = _lengths(ends, segments)
    squares = ends - p
    np.multiply(squares, squares, out=squares)
    theta = _theta(squares, ends, p, segments, lengths)
    if weighting == "unit":
        theta /= lengths
    return theta


def _rays(keypoints: FloatArray, segments: Segments, points: FloatArray) -> _Rays:
    ends, p = _ends(keypoints, segments), _columns(points)
    lengths = _lengths(ends, segments)
    vectors = p - ends
    squares = vectors * vectors
    theta = _theta(squares, ends, p, segments, lengths)
    distances = squares[0]
    if np.isinf(theta).any():
        theta[:, np.isinf(theta).any(axis=0)] = 0.0
        distances[distances == 0] = 1.0
    return _Rays(vectors, distances, _axes(ends, segments), lengths, theta)


def _theta(
    squares: FloatArray, ends: FloatArray, p: FloatArray, segments: Segments, lengths: FloatArray
) -> FloatArray:
    """Return θ = log(1 + 2ℓ/(S − ℓ)), (L, B, M), in as few passes over memory as NumPy allows.

    Works in place on `squares: (3, U, B, M)`, the squared coordinates of p − ends; `squares[0]` becomes the
    distances ‖p − ends‖.
    """
    distances, spare, other = squares
    distances += spare
    distances += other
    np.sqrt(distances, out=distances)
    links = len(segments)
    excess = distances.take(segments.start, 0, spare[:links], "clip")
    excess += distances.take(segments.end, 0, other[:links], "clip")
    excess -= lengths
    with np.errstate(divide="ignore"):
        ratio: FloatArray = np.divide(lengths + lengths, excess, out=excess)
    flat = ratio.reshape(-1)
    least = flat[flat.argmin()]
    if not (least >= 0 and flat[flat.argmax()] <= _NEAR):
        _restore_digits(ratio, ends, p, segments, lengths)
    if least < _FAR:
        np.log1p(ratio, out=ratio)
    else:  # much faster, where processors have it as a vector instruction and where not
        ratio += 1
        np.log(ratio, out=ratio)
    return ratio


def _restore_digits(
    ratio: FloatArray, ends: FloatArray, p: FloatArray, segments: Segments, lengths: FloatArray
) -> None:
    """Replace what cancels in `ratio` = 2ℓ/(S − ℓ), (L, B, M), by ℓ (S + ℓ)/((S² − ℓ²)/2)."""
    link, row, column = np.nonzero(~((ratio >= 0) & (ratio <= _NEAR)))
    shape = ratio.shape
    here = np.broadcast_to(p, (3, 1, *shape[1:]))[:, 0, row, column]
    length = np.broadcast_to(lengths, (*shape[:2], 1))[link, row, 0]
    u = here - ends[:, segments.start[link], row, 0]
    v = here - ends[:, segments.end[link], row, 0]
    with np.errstate(divide="ignore"):
        ratio[link, row, column] = length * (_norm(u) + _norm(v) + length) / _half_gap(u, v)


def _half_gap(u: FloatArray, v: FloatArray) -> FloatArray:
    """Return (S² − ℓ²)/2, (N,), from `u, v: (3, N)` without cancellation; zero on the segment."""
    d1, d2 = _norm(u), _norm(v)
    product, dot, area = d1 * d2, _dot(u, v), _norm(np.cross(u, v, axis=0))
    between = dot < 0
    gap = np.where(between, area**2 / np.where(between, product - dot, 1.0), product + dot)
    gap[between & (area <= _ROUNDING * product)] = 0.0
    gap[np.minimum(d1, d2) <= _ROUNDING * np.maximum(d1, d2)] = 0.0
    return gap


def _slopes(rays: _Rays, weighting: Weighting) -> tuple[FloatArray, FloatArray]:
    """Return c and κ, (L, B, M)."""
    theta, lengths = rays.theta, rays.lengths
    pull = np.sinh(0.5 * theta) / lengths
    pull *= pull
    pull *= 2.0
    sinh = np.sinh(theta)
    if weighting == "length":
        return pull * lengths, sinh / lengths**2
    stretch = sinh - theta
    small = theta < _SMALL
    if small.any():
        stretch[small] = _sinh_excess_series(theta[small])
    return pull, stretch / lengths**3


def _sinh_excess_series(x: FloatArray) -> FloatArray:
    """Return sinh x − x for small x."""
    square = x * x
    return x * square / 6 * (1 + square / 20 * (1 + square / 42 * (1 + square / 72)))


# ----------------------------------------------------------------------------------------------- arrangement


def _checked_pairs(pairs: ArrayLike) -> IntArray:
    array: IntArray = np.array(pairs)
    if array.ndim != 2 or array.shape[1] != 2 or not array.size or array.dtype.kind != "i" or array.min() < 0:
        raise InputError(f"segments must be pairs of key point indices, shape (L ≥ 1, 2), got {pairs!r}")
    return array


def _checked_lengths(lengths: ArrayLike, number: int) -> FloatArray:
    checked = finite_array(lengths, (number,), "lengths of segments")
    if checked.min() < 0:
        raise InputError(f"lengths of segments must not be negative, got {checked.tolist()}")
    return np.maximum(checked, _ZERO)[:, None, None]


def _ends(keypoints: FloatArray, segments: Segments) -> FloatArray:
    """Return the used key points as (3, U, B, 1)."""
    return keypoints.T.take(segments.used, 1)[..., None]


def _columns(points: FloatArray) -> FloatArray:
    """Return points (M, 3) as (3, 1, 1, M), points (B, M, 3) as (3, 1, B, M)."""
    if points.ndim == 2:
        return points.T[:, None, None, :]
    return points.transpose(2, 0, 1)[:, None]


def _axes(ends: FloatArray, segments: Segments) -> FloatArray:
    """Return b − a of every segment, (3, L, B, 1)."""
    axes: FloatArray = ends.take(segments.end, 1) - ends.take(segments.start, 1)
    return axes


def _lengths(ends: FloatArray, segments: Segments) -> FloatArray:
    """Return the lengths of the segments, (L, B, 1) or (L, 1, 1), none of them zero."""
    if segments.lengths is not None:
        return segments.lengths
    return np.maximum(_norm(_axes(ends, segments)), _ZERO)


def _per_end(segments: Segments, values: FloatArray) -> FloatArray:
    """Return for each end the sum (U, B, M) of `values: (L, B, M)` over the segments that meet there."""
    _, rows, columns = values.shape
    sums: FloatArray = segments.adjacency @ values.reshape(len(segments), -1)
    return sums.reshape(-1, rows, columns)


def _dot(u: FloatArray, v: FloatArray) -> FloatArray:
    product: FloatArray = np.add.reduce(u * v, 0)
    return product


def _norm(u: FloatArray) -> FloatArray:
    norm: FloatArray = np.sqrt(_dot(u, u))
    return norm


def _block_size(segments: Segments, arrays: int) -> int:
    """Return how many pairs of configuration and point make a block that keeps so many arrays (U, B, M)."""
    return max(1, _BLOCK // (arrays * len(segments.used)))


def _blocks(rows: int, columns: int, size: int) -> Iterator[tuple[slice, slice]]:
    """Cut (rows, columns) pairs of configurations and points into blocks, of whole rows where these fit."""
    width = max(1, min(columns, size))
    height = max(1, size // width)
    for i in range(0, rows, height):
        for j in range(0, columns, width):
            yield slice(i, i + height), slice(j, j + width)


def _part(points: FloatArray, rows: slice, columns: slice) -> FloatArray:
    """Return the points of a block."""
    return points[columns] if points.ndim == 2 else points[rows, columns]
