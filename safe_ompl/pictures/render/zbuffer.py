"""Z-buffer: the nearest triangle at each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.triangles import nearest_triangles
from safe_ompl.pictures.render.camera import Camera

_NEAR = 0.02  # [m] in front of the camera, where it begins to see


@dataclass(frozen=True)
class ZBuffer:
    """What the pixels of a grid see.

    Attributes
    ----------
    nearness : (H, W) array of float32
        Of the nearest triangle, -inf where there is none.
    faces : (H, W) array of int
        The nearest triangle, -1 where there is none.
    """

    nearness: NDArray[np.float32]
    faces: IntArray

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray, size: tuple[int, int]) -> ZBuffer:
        """Fill a buffer.

        Parameters
        ----------
        points : (V, 3) array
            Columns and rows of the vertices in pixels, centres at integers, and their nearness, which must be affine
            on a triangle in the picture: 1/depth of a perspective, or a height. NaN: not to be drawn.
        faces : (F, 3) array
            Vertices of the triangles.
        size : (int, int)
            Width and height [px].
        """
        return cls(*nearest_triangles(np.ascontiguousarray(points), np.ascontiguousarray(faces), *size))


def in_picture(camera: Camera, points: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return columns, rows and 1/depth [1/m] of points (P, 3) in a picture; NaN behind the camera."""
    back, right = camera.axes()
    away = points - camera.eye
    depth = -(away @ back)
    depth = np.where(depth > _NEAR, depth, np.nan)
    scale = size[1] / 2 / np.tan(camera.field_of_view / 2) / depth
    x = (size[0] - 1) / 2 + scale * (away @ right)
    y = (size[1] - 1) / 2 - scale * (away @ camera.up)
    return np.column_stack([x, y, 1.0 / depth])


def viewing_rays(camera: Camera, size: tuple[int, int], pixels: IntArray) -> FloatArray:
    """Return the ways of the rays (P, 3) of some pixels, numbered row by row, per metre of depth."""
    back, right = camera.axes()
    half = np.tan(camera.field_of_view / 2) / (size[1] / 2)
    row, column = np.divmod(pixels, size[0])
    x, y = (column - (size[0] - 1) / 2) * half, ((size[1] - 1) / 2 - row) * half
    return np.asarray(x[:, None] * right + y[:, None] * camera.up - back)


def floor_nearness(camera: Camera, size: tuple[int, int], floor: float) -> FloatArray:
    """Return 1/depth [1/m] of a floor in each pixel (H, W), 0 where there is only sky."""
    corners = viewing_rays(camera, size, np.array([0, size[0] - 1, (size[1] - 1) * size[0]]))[:, 2]
    first, across, down = corners / (floor - camera.eye[2])
    x, y = np.linspace(0.0, across - first, size[0]), np.linspace(0.0, down - first, size[1])
    return np.asarray(np.maximum(first + x[None] + y[:, None], 0.0))
