"""Convex bodies: hulls of meshes, bounding hulls of other bodies, and tables of bodies for compiled code."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import sqrt
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, halton_point
from safe_ompl.geometry.cells import Voxels
from safe_ompl.geometry.convex import BODY, NODE, Records, ShapeTable, extreme_vertices
from safe_ompl.geometry.pose import LONGEST

_log = logging.getLogger(__name__)

# Maximal error of coal's iterative distances.
DISTANCE_ERROR = 1e-5  # [m]
# Corners are moved randomly by this share of the body's size, so that coplanar corners leave their plane.
_JITTER = 1e-6
# Hulls are enlarged by this share against rounding.
_HULL_GROWTH = 1e-9
# Vertices count as coplanar if they spread by at most this along the normal.
_IN_PLANE = 1e-9  # [m]
# Numbers of directions that select the corners of increasingly coarse hulls.
_CORNERS = (2000, 1000, 500, 250, 120)


def triangle_tree(vertices: FloatArray, faces: IntArray) -> coal.BVHModelOBBRSS:
    """Return triangles as a bounding volume hierarchy: a hollow surface, of which only the triangles collide."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices))
    tree.addTriangles(np.ascontiguousarray(faces, dtype=np.int64))
    tree.endModel()
    tree.computeLocalAABB()
    return tree


def convex_hull(mesh: coal.BVHModelBase, name: str, thickness: float = 0.0) -> coal.ConvexBase:
    """Return the convex hull of a triangle mesh, or a slightly larger body if coal does not support the hull.

    Flat meshes get a `thickness` [m], with the vertices in the middle. Raises InputError if the mesh has no vertices or
    vertices that are not finite, or is flat without a thickness (coal's managers drop flat shapes without an error).

    coal refuses a hull in which a corner has more than 254 neighbours, such as the tip of a cone. Then the hull of
    fewer or slightly moved corners is enlarged about its centre until it contains all vertices of the mesh, and this is
    checked. For a body K with the origin inside and faces n·x ≤ d, s·K contains x exactly if n·x ≤ s·d for each face.
    """
    vertices = np.asarray(mesh.vertices(), dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise InputError(f"mesh of {name!r} has vertices that are not finite")
    if np.abs(vertices).max(initial=0.0) > LONGEST:
        raise InputError(f"mesh of {name!r} reaches {np.abs(vertices).max():g} m, {LONGEST:g} m is the limit")
    if not len(vertices):
        raise InputError(f"mesh of {name!r} has no vertices")
    thin = _thin_directions(vertices)
    if thin.any():
        if not thickness:
            raise InputError(f"mesh of {name!r} is flat (no volume); collision meshes must be solid")
        for half in thickness / 2 * thin[thin.any(axis=1)]:
            vertices = np.vstack([vertices - half, vertices + half])
        mesh = _points(vertices)
        vertices = np.asarray(mesh.vertices(), dtype=np.float64)
        _log.info("mesh of %s is flat: its hull is %g mm thick", name, 1e3 * thickness)
    try:
        mesh.buildConvexHull(True, "Qt")
    except RuntimeError as error:
        if "Too many neighbors" not in str(error):
            raise InputError(f"mesh of {name!r} has no convex hull ({' '.join(str(error).split())})") from None
        return _slightly_larger_hull(vertices, name)
    return mesh.convex


def _thin_directions(vertices: FloatArray) -> FloatArray:
    """Return unit vectors (3, 3) of the principal directions in which vertices have no extent; other rows are zero."""
    spread = np.vstack([vertices - vertices.mean(axis=0), np.zeros((3, 3))])
    _, extents, directions = np.linalg.svd(spread, full_matrices=False)
    return np.where((extents < _IN_PLANE)[:, None], directions, 0.0)


def _slightly_larger_hull(vertices: FloatArray, name: str) -> coal.Convex:
    """Return a slightly larger convex body with all `vertices: (V, 3)`, and at most 254 neighbours per corner."""
    middle = vertices.mean(axis=0)
    # This centre is well inside the body even if most vertices are at one place.
    center = middle + _extreme(vertices - middle, _CORNERS[-1]).mean(axis=0)
    points = vertices - center
    for corners in _choices(points):
        hull = _hull_or_none(corners)
        if hull is None:
            continue
        reach, offsets = _reaches(hull, points)
        if offsets.min() <= 0:
            continue
        factor = max(1.0, float((reach / offsets).max())) * (1 + _HULL_GROWTH)
        grown = _hull_or_none(factor * np.array(hull.points()) + center)
        if grown is not None and np.subtract(*_reaches(grown, vertices)).max() <= 0.0:
            growth = (factor - 1) * float(np.linalg.norm(points, axis=1).max())
            _log.info("hull of %s: %d corners, at most %.3g mm larger", name, grown.num_points, 1e3 * growth)
            return grown
    raise InputError(f"mesh of {name!r}: its convex hull has a corner with more than 254 neighbours; simplify it")


def _choices(points: FloatArray) -> Iterator[FloatArray]:
    """Yield candidate sets of corners for the hull, the most exact first. The sets are deterministic."""
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, points.shape)
    jitter = _JITTER * np.ptp(points, axis=0).max() * noise
    yield points + jitter
    for count in _CORNERS:
        corners = _extreme(points, count)
        yield corners
        yield corners + jitter[: len(corners)]


