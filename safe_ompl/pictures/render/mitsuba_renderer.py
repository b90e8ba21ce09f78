"""Ray-traced pictures of coloured surfaces with Mitsuba 3; the only module that imports it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError, SafeOmplError
from safe_ompl.pictures.render.camera import Camera
from safe_ompl.pictures.render.tessellation import Surface
from safe_ompl.pictures.style import Colour

FLOOR_VALUE = 0.87  # linear; how bright the empty floor is in a picture
_SKY_SHARE = 0.60  # of the light on the floor; the key light gives the rest
_KEY_RADIUS = 0.16  # [rad]; the wider the key light, the softer the shadows
_KEY_LIGHTS = 64
_HORIZON = 100.0  # [m] to the edge of the floor
_BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}


@dataclass(frozen=True)
class Painted:
    """A surface with a colour.

    Parameters
    ----------
    surface : Surface
        What is drawn.
    colour : Colour
        Its own colour.
    glossy : bool
        Whether a coat of clear lacquer covers the colour.
    """

    surface: Surface
    colour: Colour
    glossy: bool = False


class Studio:
    """An endless light floor under a soft sky, and a camera.

    Parameters
    ----------
    floor : float
        Height of the floor [m].
    camera : Camera
        Where pictures are taken from; the key light comes from over its left shoulder.
    size : (int, int)
        Width and height of pictures [px].
    samples : int
        Light paths per pixel.

    Raises
    ------
    InputError
        If there are no samples.
    """

    def __init__(self, floor: float, camera: Camera, size: tuple[int, int], samples: int) -> None:
        if samples < 1:
            raise InputError(f"a picture needs at least 1 sample per pixel; got {samples}")
        self.camera, self.size, self.samples = camera, size, samples
        square = np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
        corners = _HORIZON * square + camera.target * (1.0, 1.0, 0.0) + (0.0, 0.0, floor)
        self._floor = Surface(corners, np.tile((0.0, 0.0, 1.0), (4, 1)), np.array([(0, 1, 2), (0, 2, 3)]))

    def photograph(self, things: Sequence[Painted]) -> FloatArray:
        """Return a picture of things on the floor: (height, width, 3), linear RGB."""
        with _mitsuba() as mi:
            scene = self._scene(mi, {"type": "path", "max_depth": 3, "hide_emitters": True})
            scene |= self._lights()
            matt = {"type": "diffuse", "reflectance": {"type": "rgb", "value": FLOOR_VALUE}}
            scene["floor"] = _mitsuba_mesh(mi, self._floor, {"bsdf": matt})
            for i, thing in enumerate(things):
                if len(thing.surface.faces):
                    scene[f"thing{i}"] = _mitsuba_mesh(mi, thing.surface, {"bsdf": _paint(thing)})
            image = np.array(mi.render(mi.load_dict(scene), spp=self.samples), dtype=float)
        return image[..., :3] + (1.0 - image[..., 3:]) * FLOOR_VALUE

    def layers(
        self, solid: Surface, bodies: Iterable[tuple[Surface, FloatArray]], samples: int = 4
    ) -> list[FloatArray]:
        """Return what is seen of each body alone, unlit, in the values of its vertices: (height, width, 3).

        Parameters
        ----------
        solid : Surface
            What may hide a body.
        bodies : iterable of (Surface, (V, 3) array)
            What may be seen, with three values in [0, 1] per vertex.
        samples : int
            Rays per pixel.
        """
        images = []
        with _mitsuba() as mi:
            integrator = {"type": "path", "max_depth": 1}
            wall = _mitsuba_mesh(mi, solid, {"bsdf": _BLACK})
            for surface, values in bodies:
                scene = self._scene(mi, integrator) | {"wall": wall}
                scene["body"] = _glowing(mi, surface, values, self.camera.eye)
                image = np.array(mi.render(mi.load_dict(scene), spp=samples), dtype=float)
                images.append(np.clip(image[..., :3], 0.0, 1.0))
        return images

    def light_direction(self) -> FloatArray:
        """Return the unit vector (3,) to the key light."""
        return self.camera.key_light()

    def _lights(self) -> dict[str, Any]:
        """Return an even sky and a wide key light, which together light the open floor with radiance 1.

        The key light is many far ones. The renderer aims at these, and finds the sky by scattering: then
        there is no noise but that of partial shadows.
        """
        sky = {"type": "constant", "radiance": {"type": "rgb", "value": _SKY_SHARE}, "sampling_weight": 0.0}
        rays: dict[str, Any] = {}
        for i, towards in enumerate(_cone(self.light_direction())):
            irradiance = float(np.pi * (1.0 - _SKY_SHARE) / _KEY_LIGHTS / towards[2])
            rays[f"key{i}"] = {
                "type": "directional",
                "direction": (-towards).tolist(),
                "irradiance": {"type": "rgb", "value": irradiance},
            }
        return {"sky": sky, **rays}

    def _scene(self, mi: Any, integrator: dict[str, Any]) -> dict[str, Any]:
        eye, target, up = (v.tolist() for v in (self.camera.eye, self.camera.target, self.camera.up))
        film = {
            "type": "hdrfilm",
            "width": self.size[0],
            "height": self.size[1],
            "pixel_format": "rgba",
            "rfilter": {"type": "gaussian"},
        }
        sensor = {
            "type": "perspective",
            "fov_axis": "y",
            "fov": float(np.degrees(self.camera.field_of_view)),
            "to_world": mi.ScalarTransform4f().look_at(eye, target, up),
            "sampler": {"type": "multijitter"},
            "film": film,
        }
        return {"type": "scene", "integrator": integrator, "sensor": sensor}


@contextmanager
def _mitsuba() -> Iterator[Any]:
    """Mitsuba in its scalar variant, which needs no display, GPU or LLVM; then the caller's settings."""
    try:
        import mitsuba as module
    except ImportError as missing:
        raise SafeOmplError("3-D pictures need Mitsuba: pip install 'safe-ompl[plots]'") from missing
    mitsuba: Any = module
    before = mitsuba.variant()
    mitsuba.set_variant("scalar_rgb")
    logger = mitsuba.logger()
    level = logger.log_level()
    logger.set_log_level(mitsuba.LogLevel.Error)  # it warns of sample counts, and of needle-shaped triangles
    try:
        yield mitsuba
    finally:
        logger.set_log_level(level)
        if before is not None:
            mitsuba.set_variant(before)


