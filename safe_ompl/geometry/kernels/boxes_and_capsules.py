"""Pairs of boxes that may be near each other, and points on the surface of a body made of capsules.

Two boxes are apart if their shadows on some axis are. Looked at are the axes of the world, and of both boxes.
"""

from __future__ import annotations

from math import ceil, cos, pi, sin, sqrt

import numpy as np

from safe_ompl.common import FloatArray, IntArray, compiled, part


@compiled
def near_boxes(
    places: FloatArray, boxes: FloatArray, pairs: IntArray, margins: FloatArray, near: IntArray
) -> int:
    """Write which pairs may be no farther apart than their margins, and return how many these are.

    Parameters
    ----------
    places : ndarray, shape (G, 12)
        Rotation of each box, column by column, and where its frame is [m].
    boxes : ndarray, shape (G, 6)
        Its centre and half its sides in that frame [m]. One with sides that are infinite, or no numbers, is near all.
    pairs : ndarray of int, shape (P, 2)
    margins : ndarray, shape (P,)
        [m]
    near : ndarray of int, shape (P,)
        Takes the indices of these pairs, in order.
    """
    G, number = len(boxes), 0
    centres, halves, gap = np.empty((G, 3)), np.empty((G, 3)), np.empty(3)
    for g in range(G):
        for x in range(3):
            centre, half = places[g, 9 + x], 0.0
            for axis in range(3):
                centre += places[g, 3 * axis + x] * boxes[g, axis]
                half += abs(places[g, 3 * axis + x]) * boxes[g, 3 + axis]
            centres[g, x], halves[g, x] = centre, half
    for p in range(len(pairs)):
        a, b, margin, apart = pairs[p, 0], pairs[p, 1], margins[p], False
        for x in range(3):
            gap[x] = centres[b, x] - centres[a, x]
            if abs(gap[x]) > halves[a, x] + halves[b, x] + margin:
                apart = True
                break
        for turn in range(0 if apart else 6):
            axis = turn % 3
            own, other = (a, b) if turn < 3 else (b, a)
            nx, ny, nz = places[own, 3 * axis], places[own, 3 * axis + 1], places[own, 3 * axis + 2]
            shadows = boxes[own, 3 + axis] + margin
            for k in range(3):
                along = (
                    nx * places[other, 3 * k] + ny * places[other, 3 * k + 1] + nz * places[other, 3 * k + 2]
                )
                shadows += abs(along) * boxes[other, 3 + k]
            if abs(nx * gap[0] + ny * gap[1] + nz * gap[2]) > shadows:
                apart = True
                break
        if not apart:
            near[number] = p
            number += 1
    return number


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
