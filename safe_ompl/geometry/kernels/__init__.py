"""Compiled distances of convex bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.geometry.kernels.convex import BODY as BODY
    from safe_ompl.geometry.kernels.convex import POSE as POSE
    from safe_ompl.geometry.kernels.convex import Records as Records
    from safe_ompl.geometry.kernels.convex import Shapes as Shapes
    from safe_ompl.geometry.kernels.convex import begin_axis as begin_axis
    from safe_ompl.geometry.kernels.convex import distance_bounds as distance_bounds
    from safe_ompl.geometry.kernels.convex import extreme_vertices as extreme_vertices
    from safe_ompl.geometry.kernels.convex import from_box as from_box
    from safe_ompl.geometry.kernels.convex import nearest_in_simplex as nearest_in_simplex
    from safe_ompl.geometry.kernels.convex import place_bodies as place_bodies
    from safe_ompl.geometry.kernels.hull_gaps import Borne as Borne
    from safe_ompl.geometry.kernels.hull_gaps import CellFrames as CellFrames
    from safe_ompl.geometry.kernels.hull_gaps import Hulls as Hulls
    from safe_ompl.geometry.kernels.hull_gaps import Sets as Sets
    from safe_ompl.geometry.kernels.hull_gaps import cell_gaps as cell_gaps
    from safe_ompl.geometry.kernels.hull_gaps import chords_ahead as chords_ahead
    from safe_ompl.geometry.kernels.hull_gaps import gaps as gaps
    from safe_ompl.geometry.kernels.hull_gaps import separating_axes as separating_axes

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
