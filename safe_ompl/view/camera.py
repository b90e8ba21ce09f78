"""A pinhole camera that holds points in its picture, where it sees them, and the rays of its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import FloatArray, InputError, IntArray

_NEAR = 0.02  # [m] in front of the camera, where it begins to see
_MARGIN = 0.05  # share of a picture that is left free at each side


@dataclass(frozen=True)
class Camera:
    """A pinhole camera."""

    eye: FloatArray  # (3,), Where it stands, a point it looks at, and the direction that is up in the picture [m]
    target: FloatArray
    up: FloatArray
    field_of_view: float  # Vertical opening angle [rad]

    @classmethod
    def framing(
        cls, points: FloatArray, azimuth: float, elevation: float, size: tuple[int, int], field_of_view: float = 0.5
    ) -> Camera:
        """Return the camera that looks from a direction and holds all `points: (P, 3)` [m], as near as it can.

        The direction, from the points to the camera, is given by azimuth about z and elevation [rad]. Raises InputError
        if the picture, `size` [px], has no pixels.
        """
        if min(size) < 1:
            raise InputError(f"a picture needs at least 1 pixel; got {size[0]} by {size[1]}")
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        back, right = np.array([ce * ca, ce * sa, se]), np.array([-sa, ca, 0.0])  # to the camera, and in the picture
        up = np.cross(back, right)
        x, y, z = points @ right, points @ up, points @ back
        half_height = np.tan(field_of_view / 2) * (1.0 - 2.0 * _MARGIN)
        eye_x, far_x = _fit(x, z, half_height * size[0] / size[1])
        eye_y, far_y = _fit(y, z, half_height)
        eye_z = max(far_x, far_y, float(z.max()) + 1e-3)
        eye = eye_x * right + eye_y * up + eye_z * back
        return cls(eye, eye - (eye_z - float(z.mean())) * back, up, field_of_view)

    def axes(self) -> tuple[FloatArray, FloatArray]:
        """Return the unit vectors (3,) back to the eye and to the right in the picture."""
        back = (self.eye - self.target) / np.linalg.norm(self.eye - self.target)
        return back, np.cross(self.up, back)

    def key_light(self) -> FloatArray:
        """Return the unit vector (3,) to the main light of a picture: high over the left shoulder of the camera."""
        back = (self.eye - self.target - 0.35 * self.up) * (1.0, 1.0, 0.0)
        back = back / np.linalg.norm(back)
        left = np.cross(back, (0.0, 0.0, 1.0))
        key = 0.6 * back + 0.8 * left + (0.0, 0.0, 1.3)
        return np.asarray(key / np.linalg.norm(key))


def _fit(across: FloatArray, depth: FloatArray, slope: float) -> tuple[float, float]:
    """Return the nearest camera (lateral position, depth) that sees all points within ± `slope`.

    |xᵢ − x| ≤ slope · (z − zᵢ) for all i is tight at z = (max(xᵢ + s zᵢ) − min(xᵢ − s zᵢ)) / 2s.
    """
    high, low = float((across + slope * depth).max()), float((across - slope * depth).min())
    return (high + low) / 2.0, (high - low) / (2.0 * slope)


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
