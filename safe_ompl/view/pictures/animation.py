"""Animated pictures of robots in motion, side by side and from the same camera: WebP or GIF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError, SafeOmplError
from safe_ompl.view.annotations import Nearest
from safe_ompl.view.content import ViewerContent
from safe_ompl.view.pictures.bodies import obstacle_surfaces
from safe_ompl.view.pictures.camera import Camera
from safe_ompl.view.pictures.path import Image
from safe_ompl.view.pictures.rasteriser import Renderer, tone_mapped
from safe_ompl.view.pictures.scene import DrawnScene, best_view
from safe_ompl.view.pictures.surface import ColouredSurface, Surface, tube
from safe_ompl.view.style import Colour, planner_styles

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
    reel = _Frames(robot, scene, ways, panel, camera, movers)
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


class _Frames:
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
        self._drawn = DrawnScene(robot, scene, self._ways)
        camera = best_view(self._drawn, panel) if camera is None else camera
        self._renderer = Renderer(self._drawn.floor, camera, panel)
        detail = _DETAIL * camera.pixel(panel[1])
        self._drawn.body.links = [link.simplified(detail) for link in self._drawn.body.links]
        self._radius = _TRACE * self._drawn.size
        self._tips = [self._drawn.trace(way) for way in self._ways]
        self._movers = movers
        self._still = self._drawn.surroundings_without({mover.name for there in movers for mover in there})

    def frames(self, count: int) -> Iterator[list[Image]]:
        """Yield for each frame the pictures of all motions."""
        for k in range(count):
            surroundings = self._surroundings(k)
            yield [self._frame(way, tips, colour, surroundings, k) for way, tips, colour in self._all()]

    def _surroundings(self, k: int) -> list[ColouredSurface]:
        """Return all but the robot in a frame."""
        there = self._movers[min(k, len(self._movers) - 1)] if self._movers else ()
        return self._still + [thing for mover in there for thing in obstacle_surfaces(mover)]

    def _all(self) -> Iterator[tuple[FloatArray, FloatArray, Colour]]:
        return zip(self._ways, self._tips, self._colours, strict=True)

    def _frame(
        self, way: FloatArray, tips: FloatArray, colour: Colour, surroundings: Sequence[ColouredSurface], k: int
    ) -> Image:
        k = min(k, len(way) - 1)
        trace = Surface.from_triangles(*tube(tips[: k + 1], self._radius))
        body = ColouredSurface(
            self._drawn.body.posed(way[k]),
            tuple(0.55 * np.array(_BODY) + 0.45 * np.array(colour)),
            glossy=True,
        )
        picture = tone_mapped(self._renderer.render([body, ColouredSurface(trace, colour), *surroundings]))
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


RATE = 12.5  # [Hz]
_FEWEST = 40  # frames


def save_animation(content: ViewerContent, file: str | Path, *, rate: float = RATE) -> None:
    """Write the motions of an content, side by side, as one animated picture.

    A motion in time is shown in real time, with the people and things that move meanwhile. Captions say the danger and
    how far people are; of a motion in time its speed and what bounds it.

    Parameters
    ----------
    content : ViewerContent
        What is shown.
    file : path-like
        .webp or .gif.
    rate : float
        Frames per second.

    Raises
    ------
    InputError
        If there is no path, or the file has another ending.
    SafeOmplError
        If Pillow is not installed.
    """
    if not content.paths:
        raise InputError("there is no path to show in motion")
    count = max(_FEWEST, round(rate * content.playing_time) + 1)
    shares = np.linspace(0.0, 1.0, count)
    ways = {name: content.along(name, shares) for name in content.paths}
    captions = {name: _captions(content, name, way, shares) for name, way in ways.items()}
    frames_per_second = (count - 1) / content.playing_time
    movers = content.movers
    there = (
        []
        if movers is None
        else [movers.obstacles_at(t, content.scene) for t in shares * content.playing_time]
    )
    render_animation(
        content.robot,
        content.scene_at_start,
        ways,
        file,
        rate=frames_per_second,
        captions=captions,
        movers=there,
    )


def _captions(content: ViewerContent, name: str, way: FloatArray, shares: FloatArray) -> Sequence[str]:
    if name in content.motions:
        return [content.motions[name].remark(float(share) * content.playing_time) for share in shares]
    field = content.danger_field
    dangers = None if field is None else field.values(way)
    nearest = Nearest(content.robot, [obstacle for obstacle in content.scene if obstacle.weight > 0])
    captions = []
    for k, q in enumerate(way):
        found = nearest.at(q)
        said = [] if dangers is None else [f"danger {dangers[k]:.1f}"]
        said += [] if found is None else [f"{1e3 * found.distance:.0f} mm to {found.obstacle}"]
        captions.append(", ".join(said))
    return captions
