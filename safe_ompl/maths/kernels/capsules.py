"""Points on the surface of a body made of capsules, without those deep inside it."""

from __future__ import annotations

from math import ceil, cos, pi, sin, sqrt

import numpy as np
from numba import njit

from safe_ompl.arrays import FloatArray


@njit(cache=True)
def _steps(length: float, step: float) -> int:
    return max(1, ceil(length / step - 1e-9))


@njit(cache=True)
def _profile(radius: float, length: float, spacing: float) -> FloatArray:
    """Return rings (K, 2) of a capsule about z, of a ball for length 0: distance from the axis, and height."""
    if length == 0.0:
        arc = _steps(pi * radius, spacing)
        turns = np.linspace(-pi / 2, pi / 2, arc + 1)
        heights = np.zeros(arc + 1)
    else:
        arc, side = _steps(pi / 2 * radius, spacing), _steps(length, spacing)
        quarter = np.linspace(0.0, pi / 2, arc + 1)
        turns = np.concatenate((-quarter[::-1], np.zeros(side - 1), quarter))
        along = np.linspace(-length / 2, length / 2, side + 1)
        heights = np.concatenate((np.full(arc, -length / 2), along, np.full(arc, length / 2)))
    rings = np.empty((len(turns), 2))
    for k in range(len(turns)):
        rings[k, 0] = max(0.0, radius * cos(turns[k]))
        rings[k, 1] = heights[k] + radius * sin(turns[k])
    return rings


@njit(cache=True)
def _frame(axis: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) that takes z to the unit vector `axis` on the shortest way."""
    frame = np.eye(3)
    x, y, z = axis
    if z < -1.0 + 1e-12:
        frame[1, 1] = frame[2, 2] = -1.0
        return frame
    frame[0, 0], frame[0, 1], frame[0, 2] = 1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), x
    frame[1, 0], frame[1, 1], frame[1, 2] = frame[0, 1], 1.0 - y * y / (1.0 + z), y
    frame[2, 0], frame[2, 1], frame[2, 2] = -x, -y, z
    return frame


@njit(cache=True)
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


@njit(cache=True)
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
    axes = ends - starts
    squared = (axes * axes).sum(axis=1)
    most = 0
    for i in range(len(radii)):
        for ring in _profile(radii[i], sqrt(squared[i]), spacing):
            most += _steps(2 * pi * ring[0], spacing)
    points, kept = np.empty((most, 3)), 0
    for i in range(len(radii)):
        length = sqrt(squared[i])
        frame = _frame(axes[i] / length) if length > 0.0 else np.eye(3)
        middle = (starts[i] + ends[i]) / 2
        for ring in _profile(radii[i], length, spacing):
            count = _steps(2 * pi * ring[0], spacing)
            for k in range(count):
                angle = 2 * pi * k / count
                x, y, z = ring[0] * cos(angle), ring[0] * sin(angle), ring[1]
                point = points[kept]  # stays where nothing is deeper than the spacing
                for a in range(3):
                    point[a] = middle[a] + frame[a, 0] * x + frame[a, 1] * y + frame[a, 2] * z
                inside = False
                for j in range(len(radii)):
                    if j != i and _depth(point, starts[j], axes[j], squared[j], radii[j]) > spacing:
                        inside = True
                        break
                if not inside:
                    kept += 1
    return points[:kept].copy()
