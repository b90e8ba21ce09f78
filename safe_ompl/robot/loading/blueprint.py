"""Blueprints of robots: plain data that build them, and changes of them (a base, an object in the gripper, a cell).

A blueprint is plain data that travels between processes; `assemble` builds the parts of the robot from it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.common import documents as document
from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere
from safe_ompl.robot.joint_tables import Skeleton, frame_index
from safe_ompl.robot.loading.parts import BASE_JOINTS, RobotParts, combined
from safe_ompl.robot.reach import bounding_hull

_SHAPES = (Box, Sphere, Cylinder, Capsule, Mesh)
_KEYS = ("link", "touch_links", "danger")
_COLOR = np.array([0.55, 0.62, 0.7, 1.0])


@dataclass(frozen=True)
class Attachment:
    """An object that a robot holds.

    Parameters
    ----------
    name : str
        Its name, different from those of links and frames.
    shape : Shape
        A shape of `safe_ompl.geometry`.
    link, pose : str, Pose
        The link (or other frame) that it is fixed to, and where it is in its frame.
    touch_links : sequence of str
        Links that it may touch, besides those that are rigidly connected with `link`.
    danger : bool
        Make it a link of the skeleton: from the key point below it to its far end.
    """

    name: str
    shape: Shape
    link: str
    pose: Pose = field(default_factory=Pose)
    touch_links: tuple[str, ...] = ()
    danger: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.shape, _SHAPES):
            kinds = ", ".join(kind.__name__ for kind in _SHAPES)
            raise InputError(f"must be one of {kinds}, not {self.shape!r}", "attached shape")
        for key in ("name", "link"):
            document.text(key, getattr(self, key))
        document.flag("danger", self.danger)
        names = document.sequence("touch_links", self.touch_links)
        object.__setattr__(self, "touch_links", tuple(document.text("touch_links", name) for name in names))

    @classmethod
    def from_mapping(cls, data: Any, folder: Path) -> Attachment:
        """Read an object as an obstacle of a scene is written (shape and pose), with `link` and the other keys."""
        read = document.mapping("attached", data)
        link = document.text("link", document.require(read, "link"))
        body = Obstacle.from_mapping({key: value for key, value in read.items() if key not in _KEYS}, folder)
        return cls(body.name, body.shape, link, body.pose, read.get("touch_links", ()), read.get("danger", False))

    def to_mapping(self, folder: Path | None) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        data = {"link": self.link, **Obstacle(self.name, self.shape, self.pose, 0.0).to_mapping(folder)}
        if self.touch_links:
            data["touch_links"] = list(self.touch_links)
        return {**data, "danger": True} if self.danger else data

    def fixed_to(self, parts: RobotParts) -> RobotParts:
        """Return the parts of a robot with the object in its gripper.

        Raises UnknownNameError if there is no such link, InputError if something has the object's name already, or no
        key point is below it where danger is wanted.
        """
        links = [frame.name for frame in list(parts.model.frames)[1:]]
        for name in (self.link, *self.touch_links):
            if name not in links:
                raise UnknownNameError(f"link for {self.name!r}", name, links, parts.name)
        bodies = parts.collision_model.geometryObjects
        if self.name in [*links, *(_link(body.name) for body in bodies)]:
            raise InputError(f"a link or frame is called {self.name!r}: give another name", parts.name)
        frame = frame_index(parts.model, self.link)
        collision_model = self._added(parts.collision_model, parts.model, frame)
        self._add_pairs(collision_model, len(bodies))
        model, tips = parts.model, parts.tips
        if self.danger:
            model = model.copy()
            end = pin.SE3(np.eye(3), self._far_end(parts, frame))
            joint = model.frames[frame].parentJoint
            model.addFrame(pin.Frame(self.name, joint, frame, end, pin.FrameType.OP_FRAME), False)
            tips = (*tips, self.name)

        def visual() -> pin.GeometryModel | None:
            drawn = parts.read_visual()
            return None if drawn is None else self._added(drawn, parts.model, frame)

        held = (*parts.attached, self)
        return replace(
            parts, model=model, collision_model=collision_model, read_visual=visual, tips=tips, attached=held
        )

    def _added(self, geometry: pin.GeometryModel, model: pin.Model, frame: int) -> pin.GeometryModel:
        """Return a copy of `geometry` with the parts of the object, named as those of a link."""
        copy, link = geometry.copy(), model.frames[frame]
        for k, part in enumerate(self.shape.parts()):
            place = link.placement * self.pose.se3 * part.placement
            body = pin.GeometryObject(f"{self.name}_{k}", link.parentJoint, frame, place, part.geometry)
            body.meshColor = _COLOR
            copy.addGeometryObject(body)
        return copy

    def _add_pairs(self, geometry: pin.GeometryModel, first: int) -> None:
        """Check the bodies from `first` on against those before that move against them and may not touch."""
        bodies = list(geometry.geometryObjects)
        for k in range(first):
            if bodies[k].parentJoint == bodies[first].parentJoint:
                continue
            if _link(bodies[k].name) not in self.touch_links:
                for own in range(first, len(bodies)):
                    geometry.addCollisionPair(pin.CollisionPair(k, own))

    def _far_end(self, parts: RobotParts, frame: int) -> FloatArray:
        """Return the far end of the object, seen from the key point below it, in the frame of their joint [m]."""
        link = parts.model.frames[frame]
        key = Skeleton.from_model(parts.model, parts.link_ends, parts.tips).nearest(parts.model, frame)
        if key is None or link.parentJoint == 0:
            raise InputError(
                f"{self.name!r} has no danger: no joint of the skeleton is below {self.link!r}", parts.name
            )
        start = parts.model.frames[key].placement.translation
        hulls = [
            bounding_hull(part.geometry).moved(link.placement * self.pose.se3 * part.placement)
            for part in self.shape.parts()
        ]
        points = np.concatenate([hull.points for hull in hulls])
        center = (points.min(axis=0) + points.max(axis=0)) / 2
        way = center - start
        length = float(np.linalg.norm(way))
        if length < 1e-6:  # the key point is the middle of the object: any end will do
            farthest: FloatArray = points[np.linalg.norm(points - start, axis=1).argmax()]
            return farthest
        way = way / length
        reach = max(float(((hull.points - start) @ way).max()) + hull.radius for hull in hulls)
        end: FloatArray = start + reach * way
        return end


def attachments(data: Any, folder: Path) -> tuple[Attachment, ...]:
    """Read the list of attached objects of a document."""
    found = []
    for k, item in enumerate(document.sequence("attached", data)):
        with document.within(f"attached[{k}]"):
            found.append(Attachment.from_mapping(item, folder))
    return tuple(found)


def as_pose(value: Pose | pin.SE3 | Mapping[str, Any] | Sequence[float] | None, key: str = "pose") -> Pose:
    """Return `value` as a pose: a mapping is read as in a document, three numbers are a position [m]; or InputError."""
    if value is None:
        return Pose()
    if isinstance(value, Pose):
        return value
    if isinstance(value, pin.SE3):
        return Pose(tuple(value.translation.tolist()), tuple(pin.Quaternion(value.rotation).coeffs().tolist()))
    with document.within(key):
        if isinstance(value, Mapping):
            document.check_keys(value, ("position", "quaternion_xyzw", "rpy", "yaw"))
            return Pose.from_mapping(value)
        return Pose(tuple(document.numbers("position", value, 3)))


def _link(body: str) -> str:
    """Return the link of a body: Pinocchio calls its bodies link_0, link_1 and so on."""
    return body.rsplit("_", 1)[0]


RangeByJoint: TypeAlias = Mapping[str, tuple[float, float]]
PoseLike: TypeAlias = Pose | pin.SE3 | Mapping[str, Any] | Sequence[float]
Ranges: TypeAlias = Sequence[Sequence[float]]


class Blueprint(ABC):
    """How to build a robot."""

    @abstractmethod
    def assemble(self) -> RobotParts:
        """Build the parts of the robot."""

    @abstractmethod
    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Return the blueprint of the same robot with other limits [rad or m] for the joints named."""

    def state(self, name: str) -> dict[str, float]:
        """Return a named state of the robot's SRDF by joint [rad or m]; raise InputError if there is none."""
        raise InputError(f"no state {name!r}: states come with an SRDF")

    def without(self, name: str) -> Blueprint:
        """Return the blueprint of the same robot without an object that it holds."""
        return self


