"""Animated pictures of robots in motion, side by side and from the same camera: WebP or GIF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError, SafeOmplError
from safe_ompl.pictures.render.bodies import painted
from safe_ompl.pictures.render.camera import Camera
from safe_ompl.pictures.render.mitsuba_renderer import Painted, developed
from safe_ompl.pictures.render.path import Image
from safe_ompl.pictures.render.rasteriser import RasterStudio
from safe_ompl.pictures.render.stage import Stage
from safe_ompl.pictures.render.tessellation import Surface, tube
from safe_ompl.pictures.render.viewpoint import best_view
from safe_ompl.pictures.style import Colour, planner_styles

if TYPE_CHECKING:
    from safe_ompl.robot.robot import Robot
    from safe_ompl.scene.obstacle import Obstacle
    from safe_ompl.scene.scene import Scene

ENDINGS = (".webp", ".gif")
PANEL = (420, 380)
_TRACE = 0.006  # sizes of the robot's motion; radius of the trace of the tip
_DETAIL = 0.7  # pixels; what is smaller is not drawn
_HEADING, _GUTTER = 46, 8  # [px] above panels, and between them
_REST = 1.2  # [s] that the last frame stays
_QUALITY = 80  # of WebP, from 0 to 100
_BODY: Colour = (0.82, 0.83, 0.85)


def render_animation(
    robot: Robot,
    scene: Scene,
    motions: Mapping[str, FloatArray],
    file: str | Path,
    *,
    rate: float,
    captions: Mapping[str, Sequence[str]] | None = None,
    movers: Sequence[Sequence[Obstacle]] = (),
    panel: tuple[int, int] = PANEL,
    camera: Camera | None = None,
) -> None:
    """Draw robots as they move, one panel each, and save the picture as WebP or GIF.

    Parameters
    ----------
    robot : Robot
        Who moves.
    scene : Scene
        What stands around it, and what moves as it is at first: from there the camera is chosen.
    motions : mapping of str to (F, n) array
        Planner name → configurations, one for each frame [rad or m]; who is ready first waits.
    file : path-like
        Where the picture goes: .webp or .gif; missing folders are made.
    rate : float
        Frames per second.
    captions : mapping of str to sequence of str, optional
        Planner name → what to say in each of its frames.
    movers : sequence of sequences of Obstacle, optional
        For each frame the people and things that move, where they are then; they stand for those of the scene.
    panel : (int, int)
        Width and height of a panel [px].
    camera : Camera, optional
        Where from; by default the direction that shows most of robot and people on all paths.

    Raises
    ------
    InputError
        If there is no motion, one cannot be used, or the file has another ending.
    SafeOmplError
        If Pillow is not installed.
    """
    if not motions:
        raise InputError("no motion to draw; give at least one")
    if Path(file).suffix.lower() not in ENDINGS:
        raise InputError(f"must end in {' or '.join(ENDINGS)}, got {str(file)!r}", "animation")
    pillow = _pillow()
    ways = {name: finite_array(way, (None, robot.n), f"motion of {name}") for name, way in motions.items()}
    reel = _Reel(robot, scene, ways, panel, camera, movers)
    count = max(len(way) for way in ways.values())
    words = {name: list((captions or {}).get(name, ())) or [""] for name in ways}
    frames = [
        pillow.fromarray(
            _titled(images, [said[min(k, len(said) - 1)] for said in words.values()], list(ways))
        )
        for k, images in enumerate(reel.frames(count))
    ]
    stays = [round(1e3 / rate)] * (count - 1) + [round(1e3 * _REST)]
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    options = (
        {"quality": _QUALITY, "method": 5} if Path(file).suffix.lower() == ".webp" else {"optimize": True}
    )
    frames[0].save(file, save_all=True, append_images=frames[1:], duration=stays, loop=0, **options)


class _Reel:
    """All that frames share: scenery, links without what is smaller than a pixel, camera and light."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        ways: Mapping[str, FloatArray],
        panel: tuple[int, int],
        camera: Camera | None,
        movers: Sequence[Sequence[Obstacle]],
    ) -> None:
        self._ways = list(ways.values())
        styles = planner_styles(ways)
        self._colours = [styles[name].colour for name in ways]
        self._stage = Stage(robot, scene, self._ways)
        camera = best_view(self._stage, panel) if camera is None else camera
        self._studio = RasterStudio(self._stage.floor, camera, panel)
        detail = _DETAIL * camera.pixel(panel[1])
        self._stage.body.links = [link.simplified(detail) for link in self._stage.body.links]
        self._radius = _TRACE * self._stage.size
        self._tips = [self._stage.trace(way) for way in self._ways]
        self._movers = movers
        self._still = self._stage.props_without({mover.name for there in movers for mover in there})

    def frames(self, count: int) -> Iterator[list[Image]]:
        """Yield for each frame the pictures of all motions."""
        for k in range(count):
            props = self._props(k)
            yield [self._frame(way, tips, colour, props, k) for way, tips, colour in self._all()]

    def _props(self, k: int) -> list[Painted]:
        """Return all but the robot in a frame."""
        there = self._movers[min(k, len(self._movers) - 1)] if self._movers else ()
        return self._still + [thing for mover in there for thing in painted(mover)]

    def _all(self) -> Iterator[tuple[FloatArray, FloatArray, Colour]]:
        return zip(self._ways, self._tips, self._colours, strict=True)

    def _frame(
        self, way: FloatArray, tips: FloatArray, colour: Colour, props: Sequence[Painted], k: int
    ) -> Image:
        k = min(k, len(way) - 1)
        trace = Surface.from_triangles(*tube(tips[: k + 1], self._radius))
        body = Painted(
            self._stage.body.posed(way[k]),
            tuple(0.55 * np.array(_BODY) + 0.45 * np.array(colour)),
            glossy=True,
        )
        picture = developed(self._studio.photograph([body, Painted(trace, colour), *props]))
        return np.asarray(np.round(255.0 * np.clip(picture, 0.0, 1.0)), dtype=np.uint8)


def _titled(images: Sequence[Image], captions: Sequence[str], names: Sequence[str]) -> Image:
    """Return panels beside each other with name and caption above each."""
    pillow, draw, fonts = _pillow(), import_module("PIL.ImageDraw"), import_module("PIL.ImageFont")
    height, width = images[0].shape[:2]
    page = pillow.new("RGB", (len(images) * (width + _GUTTER) - _GUTTER, height + _HEADING), "white")
    pen = draw.Draw(page)
    for k, (image, caption, name) in enumerate(zip(images, captions, names, strict=True)):
        left = k * (width + _GUTTER)
        page.paste(pillow.fromarray(image), (left, _HEADING))
        pen.text((left + 2, 3), name, fill="black", font=fonts.load_default(16))
        pen.text((left + 2, 25), caption, fill=(90, 90, 90), font=fonts.load_default(13))
    return np.asarray(page)


def _pillow() -> Any:
    try:
        return import_module("PIL.Image")
    except ImportError as missing:
        raise SafeOmplError("animations need Pillow: pip install 'safe-ompl[plots]'") from missing
