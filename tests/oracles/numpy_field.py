"""The danger field in NumPy's passes over whole arrays: what the package used before kernels, an oracle for them.

Arrays are structures of arrays, (3, …, B, M) for B configurations and M points. The logarithm and the hyperbolic
functions are NumPy's, the slopes come from sinh θ and cosh θ: nothing is shared with the kernels but the formula.
"""

import numpy as np

NEAR = 1e3  # 2ℓ/(S − ℓ) above which the difference has lost too many digits
ROUNDING = 8 * np.finfo(np.float64).eps
ZERO = 1e-30


def potentials(keypoints, pairs, points, weighting="unit"):
    """Return φ_l(p), (B, L, M), of key points (B, K, 3) at points (M, 3) or (B, M, 3)."""
    theta, length = _rays(keypoints, pairs, points)[4:]
    return np.moveaxis(theta / length if weighting == "unit" else theta, 0, 1)


def distances(keypoints, pairs, points):
    """Return the distance of every point from every segment, (B, L, M)."""
    u, _, axis, _, _, _ = _rays(keypoints, pairs, points)
    along = np.clip(_dot(u, axis) / np.maximum(_dot(axis, axis), ZERO), 0.0, 1.0)
    return np.moveaxis(_norm(u - along * axis), 0, 1)


def space_gradient(keypoints, pairs, points, weighting="unit"):
    """Return ∂CDF/∂p, (B, M, 3)."""
    u, v, _, lost, theta, length = _rays(keypoints, pairs, points)
    pull, _ = _slopes(theta, length, weighting)
    slope = -(pull * (_unit(u) + _unit(v))).sum(axis=1)
    return np.moveaxis(np.where(lost, 0.0, slope), 0, -1)


def keypoint_gradient(keypoints, pairs, points, weights, weighting="unit"):
    """Return the gradient (B, K, 3) of Σ_m w_m CDF(p_m), weights (B, M)."""
    u, v, axis, lost, theta, length = _rays(keypoints, pairs, points)
    pull, stretch = _slopes(theta, length, weighting)
    weights = np.where(lost, 0.0, weights)
    at_start = (weights * (pull * _unit(u) - stretch * axis)).sum(axis=-1)  # (3, L, B)
    at_end = (weights * (pull * _unit(v) + stretch * axis)).sum(axis=-1)
    out = np.zeros(keypoints.shape)
    for link, (first, second) in enumerate(pairs):
        out[:, first] += at_start[:, link].T
        out[:, second] += at_end[:, link].T
    return out


def _rays(keypoints, pairs, points):
    """Return u and v (3, L, B, M), b − a (3, L, B, 1), where a segment is met (B, M), θ and ℓ, (L, B, M or 1)."""
    p = points.T[:, None, None, :] if points.ndim == 2 else points.transpose(2, 0, 1)[:, None]
    start, end = (keypoints[:, pairs[:, side]].transpose(2, 1, 0)[..., None] for side in (0, 1))
    u, v, axis = p - start, p - end, end - start
    length = np.maximum(_norm(axis), ZERO)
    excess = _norm(u) + _norm(v) - length
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 2 * length / excess
        near = ~((ratio >= 0) & (ratio <= NEAR))
        ratio = np.where(near, length * (_norm(u) + _norm(v) + length) / _half_gap(u, v), ratio)
    theta = np.log1p(ratio)
    return u, v, axis, np.isinf(theta).any(axis=0), theta, length


def _half_gap(u, v):
    """Return (S² − ℓ²)/2 without cancellation; zero on the segment."""
    d1, d2 = _norm(u), _norm(v)
    product, dot, area = d1 * d2, _dot(u, v), _norm(np.cross(u, v, axis=0))
    between = dot < 0
    gap = np.where(between, area**2 / np.where(between, product - dot, 1.0), product + dot)
    gap[between & (area <= ROUNDING * product)] = 0.0
    gap[np.minimum(d1, d2) <= ROUNDING * np.maximum(d1, d2)] = 0.0
    return gap


def _slopes(theta, length, weighting):
    """Return c = (cosh θ − 1)/ℓ² and κ = (sinh θ − θ)/ℓ³, by arc length (cosh θ − 1)/ℓ and sinh θ/ℓ²."""
    theta = np.where(np.isinf(theta), 0.0, theta)
    pull = 2 * (np.sinh(theta / 2) / length) ** 2
    if weighting == "length":
        return pull * length, np.sinh(theta) / length**2
    square = theta * theta
    series = theta * square / 6 * (1 + square / 20 * (1 + square / 42 * (1 + square / 72)))
    return pull, np.where(theta < 0.1, series, np.sinh(theta) - theta) / length**3


def _unit(u):
    norm = _norm(u)
    return u / np.where(norm > 0, norm, 1.0)


def _dot(u, v):
    return (u * v).sum(axis=0)


def _norm(u):
    return np.sqrt(_dot(u, u))