@dataclass(frozen=True)
class _Change(Blueprint):
    """A robot that is another one, changed."""

    of: Blueprint

    def assemble(self) -> RobotParts:
        return self.applied(self.of.assemble())

    @abstractmethod
    def applied(self, parts: RobotParts) -> RobotParts:
        """Return `parts`, changed."""

    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        return replace(self, of=self.of.with_limits(limits))

    def state(self, name: str) -> dict[str, float]:
        return self.of.state(name)

    def without(self, name: str) -> Blueprint:
        return replace(self, of=self.of.without(name))


@dataclass(frozen=True)
class OnBase(_Change):
    """A robot whose base is at `pose` in the world."""

    pose: Pose

    def applied(self, parts: RobotParts) -> RobotParts:
        return parts.placed(self.pose.se3)


@dataclass(frozen=True)
class OnMobileBase(_Change):
    """A robot on a base that slides in x and y within `ranges` [m], and turns."""

    ranges: tuple[tuple[float, float], tuple[float, float]]

    def applied(self, parts: RobotParts) -> RobotParts:
        return parts.on_mobile_base(self.ranges)

    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Keep those of the base, pass the others on."""
        if BASE_JOINTS[2] in limits:
            raise InputError(f"joint {BASE_JOINTS[2]!r} is continuous: it has no limits")
        x, y = (limits.get(name, old) for name, old in zip(BASE_JOINTS, self.ranges, strict=False))
        rest = {name: limit for name, limit in limits.items() if name not in BASE_JOINTS}
        return OnMobileBase(self.of.with_limits(rest) if rest else self.of, mobile_ranges((x, y)))


@dataclass(frozen=True)
class Attached(_Change):
    """A robot that holds an object."""

    attachment: Attachment

    def applied(self, parts: RobotParts) -> RobotParts:
        return self.attachment.fixed_to(parts)

    def without(self, name: str) -> Blueprint:
        return self.of if name == self.attachment.name else super().without(name)


@dataclass(frozen=True)
class WithAccelerations(_Change):
    """A robot whose acceleration limits are known, by joint [rad/s² or m/s²]."""

    limits: Mapping[str, float]

    def applied(self, parts: RobotParts) -> RobotParts:
        return replace(parts, accelerations={**parts.accelerations, **self.limits})


@dataclass(frozen=True)
class Combined(Blueprint):
    """Several robots in one cell as one robot; see `Robot.combined`."""

    name: str
    robots: Mapping[str, Blueprint]
    tip: str

    def assemble(self) -> RobotParts:
        return self.joined({prefix: blueprint.assemble() for prefix, blueprint in self.robots.items()})

    def joined(self, parts: Mapping[str, RobotParts]) -> RobotParts:
        """Return the parts of the robots as those of one."""
        return combined(self.name, parts, self.tip)

    def state(self, name: str) -> dict[str, float]:
        """Return the states of that name of all robots that have one, under the names that joints have here."""
        found, refused = dict[str, float](), None
        for prefix, blueprint in self.robots.items():
            try:
                found |= {f"{prefix}_{joint}": value for joint, value in blueprint.state(name).items()}
            except InputError as error:
                refused = error
        if refused is not None and not found:
            raise refused
        return found

    def without(self, name: str) -> Blueprint:
        """Take the object from the robot with the prefix of its name."""
        robots = {
            prefix: robot.without(name.removeprefix(f"{prefix}_")) if name.startswith(f"{prefix}_") else robot
            for prefix, robot in self.robots.items()
        }
        return replace(self, robots=robots)

    def with_limits(self, limits: RangeByJoint) -> Blueprint:
        """Give each robot the limits of the joints with its prefix."""
        robots, rest = dict(self.robots), dict(limits)
        for prefix, blueprint in self.robots.items():
            own = {name: rest.pop(name) for name in list(rest) if name.startswith(f"{prefix}_")}
            if own:
                robots[prefix] = blueprint.with_limits(
                    {name.removeprefix(f"{prefix}_"): limit for name, limit in own.items()}
                )
        if rest:
            raise UnknownNameError("prefix of the joint with limits", next(iter(rest)), self.robots, self.name)
        return replace(self, robots=robots)


def mobile_ranges(value: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of a mobile base in x and y [m], or raise InputError if they are not two intervals."""
    intervals = document.sequence("mobile_base", value)
    if len(intervals) != 2:
        raise InputError(f"must be the limits in x and in y, ((x0, x1), (y0, y1)), not {value!r}", "mobile_base")
    x, y = (document.interval("mobile_base", interval) for interval in intervals)
    return x, y


def check_prefixes(prefixes: Iterable[str]) -> None:
    """Raise InputError if a name that begins with one prefix may belong to another."""
    known = sorted(prefixes)
    for one in known:
        for other in known:
            if other.startswith(f"{one}_"):
                raise InputError(f"the prefixes {one!r} and {other!r} cannot be told apart in '{other}_…'")


def standing(blueprint: Blueprint, base: PoseLike | None, mobile_base: Ranges | None) -> Blueprint:
    """Return the blueprint of a robot on its base."""
    if mobile_base is not None:
        blueprint = OnMobileBase(blueprint, mobile_ranges(mobile_base))
    return blueprint if base is None else OnBase(blueprint, as_pose(base, "base"))
