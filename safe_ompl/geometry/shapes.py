"""Shapes of obstacles, with their collision geometry, danger points and triangles for pictures.

Lengths are in metres. A shape has its own frame; the pose of the obstacle places this frame in the world.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import (
    FloatArray,
    InputError,
    IntArray,
    Section,
    documents as document,
    files,
    key,
    shown,
    warn_once,
)
from safe_ompl.geometry import surfaces
from safe_ompl.geometry.cells import Voxels
from safe_ompl.geometry.hulls import convex_hull, triangle_tree
from safe_ompl.geometry.meshes import MESH_ENDINGS, read_mesh
from safe_ompl.geometry.pose import LONGEST, UNLIKELY, Pose
from safe_ompl.geometry.surfaces import Triangles

_log = logging.getLogger(__name__)

# A thinner mesh has no volume. The broad-phase managers of coal would drop it without an error.
_FLAT = 1e-6  # [m]


def _settle_boxes() -> None:
    """Query coal for the distance of a box once, before any other query.

    If the first support direction that coal computes for a box has a zero component, all boxes of the process are
    larger by a factor of 1 + 1e-10. Without this query, distances and planned paths would depend on the first query.
    """
    askew = coal.Transform3s(pin.rpy.rpyToMatrix(0.5, 0.6, 0.7), np.array([3.0, 1.0, 2.0]))
    rod, question = (coal.Capsule(0.1, 0.2), coal.Transform3s.Identity()), coal.DistanceRequest()
    coal.distance(*rod, coal.Box(1.0, 1.0, 1.0), askew, question, coal.DistanceResult())


_settle_boxes()


class Part(NamedTuple):
    """A part of a shape: name (empty if it is the only part), convex solid or triangle mesh, and placement.

    The geometry may also be a tree of coal with its `cells`.
    """

    name: str
    geometry: coal.CollisionGeometry
    placement: pin.SE3
    cells: Voxels | None = None


@dataclass(frozen=True)
class Shape(Section, ABC):
    """Base class of all shapes; the fields of a shape are its keys in YAML."""

    kind: ClassVar[str]
    # The danger weight of an obstacle whose weight is not given.
    default_weight: ClassVar[float] = 0.0

    @abstractmethod
    def parts(self) -> list[Part]:
        """Return the collision geometry as at least one part. Parts are solid unless the class says otherwise."""

    @abstractmethod
    def danger_points(self, spacing: float) -> FloatArray:
        """Return points (M, 3) on the surface. Each point of the surface is within `spacing` [m] of one of them."""

    def kept_danger_points(self, spacing: float) -> FloatArray:
        """Return `danger_points` as a read-only array, which is cached for the last spacing."""
        known: tuple[float, FloatArray] | None = vars(self).get("_points")
        if known is None or known[0] != spacing:
            known = spacing, self.danger_points(spacing)
            known[1].setflags(write=False)
            object.__setattr__(self, "_points", known)
        return known[1]

    @abstractmethod
    def most_danger_points(self, spacing: float) -> float:
        """Return an upper bound on the number of `danger_points` without computing them."""

    @abstractmethod
    def triangles(self, resolution: int) -> Triangles:
        """Return the surface for drawing, with `resolution` corners on each circle."""

    def core(self, depth: float) -> Shape:
        """Return the part of the shape deeper than `depth` [m]. Raises InputError if it is empty or not supported."""
        raise InputError(
            f"must be a box, sphere, cylinder or capsule to be touched, got a {self.kind}: give it as several of these",
            "shape",
        )

    def with_measurement(self, measured: Any, pose: Pose) -> Shape:
        """Return the shape after a new measurement in the world frame, such as new key points of a person.

        `pose` is the pose of the shape's frame. Raises InputError if shapes of this kind never change, or if the
        measurement cannot be used.
        """
        raise InputError(f"must be a Pose, a pin.SE3 or a 4×4 matrix, got {shown(measured)}", "pose")

    def same_body(self, other: Shape) -> bool:
        """Return whether `other` equals this shape up to its measurement."""
        return self == other

    def canonical(self) -> dict[str, Any]:
        """Return the data that define the shape, without file names, for hashes."""
        return self.to_mapping()

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without cached values. Trees of coal, for example, cannot be pickled."""
        return {key: value for key, value in vars(self).items() if not key.startswith("_")}


