"""Objects in the gripper: shapes that are fixed to a link and go where it goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.common import documents as document
from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere
from safe_ompl.robot.loading.parts import RobotParts
from safe_ompl.robot.reach import bounding_hull
from safe_ompl.robot.skeleton import Skeleton, frame_index

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
    link : str
        The link (or other frame) that it is fixed to.
    pose : Pose
        Where it is in the frame of the link.
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
        return cls(
            body.name, body.shape, link, body.pose, read.get("touch_links", ()), read.get("danger", False)
        )

    def to_mapping(self, folder: Path | None) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        data = {"link": self.link, **Obstacle(self.name, self.shape, self.pose, 0.0).to_mapping()}
        fields = data[self.shape.kind]
        if "file" in fields:
            fields["file"] = document.file_name(fields["file"], folder)
        if self.touch_links:
            data["touch_links"] = list(self.touch_links)
        return {**data, "danger": True} if self.danger else data

    def fixed_to(self, parts: RobotParts) -> RobotParts:
        """Return the parts of a robot with the object in its gripper.

        Raises
        ------
        UnknownNameError
            If there is no such link.
        InputError
            If something has the object's name already, or no key point is below it where danger is wanted.
        """
        links = [frame.name for frame in list(parts.model.frames)[1:]]
        for name in (self.link, *self.touch_links):
            if name not in links:
                raise UnknownNameError(f"link for {self.name!r}", name, links, parts.name)
        if self.name in [*links, *_links(parts.collision_model)]:
            raise InputError(f"a link or frame is called {self.name!r}: give another name", parts.name)
        frame = frame_index(parts.model, self.link)
        collision_model = self._added(parts.collision_model, parts.model, frame)
        self._add_pairs(collision_model, len(parts.collision_model.geometryObjects))
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

        return replace(parts, model=model, collision_model=collision_model, read_visual=visual, tips=tips)

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
    """Return `value` as a pose; a mapping is read as in a document, three numbers are a position [m].

    Raises
    ------
    InputError
        If it is none of these.
    """
    if value is None:
        return Pose()
    if isinstance(value, Pose):
        return value
    if isinstance(value, pin.SE3):
        return Pose(
            tuple(value.translation.tolist()), tuple(pin.Quaternion(value.rotation).coeffs().tolist())
        )
    with document.within(key):
        if isinstance(value, Mapping):
            document.check_keys(value, ("position", "quaternion_xyzw", "rpy", "yaw"))
            return Pose.from_mapping(value)
        return Pose(tuple(document.numbers("position", value, 3)))


def _links(geometry: pin.GeometryModel) -> list[str]:
    return [_link(part.name) for part in geometry.geometryObjects]


def _link(body: str) -> str:
    """Return the link of a body: Pinocchio calls its bodies link_0, link_1 and so on."""
    return body.rsplit("_", 1)[0]
