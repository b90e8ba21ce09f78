"""Points on the surface of a body made of capsules, without those deep inside it."""

from __future__ import annotations

from math import ceil, cos, pi, sin, sqrt

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels.compiled import compiled, part


@part
def _steps(length: float, step: float) -> int:
    return max(1, ceil(length / step - 1e-9))


@part
def _profile(radius: float, length: float, spacing: float) -> FloatArray:
    """Return rings (K, 2) of a capsule about z, of a ball for length 0: distance from the axis, and height."""
    side = _steps(length, spacing) if length > 0.0 else 0
    half = _steps(pi / 2 * radius, spacing) if length > 0.0 else _steps(pi * radius, spacing)
    rings = np.empty((2 * half + side + 1 if length > 0.0 else half + 1, 2))
    for k in range(len(rings)):
        if length > 0.0:  # a quarter of a circle, the side, another quarter
            turn = pi / 2 * (k / half - 1.0 if k < half else max(0, k - half - side) / half)
            height = length * (min(max(k - half, 0), side) / side - 0.5)
        else:
            turn, height = pi * (k / half - 0.5), 0.0
        rings[k, 0] = max(0.0, radius * cos(turn))
        rings[k, 1] = height + radius * sin(turn)
    return rings


@part
def _frame(axis: FloatArray, length: float) -> FloatArray:
    """Return the rotation (3, 3) that takes z to an axis on the shortest way; of no length: none."""
    frame = np.eye(3)
    if length == 0.0:
        return frame
    x, y, z = axis[0] / length, axis[1] / length, axis[2] / length
    if z < -1.0 + 1e-12:
        frame[1, 1] = frame[2, 2] = -1.0
        return frame
    frame[0, 0], frame[0, 1], frame[0, 2] = 1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x
    frame[1, 0], frame[1, 1], frame[1, 2] = frame[0, 1], 1.0 - y * y / (1.0 + z), y
    frame[2, 0], frame[2, 1], frame[2, 2] = -x, -y, z
    return frame


@part
def _depth(point: FloatArray, start: FloatArray, axis: FloatArray, squared: float, radius: float) -> float:
    """How deep a point lies inside the capsule about start … start + axis; negative outside [m]."""
    t = 0.0
    if squared > 0.0:
        for x in range(3):
            t += (point[x] - start[x]) * axis[x]
        t = min(1.0, max(0.0, t / squared))
    away = 0.0
    for x in range(3):
        away += (point[x] - start[x] - t * axis[x]) ** 2
    return radius - sqrt(away)


@compiled
def surface_points(starts: FloatArray, ends: FloatArray, radii: FloatArray, spacing: float) -> FloatArray:
    """Return points (M, 3) [m] on L capsules, those deeper than `spacing` inside another one left out.

    Parameters
    ----------
    starts, ends : ndarray, shape (L, 3)
        Ends of their axes [m]; the same: a ball.
    radii : ndarray, shape (L,)
        [m]
    spacing : float
        Every point of a capsule's surface is within this of one of its points [m].
    """
    axes, squared = np.empty(starts.shape), np.zeros(len(radii))
    most = 0
    for i in range(len(radii)):
        for x in range(3):
            axes[i, x] = ends[i, x] - starts[i, x]
            squared[i] += axes[i, x] * axes[i, x]
        for ring in _profile(radii[i], sqrt(squared[i]), spacing):
            most += _steps(2 * pi * ring[0], spacing)
    points, kept = np.empty((most, 3)), 0
    for i in range(len(radii)):
        length = sqrt(squared[i])
        frame = _frame(axes[i], length)
        for ring in _profile(radii[i], length, spacing):
            count = _steps(2 * pi * ring[0], spacing)
            for k in range(count):
                angle = 2 * pi * k / count
                x, y, z = ring[0] * cos(angle), ring[0] * sin(angle), ring[1]
                point = points[kept]  # stays where nothing is deeper than the spacing
                for a in range(3):
                    point[a] = (
                        (starts[i, a] + ends[i, a]) / 2 + frame[a, 0] * x + frame[a, 1] * y + frame[a, 2] * z
                    )
                inside = False
                for j in range(len(radii)):
                    if j != i and _depth(point, starts[j], axes[j], squared[j], radii[j]) > spacing:
                        inside = True
                        break
                if not inside:
                    kept += 1
    return points[:kept].copy()