@dataclass(frozen=True)
class Box(Shape):
    """A box, centred at the origin of its frame.

    Parameters
    ----------
    size : sequence of 3 float
        Edge lengths along x, y and z [m].

    Examples
    --------
    >>> Box([0.8, 0.5, 0.03]).size
    (0.8, 0.5, 0.03)
    """

    kind: ClassVar[str] = "box"
    size: tuple[float, ...] = key(document.numbers, count=3, above=0.0, at_most=LONGEST)

    # Type checkers see the types of the arguments. The fields hold what the arguments are converted to.
    if TYPE_CHECKING:

        def __init__(self, size: ArrayLike) -> None: ...

    def parts(self) -> list[Part]:
        return [Part("", coal.Box(*self.size), pin.SE3.Identity())]

    def core(self, depth: float) -> Box:
        return Box([size - 2 * depth for size in self.size])

    def most_danger_points(self, spacing: float) -> float:
        x, y, z = (size / spacing + 2 for size in self.size)
        return 2 * (x * y + y * z + x * z)

    def danger_points(self, spacing: float) -> FloatArray:
        return surfaces.box_points(np.array(self.size), spacing)

    def triangles(self, resolution: int) -> Triangles:
        return surfaces.box_triangles(np.array(self.size))


@dataclass(frozen=True)
class _Revolved(Shape):
    """A solid of revolution about the z axis, centred at the origin of its frame."""

    radius: float = key(document.number, above=0.0, at_most=LONGEST)

    def core(self, depth: float) -> Shape:
        return replace(self, radius=self.radius - depth)

    @abstractmethod
    def profile(self, arc_step: float, line_step: float) -> FloatArray:
        """Return radius and height (K, 2) [m] of the rings of the surface."""

    def most_danger_points(self, spacing: float) -> float:
        # This is an upper bound on the length along the surface from pole to pole.
        along = np.pi * self.radius + getattr(self, "length", 0.0)
        return (along / spacing + 4) * (2 * np.pi * self.radius / spacing + 1)

    def danger_points(self, spacing: float) -> FloatArray:
        return surfaces.revolved_points(self.profile(spacing, spacing), spacing)

    def triangles(self, resolution: int) -> Triangles:
        arc_step = 2 * np.pi * self.radius / resolution
        return surfaces.revolved_triangles(self.profile(arc_step, np.inf), resolution)


@dataclass(frozen=True)
class Sphere(_Revolved):
    """A sphere, centred at the origin of its frame.

    Parameters
    ----------
    radius : float
        Radius [m].

    Examples
    --------
    >>> Sphere(0.15)
    Sphere(radius=0.15)
    """

    kind: ClassVar[str] = "sphere"

    def parts(self) -> list[Part]:
        return [Part("", coal.Sphere(self.radius), pin.SE3.Identity())]

    def profile(self, arc_step: float, line_step: float) -> FloatArray:
        return surfaces.sphere_profile(self.radius, arc_step)


@dataclass(frozen=True)
class Cylinder(_Revolved):
    """A cylinder along z, centred at the origin of its frame.

    Parameters
    ----------
    radius : float
        Radius [m].
    length : float
        Length from one flat end to the other [m].

    Examples
    --------
    >>> Cylinder(radius=0.1, length=2.0)
    Cylinder(radius=0.1, length=2.0)
    """

    kind: ClassVar[str] = "cylinder"
    length: float = key(document.number, above=0.0, at_most=LONGEST)

    def core(self, depth: float) -> Shape:
        return Cylinder(self.radius - depth, self.length - 2 * depth)

    def parts(self) -> list[Part]:
        return [Part("", coal.Cylinder(self.radius, self.length), pin.SE3.Identity())]

    def profile(self, arc_step: float, line_step: float) -> FloatArray:
        return surfaces.cylinder_profile(self.radius, self.length, line_step)


