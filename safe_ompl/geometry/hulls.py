"""Convex hulls of meshes; where coal cannot keep the hull itself, one that is a little larger, never smaller.

coal keeps the number of neighbours of each corner of a convex body in one byte, and refuses a hull in which a corner
has more than 254: the end of a cylinder of 260 sides, triangulated, or the tip of a cone. Here the hull of fewer, or of
slightly moved corners is taken, and blown up about its centre until it holds every vertex of the mesh, which is then
checked. For a body K with the origin inside and faces n·x ≤ d, s·K holds x exactly if n·x ≤ s·d for each face.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import coal
import numpy as np

from safe_ompl.common import FloatArray, InputError, halton_point

_log = logging.getLogger(__name__)

_JITTER = 1e-6  # of the body's size: enough to make corners that lie in one plane leave it
_ROUNDING = 1e-9  # by which a hull is larger than computed
_FLAT = 1e-9  # [m], spread of vertices that lie in a plane
_CORNERS = (2000, 1000, 500, 250, 120)  # how many directions pick the corners of a coarser hull


def convex_hull(mesh: coal.BVHModelBase, name: str, thickness: float = 0.0) -> coal.ConvexBase:
    """Return the convex hull of a triangle mesh; a hardly larger body where coal cannot keep the hull itself.

    Parameters
    ----------
    mesh : coal.BVHModelBase
        Vertices and triangles.
    name : str
        For messages.
    thickness : float
        What to give flat meshes [m], the vertices in the middle; 0: refuse them.

    Raises
    ------
    InputError
        If the mesh has no vertices, or such that are not finite; or is flat (coal's managers drop such shapes in
        silence) and no thickness is given.
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
            raise InputError(
                f"mesh of {name!r} has no convex hull ({' '.join(str(error).split())})"
            ) from None
        return _slightly_larger_hull(vertices, name)
    return mesh.convex


def _thin_directions(vertices: FloatArray) -> FloatArray:
    """Return unit vectors (3, 3) in which vertices have no extent; rows of zeros for the others."""
    spread = np.vstack([vertices - vertices.mean(axis=0), np.zeros((3, 3))])
    _, extents, directions = np.linalg.svd(spread, full_matrices=False)
    thin: FloatArray = np.where((extents < _FLAT)[:, None], directions, 0.0)
    return thin


def _thickened(vertices: FloatArray, thickness: float) -> coal.BVHModelBase:
    """Return points whose hull holds flat `vertices` in the middle of its `thickness` [m]."""
    for direction in _thin_directions(vertices):
        half = thickness / 2 * direction
        vertices = np.vstack([vertices - half, vertices + half]) if half.any() else vertices
    return _points(vertices)


def _slightly_larger_hull(vertices: FloatArray, name: str) -> coal.Convex:
    """Return a convex body that holds all `vertices`, has at most 254 neighbours per corner, and is hardly larger.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Points with a volume [m].
    name : str
        Of the mesh, for messages.

    Raises
    ------
    InputError
        If there is none.
    """
    middle = vertices.mean(axis=0)
    center = middle + _extreme(vertices - middle, _CORNERS[-1]).mean(
        axis=0
    )  # inside, wherever vertices crowd
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
    raise InputError(
        f"mesh of {name!r}: its convex hull has a corner with more than 254 neighbours; simplify it"
    )


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
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(1, len(points))
    tree.addVertices(np.ascontiguousarray(points))
    tree.addTriangles(np.array([[0, 1, 2]]))
    tree.endModel()
    return tree


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
    reach = np.concatenate(
        [(normals @ chunk.T).max(axis=1, keepdims=True) for chunk in _chunks(points)], axis=1
    )
    return max(1.0, float((reach.max(axis=1) / offsets).max())) * (1 + _ROUNDING)


def _outside(hull: coal.Convex, points: FloatArray) -> float:
    normals, offsets = _faces(hull)
    return max(float((normals @ chunk.T - offsets[:, None]).max()) for chunk in _chunks(points))


def _chunks(points: FloatArray) -> list[FloatArray]:
    return np.array_split(points, 1 + len(points) // 1000)
