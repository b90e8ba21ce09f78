"""Obstacles given by triangles, and convex hulls of meshes, or bodies that hold these and are hardly larger."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, halton_point, warn_once
from safe_ompl.common import documents as document
from safe_ompl.geometry import surfaces
from safe_ompl.geometry.basic import LONGEST, Part, Shape
from safe_ompl.geometry.pose import UNLIKELY
from safe_ompl.geometry.surfaces import Triangles

_log = logging.getLogger(__name__)

_FLAT = 1e-6  # [m]; a thinner mesh has no volume: broad-phase managers drop it in silence


@dataclass(frozen=True)
class Mesh(Shape):
    """A triangle mesh from a file.

    Parameters
    ----------
    file : path-like
        An STL, OBJ, DAE or PLY file.
    scale : sequence of 3 float, optional
        Factors along x, y and z that turn the file's units into metres.
    convex : bool, optional
        True: the solid convex hull. False: the triangles themselves, which are hollow: a link that is wholly
        inside does not collide.
    """

    kind: ClassVar[str] = "mesh"
    file: Path
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)
    convex: bool = True

    if TYPE_CHECKING:  # what is given, which becomes what the fields say

        def __init__(self, file: str | Path, scale: ArrayLike = ..., convex: bool = ...) -> None: ...

    def __post_init__(self) -> None:
        self._set("file", document.file("file", self.file, (".stl", ".obj", ".dae", ".ply")))
        self._set("scale", document.numbers("scale", self.scale, 3, above=0.0))
        document.flag("convex", self.convex)
        self.surface  # noqa: B018 (reads and checks the file now, so that it is needed no more)

    @cached_property
    def surface(self) -> Triangles:
        """Vertices, shape (V, 3) [m], and triangles, shape (F, 3), of the obstacle: of its hull if convex."""
        vertices, faces = _load(self.file, self.scale)
        _check_volume(self.file, vertices)
        return _hull_triangles(vertices, faces, self.file.name) if self.convex else (vertices, faces)

    def parts(self) -> list[Part]:
        tree = triangle_tree(*self.surface)
        geometry = convex_hull(tree, self.file.name) if self.convex else tree
        return [Part("", geometry, pin.SE3.Identity())]

    def most_danger_points(self, spacing: float) -> float:
        return surfaces.most_mesh_points(*self.surface, spacing)

    def danger_points(self, spacing: float) -> FloatArray:
        return surfaces.mesh_points(*self.surface, spacing)

    def triangles(self, resolution: int) -> Triangles:
        return self.surface

    def canonical(self) -> dict[str, Any]:
        vertices, faces = self.surface
        return {"convex": self.convex, "surface": array_digest(vertices, faces)}


def triangle_tree(vertices: FloatArray, faces: IntArray) -> coal.BVHModelOBBRSS:
    """Return triangles as a bounding volume tree: each triangle is hit, the space between them is empty."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices))
    tree.addTriangles(np.ascontiguousarray(faces, dtype=np.int64))
    tree.endModel()
    tree.computeLocalAABB()
    return tree


def array_digest(*arrays: FloatArray | IntArray) -> str:
    """Return the SHA-256 of the arrays' contents."""
    state = sha256()
    for array in arrays:
        state.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def _load(file: Path, scale: tuple[float, ...]) -> Triangles:
    try:
        tree = coal.MeshLoader().load(str(file), np.array(scale))
    except (ValueError, RuntimeError) as error:
        reason = str(error).split("message: ")[-1].replace("\n", " ").strip()
        raise InputError(f"{file} cannot be read as a mesh: {reason}", "file") from None
    if not tree.num_tris:
        raise InputError(f"{file} has no triangles; points alone are a pointcloud", "file")
    faces = [[tree.tri_indices(k)[i] for i in range(3)] for k in range(tree.num_tris)]
    return np.array(tree.vertices()), np.array(faces, dtype=np.intp).reshape(-1, 3)


