"""Z-buffer: the nearest triangle at each pixel, in NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.pictures.render.camera import Camera

_ROWS = 1 << 16  # of triangles, filled at once
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
        width, height = size
        nearness = np.full(width * height, -np.inf, dtype=np.float32)
        owner = np.full(width * height, -1, dtype=np.intp)
        corners = points[faces]
        with np.errstate(invalid="ignore"):
            low = np.maximum(np.ceil(corners[..., 1].min(axis=1)), 0.0)
            high = np.minimum(np.floor(corners[..., 1].max(axis=1)), height - 1.0)
            drawn = np.flatnonzero(np.isfinite(corners).all(axis=(1, 2)) & (high >= low))
        rows = (high[drawn] - low[drawn]).astype(np.intp) + 1
        first = 0
        for last in _batches(rows):
            part = drawn[first:last]
            spans = _spans(corners[part], low[part], rows[first:last], width)
            _fill(nearness, owner, part, spans, width)
            first = last
        return cls(nearness.reshape(height, width), owner.reshape(height, width))


class _Spans(NamedTuple):
    """The pixels that triangles cover in each row: from a column on so many, with nearness there and its slope."""

    triangle: IntArray
    row: IntArray
    column: IntArray
    length: IntArray
    nearness: FloatArray
    slope: FloatArray


def _batches(counts: IntArray) -> list[int]:
    """Return where batches of triangles end that have about so many rows."""
    total = np.cumsum(counts)
    if not len(total):
        return []
    ends = np.searchsorted(total, np.arange(_ROWS, int(total[-1]) + _ROWS, _ROWS))
    return [int(end) for end in np.unique(np.minimum(ends + 1, len(total)))]


def _spans(corners: FloatArray, low: FloatArray, rows: IntArray, width: int) -> _Spans:
    """Return the spans of triangles with corners (T, 3, 3), each of which begins at a row and has so many."""
    (x0, y0, z0), (x1, y1, z1), (x2, y2, z2) = (corners[:, k].T for k in range(3))
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    turn = np.where(area < 0.0, -1.0, 1.0)
    triangle = np.repeat(np.arange(len(corners)), rows)
    y = low[triangle] + np.arange(len(triangle)) - np.repeat(np.cumsum(rows) - rows, rows)
    left, right = np.zeros(len(triangle)), np.full(len(triangle), width - 1.0)
    for (xa, ya), (xb, yb) in (((x0, y0), (x1, y1)), ((x1, y1), (x2, y2)), ((x2, y2), (x0, y0))):
        slope = -(turn * (yb - ya))[triangle]  # of the edge function, along the row
        value = (turn * (xb - xa))[triangle] * (y - ya[triangle]) - slope * xa[triangle]
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = -value / slope
        left = np.where(slope > 0.0, np.maximum(left, cut), left)
        right = np.where(slope < 0.0, np.minimum(right, cut), right)
        right = np.where((slope == 0.0) & (value < 0.0), -1.0, right)
    area = np.where(area == 0.0, np.inf, area)
    dx = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / area
    dy = ((z2 - z0) * (x1 - x0) - (z1 - z0) * (x2 - x0)) / area
    column = np.ceil(left)
    z = z0[triangle] + dx[triangle] * (column - x0[triangle]) + dy[triangle] * (y - y0[triangle])
    count = np.clip(np.floor(right) - column + 1.0, 0.0, width).astype(np.intp)
    return _Spans(triangle, y.astype(np.intp), column.astype(np.intp), count, z, dx[triangle])


def _fill(nearness: NDArray[np.float32], owner: IntArray, faces: IntArray, spans: _Spans, width: int) -> None:
    """Keep what is nearest in each pixel of some spans."""
    span = np.repeat(np.arange(len(spans.length)), spans.length)
    along = np.arange(len(span)) - np.repeat(np.cumsum(spans.length) - spans.length, spans.length)
    pixel = (spans.row * width + spans.column)[span] + along
    z = (spans.nearness[span] + spans.slope[span] * along).astype(np.float32)
    np.maximum.at(nearness, pixel, z)
    nearest = np.flatnonzero(nearness[pixel] == z)
    owner[pixel[nearest]] = faces[spans.triangle[span[nearest]]]


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
