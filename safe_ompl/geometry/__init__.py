"""Geometry: poses, shapes, point clouds, hulls, and bounds of convex distances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.geometry import surfaces as surfaces
    from safe_ompl.geometry.cells import Voxels as Voxels
    from safe_ompl.geometry.cloud import PointCloud as PointCloud
    from safe_ompl.geometry.hulls import (
        DISTANCE_ERROR as DISTANCE_ERROR,
        ConvexBodies as ConvexBodies,
        Hull as Hull,
        bounding_box as bounding_box,
        bounding_hull as bounding_hull,
        convex_hull as convex_hull,
        hull_planes as hull_planes,
        triangle_tree as triangle_tree,
    )
    from safe_ompl.geometry.meshes import MeshFrame as MeshFrame, check_mesh as check_mesh
    from safe_ompl.geometry.obstacle import Obstacle as Obstacle, check_number as check_number
    from safe_ompl.geometry.person import LIMBS as LIMBS, STANDING as STANDING, Limb as Limb, Person as Person
    from safe_ompl.geometry.pose import (
        LONGEST as LONGEST,
        Pose as Pose,
        PoseLike as PoseLike,
        placed as placed,
        rotation_vectors as rotation_vectors,
        turn_between as turn_between,
        turn_onto as turn_onto,
    )
    from safe_ompl.geometry.shapes import (
        Box as Box,
        Capsule as Capsule,
        Cylinder as Cylinder,
        Mesh as Mesh,
        Part as Part,
        Shape as Shape,
        Sphere as Sphere,
    )
    from safe_ompl.geometry.surfaces import Triangles as Triangles

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
