"""Convex hulls of meshes."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.errors import InputError
from safe_ompl.robot.enclosing_hull import enclosing_hull


def convex_hull(mesh: coal.BVHModelBase, name: str) -> coal.ConvexBase:
    """Return the convex hull of a triangle mesh; a hardly larger body where coal cannot keep the hull itself.

    Raises
    ------
    InputError
        If the mesh is flat: coal's managers drop such shapes in silence; or has vertices that are not finite.
    """
    vertices = np.asarray(mesh.vertices(), dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise InputError(f"mesh of {name!r} has vertices that are not finite")
    spread = vertices - vertices.mean(axis=0) if len(vertices) else np.zeros((1, 3))
    if len(vertices) < 4 or np.linalg.matrix_rank(spread, tol=1e-9) < 3:
        raise InputError(f"mesh of {name!r} is flat (no volume); collision meshes must be solid")
    try:
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError as error:
        if "Too many neighbors" not in str(error):
            raise InputError(
                f"mesh of {name!r} has no convex hull ({' '.join(str(error).split())})"
            ) from None
        return enclosing_hull(vertices, name)
    return mesh.convex


def make_convex(geometry: pin.GeometryModel) -> None:
    """Replace every mesh of `geometry` by its convex hull, in place."""
    for part in geometry.geometryObjects:
        if isinstance(part.geometry, coal.BVHModelBase):
            part.geometry = convex_hull(part.geometry, part.name)
