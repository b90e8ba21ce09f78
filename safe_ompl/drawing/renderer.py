"""Render pictures of surfaces with soft shadows, without noise, without a display and without a graphics library."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray
from safe_ompl.drawing.drawn_scene import Camera, in_picture, viewing_rays
from safe_ompl.drawing.light import Light
from safe_ompl.drawing.rendering import (
    FLOOR_VALUE,
    SUBPIXELS,
    Painted,
    Shading,
    View,
    draw_triangles,
    interpolated,
    nearest_triangles,
)
from safe_ompl.drawing.surfaces import ColouredSurface, Surface


class Renderer:
    """An endless light floor, at a height [m], under a soft sky; the key light is over the camera's left shoulder.

    Things that stand `still` in many pictures are rendered once. Then `around` (P, 3) [m] must be given; shadows
    are computed in their region, else in the region of the picture's things.
    """

    def __init__(
        self,
        floor: float,
        camera: Camera,
        size: tuple[int, int],
        still: Sequence[ColouredSurface] = (),
        around: FloatArray | None = None,
    ) -> None:
        self.camera, self.size, self._floor = camera, size, floor
        self._fine = (SUBPIXELS * size[0], SUBPIXELS * size[1])
        rays = viewing_rays(camera, self._fine, np.arange(self._fine[0] * self._fine[1]))
        self._floor_nearness = np.maximum(rays[:, 2] / (floor - camera.eye[2]), 0.0)
        self._still = list(still)
        self._background = Surface.merged(thing.surface for thing in still)
        self._seen = self._nearest(self._background)
        self._light = None if around is None else self._light_around(around, self._background)

    def render(self, things: Sequence[ColouredSurface]) -> FloatArray:
        """Return a picture of things on the floor: (height, width, 3), linear RGB."""
        return self.render_layers(things, ())[0]

    def render_layers(
        self, things: Sequence[ColouredSurface], bodies: Iterable[tuple[Surface, FloatArray]]
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Return the picture of `render`, and pictures of translucent bodies among the things.

        The picture of a body shows the values (V, C) in [0, 1] of its vertices, and 0 where the body is hidden.
        """
        moving = Surface.merged(thing.surface for thing in things)
        nearness, faces = self._seen[0].copy(), self._seen[1].copy()
        points = in_picture(self.camera, moving.vertices, self._fine)
        draw_triangles(points, moving.faces, len(self._background.faces), nearness, faces)
        hidden = np.maximum(nearness.ravel(), self._floor_nearness)
        faces = np.where(nearness.ravel() > self._floor_nearness, faces.ravel(), -1)
        solid = Surface.merged([self._background, moving])
        known = self._light
        light = self._light_around(solid.vertices, solid) if known is None else known.behind(moving)
        picture = self._picture(solid, [*self._still, *things], light, faces)
        return picture, [self._layer(hidden, *body) for body in bodies]

    def _nearest(self, surface: Surface) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return 1/depth of a surface at all subpixels, and the indices of the visible triangles."""
        return nearest_triangles(in_picture(self.camera, surface.vertices, self._fine), surface.faces, *self._fine)

    def _light_around(self, points: FloatArray, solid: Surface) -> Light:
        return Light.around(points, self._floor, self.camera.key_light()).behind(solid)

    def _picture(
        self, solid: Surface, things: Sequence[ColouredSurface], light: Light, faces: NDArray[np.int32]
    ) -> FloatArray:
        """Shade a solid of all things, given the index of the visible triangle of each subpixel, or -1."""
        owners = np.repeat(np.arange(len(things)), [len(thing.surface.faces) for thing in things])
        paint = np.array([(*linear(np.array(thing.colour)), thing.glossy) for thing in things], dtype=float)
        painted = Painted(solid.vertices, solid.normals, solid.faces, owners, paint.reshape(-1, 4))
        camera, (width, height) = self.camera, self._fine
        back, right = camera.axes()
        scale = np.tan(camera.field_of_view / 2) / (height / 2)
        view = View(camera.eye, np.stack([right, camera.up, back]), scale, camera.key_light())
        shading = Shading(painted, light, view)
        return shading.picture(faces.reshape(height, width), self._floor_nearness.reshape(height, width))

    def _layer(self, hidden: FloatArray, surface: Surface, values: FloatArray) -> FloatArray:
        """Return an image (height, width, C) of the values (V, C) of a body's vertices, 0 where it is hidden."""
        nearness, faces = self._nearest(surface)
        there = np.flatnonzero(nearness.ravel() > hidden)
        rays, seen = viewing_rays(self.camera, self._fine, there), surface.faces[faces.ravel()[there]]
        image = np.zeros((nearness.size, values.shape[1]), dtype=np.float32)
        image[there] = interpolated(surface.vertices, seen, values, self.camera.eye, rays)
        pixels = image.reshape(self.size[1], SUBPIXELS, self.size[0], SUBPIXELS, -1)
        return np.asarray(np.clip(pixels.mean(axis=(1, 3), dtype=float), 0.0, 1.0))


def linear(srgb: FloatArray) -> FloatArray:
    """Return the linear RGB of sRGB values in [0, 1]."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def tone_mapped(linear_rgb: FloatArray) -> FloatArray:
    """Return the sRGB values in [0, 1] of linear RGB, highlights softened rather than clipped."""
    knee = FLOOR_VALUE
    over = np.clip(linear_rgb - knee, 0.0, None)
    soft = np.minimum(linear_rgb, knee) + (1.0 - knee) * (1.0 - np.exp(-over / (1.0 - knee)))
    soft = np.clip(soft, 0.0, 1.0)
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * soft ** (1 / 2.4) - 0.055)
