"""Triangles and shading normals of coal shapes and of tubes.

trimesh has meshes and primitives, too, but none of coal's shapes, and it would be one more dependency for 100 lines.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray
from safe_ompl.geometry import Triangles, surfaces
from safe_ompl.view.style import Colour

_AROUND = 32  # facets around a round shape
_SMOOTH_GROUPS = 4  # of triangles at one vertex
_SAME_PLACE, _SAME_DIRECTION = 1e-6, 1e-3  # [m], and of unit vectors


@dataclass(frozen=True)
class Surface:
    """Triangles with a shading normal per vertex.

    Parameters
    ----------
    vertices : (V, 3) array
        Positions [m].
    normals : (V, 3) array
        Unit normals.
    faces : (F, 3) array
        Vertex indices of each triangle.
    """

    vertices: FloatArray
    normals: FloatArray
    faces: IntArray

    @classmethod
    def from_triangles(cls, vertices: FloatArray, faces: IntArray, crease: float = 0.6) -> Surface:
        """Return a surface with smooth shading, except across edges that bend more than `crease` [rad]."""
        vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.intp)
        _, welded = _distinct_rows(np.round(vertices / _SAME_PLACE))
        normals, places = _corner_normals(vertices, faces, welded, np.cos(crease)), faces.reshape(-1)
        kept, index = _distinct_rows(np.column_stack([welded[places], np.round(normals / _SAME_DIRECTION)]))
        return cls(vertices[places[kept]], normals[kept], index.reshape(-1, 3))

    @classmethod
    def coarsened(cls, vertices: FloatArray, faces: IntArray, cell: float) -> Surface:
        """Return the surface of triangles without what is smaller than a cell [m]."""
        rough = cls(vertices, vertices, faces).simplified(cell)
        return cls.from_triangles(rough.vertices, rough.faces)

    @classmethod
    def merged(cls, surfaces: Iterable[Surface]) -> Surface:
        """Return one surface out of many."""
        parts = list(surfaces)
        if not parts:
            return cls(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3), dtype=np.intp))
        starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
        return cls(
            np.vstack([part.vertices for part in parts]),
            np.vstack([part.normals for part in parts]),
            np.vstack([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        )

    def inflated(self, distance: float) -> Surface:
        """Return the surface moved outwards by a distance [m]."""
        return Surface(self.vertices + distance * self.normals, self.normals, self.faces)

    def simplified(self, cell: float) -> Surface:
        """Return the surface with all vertices within a cubic cell [m] drawn together into one of them."""
        kept, index = _distinct_rows(np.round(self.vertices / cell))
        faces = index[self.faces]
        flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
        first, _ = _distinct_rows(np.sort(faces, axis=1))
        distinct = np.zeros(len(faces), dtype=bool)
        distinct[first] = True
        return Surface(self.vertices[kept], self.normals[kept], faces[distinct & ~flat])

    def part(self, chosen: BoolArray) -> Surface:
        """Return the triangles for which `chosen: (F,)` is true."""
        return Surface(self.vertices, self.normals, self.faces[chosen])

    def moved(self, rotation: FloatArray, translation: FloatArray) -> Surface:
        """Return the surface after x ↦ R x + p."""
        return Surface(self.vertices @ rotation.T + translation, self.normals @ rotation.T, self.faces)


def _corner_normals(vertices: FloatArray, faces: IntArray, welded: IntArray, cos_crease: float) -> FloatArray:
    """Return normals (3 F, 3) of all triangle corners: area-weighted means over neighbours that bend little.

    The largest triangle at a vertex takes those together that bend less than the crease from it, the largest of the
    rest does the same, and so on; triangles that are left after some rounds keep their own normals.
    `welded: (V,)` is the same for vertices in one place.
    """
    points = vertices[faces]
    area_normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    unit = _normalised(area_normals)
    by_area = np.argsort(-np.einsum("ij,ij->i", area_normals, area_normals), kind="stable")
    corners = (3 * by_area[:, None] + np.arange(3)).reshape(-1)
    corners = corners[np.argsort(welded[faces.reshape(-1)[corners]], kind="stable")]
    vertex = welded[faces.reshape(-1)[corners]]
    normals = np.repeat(unit, 3, axis=0)
    for _ in range(_SMOOTH_GROUPS):
        if not len(corners):
            break
        new = np.concatenate([[True], vertex[1:] != vertex[:-1]])
        first, group = np.flatnonzero(new), np.cumsum(new) - 1
        face = corners // 3
        close = np.einsum("ij,ij->i", unit[face], unit[face[first]][group]) > cos_crease
        close[first] = True
        means = _normalised(np.add.reduceat(np.where(close[:, None], area_normals[face], 0.0), first))
        normals[corners[close]] = means[group[close]]
        corners, vertex = corners[~close], vertex[~close]
    return normals


def _distinct_rows(rows: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the indices of the distinct rows of whole numbers (R, C), and which of them each row equals: (R,)."""
    low = rows.min(axis=0, initial=0.0)
    spans = rows.max(axis=0, initial=0.0) - low + 1.0
    if spans.prod() < 2.0**62:  # a row is one whole number, which is sorted several times faster
        places = np.cumprod([1, *spans[:-1].astype(np.int64)])
        _, first, index = np.unique(
            (rows - low).astype(np.int64) @ places, return_index=True, return_inverse=True
        )
        return first, index
    order = np.lexsort(rows.T)
    new = np.concatenate([[True], (rows[order[1:]] != rows[order[:-1]]).any(axis=1)])[: len(rows)]
    index = np.empty(len(rows), dtype=np.intp)
    index[order] = np.cumsum(new) - 1
    return order[new], index


