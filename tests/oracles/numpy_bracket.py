"""Bounds of the isotropic part of the kinetostatic field, in NumPy."""

import numpy as np

_ZERO = 1e-30


def isotropic_bracket(keypoints, velocities, segments, points):
    """Return proven bounds below and above the isotropic part of every link, (B, L, M), with unit weighting.

    Along a link (1−t)‖v_a‖ + t‖v_b‖ ≥ ‖v(t)‖ ≥ e·v(t) for any unit vector e, here that of the middle. Over a link

        ∫ (c₀ + c₁t)/‖ρ‖² dt = [c₁ ½ log(x² + h²) + (c₀ + c₁s)/h atan(x/h)]/ℓ²,    x = t − s from −s to 1 − s.

    Points are (M, 3), `keypoints` and `velocities` (B, K, 3).
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

    def integral(c):
        c0, c1 = c[0][..., None], (c[1] - c[0])[..., None]
        logs = 0.5 * (np.log((1 - s) ** 2 + apart**2) - np.log(s**2 + apart**2))
        angle = np.arctan2(apart, apart**2 - s * (1 - s))  # atan((1−s)/h) + atan(s/h)
        return (c1 * logs + (c0 + c1 * s) / apart * angle) / squared

    return np.maximum(integral(lower), 0.0), integral(upper)
