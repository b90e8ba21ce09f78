"""Pictures of surfaces as a camera sees them, by a z-buffer with soft shadows: no noise, no display, no library."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from math import ceil, floor
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray, IntArray, compiled
from safe_ompl.view.camera import Camera, in_picture, viewing_rays
from safe_ompl.view.surfaces import ColouredSurface, Surface

_Numbers: TypeAlias = NDArray[np.int32]  # there are millions: half as many bytes as `IntArray`
_SUBPIXELS = 2  # along each side of a pixel
_SKY_SHARE = 0.55  # of the light on the open floor; the key light gives the rest
_SKY_LIGHTS, _KEY_LIGHTS = 24, 8
_KEY_RADIUS = 0.12  # [rad]
_LOWEST = 0.3  # sine of the elevation of the lowest light
_MAP = 256  # texels along each side of a shadow map
_FADING = 0.12  # share of its sides
_BOUNCE = 0.22  # light from the floor on what looks down
_GLOSS, _SHININESS = 0.16, 60.0


class Renderer:
    """An endless light floor, at a height [m], under a soft sky; the key light is over the camera's left shoulder.

    What stands `still` in many pictures is drawn once. Then shadows are known `around` points (P, 3) [m], which must be
    given; else around whatever a picture shows.
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
        self._fine = (_SUBPIXELS * size[0], _SUBPIXELS * size[1])
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
        """Return the picture of `render`, and what is seen of translucent bodies among the things.

        That is of each body alone the values (V, C) in [0, 1] of its vertices, 0 where it is not seen.
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

    def _nearest(self, surface: Surface) -> tuple[NDArray[np.float32], _Numbers]:
        """Return 1/depth of a surface at all subpixels, and which of its triangles they see."""
        return nearest_triangles(in_picture(self.camera, surface.vertices, self._fine), surface.faces, *self._fine)

    def _light_around(self, points: FloatArray, solid: Surface) -> _Light:
        return _Light(points, self._floor, self.camera.key_light()).behind(solid)

    def _picture(self, solid: Surface, things: Sequence[ColouredSurface], light: _Light, faces: _Numbers) -> FloatArray:
        """Return the picture of things, which make one solid of which subpixels (S,) see triangles, or -1."""
        thing_of_face = np.repeat(np.arange(len(things)), [len(thing.surface.faces) for thing in things])
        seen = np.zeros(len(solid.faces) + 1, dtype=bool)
        groups = np.full(len(seen), -1, dtype=np.int32)
        seen[faces] = True
        shown = np.flatnonzero(seen[:-1])
        groups[shown] = 1000 * thing_of_face[shown] + _facets(solid.vertices[solid.faces[shown]])
        pixels, first = self._distinct(groups[faces])
        colours = np.full((len(faces), 3), FLOOR_VALUE, dtype=np.float32)
        own = pixels[faces[pixels] >= 0]
        if len(own):
            paint = linear(np.array([thing.colour for thing in things]))[thing_of_face[faces[own]]]
            glossy = np.array([thing.glossy for thing in things])[thing_of_face[faces[own]]]
            colours[own] = self._shaded(solid, faces[own], own, light, paint, glossy)
        ground = pixels[(faces[pixels] < 0) & (self._floor_nearness[pixels] > 0)]
        rays = viewing_rays(self.camera, self._fine, ground)
        places = self.camera.eye + rays / self._floor_nearness[ground, None]
        colours[ground] *= light.on_floor(places)[:, None]
        return _averaged(colours[first].reshape(self._fine[1], self._fine[0], 3))

    def _layer(self, hidden: FloatArray, surface: Surface, values: FloatArray) -> FloatArray:
        """Return the values (V, C) of a body's vertices where it is nearer than what hides it: (height, width, C)."""
        nearness, faces = self._nearest(surface)
        pixels = np.flatnonzero(nearness.ravel() > hidden)
        image = np.zeros((nearness.size, values.shape[1]), dtype=np.float32)
        image[pixels] = self._interpolated(surface, faces.ravel()[pixels], pixels, values)
        return np.clip(_averaged(image.reshape(self._fine[1], self._fine[0], -1)), 0.0, 1.0)

    def _distinct(self, groups: _Numbers) -> tuple[IntArray, _Numbers]:
        """Return subpixels that are alone in their group within their pixel, and for each subpixel its like there."""
        fine = groups.reshape(self._fine[1], self._fine[0])
        numbers = np.arange(groups.size, dtype=np.int32).reshape(fine.shape)
        first = numbers.copy()
        corners = [
            (slice(i, None, _SUBPIXELS), slice(j, None, _SUBPIXELS)) for i, j in np.ndindex(_SUBPIXELS, _SUBPIXELS)
        ]
        for k, one in enumerate(corners):
            for other in reversed(corners[:k]):
                first[one] = np.where(fine[one] == fine[other], numbers[other], first[one])
        return np.flatnonzero(first == numbers), first.ravel()

    def _interpolated(self, surface: Surface, faces: _Numbers, pixels: IntArray, values: FloatArray) -> FloatArray:
        """Return values (V, C) of vertices where the rays of pixels (P,) meet triangles (P,): (P, C)."""
        rays = viewing_rays(self.camera, self._fine, pixels)
        return interpolated(surface.vertices, surface.faces[faces], values, self.camera.eye, rays)

    def _shaded(
        self, solid: Surface, faces: _Numbers, pixels: IntArray, light: _Light, paint: FloatArray, glossy: FloatArray
    ) -> FloatArray:
        """Return the colours (P, 3) of triangles where pixels see them."""
        found = self._interpolated(solid, faces, pixels, np.hstack([solid.vertices, solid.normals]))
        places, normals = found[:, :3], found[:, 3:]
        to_eye = self.camera.eye - places
        to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
        normals *= np.where(np.einsum("ij,ij->i", normals, to_eye) < 0.0, -1.0, 1.0)[:, None]
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        brightness, key = light.on(places, normals)
        half = to_eye + self.camera.key_light()
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        facing = np.clip(np.einsum("ij,ij->i", normals, half), 0.0, 1.0)
        shine = np.where(glossy, _GLOSS * facing**_SHININESS * key, 0.0)
        return np.asarray(paint * brightness[:, None] + shine[:, None])


