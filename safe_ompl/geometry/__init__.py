"""Geometry: poses, shapes, point clouds, hulls, and bounds of convex distances."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.geometry import surfaces as surfaces
    from safe_ompl.geometry.basic import Box as Box
    from safe_ompl.geometry.basic import Capsule as Capsule
    from safe_ompl.geometry.basic import Cylinder as Cylinder
    from safe_ompl.geometry.basic import Part as Part
    from safe_ompl.geometry.basic import Shape as Shape
    from safe_ompl.geometry.basic import Sphere as Sphere
    from safe_ompl.geometry.cloud import PointCloud as PointCloud
    from safe_ompl.geometry.mesh import Mesh as Mesh
    from safe_ompl.geometry.mesh import convex_hull as convex_hull
    from safe_ompl.geometry.obstacle import Obstacle as Obstacle
    from safe_ompl.geometry.obstacle import check_number as check_number
    from safe_ompl.geometry.person import LIMBS as LIMBS
    from safe_ompl.geometry.person import STANDING as STANDING
    from safe_ompl.geometry.person import Limb as Limb
    from safe_ompl.geometry.person import Person as Person
    from safe_ompl.geometry.pose import Pose as Pose
    from safe_ompl.geometry.pose import placed as placed
    from safe_ompl.geometry.surfaces import Triangles as Triangles

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
