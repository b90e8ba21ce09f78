"""People as obstacles: capsules between the key points of the body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import dist
from typing import Any, ClassVar, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, UnknownNameError, documents as document, key
from safe_ompl.geometry import surfaces
from safe_ompl.geometry.pose import Pose, placed, turn_onto
from safe_ompl.geometry.shapes import Capsule, Part, Shape, Sphere
from safe_ompl.geometry.surfaces import Triangles

# Key points of a standing body with arms down, as fractions of its height: x forward, y to the left, z up, with the
# origin on the floor between the feet. The segment lengths are those of Drillis and Contini (1966).
_LEFT = {
    "shoulder": (0.0, 0.110, 0.812),
    "elbow": (-0.01, 0.132, 0.628),
    "wrist": (0.02, 0.136, 0.482),
    "hand": (0.036, 0.136, 0.400),
    "hip": (0.0, 0.055, 0.525),
    "knee": (0.01, 0.058, 0.285),
    "ankle": (0.0, 0.060, 0.045),
    "toe": (0.095, 0.070, 0.022),
}
_SIDES = {"left": 1.0, "right": -1.0}
STANDING: dict[str, FloatArray] = {
    "head": np.array([0.01, 0.0, 0.935]),
    **{
        f"{side}_{name}": np.array([x, y * sign, z])
        for side, sign in _SIDES.items()
        for name, (x, y, z) in _LEFT.items()
    },
}
_PARENT = {"elbow": "shoulder", "wrist": "elbow", "hand": "wrist", "knee": "hip", "ankle": "knee", "toe": "ankle"}

# Capsules between two key points, with the radius as a fraction of the height.
_SIDE_LIMBS = {
    "flank": ("shoulder", "hip", 0.052),
    "upper_arm": ("shoulder", "elbow", 0.028),
    "forearm": ("elbow", "wrist", 0.024),
    "hand": ("wrist", "hand", 0.024),
    "thigh": ("hip", "knee", 0.045),
    "shank": ("knee", "ankle", 0.032),
    "foot": ("ankle", "toe", 0.022),
}
LIMBS: dict[str, tuple[str, str, float]] = {
    "head": ("head", "head", 0.062),
    "neck": ("shoulders", "head", 0.036),
    "shoulders": ("left_shoulder", "right_shoulder", 0.042),
    "torso": ("chest", "pelvis", 0.074),
    "hips": ("left_hip", "right_hip", 0.066),
    **{
        f"{side}_{name}": (f"{side}_{start}", f"{side}_{end}", radius)
        for side in _SIDES
        for name, (start, end, radius) in _SIDE_LIMBS.items()
    },
}
_DEFAULT_HEIGHT = 1.75  # [m]
_HEIGHTS = (0.3, 2.8)  # [m] of people
_UPWARDS = np.array([0.0, 0.0, 1.0])
_SHORTEST = 1e-9  # [m] of a limb


@dataclass(frozen=True)
class Body:
    """Key points of a body, computed from `given` key points [m] with names as in `STANDING`.

    A missing key point moves with its parent key point. If the hand or the wrist is given, the elbow bends downwards
    and the lengths of upper arm and forearm are kept. All lengths are proportional to the height [m].
    """

    height: float
    given: Mapping[str, Sequence[float]]

    def point(self, name: str) -> FloatArray:
        """Return a key point (3,) [m] in the frame of the body, also for `shoulders`, `pelvis` and `chest`."""
        if name in self.given:
            return np.array(self.given[name])
        if name == "shoulders":
            return (self.point("left_shoulder") + self.point("right_shoulder")) / 2
        if name == "pelvis":
            return (self.point("left_hip") + self.point("right_hip")) / 2
        if name == "chest":
            return 0.72 * self.point("shoulders") + 0.28 * self.point("pelvis")
        side, _, joint = name.partition("_")
        if joint == "elbow" and {f"{side}_wrist", f"{side}_hand"} & set(self.given):
            return self._bent_elbow(side)
        if joint == "wrist" and f"{side}_hand" in self.given:
            hand = self.point(f"{side}_hand")
            return self._beyond(hand, self.point(f"{side}_shoulder") - hand, side)
        if joint == "hand":
            wrist, elbow = (self.point(f"{side}_{name}") for name in ("wrist", "elbow"))
            return self._beyond(wrist, wrist - elbow, side)
        if joint not in _PARENT:
            return self.height * STANDING[name]
        parent = f"{side}_{_PARENT[joint]}"
        return self.point(parent) + self.height * (STANDING[name] - STANDING[parent])

    def _segment(self, side: str, start: str, end: str) -> float:
        return self.height * float(np.linalg.norm(STANDING[f"{side}_{end}"] - STANDING[f"{side}_{start}"]))

    def _bent_elbow(self, side: str) -> FloatArray:
        """Return the lowest possible elbow (3,) [m] of a two-segment arm from shoulder to wrist."""
        upper, fore = self._segment(side, "shoulder", "elbow"), self._segment(side, "elbow", "wrist")
        shoulder, wrist = self.point(f"{side}_shoulder"), self.point(f"{side}_wrist")
        reach = float(np.linalg.norm(wrist - shoulder))
        if not abs(upper - fore) < reach <= upper + fore:
            raise InputError(
                f"the wrist is {reach:.3g} m from the shoulder, but the arm spans {abs(upper - fore):.3g} to "
                f"{upper + fore:.3g} m: move the person, or give {side}_elbow too",
                f"{side}_wrist" if f"{side}_wrist" in self.given else f"{side}_hand",
            )
        forward = (wrist - shoulder) / reach
        down = _perpendicular(np.array([0.0, 0.0, -1.0]), forward)
        along = (reach**2 + upper**2 - fore**2) / (2 * reach)
        return np.asarray(shoulder + along * forward + np.sqrt(max(upper**2 - along**2, 0.0)) * down)

    def _beyond(self, point: FloatArray, way: FloatArray, side: str) -> FloatArray:
        """Return the point (3,) [m] from `point` in the direction `way`, at the distance between wrist and hand."""
        return point + self._segment(side, "wrist", "hand") * way / max(float(np.linalg.norm(way)), 1e-9)


def _perpendicular(vector: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the unit vector (3,) perpendicular to the unit vector `axis` that is nearest to `vector`."""
    for candidate in (vector, np.array([-1.0, 0.0, 0.0])):
        rest = candidate - (candidate @ axis) * axis
        if np.linalg.norm(rest) > 1e-6:
            break
    return rest / np.linalg.norm(rest)


