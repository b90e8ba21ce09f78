"""Convex bodies as the kernels of distance bounds take them, made from coal's geometries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry.kernels import BODY, Records, extreme_vertices
from safe_ompl.robot.reach import bounding_hull

_FEW = 12  # vertices that are quicker looked at one by one
_GRIDS = ((100, 4), (1000, 8), (np.inf, 12))  # cells by the number of vertices
_COARSE = 2  # cells in which many vertices are thinned first
_MANY, _MOST = 1000, 20_000  # vertices: from here on thinned first, and from here on only their box

_FARTHEST = 1e6  # [m] from the origin: beyond are shapes without end
_POINT = np.zeros((1, 3))


@dataclass(frozen=True)
class ConvexBodies:
    """Convex bodies that hold the bodies of a geometry model, in its order; exact where these are convex.

    Attributes
    ----------
    bodies : structured array (G,)
        The bodies, of type `BODY` (`safe_ompl.geometry.kernels.convex`).
    starts, vertices : ndarray, shape (C + 1,), (E, 3)
        Lists of their vertices.
    bounded : bool
        Whether all of them are finite: no plane, no half space.
    """

    bodies: Records
    starts: IntArray
    vertices: FloatArray
    bounded: bool

    @classmethod
    def of(cls, parts: Sequence[pin.GeometryObject]) -> ConvexBodies:
        """Return the bodies of a geometry model."""
        bodies = np.zeros(len(parts), BODY)
        starts, lists, bounded = [np.zeros(1, dtype=np.intp)], [np.zeros((0, 3))], True
        cells = entries = 0
        for body, part in zip(bodies, parts, strict=True):
            summands = _summands(part.geometry)
            bounded &= summands.bounded
            grid, own_starts, own_vertices = _listed(summands.vertices)
            if summands.bounded:
                _fill(body, part, summands)
            body["grid"], body["first_cell"] = grid, cells
            starts.append(own_starts[1:] + entries)
            lists.append(own_vertices)
            cells, entries = cells + len(own_starts) - 1, entries + len(own_vertices)
        return cls(bodies, np.concatenate(starts), np.concatenate(lists), bounded)

    def joined(self, others: ConvexBodies) -> ConvexBodies:
        """Return these bodies and, after them, others."""
        moved = others.bodies.copy()
        moved["first_cell"] += len(self.starts) - 1
        return ConvexBodies(
            np.concatenate([self.bodies, moved]),
            np.concatenate([self.starts, others.starts[1:] + len(self.vertices)]),
            np.concatenate([self.vertices, others.vertices]),
            self.bounded and others.bounded,
        )


@dataclass(frozen=True)
class _Summands:
    """The parts whose Minkowski sum is a convex body: vertices (V, 3), box (3,), disc and ball."""

    vertices: FloatArray
    box: FloatArray
    disc: float = 0.0
    ball: float = 0.0

    @property
    def bounded(self) -> bool:
        return bool(np.isfinite(self.vertices).all() and np.abs(self.vertices).max(initial=0.0) < _FARTHEST)


def _summands(geometry: coal.CollisionGeometry) -> _Summands:
    swept = float(geometry.getSweptSphereRadius()) if isinstance(geometry, coal.ShapeBase) else 0.0
    if isinstance(geometry, coal.Box):
        return _Summands(_POINT, np.array(geometry.halfSide, dtype=np.float64).ravel(), ball=swept)
    if isinstance(geometry, coal.Sphere):
        return _Summands(_POINT, np.zeros(3), ball=geometry.radius + swept)
    if isinstance(geometry, coal.Capsule):
        along = np.array([0.0, 0.0, geometry.halfLength])
        return _Summands(_POINT, along, ball=geometry.radius + swept)
    if isinstance(geometry, coal.Cylinder):
        along = np.array([0.0, 0.0, geometry.halfLength])
        return _Summands(_POINT, along, disc=geometry.radius, ball=swept)
    with np.errstate(over="ignore"):  # of planes
        hull = bounding_hull(geometry)
    if len(hull.points) > _MOST:
        hull = bounding_hull(geometry, coarse=True)
    return _Summands(hull.points, np.zeros(3), ball=hull.radius + swept)


def _fill(body: Records, part: pin.GeometryObject, summands: _Summands) -> None:
    """Write everything but the lists of vertices."""
    vertices, box, disc, ball = summands.vertices, summands.box, summands.disc, summands.ball
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2
    rim = np.hypot(np.hypot(box[0], box[1]) + disc, box[2])  # of box and disc
    body["joint"] = part.parentJoint
    body["rotation"], body["translation"] = part.placement.rotation, part.placement.translation
    body["box"], body["disc"], body["ball"] = box, disc, ball
    body["centre"] = centre
    body["extent"] = (high - low) / 2 + box + (disc, disc, 0.0) + ball
    body["reach"] = np.linalg.norm(vertices - centre, axis=1).max() + rim + ball


def _listed(vertices: FloatArray) -> tuple[int, IntArray, FloatArray]:
    """Return the grid of a body, and its vertices as lists for each cell."""
    if len(vertices) <= _FEW:
        return 0, np.array([0, len(vertices)], dtype=np.intp), vertices
    if len(vertices) > _MANY:
        vertices = vertices[np.unique(extreme_vertices(vertices, _COARSE)[1])]
    grid = next(grid for most, grid in _GRIDS if len(vertices) <= most)
    starts, found = extreme_vertices(vertices, grid)
    return grid, starts, vertices[found]
