"""People as obstacles: capsules between a handful of key points of the body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import dist
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from safe_ompl import document
from safe_ompl.arrays import FloatArray
from safe_ompl.errors import UnknownNameError
from safe_ompl.maths.kernels.capsules import surface_points
from safe_ompl.scene import surfaces
from safe_ompl.scene.pose import Pose, placed
from safe_ompl.scene.shapes.anatomy import LIMBS, STANDING, Body
from safe_ompl.scene.shapes.basic import Capsule, Part, Shape, Sphere
from safe_ompl.scene.surfaces import Triangles

_DEFAULT_HEIGHT = 1.75  # [m]
_HEIGHTS = (0.3, 2.8)  # [m] of people
_UP = np.array([0.0, 0.0, 1.0])
_SHORTEST = 1e-9  # [m] of a limb


class Limb(NamedTuple):
    """One capsule of a body, or a ball if both its ends are the same key point."""

    name: str
    start: FloatArray
    end: FloatArray
    radius: float

    @property
    def length(self) -> float:
        """Distance between the ends [m]."""
        return dist(self.start, self.end)

    @property
    def shape(self) -> Shape:
        """The capsule or ball, centred at its origin, along z."""
        return Capsule(self.radius, self.length) if self.length > 0 else Sphere(self.radius)

    @property
    def placement(self) -> pin.SE3:
        """Where the shape is in the frame of the person."""
        axis = self.end - self.start
        turn = pin.Quaternion.FromTwoVectors(_UP, axis if axis.any() else _UP)
        return pin.SE3(turn.toRotationMatrix(), (self.start + self.end) / 2)

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """The same for collision. A capsule stays one, wherever its ends go."""
        start, end, _ = LIMBS[self.name]
        if start == end:
            return coal.Sphere(self.radius)
        return coal.Capsule(self.radius, max(self.length, _SHORTEST))


@dataclass(frozen=True)
class Person(Shape):
    """A person, or part of one: standing upright with the arms down unless key points say otherwise.

    The frame of the person has its origin on the floor between the feet, x forward, y to the left, z up.

    Parameters
    ----------
    height : float, optional
        Body height, from 0.3 to 2.8 [m]; all sizes follow from it.
    keypoints : mapping of str to 3 float, optional
        Where key points are instead, in the frame of the person [m]: ``head``, and ``left_`` or ``right_``
        with ``shoulder``, ``elbow``, ``wrist``, ``hand`` (the outer finger joints), ``hip``, ``knee``,
        ``ankle``, ``toe``. The other key points follow, see `safe_ompl.scene.shapes.anatomy.Body`.
    only : sequence of str, optional
        Names of the limbs that there are, for example ``("right_hand", "right_forearm")``; default: all.

    Raises
    ------
    InputError
        If the height is not a person's, a name is unknown, or a hand is out of the arm's reach.

    Notes
    -----
    The danger points lie on the surface: the field of a robot outside is harmonic inside the body, so its
    largest value over the body is on the surface. Those deep inside another limb are left out.
    """

    kind: ClassVar[str] = "person"
    default_weight: ClassVar[float] = 1.0
    height: float = _DEFAULT_HEIGHT
    keypoints: Mapping[str, Sequence[float]] = field(default_factory=dict)
    only: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._set("height", document.number("height", self.height, at_least=_HEIGHTS[0], at_most=_HEIGHTS[1]))
        points = document.mapping("keypoints", self.keypoints)
        with document.within("keypoints"):
            document.check_keys(points, STANDING)
            self._set("keypoints", {name: document.numbers(name, point, 3) for name, point in points.items()})
        self._set("only", tuple(document.sequence("only", self.only)))
        for name in self.only:
            if name not in LIMBS:
                raise UnknownNameError("limb", name, LIMBS, "only")
        with document.within("keypoints"):
            self.limbs()

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path, pose: Pose) -> Shape:
        """Read a person; `world_keypoints` are given in the world frame and win over `keypoints`."""
        own = dict(data)
        world = document.mapping("world_keypoints", own.pop("world_keypoints", {}), STANDING)
        with document.within("world_keypoints"):
            moved = _in_frame(pose, world)
        if moved:
            own["keypoints"] = {**document.mapping("keypoints", own.get("keypoints", {})), **moved}
        return super().from_mapping(own, folder, pose)

    def measured_anew(self, measured: Any, pose: Pose) -> Person:
        """Return the person with these key points, in the world frame, in the place of those known before."""
        points = document.mapping("keypoints", measured, STANDING)
        return Person(self.height, _in_frame(pose, points), self.only)

    def same_body(self, other: Shape) -> bool:
        """Return whether another person is as tall, and has the same limbs."""
        if not isinstance(other, Person) or other.height != self.height:
            return False
        return [limb.name for limb in other.limbs()] == [limb.name for limb in self.limbs()]

    def limbs(self) -> tuple[Limb, ...]:
        """Return the capsules that make up the person, in its own frame."""
        return self._limbs

    @cached_property
    def _limbs(self) -> tuple[Limb, ...]:
        body = Body(self.height, self.keypoints)
        return tuple(
            Limb(name, body.point(start), body.point(end), radius * self.height)
            for name, (start, end, radius) in LIMBS.items()
            if not self.only or name in self.only
        )

    @cached_property
    def _capsules(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Starts (L, 3), ends (L, 3) and radii (L,) of the limbs [m]."""
        _, starts, ends, radii = zip(*self.limbs(), strict=True)
        return np.array(starts), np.array(ends), np.array(radii)

    def parts(self) -> list[Part]:
        several = len(self.limbs()) > 1
        return [Part(limb.name if several else "", limb.geometry, limb.placement) for limb in self.limbs()]

    def most_danger_points(self, spacing: float) -> float:
        starts, ends, radii = self._capsules
        along = np.pi * radii + np.linalg.norm(ends - starts, axis=1)  # from pole to pole
        return float(((along / spacing + 4) * (2 * np.pi * radii / spacing + 1)).sum())

    def danger_points(self, spacing: float) -> FloatArray:
        """Return points on the surface, shape (M, 3); all of it is within `spacing` of them [m]."""
        points: FloatArray = surface_points(*self._capsules, spacing)
        return points

    def triangles(self, resolution: int) -> Triangles:
        pieces = [(limb.placement, limb.shape.triangles(resolution)) for limb in self.limbs()]
        return surfaces.joined(
            [(placed(placement, vertices), faces) for placement, (vertices, faces) in pieces]
        )


def _in_frame(pose: Pose, points: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Return where key points of the world are in the frame of the person [m]."""
    world = [document.numbers(name, point, 3) for name, point in points.items()]
    own = placed(pose.se3.inverse(), np.reshape(world, (-1, 3))).tolist()
    return {name: tuple(point) for name, point in zip(points, own, strict=True)}
