"""Triangles drawn into a grid of pixels, of which each keeps the nearest; shadows by such grids."""

from __future__ import annotations

from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray, IntArray, compiled


@compiled
def nearest_triangles(
    points: FloatArray, faces: IntArray, width: int, height: int
) -> tuple[NDArray[np.float32], IntArray]:
    """Return how near the nearest triangle is at each pixel (height, width), -inf beside all, and which it is, or -1.

    A pixel is in a triangle where the three edge functions (b − a) × (p − a) have the sign of its area; along a row
    they bound an interval of columns. The nearness of `points: (V, 3)` is affine on a triangle. NaN: it is not drawn.
    """
    nearness = np.full((height, width), -np.inf, dtype=np.float32)
    owner = np.full((height, width), -1, dtype=np.intp)
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if not np.isfinite(area + a[2] + b[2] + c[2]) or area == 0.0:
            continue
        turn = 1.0 if area > 0.0 else -1.0
        across = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area
        down = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / area
        lowest = max(ceil(min(a[1], b[1], c[1])), 0)
        highest = min(floor(max(a[1], b[1], c[1])), height - 1)
        for row in range(lowest, highest + 1):
            left, right = 0.0, width - 1.0
            for one, other in ((a, b), (b, c), (c, a)):
                slope = -turn * (other[1] - one[1])  # of the edge function, along the row
                value = turn * (other[0] - one[0]) * (row - one[1]) - slope * one[0]
                if slope > 0.0:
                    left = max(left, -value / slope)
                elif slope < 0.0:
                    right = min(right, -value / slope)
                elif value < 0.0:
                    right = -1.0
            for column in range(ceil(left), floor(right) + 1):
                near = a[2] + across * (column - a[0]) + down * (row - a[1])
                if near > nearness[row, column]:
                    nearness[row, column] = near
                    owner[row, column] = f
    return nearness, owner


@compiled
def light_at(
    places: FloatArray,
    normals: FloatArray,
    slants: FloatArray,
    directions: FloatArray,
    maps: NDArray[np.float32],
    tolerance: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the light (P,) that surfaces receive at places, and the summed shares (P,) of the lights that see them.

    Parameters
    ----------
    places : (P, 3) array
        Columns and rows of the texels under them, and their heights above the floor [m].
    normals : (P, 3) array
        Unit normals of the surfaces.
    slants : (L, 2) array
        How far aside each light is, per metre of height [texels/m].
    directions : (L, 4) array
        Direction to each light, as long as it lights the open floor; and its share of what is counted.
    maps : (L, S, S) array
        For each light how high above the floor [m] the highest thing is on the ray that ends in each texel.
    tolerance : float
        How much higher that must be than a place to shade it [m].
    """
    size = maps.shape[1]
    light, counted = np.zeros(len(places)), np.zeros(len(places))
    for p in range(len(places)):
        height = places[p, 2]
        for k in range(len(slants)):
            column = round(places[p, 0] - height * slants[k, 0])
            row = round(places[p, 1] - height * slants[k, 1])
            inside = 0 <= column < size and 0 <= row < size
            if inside and maps[k, row, column] > height + tolerance:
                continue
            towards = directions[k]
            facing = normals[p, 0] * towards[0] + normals[p, 1] * towards[1] + normals[p, 2] * towards[2]
            light[p] += max(facing, 0.0)
            counted[p] += towards[3]
    return light, counted