def _normalised(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))


def tessellate(geometry: Any) -> Triangles:
    """Triangles of a coal collision geometry, in its own frame.

    Parameters
    ----------
    geometry : coal.CollisionGeometry
        A mesh, convex hull, box, sphere, ellipsoid, cylinder, capsule or cone.

    Returns
    -------
    vertices : (V, 3) array [m]
    faces : (F, 3) array

    Raises
    ------
    InputError
        If the kind of geometry cannot be drawn.
    """
    kind = type(geometry).__name__
    if kind.startswith("BVHModel"):
        return _mesh_triangles(geometry)
    if kind.startswith("Convex"):
        return _convex_triangles(geometry)
    if kind == "Box":
        return surfaces.box_triangles(2.0 * geometry.halfSide)
    return surfaces.revolved_triangles(_profile(geometry, kind), _AROUND)


def _profile(geometry: Any, kind: str) -> FloatArray:
    """Radius and height of a coal solid of revolution, from the bottom pole to the top pole: (P, 2)."""
    if kind not in ("Sphere", "Cylinder", "Capsule", "Cone"):
        known = "mesh, convex, box, sphere, cylinder, capsule, cone"
        raise InputError(f"cannot draw a geometry of type {kind}; known: {known}")
    radius = float(geometry.radius)
    step = 2.0 * np.pi * radius / _AROUND
    if kind == "Sphere":
        return surfaces.sphere_profile(radius, step)
    length = 2.0 * float(geometry.halfLength)
    if kind == "Cylinder":
        return surfaces.cylinder_profile(radius, length, np.inf)
    if kind == "Capsule":
        return surfaces.capsule_profile(radius, length, step, np.inf)
    return np.array([(0.0, -length / 2), (radius, -length / 2), (0.0, length / 2)])


def _mesh_triangles(model: Any) -> Triangles:
    corners = map(itemgetter(0, 1, 2), map(model.tri_indices, range(model.num_tris)))
    faces = np.array(list(corners), dtype=np.intp)
    return np.array(model.vertices(), dtype=float), faces.reshape(-1, 3)


def _convex_triangles(convex: Any) -> Triangles:
    polygons = (convex.polygons(i) for i in range(convex.num_polygons))
    faces = np.array([(t[0], t[1], t[2]) for t in polygons], dtype=np.intp)
    return np.array(convex.points(), dtype=float), faces.reshape(-1, 3)


def tube(points: FloatArray, radius: float) -> Triangles:
    """Triangles of a round tube along a polyline.

    Parameters
    ----------
    points : (P, 3) array
        The centre line [m]; repeated points are skipped.
    radius : float
        [m]
    """
    points = np.asarray(points, dtype=float)
    moving = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    points = points[np.concatenate(([True], moving))]
    if len(points) < 2:
        vertices, faces = surfaces.revolved_triangles(surfaces.sphere_profile(radius, radius / 4), _AROUND)
        return vertices + points[0], faces
    across, up = _transported_frame(_normalised(np.gradient(points, axis=0)))
    turn = np.arange(_AROUND) * (2.0 * np.pi / _AROUND)
    circle = np.cos(turn)[None, :, None] * across[:, None] + np.sin(turn)[None, :, None] * up[:, None]
    vertices = (points[:, None] + radius * circle).reshape(-1, 3)
    return vertices, _grid_faces(len(points), _AROUND)


def _transported_frame(tangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors across each tangent that twist as little as possible: (P, 3) each."""
    across = np.empty_like(tangents)
    seed = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    for i, tangent in enumerate(tangents):
        seed = seed - tangent * (seed @ tangent)
        seed = seed / np.linalg.norm(seed)
        across[i] = seed
    return across, np.cross(tangents, across)


def _grid_faces(rows: int, columns: int) -> IntArray:
    """Triangles between consecutive rings of `columns` vertices: (2 (rows-1) columns, 3)."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    here, right = i * columns + j, i * columns + (j + 1) % columns
    below, below_right = here + columns, right + columns
    quads = [np.stack([here, below, below_right], axis=-1), np.stack([here, below_right, right], axis=-1)]
    return np.concatenate([half.reshape(-1, 3) for half in quads])


@dataclass(frozen=True)
class ColouredSurface:
    """A surface with a colour.

    Parameters
    ----------
    surface : Surface
        What is drawn.
    colour : Colour
        Its own colour.
    glossy : bool
        Whether a coat of clear lacquer covers the colour.
    """

    surface: Surface
    colour: Colour
    glossy: bool = False
