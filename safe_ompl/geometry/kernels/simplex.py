"""The point of a simplex that is nearest to the origin."""

from __future__ import annotations

import numpy as np

from safe_ompl.common import FloatArray, part

Found = tuple[float, float, float, int]

_FLAT = 1e-12  # squared sine of an angle of triangles that count as segments


@part
def _in_segment(S: FloatArray, i: int, j: int) -> Found:
    """Return the nearest point of the segment of corners i and j, and the corners it lies between as bits."""
    x, y, z = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1], S[j, 2] - S[i, 2]
    square = x * x + y * y + z * z
    along = -(S[i, 0] * x + S[i, 1] * y + S[i, 2] * z)
    if along <= 0.0:
        return S[i, 0], S[i, 1], S[i, 2], 1 << i
    if along >= square:
        return S[j, 0], S[j, 1], S[j, 2], 1 << j
    t = along / square
    return S[i, 0] + t * x, S[i, 1] + t * y, S[i, 2] + t * z, (1 << i) | (1 << j)


@part
def _in_triangle(S: FloatArray, i: int, j: int, k: int) -> Found:
    """Return the nearest point of the triangle of corners i, j and k, and the corners it lies between as bits."""
    ux, uy, uz = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1], S[j, 2] - S[i, 2]
    vx, vy, vz = S[k, 0] - S[i, 0], S[k, 1] - S[i, 1], S[k, 2] - S[i, 2]
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu = S[i, 0] * ux + S[i, 1] * uy + S[i, 2] * uz
    pv = S[i, 0] * vx + S[i, 1] * vy + S[i, 2] * vz
    area = uu * vv - uv * uv
    if area > _FLAT * uu * vv:
        s, t = (uv * pv - vv * pu) / area, (uv * pu - uu * pv) / area
        if s > 0.0 and t > 0.0 and s + t < 1.0:
            x, y, z = S[i, 0] + s * ux + t * vx, S[i, 1] + s * uy + t * vy, S[i, 2] + s * uz + t * vz
            return x, y, z, (1 << i) | (1 << j) | (1 << k)
    best: Found = _in_segment(S, i, j)
    least = np.inf
    for n in range(3):
        found = best if n == 0 else (_in_segment(S, i, k) if n == 1 else _in_segment(S, j, k))
        square = found[0] ** 2 + found[1] ** 2 + found[2] ** 2
        if square < least:
            best, least = found, square
    return best


@part
def _hides(S: FloatArray, i: int, j: int, k: int, opposite: int) -> bool:
    """Return whether the origin is not on the same side of the face of corners i, j and k as the fourth corner."""
    ux, uy, uz = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1], S[j, 2] - S[i, 2]
    vx, vy, vz = S[k, 0] - S[i, 0], S[k, 1] - S[i, 1], S[k, 2] - S[i, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    to_origin = -(x * S[i, 0] + y * S[i, 1] + z * S[i, 2])
    to_corner = x * S[opposite, 0] + y * S[opposite, 1] + z * S[opposite, 2] + to_origin
    return not to_origin * to_corner > 0.0


@part
def nearest_in_simplex(S: FloatArray, corners: int) -> Found:
    """Return the point of a simplex that is nearest to the origin, and how many corners it lies between.

    `S: (4, 3 or more)` has so many corners; those that the point lies between are moved to the front, with all that is
    in their rows.
    """
    if corners == 1:
        return S[0, 0], S[0, 1], S[0, 2], 1
    if corners == 2:
        x, y, z, between = _in_segment(S, 0, 1)
    elif corners == 3:
        x, y, z, between = _in_triangle(S, 0, 1, 2)
    else:
        x, y, z, between = 0.0, 0.0, 0.0, 15
        nearest = np.inf
        for opposite in range(4):
            i, j, k = (opposite + 1) % 4, (opposite + 2) % 4, (opposite + 3) % 4
            if _hides(S, i, j, k, opposite):
                a, b, c, found = _in_triangle(S, i, j, k)
                if a * a + b * b + c * c < nearest:
                    x, y, z, between, nearest = a, b, c, found, a * a + b * b + c * c
    count = 0
    for i in range(corners):
        if between >> i & 1:
            for column in range(S.shape[1]):
                S[count, column] = S[i, column]
            count += 1
    return x, y, z, count
