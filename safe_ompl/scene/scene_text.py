"""Reading `.scene` files, in which MoveIt and RViz store the objects of a planning scene.

The first line is a name. Each object begins with `* ID`, and a line with a dot ends the file. Files since 2020 have the
pose of the object on the next line, and subframes at the end of the object. The number of shapes follows and, for each
shape, its kind, sizes, pose and colour. A pose is a position [m] and a quaternion x, y, z, w.
"""

from __future__ import annotations

from itertools import takewhile
from math import cos, pi
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, documents as document, files
from safe_ompl.geometry import Box, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere, surfaces, written_mesh

_SIZES = {"box": ("x", "y", "z"), "sphere": ("radius",), "cylinder": ("radius", "length"), "cone": ("radius", "length")}
# Number of corners of the polygon around the base of a cone. The polygon is at most 0.5 % wider than the base.
_CONE_CORNERS = 32


def read_scene_text(file: str | Path, meshes: str | Path | None = None) -> tuple[Obstacle, ...]:
    """Return the objects of a `.scene` file as obstacles with the same names; several shapes are named ID/0, ID/1, ….

    Meshes and cones are written to the folder `meshes` (.obj). Raises InputError with file, line and value if the file
    is malformed, or contains meshes or cones without a folder given.
    """
    path = Path(file)
    with document.within(str(path), ": "):
        words = _Words(path, files.file_text(path))
    found: dict[str, list[Obstacle]] = {}
    while (marker := words.word("the dot that ends it")) != ".":
        if marker != "*":
            raise InputError(f"must be '* ID' or '.', got {marker!r}", words.place)
        words.name = name = words.rest_of_line()
        if not name or name in found:
            raise InputError("is there twice" if name else "must be named", words.place)
        frame = words.pose() if words.has_poses else pin.SE3.Identity()
        count = words.count("number of shapes", 0)
        names = (name if count == 1 else f"{name}/{k}" for k in range(count))
        found[name] = [words.obstacle(each, frame, None if meshes is None else Path(meshes)) for each in names]
        for _ in range(words.count("number of subframes", 0) if words.has_poses else 0):
            words.word("name of a subframe")
            words.pose()
    return tuple(obstacle for own in found.values() for obstacle in own)


def written_cone(folder: Path | None, name: str, radius: float, length: float) -> Mesh:
    """Write a mesh that contains a cone to a folder (.obj), and return the mesh.

    The tip of the cone is on the positive z axis, and the origin at half its height. The base of the mesh is a polygon
    around the base of the cone.
    """
    wide, half = radius / cos(pi / _CONE_CORNERS), length / 2
    vertices, faces = surfaces.revolved_triangles(np.array([[0.0, -half], [wide, -half], [0.0, half]]), _CONE_CORNERS)
    return written_mesh(folder, name, vertices.tolist(), faces.tolist())


class _Words:
    """The words of a file, which are read in order; `name` is the object that is being read."""

    def __init__(self, path: Path, content: str) -> None:
        lines = content.splitlines()
        self._path, self._line, self._next, self.name = path, 1, 0, ""
        self._words = [(k, word) for k, line in enumerate(lines[1:], start=2) for word in line.split()]
        # As in MoveIt, the line after the first object decides: a pose has several words, a number of shapes has one.
        starts = [k for k, line in enumerate(lines) if k and line.startswith("*")]
        self.has_poses = bool(starts) and " " in "".join(lines[starts[0] + 1 : starts[0] + 2]).strip()

    @property
    def place(self) -> str:
        """File, line and object, for error messages."""
        return f"{self._path}:{self._line}" + (f": {self.name!r}" if self.name else "")

    def word(self, what: str) -> str:
        if self._next == len(self._words):
            raise InputError(f"ends before {what}", self.place)
        self._line, word = self._words[self._next]
        self._next += 1
        return word

    def rest_of_line(self) -> str:
        rest = [word for _, word in takewhile(lambda word: word[0] == self._line, self._words[self._next :])]
        self._next += len(rest)
        return " ".join(rest)

    def number(self, what: str, **bounds: Any) -> float:
        word = self.word(what)
        with document.within(self.place, ": "):
            try:
                value = float(word)
            except ValueError:
                raise InputError(f"must be a number, got {word!r}", what) from None
            return document.number(what, value, **bounds)

    def count(self, what: str, at_least: int, at_most: float = 1e9) -> int:
        value = self.number(what, at_least=at_least, at_most=at_most)
        if value != int(value):
            raise InputError(f"must be a whole number, got {value:g}", f"{self.place}: {what}")
        return int(value)

    def pose(self) -> pin.SE3:
        values = [self.number("pose") for _ in range(7)]
        with document.within(self.place, ": "):
            return Pose(values[:3], values[3:]).se3

    def obstacle(self, name: str, frame: pin.SE3, folder: Path | None) -> Obstacle:
        shape = self.shape(name, folder)
        place = self.pose()
        color = [self.number("color", at_least=0.0, at_most=1.0) for _ in range(4)]
        # All zeros mean that the object has no colour.
        return Obstacle(name, shape, Pose.of(frame * place), color=color[:3] if any(color) else None)

    def shape(self, name: str, folder: Path | None) -> Shape:
        kind, safe = self.word("kind of shape"), quote(name, safe="")
        if kind not in _SIZES and kind != "mesh":
            raise UnknownNameError("kind of shape", kind, (*_SIZES, "mesh"), self.place)
        sizes = [self.number(f"{size} of the {kind}", above=0.0) for size in _SIZES.get(kind, ())]
        if kind == "mesh":
            corners = self.count("number of vertices", 4)
            triangles = self.count("number of triangles", 4)
            points = [[self.number("vertex") for _ in range(3)] for _ in range(corners)]
            faces = [[self.count("corner of a triangle", 0, corners - 1) for _ in range(3)] for _ in range(triangles)]
        with document.within(self.place, ": "):
            if kind == "mesh":
                return written_mesh(folder, safe, points, faces)
            if kind == "cone":
                return written_cone(folder, safe, *sizes)
            return Box(sizes) if kind == "box" else Sphere(*sizes) if kind == "sphere" else Cylinder(*sizes)
