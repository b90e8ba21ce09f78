"""An exhibit as an animated picture, which needs no browser: WebP or GIF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError
from safe_ompl.pictures.render.animation import render_animation
from safe_ompl.viewer.clearance import Nearest
from safe_ompl.viewer.exhibit import Exhibit

RATE = 12.5  # [Hz]
_FEWEST = 40  # frames


def save_film(exhibit: Exhibit, file: str | Path, *, rate: float = RATE) -> None:
    """Write the motions of an exhibit, side by side, as one animated picture.

    A motion in time is shown in real time, with the people and things that move meanwhile. Captions say the danger and
    how far people are; of a motion in time its speed and what bounds it.

    Parameters
    ----------
    exhibit : Exhibit
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
    if not exhibit.paths:
        raise InputError("there is no path to show in motion")
    count = max(_FEWEST, round(rate * exhibit.playing_time) + 1)
    shares = np.linspace(0.0, 1.0, count)
    ways = {name: exhibit.along(name, shares) for name in exhibit.paths}
    captions = {name: _captions(exhibit, name, way, shares) for name, way in ways.items()}
    frames_per_second = (count - 1) / exhibit.playing_time
    movers = exhibit.movers
    there = (
        []
        if movers is None
        else [movers.obstacles_at(t, exhibit.scene) for t in shares * exhibit.playing_time]
    )
    render_animation(
        exhibit.robot,
        exhibit.staged,
        ways,
        file,
        rate=frames_per_second,
        captions=captions,
        movers=there,
    )


def _captions(exhibit: Exhibit, name: str, way: FloatArray, shares: FloatArray) -> Sequence[str]:
    if name in exhibit.motions:
        return [exhibit.motions[name].remark(float(share) * exhibit.playing_time) for share in shares]
    field = exhibit.danger_field
    dangers = None if field is None else field.values(way)
    nearest = Nearest(exhibit.robot, [obstacle for obstacle in exhibit.scene if obstacle.weight > 0])
    captions = []
    for k, q in enumerate(way):
        found = nearest.at(q)
        said = [] if dangers is None else [f"danger {dangers[k]:.1f}"]
        said += [] if found is None else [f"{1e3 * found.distance:.0f} mm to {found.obstacle}"]
        captions.append(", ".join(said))
    return captions
