"""Animated pictures of robots in motion, side by side and from the same camera: WebP or GIF."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, SafeOmplError
from safe_ompl.view.content import Nearest, ViewerContent
from safe_ompl.view.pictures.path import TRACE, Image, trace
from safe_ompl.view.pictures.rasteriser import Renderer, tone_mapped
from safe_ompl.view.pictures.scene import DrawnScene, best_view
from safe_ompl.view.pictures.surface import ColouredSurface, obstacle_surfaces
from safe_ompl.view.style import NEUTRAL, as_bytes, mixed, planner_styles

ANIMATION_ENDINGS = (".webp", ".gif")
PANEL = (420, 380)
RATE = 12.5  # [Hz]
FEWEST_FRAMES = 40
_HEADING, _GUTTER = 46, 8  # [px] above panels, and between them
_REST = 1.2  # [s] that the last frame stays
_QUALITY = 80  # of WebP, from 0 to 100
_TINT = 0.45  # share of the planner's colour in its robot


def save_animation(content: ViewerContent, file: str | Path, *, rate: float = RATE) -> None:
    """Write the motions of what a view shows, side by side, as one animated picture.

    A motion in time is shown in real time, with the people and things that move meanwhile. Captions say the danger and
    how far people are; of a motion in time its speed and what bounds it.

    Parameters
    ----------
    content : ViewerContent
        What is shown.
    file : path-like
        Where the picture goes: .webp or .gif; missing folders are made.
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
    ending = Path(file).suffix.lower()
    if ending not in ANIMATION_ENDINGS:
        raise InputError(f"must end in {' or '.join(ANIMATION_ENDINGS)}, got {str(file)!r}", "animation")
    pillow = _pillow("Image")
    shares = np.linspace(0.0, 1.0, max(FEWEST_FRAMES, round(rate * content.playing_time) + 1))
    frames = _Frames(content, shares)
    captions = [_captions(content, name, way, shares) for name, way in frames.paths.items()]
    pages = [
        pillow.fromarray(_titled(frames.frame(k), [words[k] for words in captions], list(frames.paths)))
        for k in range(len(shares))
    ]
    duration = round(1e3 * content.playing_time / (len(shares) - 1))  # [ms] of a frame
    stays = [duration] * (len(shares) - 1) + [round(1e3 * _REST)]
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    options = {"quality": _QUALITY, "method": 5} if ending == ".webp" else {"optimize": True}
    pages[0].save(file, save_all=True, append_images=pages[1:], duration=stays, loop=0, **options)


class _Frames:
    """What all frames share: robot and scene, camera and light; `paths` holds (F, n) configurations by planner."""

    def __init__(self, content: ViewerContent, shares: FloatArray) -> None:
        self.paths = {name: content.along(name, shares) for name in content.paths}
        styles = planner_styles(self.paths)
        self._colours = [styles[name].colour for name in self.paths]
        self._drawn = DrawnScene(content.robot, content.scene_at_start, list(self.paths.values()))
        self._renderer = Renderer(self._drawn.floor, best_view(self._drawn, PANEL), PANEL)
        times = shares * content.playing_time
        movers = content.movers
        self._moving = [[] if movers is None else movers.obstacles_at(t, content.scene) for t in times]
        self._still = self._drawn.surroundings_without(
            {mover.name for there in self._moving for mover in there}
        )

    def frame(self, k: int) -> list[Image]:
        """Return the pictures of all paths in a frame."""
        moving = [surface for mover in self._moving[k] for surface in obstacle_surfaces(mover)]
        images = []
        for path, colour in zip(self.paths.values(), self._colours, strict=True):
            body = self._drawn.body.posed(path[k])
            robot = ColouredSurface(body, mixed(NEUTRAL, colour, _TINT), glossy=True)
            way = ColouredSurface(trace(self._drawn, path[: k + 1], TRACE), colour)
            images.append(as_bytes(tone_mapped(self._renderer.render([robot, way, *self._still, *moving]))))
        return images


def _titled(images: Sequence[Image], captions: Sequence[str], names: Sequence[str]) -> Image:
    """Return panels beside each other with name and caption above each."""
    pillow, draw, fonts = (_pillow(part) for part in ("Image", "ImageDraw", "ImageFont"))
    height, width = images[0].shape[:2]
    page = pillow.new("RGB", (len(images) * (width + _GUTTER) - _GUTTER, height + _HEADING), "white")
    pen = draw.Draw(page)
    for k, (image, caption, name) in enumerate(zip(images, captions, names, strict=True)):
        left = k * (width + _GUTTER)
        page.paste(pillow.fromarray(image), (left, _HEADING))
        pen.text((left + 2, 3), name, fill="black", font=fonts.load_default(16))
        pen.text((left + 2, 25), caption, fill=(90, 90, 90), font=fonts.load_default(13))
    return np.asarray(page)


def _pillow(part: str) -> Any:
    try:
        return import_module(f"PIL.{part}")
    except ImportError as missing:
        raise SafeOmplError("animations need Pillow: pip install 'safe-ompl[plots]'") from missing


def _captions(content: ViewerContent, name: str, way: FloatArray, shares: FloatArray) -> Sequence[str]:
    """Return what is written above each frame of one path."""
    if name in content.motions:
        return [content.motions[name].remark(float(share) * content.playing_time) for share in shares]
    field = content.danger_field
    dangers = None if field is None else field.values(way)
    nearest = Nearest(content.robot, [obstacle for obstacle in content.scene if obstacle.weight > 0])
    captions = []
    for k, q in enumerate(way):
        found = nearest.at(q)
        facts = [] if dangers is None else [f"danger {dangers[k]:.1f}"]
        facts += [] if found is None else [f"{1e3 * found.distance:.0f} mm to {found.obstacle}"]
        captions.append(", ".join(facts))
    return captions