def _check_volume(file: Path, vertices: FloatArray) -> None:
    if not np.isfinite(vertices).all():
        raise InputError(f"{file} has vertices that are not finite", "file")
    if np.abs(vertices).max(initial=0.0) > LONGEST:
        raise InputError(
            f"{file} reaches {np.abs(vertices).max():g} m, {LONGEST:g} m are the most; "
            "a file in millimetres needs a scale of [0.001, 0.001, 0.001]",
            "scale",
        )
    if np.abs(vertices).max() > UNLIKELY:
        warn_once(
            _log,
            f"scale: {file.name} reaches {np.abs(vertices).max():.0f} m: meshes are in metres; "
            "a file in millimetres needs a scale of [0.001, 0.001, 0.001]",
        )
    centred = vertices - vertices.mean(axis=0)
    thinnest = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    if len(vertices) < 4 or np.ptp(vertices @ thinnest) < _FLAT:
        raise InputError(f"{file} is flat: a mesh obstacle needs a volume", "file")


def _hull_triangles(vertices: FloatArray, faces: IntArray, name: str) -> Triangles:
    convex = convex_hull(triangle_tree(vertices, faces), name)
    polygons = [convex.polygons(k) for k in range(convex.num_polygons)]
    return np.array(convex.points()), np.array([[p[0], p[1], p[2]] for p in polygons], dtype=np.intp)


_JITTER = 1e-6  # of the body's size: enough to make corners that lie in one plane leave it
_ROUNDING = 1e-9  # by which a hull is larger than computed
_IN_PLANE = 1e-9  # [m], spread of vertices that lie in a plane
_CORNERS = (2000, 1000, 500, 250, 120)  # how many directions pick the corners of a coarser hull


def convex_hull(mesh: coal.BVHModelBase, name: str, thickness: float = 0.0) -> coal.ConvexBase:
    """Return the convex hull of a triangle mesh; a hardly larger body where coal cannot keep the hull itself.

    The name is for messages. Flat meshes get a `thickness` [m], the vertices in the middle. Raises InputError if the
    mesh has no vertices, or such that are not finite; or is flat (coal's managers drop such shapes in silence) and no
    thickness is given.

    coal keeps the number of neighbours of each corner of a convex body in one byte, and refuses a hull in which a
    corner has more than 254: the end of a cylinder of 260 sides, triangulated, or the tip of a cone. Then the hull of
    fewer, or of slightly moved corners is taken, and blown up about its centre until it holds every vertex of the mesh,
    which is then checked. For a body K with the origin inside and faces n·x ≤ d, s·K holds x exactly if n·x ≤ s·d for
    each face.
    """
    vertices = np.asarray(mesh.vertices(), dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise InputError(f"mesh of {name!r} has vertices that are not finite")
    if not len(vertices):
        raise InputError(f"mesh of {name!r} has no vertices")
    if _thin_directions(vertices).any():
        if not thickness:
            raise InputError(f"mesh of {name!r} is flat (no volume); collision meshes must be solid")
        mesh = _thickened(vertices, thickness)
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
    """Return unit vectors (3, 3) in which vertices have no extent; rows of zeros for the others."""
    spread = np.vstack([vertices - vertices.mean(axis=0), np.zeros((3, 3))])
    _, extents, directions = np.linalg.svd(spread, full_matrices=False)
    thin: FloatArray = np.where((extents < _IN_PLANE)[:, None], directions, 0.0)
    return thin


def _thickened(vertices: FloatArray, thickness: float) -> coal.BVHModelBase:
    """Return points whose hull holds flat `vertices` in the middle of its `thickness` [m]."""
    for direction in _thin_directions(vertices):
        half = thickness / 2 * direction
        vertices = np.vstack([vertices - half, vertices + half]) if half.any() else vertices
    return _points(vertices)


def _slightly_larger_hull(vertices: FloatArray, name: str) -> coal.Convex:
    """Return a convex body that holds all `vertices: (V, 3)`, at most 254 neighbours a corner, and is hardly larger."""
    middle = vertices.mean(axis=0)
    # Inside, wherever vertices crowd.
    center = middle + _extreme(vertices - middle, _CORNERS[-1]).mean(axis=0)
    points = vertices - center
    for corners in _choices(points):
        hull = _hull_or_none(corners)
        if hull is None:
            continue
        factor = _needed_factor(hull, points)
        if not np.isfinite(factor):
            continue
        grown = _hull_or_none(factor * np.array(hull.points()) + center)
        if grown is not None and _outside(grown, vertices) <= 0.0:
            growth = (factor - 1) * float(np.linalg.norm(points, axis=1).max())
            _log.info("hull of %s: %d corners, at most %.3g mm larger", name, grown.num_points, 1e3 * growth)
            return grown
    raise InputError(f"mesh of {name!r}: its convex hull has a corner with more than 254 neighbours; simplify it")


def _choices(points: FloatArray) -> Iterator[FloatArray]:
    """Corners to take the hull of, the most exact first; always the same ones."""
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, points.shape)
    jitter = _JITTER * np.ptp(points, axis=0).max() * noise
    yield points + jitter
    for count in _CORNERS:
        corners = _extreme(points, count)
        yield corners
        yield corners + jitter[: len(corners)]