def _extreme(points: FloatArray, count: int) -> FloatArray:
    """Return the extreme points in `count` directions, which are uniform after the points are scaled to unit variance.

    The directions are Halton points mapped to the sphere.
    """
    round_points = points @ np.linalg.inv(np.linalg.cholesky(points.T @ points / len(points))).T
    uv = np.array([halton_point(k + 1, 2) for k in range(count)])
    height, angle = 2 * uv[:, 0] - 1, 2 * np.pi * uv[:, 1]
    radius = np.sqrt(1 - height**2)
    directions = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return points[sorted({int((round_points @ direction).argmax()) for direction in directions})]


def _points(points: FloatArray) -> coal.BVHModelBase:
    """Return a mesh with the points as vertices, from which coal builds hulls."""
    return triangle_tree(points, np.array([[0, 1, 2]]))


def _hull_or_none(points: FloatArray) -> coal.Convex | None:
    tree = _points(points)
    try:
        tree.buildConvexHull(True, "Qt")
    except RuntimeError:
        # A corner of the hull has too many neighbours, or the hull is too flat for Qhull.
        return None
    return tree.convex


def hull_planes(hull: coal.Convex) -> tuple[FloatArray, FloatArray]:
    """Return outward unit normals (F, 3) and offsets (F,) [m] of the planes of a hull's faces: n·x ≤ d inside."""
    corners = np.array(hull.points())
    triangles = np.array([[hull.polygons(k)[i] for i in range(3)] for k in range(hull.num_polygons)])
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    # The normal of a sliver triangle is not reliable.
    thick = lengths > 1e-12 * lengths.max()
    normals = normals[thick] / lengths[thick, None]
    offsets = np.einsum("fc,fc->f", normals, a[thick])
    inward = offsets < normals @ corners.mean(axis=0)
    normals[inward], offsets[inward] = -normals[inward], -offsets[inward]
    return normals, offsets


