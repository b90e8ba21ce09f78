"""The light of a picture: a soft sky and a key light, sampled by directions with one shadow map each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray
from safe_ompl.drawing.rendering import draw_triangles
from safe_ompl.drawing.surfaces import Surface

# The share of the sky in the light on the open floor. The rest is the key light.
_SKY_SHARE = 0.55
_SKY_LIGHTS, _KEY_LIGHTS = 24, 8
_KEY_RADIUS = 0.12  # [rad]
# The sine of the elevation of the lowest light.
_LOWEST = 0.3
# The number of texels along each side of a shadow map.
_MAP = 256
_FADING = 0.12  # share of its sides


class Light(NamedTuple):
    """L lights, and their shadow maps on the floor.

    A texel of a map holds the height above the floor [m] of the highest object on the light ray that ends in the texel.
    Points lower than this by more than a texel are in the shadow.
    """

    floor: float  # Its height [m]
    # A corner of the maps (2,) [m].
    corner: FloatArray
    texel: float  # [m]
    # The horizontal displacement of each light per metre of height (L, 2) [texels/m].
    slants: FloatArray
    # The directions to the lights, with lengths that are their shares of the floor's light, and shares of the key light
    # (L, 4).
    lights: FloatArray
    maps: NDArray[np.float32]  # (L, S, S)
    # The light on the floor, 1 where nothing covers it (S, S).
    on_floor: FloatArray

    @classmethod
    def around(cls, points: FloatArray, floor: float, key: FloatArray) -> Light:
        """Return the light on an empty floor, with shadow maps for the region around points (P, 3) [m]."""
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
        """Return the light with the shadows of an additional solid."""
        coarse = solid.simplified(0.8 * self.texel)
        texels, heights = (coarse.vertices[:, :2] - self.corner) / self.texel, coarse.vertices[:, 2] - self.floor
        maps, owner = self.maps.copy(), np.empty((_MAP, _MAP), dtype=np.int32)
        for slant, there in zip(self.slants, maps, strict=True):
            points = np.column_stack([texels - heights[:, None] * slant, heights])
            draw_triangles(points, coarse.faces, 0, there, owner)
        shaded = _blurred(np.tensordot(self.lights[:, 2], np.isfinite(maps), axes=1))
        # Shadows are not known beyond the edges, so they fade to 0 there.
        rank = np.arange(_MAP)
        across = np.clip(np.minimum(rank, rank[::-1]) / (_FADING * _MAP), 0.0, 1.0)
        across = across * across * (3.0 - 2.0 * across)
        return self._replace(maps=maps, on_floor=1.0 - shaded * np.minimum.outer(across, across))


def _sky() -> FloatArray:
    """Return directions (_SKY_LIGHTS, 3) of a uniform sky, distributed by their share of the floor's light."""
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
