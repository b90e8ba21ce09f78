"""Compiled distances of convex bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.geometry.kernels.convex import (
        BODY,
        POSE,
        Records,
        Shapes,
        begin_axis,
        distance_bounds,
        extreme_vertices,
        from_box,
        nearest_in_simplex,
        place_bodies,
    )
    from safe_ompl.geometry.kernels.hull_gaps import (
        Borne,
        CellFrames,
        Hulls,
        Sets,
        cell_gaps,
        chords_ahead,
        gaps,
        separating_axes,
    )

__all__ = [
    "BODY",
    "POSE",
    "Borne",
    "CellFrames",
    "Hulls",
    "Records",
    "Sets",
    "Shapes",
    "begin_axis",
    "cell_gaps",
    "chords_ahead",
    "distance_bounds",
    "extreme_vertices",
    "from_box",
    "gaps",
    "nearest_in_simplex",
    "place_bodies",
    "separating_axes",
]

__getattr__, __dir__ = lazily(__name__, __file__)
