"""Geometry: poses, shapes, point clouds, hulls, and bounds of convex distances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.geometry import surfaces
    from safe_ompl.geometry.cloud import PointCloud
    from safe_ompl.geometry.hulls import (
        ConvexBodies,
        Hull,
        bounding_box,
        bounding_hull,
        convex_hull,
        hull_planes,
        triangle_tree,
    )
    from safe_ompl.geometry.obstacle import Obstacle, check_number
    from safe_ompl.geometry.person import LIMBS, STANDING, Limb, Person
    from safe_ompl.geometry.pose import Pose, PoseLike, placed
    from safe_ompl.geometry.shapes import Box, Capsule, Cylinder, Mesh, Part, Shape, Sphere
    from safe_ompl.geometry.surfaces import Triangles

__all__ = [
    "LIMBS",
    "STANDING",
    "Box",
    "Capsule",
    "ConvexBodies",
    "Cylinder",
    "Hull",
    "Limb",
    "Mesh",
    "Obstacle",
    "Part",
    "Person",
    "PointCloud",
    "Pose",
    "PoseLike",
    "Shape",
    "Sphere",
    "Triangles",
    "bounding_box",
    "bounding_hull",
    "check_number",
    "convex_hull",
    "hull_planes",
    "placed",
    "surfaces",
    "triangle_tree",
]

__getattr__, __dir__ = lazily(__name__, __file__)
