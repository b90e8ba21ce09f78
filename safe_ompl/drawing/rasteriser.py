"""A z-buffer: which triangle is the nearest at each pixel, and what is where a ray meets it."""

from __future__ import annotations

from math import ceil, floor
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray, IntArray, compiled, part

Numbers: TypeAlias = NDArray[np.int32]  # there are millions: half as many bytes as `IntArray`


def nearest_triangles(
    points: FloatArray, faces: IntArray, width: int, height: int
) -> tuple[NDArray[np.float32], Numbers]:
    """Return how near the nearest triangle is at each pixel (height, width), -inf beside all, and which it is, or -1.

    See `draw_triangles`.
    """
    nearness, owner = np.full((height, width), -np.inf, dtype=np.float32), np.full((height, width), -1, dtype=np.int32)
    draw_triangles(points, faces, 0, nearness, owner)
    return nearness, owner


@compiled
def draw_triangles(
    points: FloatArray, faces: IntArray, first: int, nearness: NDArray[np.float32], owner: Numbers
) -> None:
    """Draw triangles over what is there: where they are nearer, `nearness` and `owner` (height, width) become theirs.

    Triangles are `faces: (F, 3)` of vertices `points: (V, 3)`: columns and rows in pixels, centres at integers, and
    nearness, which must be affine on a triangle in the picture: 1/depth of a perspective, or a height. NaN: not to be
    drawn. Their numbers begin with `first`. A pixel is in a triangle where the three edge functions
    (b − a) × (p − a) have the sign of its area; along a row they bound an interval of columns.
    """
    height, width = nearness.shape
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
                    owner[row, column] = first + f


@part
def meets(vertices: FloatArray, corners: IntArray, eye: FloatArray, ray: FloatArray) -> tuple[float, float]:
    """Return the shares of the second and third of the corners (3,) where a ray (3,) from the eye meets their triangle.

    A ray that misses its triangle, as one through the edge may, has those of the edge.
    """
    i, j, k = corners[0], corners[1], corners[2]
    ax, ay, az = eye[0] - vertices[i, 0], eye[1] - vertices[i, 1], eye[2] - vertices[i, 2]
    ux, uy, uz = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
    vx, vy, vz = vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2]
    cx, cy, cz = ray[1] * vz - ray[2] * vy, ray[2] * vx - ray[0] * vz, ray[0] * vy - ray[1] * vx
    determinant = ux * cx + uy * cy + uz * cz
    if determinant == 0.0:
        determinant = 1.0
    u = min(max((ax * cx + ay * cy + az * cz) / determinant, 0.0), 1.0)
    v = ray[0] * (ay * uz - az * uy) + ray[1] * (az * ux - ax * uz) + ray[2] * (ax * uy - ay * ux)
    return u, min(max(v / determinant, 0.0), 1.0 - u)


@compiled
def interpolated(
    vertices: FloatArray, corners: IntArray, values: FloatArray, eye: FloatArray, rays: FloatArray
) -> FloatArray:
    """Return values (V, C) of vertices where rays (P, 3) from the eye meet triangles of corners (P, 3): (P, C)."""
    found = np.empty((len(rays), values.shape[1]))
    for p in range(len(rays)):
        i, j, k = corners[p]
        u, v = meets(vertices, corners[p], eye, rays[p])
        for c in range(values.shape[1]):
            found[p, c] = (1.0 - u - v) * values[i, c] + u * values[j, c] + v * values[k, c]
    return found