def _reaches(hull: coal.Convex, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the maximal n·x (F,) of points for the face normals n of a hull, and the offsets (F,) of the faces [m]."""
    normals, offsets = hull_planes(hull)
    chunks = np.array_split(points, 1 + len(points) // 1000)
    return np.max([(normals @ chunk.T).max(axis=1) for chunk in chunks], axis=0), offsets


# For up to this many vertices, a linear search is quicker than lists of extreme vertices.
_FEW = 12
# Pairs of a number of vertices and the cells along a side of the cube of directions, for up to this many vertices.
_GRIDS = ((100, 4), (1000, 8), (np.inf, 12))
# Large sets of vertices are first reduced to the extreme vertices of this grid.
_COARSE = 2
# Above the first number, vertices are reduced first. Above the second, they are replaced by their bounding box.
_MANY, _MOST = 1000, 20_000

# A shape with vertices farther from the origin than this counts as infinite.
_FARTHEST = 1e6  # [m]
_POINT, _NO_BOX, _ACROSS = np.zeros((1, 3)), (0.0, 0.0, 0.0), (1.0, 1.0, 0.0)
_BOX_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)


@dataclass(frozen=True, eq=False, repr=False)
class Hull:
    """Points (P, 3) [m] whose convex hull, enlarged by `radius` [m], contains a body."""

    points: FloatArray
    radius: float

    def moved(self, placement: pin.SE3) -> Hull:
        """Return the hull transformed by `placement`."""
        return Hull(self.points @ placement.rotation.T + placement.translation, self.radius)


def bounding_hull(geometry: coal.CollisionGeometry, *, coarse: bool = False) -> Hull:
    """Return a hull that contains `geometry`, in the frame of the geometry.

    The hull is exact for spheres, capsules, boxes and meshes. Other shapes, and meshes if `coarse`, get the eight
    corners of their bounding box.
    """
    if isinstance(geometry, coal.Sphere):
        return Hull(np.zeros((1, 3)), geometry.radius)
    if isinstance(geometry, coal.Capsule):
        ends = np.array([[0.0, 0.0, -geometry.halfLength], [0.0, 0.0, geometry.halfLength]])
        return Hull(ends, geometry.radius)
    if isinstance(geometry, (coal.ConvexBase, coal.BVHModelBase)) and not coarse:
        vertices = geometry.points() if isinstance(geometry, coal.ConvexBase) else geometry.vertices()
        return Hull(np.array(vertices, dtype=np.float64).reshape(-1, 3), 0.0)
    box = bounding_box(geometry)
    return Hull(box[:3] + _BOX_CORNERS * box[3:], 0.0)


def bounding_box(geometry: coal.CollisionGeometry) -> FloatArray:
    """Return the bounding box (6,) of `geometry` in its own frame: centre and half sides [m]."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    low, high = box.min_, box.max_
    return np.concatenate([high + low, high - low], dtype=np.float64) / 2


# Cells count as exact if the rounding of coal's trees is below this.
_EXACT = 2e-6  # [m]
_NO_NODES = np.zeros(0, NODE)


@dataclass(frozen=True, eq=False, repr=False)
class ConvexBodies:
    """Convex bodies that contain the G bodies of a geometry model, in its order; `exact: (G,)`: which equal them.

    `starts: (C + 1,)` and `vertices: (E, 3)` are lists of vertices for compiled code. The first list contains only the
    origin, and most bodies use this list. `bounded` is false if a body is infinite (a plane or half space).

    Bodies may be `solids` of cells, by index. After `joined`, `nodes` has the trees of their cells, and each level of a
    tree adds one cell as a body after all others.
    """

    bodies: Records
    starts: IntArray
    vertices: FloatArray
    bounded: bool
    exact: BoolArray
    solids: Mapping[int, Voxels] = field(default_factory=dict)
    nodes: Records = field(default_factory=lambda: _NO_NODES)

    @cached_property
    def table(self) -> ShapeTable:
        """The table of the bodies for compiled code."""
        return ShapeTable(self.bodies, self.starts, self.vertices, self.nodes)

    @classmethod
    def of(cls, parts: Sequence[Any]) -> ConvexBodies:
        """Convert the bodies of a geometry model (`pin.GeometryObject`), or parts of shapes (`Part`)."""
        bodies, known = np.zeros(len(parts), BODY), [_summands(part.geometry) for part in parts]
        if parts:
            # Parts of shapes have no joint. Their placement is in the world.
            bodies["joint"] = [getattr(part, "parentJoint", 0) for part in parts]
            bodies["rotation"] = [part.placement.rotation for part in parts]
            bodies["translation"] = [part.placement.translation for part in parts]
            box, disc, ball, span = (
                np.array(column, dtype=np.float64) for column in list(zip(*known, strict=True))[1:5]
            )
            bodies["box"], bodies["disc"], bodies["ball"] = box, disc, ball
            low, high = span[:, :3], span[:, 3:6]
            bodies["centre"] = (low + high) / 2
            bodies["extent"] = (high - low) / 2 + box + disc[:, None] * _ACROSS + ball[:, None]
            bodies["reach"] = span[:, 6] + np.hypot(np.hypot(box[:, 0], box[:, 1]) + disc, box[:, 2]) + ball
        starts, lists = [0, 1], [_POINT]
        for k in [k for k, summands in enumerate(known) if summands.vertices is not _POINT]:
            grid, own_starts, own_vertices = _listed(known[k].vertices)
            bodies[k]["grid"], bodies[k]["first_cell"] = grid, len(starts) - 1
            starts += [first + starts[-1] for first in own_starts[1:]]
            lists.append(own_vertices)
        bounded = bool(np.isfinite(bodies["reach"]).all())
        exact = np.array([summands.exact for summands in known], dtype=bool)
        solids = {k: cells for k, part in enumerate(parts) if (cells := getattr(part, "cells", None))}
        exact[[k for k, cells in solids.items() if cells.rounding < _EXACT]] = True
        return cls(bodies, np.array(starts, dtype=np.intp), np.concatenate(lists), bounded, exact, solids)

    def joined(self, others: ConvexBodies) -> ConvexBodies:
        """Return these bodies followed by `others`. None of these may be a solid of cells."""
        bodies = _in_a_row([self.bodies, others.bodies])
        starts, vertices = self.starts, self.vertices
        if len(others.vertices) > 1:
            bodies["first_cell"][len(self.bodies) :] += np.where(others.bodies["first_cell"] > 0, len(starts) - 2, 0)
            starts = np.concatenate([starts, others.starts[2:] + (len(vertices) - 1)])
            vertices = np.concatenate([vertices, others.vertices[1:]])
        exact, nodes, cells = np.concatenate([self.exact, others.exact]), [_NO_NODES], [bodies]
        for k, solid in others.solids.items():
            body, sides = bodies[len(self.bodies) + k], solid.half_sides
            levels = np.repeat(body, len(sides))
            levels["box"] = levels["extent"] = sides[:, None]
            levels["reach"] = sqrt(3) * sides
            levels["centre"], levels["grid"], levels["first_cell"] = 0.0, 0, 0
            body["levels"], body["root"] = sum(map(len, cells)), sum(map(len, nodes))
            nodes.append(solid.tree)
            cells.append(levels)
        return ConvexBodies(
            _in_a_row(cells), starts, vertices, self.bounded and others.bounded, exact, {}, _in_a_row(nodes)
        )


def _in_a_row(tables: Sequence[Records]) -> Records:
    """Return the records of tables of one type, one table after the other, in new memory."""
    # NumPy copies records field by field, which takes eight times as long as copying their bytes.
    return np.concatenate([table.view(np.uint8) for table in tables]).view(tables[0].dtype)


class _Summands(NamedTuple):
    """Parts whose Minkowski sum contains a body, or equals it if `exact`: vertices (V, 3), box (3,), disc and ball.

    The `span` (7,) has the minimal and maximal coordinates of the vertices, and the radius of a ball that contains
    them [m].
    """

    vertices: FloatArray
    box: ArrayLike
    disc: float = 0.0
    ball: float = 0.0
    span: ArrayLike = (0.0,) * 7
    exact: bool = True


def _summands(geometry: coal.CollisionGeometry) -> _Summands:
    ball = float(geometry.getSweptSphereRadius()) if isinstance(geometry, coal.ShapeBase) else 0.0
    if isinstance(geometry, coal.Box):
        return _Summands(_POINT, np.ravel(geometry.halfSide), 0.0, ball)
    if isinstance(geometry, coal.Sphere):
        return _Summands(_POINT, _NO_BOX, 0.0, geometry.radius + ball)
    if isinstance(geometry, coal.Capsule):
        return _Summands(_POINT, (0.0, 0.0, geometry.halfLength), 0.0, geometry.radius + ball)
    if isinstance(geometry, coal.Cylinder):
        return _Summands(_POINT, (0.0, 0.0, geometry.halfLength), geometry.radius, ball)
    # The bounding box of a plane overflows.
    with np.errstate(over="ignore"):
        hull = bounding_hull(geometry)
    few = len(hull.points) <= _MOST
    if not few:
        hull = bounding_hull(geometry, coarse=True)
    exact, span = few and isinstance(geometry, coal.ConvexBase), (*_NO_BOX, *_NO_BOX, np.inf)
    if np.isfinite(hull.points).all() and np.abs(hull.points).max(initial=0.0) < _FARTHEST:
        low, high = hull.points.min(axis=0), hull.points.max(axis=0)
        span = (*low, *high, np.linalg.norm(hull.points - (low + high) / 2, axis=1).max())
    return _Summands(hull.points, _NO_BOX, 0.0, hull.radius + ball, span, exact)


def _listed(vertices: FloatArray) -> tuple[int, list[int], FloatArray]:
    """Return the grid size of a body, and its lists of extreme vertices per cell of directions."""
    if len(vertices) <= _FEW:
        return 0, [0, len(vertices)], vertices
    if len(vertices) > _MANY:
        vertices = vertices[np.unique(extreme_vertices(vertices, _COARSE)[1])]
    grid = next(grid for most, grid in _GRIDS if len(vertices) <= most)
    starts, found = extreme_vertices(vertices, grid)
    return grid, starts.tolist(), vertices[found]