class _Light:
    """Sky and key light as many directions, each with a shadow map over the floor around points (P, 3) [m]."""

    def __init__(self, points: FloatArray, floor: float, key: FloatArray) -> None:
        self._floor = floor
        self._directions = np.vstack([_sky(), _cone(key)])
        shares = [_SKY_SHARE / _SKY_LIGHTS, (1.0 - _SKY_SHARE) / _KEY_LIGHTS]
        self._shares = np.repeat(shares, [_SKY_LIGHTS, _KEY_LIGHTS])
        points = points if len(points) else np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        reach = 0.8 * (high[2] - floor) + 0.05
        self._corner = low[:2] - reach
        self._texel = float((high[:2] - low[:2] + 2 * reach).max()) / _MAP
        self._slants = self._directions[:, :2] / self._directions[:, 2:] / self._texel
        # How high above the floor the highest thing is between each texel and a light
        self._maps = np.full((len(self._slants), _MAP, _MAP), -np.inf, dtype=np.float32)
        self._on_floor = np.ones((_MAP, _MAP))

    def behind(self, solid: Surface) -> _Light:
        """Return the light with the shadows of one more solid."""
        light, coarse = copy(self), solid.simplified(0.8 * self._texel)
        texels, heights = self._on_map(coarse.vertices)
        light._maps, owner = self._maps.copy(), np.empty((_MAP, _MAP), dtype=np.int32)
        for slant, heights_there in zip(self._slants, light._maps, strict=True):
            points = np.column_stack([texels - heights[:, None] * slant, heights])
            draw_triangles(points, coarse.faces, 0, heights_there, owner)
        shaded = _blurred(np.tensordot(self._shares, np.isfinite(light._maps), axes=1))
        light._on_floor = 1.0 - shaded * _fading(_MAP)
        return light

    def _on_map(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the texels (P, 2) under places (P, 3), and their heights (P,) above the floor."""
        return (places[:, :2] - self._corner) / self._texel, places[:, 2] - self._floor

    def on_floor(self, places: FloatArray) -> FloatArray:
        """Return the light (P,) on the floor at places (P, 3), 1 where it is open."""
        at = (places[:, :2] - self._corner) / self._texel
        base = np.floor(at).astype(np.intp)
        inside = ((base >= 0) & (base < _MAP - 1)).all(axis=1)
        light = np.ones(len(places))
        (x, y), (u, v) = base[inside].T, (at[inside] - base[inside]).T
        m, k = self._on_floor.ravel(), _MAP * y + x
        low = (1 - u) * m[k] + u * m[k + 1]
        high = (1 - u) * m[k + _MAP] + u * m[k + _MAP + 1]
        light[inside] = (1 - v) * low + v * high
        return light

    def on(self, places: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the light (P,) at places (P, 3) of surfaces with normals (P, 3), and the share of the key light."""
        texels, heights = self._on_map(places + 1.5 * self._texel * normals)
        sent = self._directions * (self._shares / self._directions[:, 2])[:, None]
        counted = np.repeat([0.0, 1.0 / _KEY_LIGHTS], [_SKY_LIGHTS, _KEY_LIGHTS])
        lights = np.column_stack([sent, counted])
        raised = np.column_stack([texels, heights])
        light, key = light_at(raised, normals, self._slants, lights, self._maps, self._texel)
        return light + _BOUNCE * (0.5 - 0.5 * normals[:, 2]), key


def _averaged(fine: NDArray[np.float32]) -> FloatArray:
    """Return the means (height, width, C) of all pixels from their subpixels."""
    parts = [fine[i::_SUBPIXELS, j::_SUBPIXELS] for i in range(_SUBPIXELS) for j in range(_SUBPIXELS)]
    return np.asarray(sum(parts) / len(parts), dtype=float)


def _facets(corners: FloatArray) -> IntArray:
    """Return a number in [0, 125) for each triangle (F, 3, 3) that tells its direction: edges are smoothed."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray((np.rint(2 * normals) + 2).astype(np.intp) @ np.array([25, 5, 1]))


def _sky() -> FloatArray:
    """Return directions (_SKY_LIGHTS, 3) of an even sky, denser where they light a floor more."""
    rank = np.arange(_SKY_LIGHTS) + 0.5
    radius, turn = np.sqrt(rank / _SKY_LIGHTS * (1.0 - _LOWEST**2)), rank * np.pi * (3.0 - np.sqrt(5.0))
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - radius**2)])


def _cone(axis: FloatArray) -> FloatArray:
    """Return directions (_KEY_LIGHTS, 3) evenly spread about an axis (3,)."""
    rank = np.arange(_KEY_LIGHTS) + 0.5
    tilt, turn = _KEY_RADIUS * np.sqrt(rank / _KEY_LIGHTS), rank * np.pi * (3.0 - np.sqrt(5.0))
    across = np.cross(axis, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    offset = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), np.cross(axis, across))
    return np.asarray(np.cos(tilt)[:, None] * axis + np.sin(tilt)[:, None] * offset)


def _fading(size: int) -> FloatArray:
    """Return weights (size, size) that go down to 0 at the edges, beyond which shadows are not known."""
    across = np.clip(np.minimum(np.arange(size), np.arange(size)[::-1]) / (_FADING * size), 0.0, 1.0)
    across = across * across * (3.0 - 2.0 * across)
    return np.asarray(np.minimum.outer(across, across))


def _blurred(image: FloatArray) -> FloatArray:
    """Return the means over squares of seven by seven pixels."""
    radius = 3
    for axis in (0, 1):
        padded = np.pad(image, [(radius + 1, radius) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        sums, width = np.cumsum(padded, axis=axis), 2 * radius + 1
        high = np.take(sums, np.arange(width, sums.shape[axis]), axis=axis)
        low = np.take(sums, np.arange(sums.shape[axis] - width), axis=axis)
        image = (high - low) / width
    return image


FLOOR_VALUE = 0.87  # linear; how bright the empty floor is in a picture


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


def nearest_triangles(
    points: FloatArray, faces: IntArray, width: int, height: int
) -> tuple[NDArray[np.float32], _Numbers]:
    """Return how near the nearest triangle is at each pixel (height, width), -inf beside all, and which it is, or -1.

    See `draw_triangles`.
    """
    nearness, owner = np.full((height, width), -np.inf, dtype=np.float32), np.full((height, width), -1, dtype=np.int32)
    draw_triangles(points, faces, 0, nearness, owner)
    return nearness, owner


@compiled
def draw_triangles(
    points: FloatArray, faces: IntArray, first: int, nearness: NDArray[np.float32], owner: _Numbers
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


@compiled
def interpolated(
    vertices: FloatArray, corners: IntArray, values: FloatArray, eye: FloatArray, rays: FloatArray
) -> FloatArray:
    """Return values (V, C) of vertices where rays (P, 3) from the eye meet triangles of corners (P, 3): (P, C).

    A ray that misses its triangle, as one through the edge may, has the values of the edge.
    """
    found = np.empty((len(rays), values.shape[1]))
    for p in range(len(rays)):
        i, j, k = corners[p, 0], corners[p, 1], corners[p, 2]
        rx, ry, rz = rays[p, 0], rays[p, 1], rays[p, 2]
        ax, ay, az = eye[0] - vertices[i, 0], eye[1] - vertices[i, 1], eye[2] - vertices[i, 2]
        ux, uy, uz = (vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2])
        vx, vy, vz = (vertices[k, 0] - vertices[i, 0], vertices[k, 1] - vertices[i, 1], vertices[k, 2] - vertices[i, 2])
        cx, cy, cz = ry * vz - rz * vy, rz * vx - rx * vz, rx * vy - ry * vx
        determinant = ux * cx + uy * cy + uz * cz
        if determinant == 0.0:
            determinant = 1.0
        u = min(max((ax * cx + ay * cy + az * cz) / determinant, 0.0), 1.0)
        v = rx * (ay * uz - az * uy) + ry * (az * ux - ax * uz) + rz * (ax * uy - ay * ux)
        v = min(max(v / determinant, 0.0), 1.0 - u)
        for c in range(values.shape[1]):
            found[p, c] = (1.0 - u - v) * values[i, c] + u * values[j, c] + v * values[k, c]
    return found


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

    Places (P, 3) are columns and rows of the texels under them, and heights above the floor [m]; slants (L, 2) how far
    aside each light is, per metre of height [texels/m]; directions (L, 4) towards each light, as long as it lights the
    open floor, and its share of what is counted. The maps (L, S, S) hold for each light how high above the floor [m]
    the highest thing is on the ray that ends in each texel; that shades what is lower by more than the tolerance.
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
