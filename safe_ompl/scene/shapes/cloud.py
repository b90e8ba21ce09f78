"""Obstacles measured as points."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import coal
import numpy as np
import pinocchio as pin

from safe_ompl import document
from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError
from safe_ompl.scene import surfaces
from safe_ompl.scene.ply import read_ply
from safe_ompl.scene.shapes.basic import Part, Shape
from safe_ompl.scene.shapes.mesh import digest, triangle_tree
from safe_ompl.scene.surfaces import Triangles

_MOST_BALLS = 32  # a larger cloud collides as one tree instead of one ball per point


@dataclass(frozen=True)
class PointCloud(Shape):
    """Points, each of which stands for a ball.

    Parameters
    ----------
    radius : float
        Radius of the ball about each point [m].
    file : path-like, optional
        A PLY file (ASCII or binary), or an NPY file with an array of shape (N, 3).
    points : array_like, shape (N, 3), optional
        The points [m], instead of a file.

    Notes
    -----
    Up to 32 points collide as balls, exactly. A larger cloud is one bounding volume tree over an icosahedron
    about each ball. The icosahedron contains the ball, so nothing is missed, neither in a collision query
    (with margin or without) nor in a distance query; distances come out at most 0.26 radii too small. Its
    triangles are hollow: a link wholly inside *one* icosahedron would not be seen, so radii belong well below
    the size of a robot's links. OcTrees are not used: their cells do not contain the balls.

    The danger points are points of the cloud, thinned to the spacing.
    """

    kind: ClassVar[str] = "pointcloud"
    radius: float
    file: Path | None = None
    points: tuple[tuple[float, ...], ...] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        self._set("radius", document.number("radius", self.radius, above=0.0))
        if (self.points is None) == (self.file is None):
            raise InputError("give either points or file, one of the two", "points")
        if self.file is not None:
            self._set("file", document.file("file", self.file, (".ply", ".npy")))
        if self.points is not None:
            rows = document.sequence("points", self.points)
            self._set("points", tuple(document.numbers(f"points[{k}]", row, 3) for k, row in enumerate(rows)))
        self.centres  # noqa: B018 (reads and checks the file now, so that it is needed no more)

    @cached_property
    def centres(self) -> FloatArray:
        """The points, shape (N, 3) [m]; read-only."""
        key = "points" if self.file is None else "file"
        points = np.array(self.points, dtype=float) if self.file is None else _read(self.file)
        if not points.size:
            raise InputError("the point cloud is empty", key)
        if not np.isfinite(points).all():
            row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise InputError(f"point {row} is not finite: {points[row].tolist()}", key)
        points.flags.writeable = False
        return points

    def parts(self) -> list[Part]:
        count = len(self.centres)
        if count > _MOST_BALLS:
            return [Part("", triangle_tree(*_icosahedra(self.centres, self.radius)), pin.SE3.Identity())]
        return [
            Part(str(k) if count > 1 else "", coal.Sphere(self.radius), pin.SE3(np.eye(3), centre))
            for k, centre in enumerate(self.centres)
        ]

    def danger_points(self, spacing: float) -> FloatArray:
        """Return points of the cloud, shape (M, 3), such that all others are within `spacing` of them [m]."""
        return surfaces.thinned(self.centres, spacing)

    def triangles(self, resolution: int) -> Triangles:
        return _icosahedra(self.centres, self.radius)

    def canonical(self) -> dict[str, Any]:
        return {"radius": self.radius, "points": digest(self.centres)}


def _read(file: Path) -> FloatArray:
    if file.suffix.lower() == ".ply":
        return read_ply(file)
    try:
        points = np.load(file, allow_pickle=False).astype(np.float64)
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{file} cannot be read as an array of numbers: {error}", "file") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{file} must hold an array of shape (N, 3), not {points.shape}", "file")
    return np.ascontiguousarray(points)


def _icosahedra(centres: FloatArray, radius: float) -> Triangles:
    """Return around each centre an icosahedron that contains the ball of the given radius."""
    vertices = (centres[:, None] + radius * _CORNERS).reshape(-1, 3)
    first = len(_CORNERS) * np.arange(len(centres), dtype=np.intp)
    return vertices, (first[:, None, None] + _FACES).reshape(-1, 3)


# The regular icosahedron: corners at (0, ±1, ±g) and their cyclic permutations, scaled so that its faces
# touch the unit ball from outside (a hair further, for rounding).
_G = (1 + 5**0.5) / 2
_CORNERS = np.array(
    [
        *((-1, _G, 0), (1, _G, 0), (-1, -_G, 0), (1, -_G, 0), (0, -1, _G), (0, 1, _G)),
        *((0, -1, -_G), (0, 1, -_G), (_G, 0, -1), (_G, 0, 1), (-_G, 0, -1), (-_G, 0, 1)),
    ]
) * (3**0.5 / _G**2 * (1 + 1e-9))
_FACES = np.array(
    [
        *((0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2)),
        *((10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5)),
        *((2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)),
    ],
    dtype=np.intp,
)