class Limb(NamedTuple):
    """One capsule of a body, or a sphere if both ends are the same key point."""

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
        """The capsule along z, or the sphere, centred at its origin."""
        return Capsule(self.radius, self.length) if self.length > 0 else Sphere(self.radius)

    @property
    def placement(self) -> pin.SE3:
        """Placement of the shape in the frame of the person."""
        axis = self.end - self.start
        return pin.SE3(turn_onto(_UPWARDS, axis if axis.any() else _UPWARDS), (self.start + self.end) / 2)

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """The collision geometry. A capsule whose ends coincide remains a capsule."""
        start, end, _ = LIMBS[self.name]
        if start == end:
            return coal.Sphere(self.radius)
        return coal.Capsule(self.radius, max(self.length, _SHORTEST))


def _limb(key: str, value: Any) -> str:
    name = document.text(key, value)
    if name not in LIMBS:
        raise UnknownNameError("limb", name, LIMBS, key)
    return name


@dataclass(frozen=True)
class Person(Shape):
    """A person, or some limbs of a person, standing upright with the arms down unless key points are given.

    The frame of the person has its origin on the floor between the feet, x forward, y to the left, z up.

    Parameters
    ----------
    height : float, optional
        Body height, from 0.3 to 2.8 [m]; all sizes are proportional to the height.
    keypoints : mapping of str to 3 float, optional
        Measured key points in the frame of the person [m]: ``head``, and ``left_`` or ``right_`` with ``shoulder``,
        ``elbow``, ``wrist``, ``hand`` (the outer finger joints), ``hip``, ``knee``, ``ankle``, ``toe``. The other key
        points are computed, see `safe_ompl.geometry.person.Body`.
    only : sequence of str, optional
        Names of the limbs to include, for example ``("right_hand", "right_forearm")``; default: all.

    Raises
    ------
    InputError
        If the height is out of range, a name is unknown, or a hand is out of the arm's reach.

    Notes
    -----
    The danger points lie on the surface: the field of a robot outside is harmonic inside the body, so its maximum over
    the body is on the surface. Points deep inside another limb are left out.

    Examples
    --------
    >>> person = Person(height=1.7, keypoints={"right_hand": [0.4, -0.2, 1.1]})
    >>> person.height, len(person.limbs())
    (1.7, 19)
    """

    kind: ClassVar[str] = "person"
    default_weight: ClassVar[float] = 1.0
    height: float = key(document.number, default=_DEFAULT_HEIGHT, at_least=_HEIGHTS[0], at_most=_HEIGHTS[1])
    keypoints: Mapping[str, Sequence[float]] = key(
        document.mapping_of, factory=dict, read=document.numbers, known=STANDING, count=3
    )
    only: tuple[str, ...] = key(document.list_of, default=(), read=_limb)

    def check(self) -> None:
        """Raise InputError if the key points contradict each other."""
        with document.within("keypoints"):
            self.limbs()

    def with_measurement(self, measured: Any, pose: Pose) -> Person:
        """Return the person with new key points in the world frame, which replace all earlier ones."""
        points = document.mapping("keypoints", measured, STANDING)
        return Person(self.height, _in_frame(pose, points), self.only)

    def same_body(self, other: Shape) -> bool:
        """Return whether another person has the same height and the same limbs."""
        if not isinstance(other, Person) or other.height != self.height:
            return False
        return [limb.name for limb in other.limbs()] == [limb.name for limb in self.limbs()]

    def limbs(self) -> tuple[Limb, ...]:
        """Return the capsules of the person, in the frame of the person."""
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
        # Lengths of the capsules' surfaces from pole to pole.
        along = np.pi * radii + np.linalg.norm(ends - starts, axis=1)
        return float(((along / spacing + 4) * (2 * np.pi * radii / spacing + 1)).sum())

    def danger_points(self, spacing: float) -> FloatArray:
        return surfaces.capsule_points(*self._capsules, spacing)

    def triangles(self, resolution: int) -> Triangles:
        pieces = [(limb.placement, limb.shape.triangles(resolution)) for limb in self.limbs()]
        return surfaces.joined([(placed(placement, vertices), faces) for placement, (vertices, faces) in pieces])


def with_own_keypoints(data: Mapping[str, Any], pose: Pose) -> dict[str, Any]:
    """Return the mapping of a person with `world_keypoints` converted to `keypoints`, which they override."""
    own = dict(data)
    world = document.mapping("world_keypoints", own.pop("world_keypoints", {}), STANDING)
    with document.within("world_keypoints"):
        moved = _in_frame(pose, world)
    return {**own, "keypoints": {**document.mapping("keypoints", own.get("keypoints", {})), **moved}} if moved else own


def _in_frame(pose: Pose, points: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Convert key points from the world frame to the frame of the person [m]."""
    world = [document.numbers(name, point, 3) for name, point in points.items()]
    own = placed(pose.se3.inverse(), np.reshape(world, (-1, 3))).tolist()
    return {name: tuple(point) for name, point in zip(points, own, strict=True)}
