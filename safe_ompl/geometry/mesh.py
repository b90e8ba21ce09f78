"""Obstacles given by triangles."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray, warn_once
from safe_ompl.common import documents as document
from safe_ompl.geometry import surfaces
from safe_ompl.geometry.basic import LONGEST, Part, Shape
from safe_ompl.geometry.hulls import convex_hull
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
