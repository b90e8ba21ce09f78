"""The class `Obstacle`: a shape with a pose in the world and a danger weight."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import InputError, documents as document, shown
from safe_ompl.geometry.cloud import PointCloud
from safe_ompl.geometry.person import Person, with_own_keypoints
from safe_ompl.geometry.pose import POSE_KEYS, Pose, placed
from safe_ompl.geometry.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from safe_ompl.geometry.surfaces import Triangles

SHAPES: dict[str, type[Shape]] = {
    shape.kind: shape for shape in (Box, Sphere, Cylinder, Capsule, Mesh, PointCloud, Person)
}
# A scene has at most this many danger points. A setup with this many points takes seconds.
MOST_DANGER_POINTS = 1_000_000
_KEYS = ("name", *SHAPES, *POSE_KEYS, "weight", "color", "touched_by")


@dataclass(frozen=True, init=False)
class Obstacle:
    """A body that the robot must not touch, with a weight for the danger of approaching it.

    Parameters
    ----------
    name : str
        Name, unique in its scene.
    shape : Shape
        `Box`, `Sphere`, `Cylinder`, `Capsule`, `Mesh`, `PointCloud` or `Person`.
    pose : Pose, pin.SE3 or array_like of shape (4, 4), optional
        Pose in the world; default: identity.
    weight : float, optional
        Danger weight, ≥ 0; 0 means not dangerous to approach. Default: 1 for people, 0 for all other shapes.
    color : str or sequence of 3 float, optional
        Colour in pictures: "#rrggbb", or red, green and blue from 0 to 1.
    touched_by : sequence of str, optional
        Links and held objects that may touch the obstacle: these pairs are not checked. See `Scene.touched`.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its name.

    Examples
    --------
    >>> Obstacle("pillar", Cylinder(0.1, 2.0), Pose([0.2, 0.8, 1.0]), weight=0.5).weight
    0.5
    """

    name: str
    shape: Shape
    pose: Pose
    weight: float
    color: tuple[float, ...] | None
    touched_by: tuple[str, ...]

    def __init__(
        self,
        name: str,
        shape: Shape,
        pose: Pose | pin.SE3 | ArrayLike | None = None,
        weight: float | None = None,
        color: str | Sequence[float] | None = None,
        touched_by: Sequence[str] = (),
    ) -> None:
        if not isinstance(shape, Shape):
            kinds = ", ".join(kind.__name__ for kind in SHAPES.values())
            raise InputError(f"must be a shape ({kinds}), got {shown(shape)}", "shape")
        values = {
            "name": document.text("name", name),
            "shape": shape,
            "pose": Pose() if pose is None else Pose.of(pose),
            "weight": shape.default_weight if weight is None else document.number("weight", weight, at_least=0.0),
            "color": None if color is None else _rgb(color),
            "touched_by": document.list_of("touched_by", touched_by, document.text),
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def moved(self, place: Any) -> Obstacle:
        """Return the obstacle at another place. Raises InputError for a place that the shape does not accept.

        Parameters
        ----------
        place : Pose, pin.SE3, array_like of shape (4, 4), mapping or array_like of shape (N, 3)
            The new pose; or, in the world frame [m], the key points of a `Person` by name, or the points of a
            `PointCloud`. `Person` describes how missing key points are computed.
        """
        shape, pose = self.shape, self.pose
        rows = place if isinstance(place, (np.ndarray, list, tuple)) else ()
        if isinstance(place, (Pose, pin.SE3)) or (len(rows) == 4 and np.shape(rows[0]) == (4,)):
            pose = Pose.of(place)
        else:
            shape = shape.with_measurement(place, pose)
        return Obstacle(self.name, shape, pose, self.weight, self.color, self.touched_by)

    def same_but_for_place(self, other: Obstacle) -> bool:
        """Return whether another obstacle equals this one up to its place."""
        mine, its = ((o.name, o.weight, o.color, o.touched_by) for o in (self, other))
        return mine == its and self.shape.same_body(other.shape)

    def __repr__(self) -> str:
        given = [repr(self.name), repr(self.shape)]
        given += [repr(self.pose)] if self.pose != Pose() else []
        given += [f"weight={self.weight:g}"] if self.weight != self.shape.default_weight else []
        given += [f"color={self.color}"] if self.color is not None else []
        given += [f"touched_by={self.touched_by}"] if self.touched_by else []
        return f"Obstacle({', '.join(given)})"

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path) -> Obstacle:
        """Read an obstacle from a mapping of a document. File names are relative to `folder`."""
        document.check_keys(data, _KEYS)
        kinds = [key for key in SHAPES if key in data]
        if len(kinds) != 1:
            found = f"found {' and '.join(kinds)}" if kinds else "found none"
            raise InputError(f"give exactly one of {', '.join(SHAPES)}; {found}", "shape")
        kind = kinds[0]
        pose = Pose.from_mapping(data)
        fields = document.mapping(kind, data[kind] if data[kind] is not None else {})
        with document.within(kind):
            fields = with_own_keypoints(fields, pose) if kind == Person.kind else fields
            shape = SHAPES[kind].from_mapping(fields, folder)
        more = data.get("weight"), data.get("color"), data.get("touched_by", ())
        return cls(document.require(data, "name"), shape, pose, *more)

    def to_mapping(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the obstacle as a mapping for `from_mapping`. File names are relative to `folder`, else absolute."""
        data = {"name": self.name, self.shape.kind: self.shape.to_mapping(folder), **self.pose.to_mapping()}
        if self.weight != self.shape.default_weight:
            data["weight"] = self.weight
        if self.color is not None:
            data["color"] = self.color
        if self.touched_by:
            data["touched_by"] = list(self.touched_by)
        return data

    def canonical(self) -> dict[str, Any]:
        """Return the data that define the obstacle, without file names, for hashes."""
        return {**self.to_mapping(), self.shape.kind: self.shape.canonical(), "weight": self.weight}

    def geometries(self) -> list[tuple[str, coal.CollisionGeometry, pin.SE3]]:
        """Return name, collision geometry and world placement of each part."""
        named = [(f"{self.name}/{part.name}" if part.name else self.name, part) for part in self.shape.parts()]
        return [(name, part.geometry, self.pose.se3 * part.placement) for name, part in named]

    def triangles(self, resolution: int = 24) -> Triangles:
        """Return the surface in the world frame for drawing, with `resolution` corners on each circle.

        Returns vertices (V, 3) [m] and faces (F, 3), whose vertices are anticlockwise as seen from outside.
        """
        vertices, faces = self.shape.triangles(resolution)
        return placed(self.pose.se3, vertices), faces


def check_number(most: float, spacing: float, what: str) -> None:
    """Raise InputError with a suitable spacing if `most`, the bound on the danger points, exceeds a million."""
    if most > MOST_DANGER_POINTS:
        enough = spacing * (most / MOST_DANGER_POINTS) ** 0.5
        raise InputError(
            f"{spacing:g} m makes about {most:.2g} danger points of {what}, at most {MOST_DANGER_POINTS:g} are "
            f"taken; give at least {enough:.2g} m",
            "spacing",
        )


def _rgb(color: str | Sequence[float]) -> tuple[float, ...]:
    if isinstance(color, str):
        if not re.fullmatch("#[0-9a-fA-F]{6}", color):
            raise InputError(f"must be '#rrggbb' or three numbers from 0 to 1, not {color!r}", "color")
        return tuple(int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    levels = document.numbers("color", color, 3)
    if not all(0 <= level <= 1 for level in levels):
        raise InputError(f"must be '#rrggbb' or three numbers from 0 to 1, not {list(levels)}", "color")
    return levels
