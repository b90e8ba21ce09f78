"""The light in a picture: a soft sky and a key light, as many directions with a shadow map each."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.drawing.rasteriser import Numbers, draw_triangles, meets
from safe_ompl.drawing.surfaces import Surface

FLOOR_VALUE = 0.87  # linear; how bright the empty floor is in a picture
SUBPIXELS = 2  # along each side of a pixel
_SKY_SHARE = 0.55  # of the light on the open floor; the key light gives the rest
_SKY_LIGHTS, _KEY_LIGHTS = 24, 8
_KEY_RADIUS = 0.12  # [rad]
_LOWEST = 0.3  # sine of the elevation of the lowest light
_MAP = 256  # texels along each side of a shadow map
_FADING = 0.12  # share of its sides
_BOUNCE = 0.22  # light from the floor on what looks down
_GLOSS, _SHININESS = 0.16, 60.0


class Light(NamedTuple):
    """L lights, and their shadow maps on the floor.

    A map holds how high above the floor [m] the highest thing is on the ray of its light that ends in each texel; that
    shades what is lower by more than a texel.
    """

    floor: float  # Its height [m]
    corner: FloatArray  # (2,), of the maps [m]
    texel: float  # [m]
    slants: FloatArray  # (L, 2), how far aside each light is, per metre of height [texels/m]
    lights: FloatArray  # (L, 4), towards each light, as long as it lights the open floor; its share of the key light
    maps: NDArray[np.float32]  # (L, S, S)
    on_floor: FloatArray  # (S, S), the light there, 1 where it is open

    @classmethod
    def around(cls, points: FloatArray, floor: float, key: FloatArray) -> Light:
        """Return the light on nothing but a floor, with maps that hold shadows of what is around points (P, 3) [m]."""
        directions = np.vstack([_sky(), _cone(key)])
        shares = [_SKY_SHARE / _SKY_LIGHTS, (1.0 - _SKY_SHARE) / _KEY_LIGHTS]
        points = points if len(points) else np.zeros((1, 3))
        low, high = points.min(axis=0), points.max(axis=0)
        reach = 0.8 * (high[2] - floor) + 0.05
        texel = float((high[:2] - low[:2] + 2 * reach).max()) / _MAP
        sent = directions * (np.repeat(shares, [_SKY_LIGHTS, _KEY_LIGHTS]) / directions[:, 2])[:, None]
        counted = np.repeat([0.0, 1.0 / _KEY_LIGHTS], [_SKY_LIGHTS, _KEY_LIGHTS])
        slants, lights = directions[:, :2] / directions[:, 2:] / texel, np.column_stack([sent, counted])
        maps = np.full((len(directions), _MAP, _MAP), -np.inf, dtype=np.float32)
        return cls(floor, low[:2] - reach, texel, slants, lights, maps, np.ones((_MAP, _MAP)))

    def behind(self, solid: Surface) -> Light:
        """Return the light with the shadows of one more solid."""
        coarse = solid.simplified(0.8 * self.texel)
        texels, heights = (coarse.vertices[:, :2] - self.corner) / self.texel, coarse.vertices[:, 2] - self.floor
        maps, owner = self.maps.copy(), np.empty((_MAP, _MAP), dtype=np.int32)
        for slant, there in zip(self.slants, maps, strict=True):
            points = np.column_stack([texels - heights[:, None] * slant, heights])
            draw_triangles(points, coarse.faces, 0, there, owner)
        shaded = _blurred(np.tensordot(self.lights[:, 2], np.isfinite(maps), axes=1))
        rank = np.arange(_MAP)  # at the edges, beyond which shadows are not known, they go down to 0
        across = np.clip(np.minimum(rank, rank[::-1]) / (_FADING * _MAP), 0.0, 1.0)
        across = across * across * (3.0 - 2.0 * across)
        return self._replace(maps=maps, on_floor=1.0 - shaded * np.minimum.outer(across, across))


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


class Painted(NamedTuple):
    """Triangles of several things."""

    vertices: FloatArray  # (V, 3) [m]
    normals: FloatArray  # (V, 3)
    faces: IntArray  # (F, 3)
    owners: IntArray  # (F,), which thing each is of
    paint: FloatArray  # (T, 4), of each thing its linear RGB, and 1 if it is glossy, or 0


class View(NamedTuple):
    """What a camera sees of light."""

    eye: FloatArray  # (3,) [m]
    axes: FloatArray  # (3, 3), rows: to the right and up in the picture, and back
    scale: float  # of a subpixel, per metre of depth
    key: FloatArray  # (3,), the unit vector to the key light


@part
def _light_at(place: FloatArray, normal: FloatArray, light: Light) -> tuple[float, float]:
    """Return the light that a surface receives at a place (3,), and the share of the key light that it sees."""
    size = light.maps.shape[1]
    height = place[2] + 1.5 * light.texel * normal[2] - light.floor
    x = (place[0] + 1.5 * light.texel * normal[0] - light.corner[0]) / light.texel
    y = (place[1] + 1.5 * light.texel * normal[1] - light.corner[1]) / light.texel
    found, counted = _BOUNCE * (0.5 - 0.5 * normal[2]), 0.0
    for k in range(len(light.slants)):
        column, row = round(x - height * light.slants[k, 0]), round(y - height * light.slants[k, 1])
        inside = 0 <= column < size and 0 <= row < size
        if not (inside and light.maps[k, row, column] > height + light.texel):
            towards = light.lights[k]
            found += max(normal[0] * towards[0] + normal[1] * towards[1] + normal[2] * towards[2], 0.0)
            counted += towards[3]
    return found, counted


@part
def _on_floor(x: float, y: float, light: Light) -> float:
    """Return the light on the floor at a place."""
    x, y = (x - light.corner[0]) / light.texel, (y - light.corner[1]) / light.texel
    column, row, known = int(np.floor(x)), int(np.floor(y)), light.on_floor
    if not (0 <= column < len(known) - 1 and 0 <= row < len(known) - 1):
        return 1.0
    u, v = x - column, y - row
    low = (1 - u) * known[row, column] + u * known[row, column + 1]
    high = (1 - u) * known[row + 1, column] + u * known[row + 1, column + 1]
    return float((1 - v) * low + v * high)


@part
def _facet(solid: Painted, face: int) -> int:
    """Return a number that tells the thing of a triangle and roughly its direction: edges between them are smoothed."""
    a, b, c = solid.faces[face, 0], solid.faces[face, 1], solid.faces[face, 2]
    points = solid.vertices
    ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = max(sqrt(x * x + y * y + z * z), 1e-12)
    side = 25 * round(2 * x / length) + 5 * round(2 * y / length) + round(2 * z / length)
    return int(1000 * solid.owners[face] + side + 62)


@part
def _shade(
    solid: Painted, face: int, light: Light, view: View, ray: FloatArray, spare: FloatArray, colour: FloatArray
) -> None:
    """Write the colour (3,) of a triangle where a ray meets it; `spare: (3, 3)` is written, too."""
    place, normal, to_eye = spare[0], spare[1], spare[2]
    a, b, c = solid.faces[face, 0], solid.faces[face, 1], solid.faces[face, 2]
    u, v = meets(solid.vertices, solid.faces[face], view.eye, ray)
    for k in range(3):
        place[k] = (1.0 - u - v) * solid.vertices[a, k] + u * solid.vertices[b, k] + v * solid.vertices[c, k]
        normal[k] = (1.0 - u - v) * solid.normals[a, k] + u * solid.normals[b, k] + v * solid.normals[c, k]
        to_eye[k] = view.eye[k] - place[k]
    _scale(to_eye, 1.0)
    towards = normal[0] * to_eye[0] + normal[1] * to_eye[1] + normal[2] * to_eye[2]
    _scale(normal, -1.0 if towards < 0.0 else 1.0)
    brightness, key = _light_at(place, normal, light)
    for k in range(3):
        to_eye[k] += view.key[k]
    _scale(to_eye, 1.0)
    facing = min(max(normal[0] * to_eye[0] + normal[1] * to_eye[1] + normal[2] * to_eye[2], 0.0), 1.0)
    paint = solid.paint[solid.owners[face]]
    for k in range(3):
        colour[k] = paint[k] * brightness + paint[3] * _GLOSS * facing**_SHININESS * key


@part
def _scale(vector: FloatArray, length: float) -> None:
    """Give a vector (3,) a length; a negative one turns it."""
    scale = length / max(sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2), 1e-9)
    for k in range(3):
        vector[k] *= scale


@compiled
def shaded(faces: Numbers, floor_nearness: FloatArray, solid: Painted, light: Light, view: View) -> FloatArray:
    """Return a picture in linear RGB (height, width, 3) of a solid on a floor.

    Subpixels (H, W) see triangles, or the floor where that is -1 and 1/depth of the floor is positive. Of those of one
    pixel that see the same thing from the same side only the first is shaded.
    """
    height, width = faces.shape
    picture = np.zeros((height // SUBPIXELS, width // SUBPIXELS, 3))
    groups, colours = np.empty(SUBPIXELS**2, dtype=np.int64), np.empty((SUBPIXELS**2, 3))
    ray, spare = np.empty(3), np.empty((3, 3))
    for row in range(picture.shape[0]):
        for column in range(picture.shape[1]):
            for s in range(SUBPIXELS**2):
                i, j = SUBPIXELS * row + s // SUBPIXELS, SUBPIXELS * column + s % SUBPIXELS
                face, alike = faces[i, j], -1
                groups[s] = _facet(solid, face) if face >= 0 else -1
                for other in range(s):
                    if groups[other] == groups[s]:
                        alike = other
                        break
                if alike >= 0:
                    colours[s] = colours[alike]
                else:
                    x, y = view.scale * (j - (width - 1) / 2), view.scale * ((height - 1) / 2 - i)
                    for k in range(3):
                        ray[k] = x * view.axes[0, k] + y * view.axes[1, k] - view.axes[2, k]
                    if face >= 0:
                        _shade(solid, face, light, view, ray, spare, colours[s])
                    else:
                        colours[s] = FLOOR_VALUE
                        if floor_nearness[i, j] > 0.0:
                            depth = 1.0 / floor_nearness[i, j]
                            colours[s] *= _on_floor(view.eye[0] + depth * ray[0], view.eye[1] + depth * ray[1], light)
                for k in range(3):
                    picture[row, column, k] += colours[s, k] / SUBPIXELS**2
    return picture
