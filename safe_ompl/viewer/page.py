"""A view as one HTML file that opens offline, with a play bar."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from safe_ompl.viewer.exhibit import Exhibit
from safe_ompl.viewer.view import View

_REST = 0.8  # [s] at the goal, before it begins again
_RATE = 25.0  # [Hz] of frames, where a motion has times
_FEWEST, _MOST = 97, 1501  # frames


def save_page(exhibit: Exhibit, file: str | Path, *, slice_at: float | None = None) -> None:
    """Write a view as one HTML file that needs no server and no network.

    Parameters
    ----------
    exhibit : Exhibit
        What is shown.
    file : path-like
        Where the page goes.
    slice_at : float, optional
        Height [m] of a level slice through the danger field, where there is one.

    Raises
    ------
    SafeOmplError
        If viser is not installed.
    """
    view = View(exhibit)
    try:
        for booth in view.booths:
            if slice_at is not None and booth.slice is not None:
                booth.slice.move("level", slice_at)
                booth.slice.show(True)
        view.go_to(0.0)
        recording = view.server.get_scene_serializer()
        if exhibit.paths:
            frames = (
                int(np.clip(_RATE * exhibit.playing_time, _FEWEST, _MOST)) if exhibit.motions else _FEWEST
            )
            for share in np.linspace(0.0, 1.0, frames)[1:]:
                recording.insert_sleep(exhibit.playing_time / (frames - 1))
                view.go_to(float(share))
            recording.insert_sleep(_REST)
        Path(file).write_text(recording.as_html(), encoding="utf-8")
    finally:
        view.stop()