@dataclass(frozen=True)
class Capsule(_Revolved):
    """A capsule along z, centred at the origin of its frame: a cylinder with a hemisphere on each end.

    Parameters
    ----------
    radius : float
        Radius [m].
    length : float
        Length of the cylinder, that is, the distance between the centres of the hemispheres [m].

    Examples
    --------
    >>> Capsule(radius=0.03, length=0.8)
    Capsule(radius=0.03, length=0.8)
    """

    kind: ClassVar[str] = "capsule"
    length: float = key(document.number, above=0.0, at_most=LONGEST)

    def parts(self) -> list[Part]:
        return [Part("", coal.Capsule(self.radius, self.length), pin.SE3.Identity())]

    def profile(self, arc_step: float, line_step: float) -> FloatArray:
        return surfaces.capsule_profile(self.radius, self.length, arc_step, line_step)


@dataclass(frozen=True)
class Mesh(Shape):
    """A triangle mesh from a file.

    Parameters
    ----------
    file : path-like
        An STL, OBJ, DAE or PLY file. The unit and the upward axis of a DAE file are used: its upward axis becomes z.
    scale : sequence of 3 float, optional
        Factors along x, y and z that convert the units of other files to metres.
    convex : bool, optional
        True: the solid convex hull. False: the triangles, which are hollow: a link wholly inside does not collide.

    Examples
    --------
    >>> Mesh("missing.stl", scale=[0.001, 0.001, 0.001])
    Traceback (most recent call last):
    safe_ompl.common.errors.InputError: file: 'missing.stl' does not exist
    """

    kind: ClassVar[str] = "mesh"
    file: Path = key(document.file, endings=MESH_ENDINGS)
    scale: tuple[float, ...] = key(document.numbers, default=(1.0, 1.0, 1.0), count=3, above=0.0)
    convex: bool = key(document.flag, default=True)

    # Type checkers see the types of the arguments. The fields hold what the arguments are converted to.
    if TYPE_CHECKING:

        def __init__(self, file: str | Path, scale: ArrayLike = ..., convex: bool = ...) -> None: ...

    def check(self) -> None:
        """Raise InputError if the file is not a mesh with a volume."""
        self.surface  # noqa: B018 (reads and checks the file now, so that it is needed no more)

    @cached_property
    def surface(self) -> Triangles:
        """Vertices (V, 3) [m] and triangles (F, 3) of the mesh, or of its hull if convex."""
        with document.within("file", ": "):
            vertices, faces = read_mesh(self.file, np.array(self.scale))
        _check_volume(self.file, vertices)
        if not self.convex:
            return vertices, faces
        convex = convex_hull(triangle_tree(vertices, faces), self.file.name)
        polygons = [convex.polygons(k) for k in range(convex.num_polygons)]
        return np.array(convex.points()), np.array([[p[0], p[1], p[2]] for p in polygons], dtype=np.intp)

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


def written_mesh(
    folder: Path | None, name: str, vertices: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]
) -> Mesh:
    """Write vertices (V, 3) and faces (F, 3) to an .obj file and return the mesh. No folder raises InputError."""
    if folder is None:
        raise InputError("missing, but needed: the folder to which meshes and cones are written", "meshes")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{name}.obj"
    lines = ["v {!r} {!r} {!r}".format(*map(float, point)) for point in vertices]
    files.write(file, "\n".join([*lines, *("f {} {} {}".format(*(k + 1 for k in face)) for face in faces), ""]))
    return Mesh(file)


def array_digest(*arrays: FloatArray | IntArray) -> str:
    """Return the SHA-256 of the shapes and contents of arrays."""
    state = sha256()
    for array in arrays:
        state.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def _check_volume(file: Path, vertices: FloatArray) -> None:
    if not np.isfinite(vertices).all():
        raise InputError(f"{file} has vertices that are not finite", "file")
    reach, hint = np.abs(vertices).max(), "a file in millimetres needs a scale of [0.001, 0.001, 0.001]"
    if reach > LONGEST:
        raise InputError(f"{file} reaches {reach:g} m, {LONGEST:g} m is the limit; {hint}", "scale")
    if reach > UNLIKELY:
        warn_once(_log, f"scale: {file.name} reaches {reach:.0f} m: meshes are in metres; {hint}")
    centred = vertices - vertices.mean(axis=0)
    thinnest = np.linalg.eigh(centred.T @ centred)[1][:, 0]
    if len(vertices) < 4 or np.ptp(vertices @ thinnest) < _FLAT:
        raise InputError(f"{file} is flat: a mesh obstacle needs a volume", "file")
