"""Pictures of a robot that moves along a path among obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray
from safe_ompl.view.pictures.camera import Camera
from safe_ompl.view.pictures.rasteriser import Renderer, tone_mapped
from safe_ompl.view.pictures.scene import DrawnScene, best_view, resampled
from safe_ompl.view.pictures.surface import ColouredSurface, Surface, tube
from safe_ompl.view.style import Colour, as_bytes, mixed

if TYPE_CHECKING:
    from safe_ompl.robot import Robot
    from safe_ompl.scene import Scene

Image = NDArray[np.uint8]
"""Rows of pixels in sRGB: (height, width, 3)."""

ACCENT: Colour = (0.09, 0.42, 0.78)
START: Colour = (0.66, 0.67, 0.69)
_COINCIDENCE = 1e-3  # sizes of the robot's motion by which bodies that share a place are told apart
TRACE, _THIN = (
    0.006,
    0.0022,
)  # sizes of the robot's motion; radius of the trace of the tip, and of the planned one
GHOSTS = 4
PALE: Colour = (1.0, 1.0, 1.0)
_FIRST_TINT = 0.35  # share of the accent colour in the first posture after the start


@dataclass(frozen=True)
class DrawnPath:
    """A path, and how it is drawn.

    Parameters
    ----------
    path : (N, n) array
        Way points [rad or m]; between them the joints move on straight lines.
    planned : (N', n) array, optional
        The path before it was simplified; the way of its tip is drawn as a thin line.
    closest : float, optional
        Where along the path, as a fraction of its length, the robot is closest to an obstacle: this posture
        will be among those shown.
    accent : Colour, optional
        Colour of the goal posture and of the trace of the tip.
    subtitle : str
        What to write under the name, for example "mean danger 3.9, closest 12 mm".
    """

    path: FloatArray
    planned: FloatArray | None = None
    closest: float | None = None
    accent: Colour | None = None
    subtitle: str = ""


def render_path(
    robot: Robot,
    scene: Scene,
    path: FloatArray | DrawnPath,
    *,
    size: tuple[int, int] = (900, 700),
    camera: Camera | None = None,
    ghosts: int = GHOSTS,
    danger_points: bool = False,
) -> Image:
    """Draw a robot along a path: start in grey, goal in the accent colour, translucent postures between.

    Parameters
    ----------
    robot : Robot
        Who moves.
    scene : Scene
        What stands around it.
    path : (N, n) array or DrawnPath
        Way points [rad or m]; between them the joints move on straight lines.
    size : (int, int)
        Width and height [px].
    camera : Camera, optional
        Where from; by default the direction that shows most of robot and people.
    ghosts : int
        How many postures are shown between start and goal.
    danger_points : bool
        Whether the scene's danger points are drawn.

    Returns
    -------
    (height, width, 3) array of uint8
        sRGB.

    Raises
    ------
    InputError
        If a path is empty, has the wrong number of joints or is not finite.
    """
    shown = path if isinstance(path, DrawnPath) else DrawnPath(path)
    drawn = DrawnScene(robot, scene, [shown.path], danger_points=danger_points)
    renderer = Renderer(drawn.floor, camera or best_view(drawn, size), size)
    return draw(drawn, renderer, shown, ghosts)


def choose_camera(
    robot: Robot,
    scene: Scene,
    paths: Mapping[str, FloatArray],
    *,
    size: tuple[int, int] = (900, 700),
    azimuth: float | None = None,
    elevation: float | None = None,
) -> Camera:
    """Return the camera that shows all paths best.

    Parameters
    ----------
    robot : Robot
        Who moves.
    scene : Scene
        What stands around it.
    paths : mapping of str to (N, n) array
        What must be in view.
    size : (int, int)
        Width and height of the picture [px].
    azimuth, elevation : float, optional
        Direction from the scene to the camera [rad]: about z from the x axis, and above the floor. What is
        not given is chosen; a robot that moves in a level plane is seen from above.
    """
    return best_view(DrawnScene(robot, scene, list(paths.values())), size, azimuth, elevation)


def moments(count: int, closest: float | None) -> FloatArray:
    """Return `count` fractions of a path, evenly spaced but for the one that gives way to `closest`."""
    even = np.linspace(0.0, 1.0, count + 2)[1:-1]
    if closest is not None and count:
        even[np.argmin(np.abs(even - closest))] = closest
    return even


def draw(drawn: DrawnScene, renderer: Renderer, shown: DrawnPath, ghosts: int) -> Image:
    """Return the picture of one path of a scene with so many translucent postures, see `render_path`."""
    samples, accent = resampled(drawn.robot, shown.path), shown.accent or ACCENT
    start, goal = samples[0], samples[-1]
    gap = _COINCIDENCE * drawn.size
    things = [
        ColouredSurface(drawn.body.posed(start), START, glossy=True),
        ColouredSurface(drawn.body.posed(goal, moved_from=start).inflated(gap), accent, glossy=True),
        ColouredSurface(trace(drawn, samples, TRACE), accent),
        *drawn.surroundings,
    ]
    if shown.planned is not None:
        planned = resampled(drawn.robot, shown.planned)
        things.append(ColouredSurface(trace(drawn, planned, _THIN), mixed(accent, PALE, 0.35)))
    shares = moments(ghosts, shown.closest)
    postures = [samples[round(share * (len(samples) - 1))] for share in shares]
    bodies = [drawn.body.posed(q, moved_from=start).inflated(-2.0 * gap) for q in postures]
    linear, layers = renderer.render_layers(things, [(body, _glass(body, renderer)) for body in bodies])
    picture = tone_mapped(linear)
    for share, layer in zip(shares, layers, strict=True):
        weight = _FIRST_TINT + (1.0 - _FIRST_TINT) * share
        tint = (1.0 - weight) * np.array(START) + weight * np.array(accent)
        picture = picture * (1.0 - layer[..., :1]) + tint * layer[..., 1:]
    return as_bytes(picture)


def trace(drawn: DrawnScene, samples: FloatArray, width: float) -> Surface:
    """Return the way of the tip as a tube; its radius is a share of the size of the robot's motion."""
    return Surface.from_triangles(*tube(drawn.trace(samples), width * drawn.size))


def _glass(body: Surface, renderer: Renderer) -> FloatArray:
    """Return the opacity of a glass body at its vertices, and its brightness times opacity: (V, 2)."""
    to_eye = renderer.camera.eye - body.vertices
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    facing = np.einsum("ij,ij->i", to_eye, body.normals)
    lit = np.clip((body.normals * np.sign(facing)[:, None]) @ renderer.light_direction(), 0.0, 1.0)
    opacity = 0.34 + 0.45 * (1.0 - np.abs(facing)) ** 3
    return np.column_stack([opacity, opacity * (0.72 + 0.44 * lit)])