def _cone(axis: FloatArray) -> FloatArray:
    """Directions (_KEY_LIGHTS, 3) evenly spread (on a sunflower spiral) about an axis (3,)."""
    rank = np.arange(_KEY_LIGHTS) + 0.5
    tilt, turn = _KEY_RADIUS * np.sqrt(rank / _KEY_LIGHTS), rank * np.pi * (3.0 - np.sqrt(5.0))
    across = np.cross(axis, (0.0, 0.0, 1.0))
    across = across / np.linalg.norm(across)
    offset = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), np.cross(axis, across))
    return np.asarray(np.cos(tilt)[:, None] * axis + np.sin(tilt)[:, None] * offset)


def _paint(thing: Painted) -> dict[str, Any]:
    colour = {"type": "rgb", "value": linear(np.array(thing.colour)).tolist()}
    if not thing.glossy:
        return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": colour}}
    coat = {"type": "roughplastic", "diffuse_reflectance": colour, "alpha": 0.3, "int_ior": 1.4}
    return {"type": "twosided", "bsdf": coat}


def _glowing(mi: Any, surface: Surface, values: FloatArray, eye: FloatArray) -> Any:
    """Mesh that shines at the eye with the values of its vertices, whichever way its triangles turn."""
    shine = {"type": "area", "radiance": {"type": "mesh_attribute", "name": "vertex_value"}}
    facing = Surface(surface.vertices, eye - surface.vertices, surface.faces)
    return _mitsuba_mesh(mi, facing, {"bsdf": _BLACK, "emitter": shine}, values)


def _mitsuba_mesh(mi: Any, surface: Surface, looks: dict[str, Any], values: FloatArray | None = None) -> Any:
    properties = mi.Properties()
    for name, plugin in looks.items():
        properties[name] = mi.load_dict(plugin)
    mesh = mi.Mesh("surface", len(surface.vertices), len(surface.faces), properties, has_vertex_normals=True)
    if values is not None:
        mesh.add_attribute("vertex_value", 3, np.asarray(values, dtype=np.float32).ravel())
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = surface.vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = surface.normals.astype(np.float32).ravel()
    parameters["faces"] = surface.faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def linear(srgb: FloatArray) -> FloatArray:
    """Return the linear RGB of sRGB values in [0, 1]."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def developed(linear_rgb: FloatArray) -> FloatArray:
    """Return the sRGB values in [0, 1] of linear RGB, highlights softened rather than clipped."""
    knee = FLOOR_VALUE
    over = np.clip(linear_rgb - knee, 0.0, None)
    soft = np.minimum(linear_rgb, knee) + (1.0 - knee) * (1.0 - np.exp(-over / (1.0 - knee)))
    soft = np.clip(soft, 0.0, 1.0)
    return np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * soft ** (1 / 2.4) - 0.055)