def _extreme(points: FloatArray, count: int) -> FloatArray:
    """Return the points that are farthest in `count` directions, evenly spread once the body is as wide as long."""
    round_points = points @ np.linalg.inv(np.linalg.cholesky(points.T @ points / len(points))).T
    farthest = {int((round_points @ direction).argmax()) for direction in _directions(count)}
    return points[sorted(farthest)]


def _directions(count: int) -> FloatArray:
    """Return unit vectors (`count`, 3) spread evenly (Halton's points, carried to the sphere)."""
    uv = np.array([halton_point(k + 1, 2) for k in range(count)])
    height, angle = 2 * uv[:, 0] - 1, 2 * np.pi * uv[:, 1]
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def _points(points: FloatArray) -> coal.BVHModelBase:
    """Return points as vertices of a mesh, which coal makes hulls of."""
    return triangle_tree(points, np.array([[0, 1, 2]]))


def _hull_or_none(points: FloatArray) -> coal.Convex | None:
    tree = _points(points)
    try:
        tree.buildConvexHull(True, "Qt")
    except RuntimeError:  # too many neighbours, or too flat for Qhull
        return None
    return tree.convex


def _faces(hull: coal.Convex) -> tuple[FloatArray, FloatArray]:
    """Return outward normals (F, 3) and offsets (F,) of the planes through the triangles: n·x ≤ d inside."""
    corners = np.array(hull.points())
    triangles = np.array([[hull.polygons(k)[i] for i in range(3)] for k in range(hull.num_polygons)])
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    thick = lengths > 1e-12 * lengths.max()  # the plane of a sliver is any plane
    normals = normals[thick] / lengths[thick, None]
    offsets = np.einsum("fc,fc->f", normals, a[thick])
    inward = offsets < normals @ corners.mean(axis=0)
    normals[inward], offsets[inward] = -normals[inward], -offsets[inward]
    return normals, offsets


def _needed_factor(hull: coal.Convex, points: FloatArray) -> float:
    normals, offsets = _faces(hull)
    if offsets.min() <= 0:
        return np.inf
    reach = np.concatenate([(normals @ chunk.T).max(axis=1, keepdims=True) for chunk in _chunks(points)], axis=1)
    return max(1.0, float((reach.max(axis=1) / offsets).max())) * (1 + _ROUNDING)


def _outside(hull: coal.Convex, points: FloatArray) -> float:
    normals, offsets = _faces(hull)
    return max(float((normals @ chunk.T - offsets[:, None]).max()) for chunk in _chunks(points))


def _chunks(points: FloatArray) -> list[FloatArray]:
    return np.array_split(points, 1 + len(points) // 1000)
