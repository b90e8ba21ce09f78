"""Compiled distances of convex bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.geometry.kernels.boxes_and_capsules import near_boxes
    from safe_ompl.geometry.kernels.convex import (
        BODY,
        POSE,
        Records,
        begin_axis,
        distance_bounds,
        from_box,
        place_bodies,
    )
    from safe_ompl.geometry.kernels.hull_gaps import cell_gaps, gaps
    from safe_ompl.geometry.kernels.vertex_grids import extreme_vertices

__all__ = [
    "BODY",
    "POSE",
    "Records",
    "begin_axis",
    "cell_gaps",
    "distance_bounds",
    "extreme_vertices",
    "from_box",
    "gaps",
    "near_boxes",
    "place_bodies",
]

__getattr__, __dir__ = lazily(__name__, __file__)
