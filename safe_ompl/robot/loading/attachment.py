"""Objects in the gripper, and the poses that users give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import pinocchio as pin

from safe_ompl.common import InputError
from safe_ompl.common import documents as document
from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Pose, Shape, Sphere

_SHAPES = (Box, Sphere, Cylinder, Capsule, Mesh)
_KEYS = ("link", "touch_links", "danger")

PoseLike: TypeAlias = Pose | pin.SE3 | Mapping[str, Any] | Sequence[float]


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
        object.__setattr__(self, "pose", as_pose(self.pose))
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


def attachments(data: Any, folder: Path) -> tuple[Attachment, ...]:
    """Read the list of attached objects of a document."""
    found = []
    for k, item in enumerate(document.sequence("attached", data)):
        with document.within(f"attached[{k}]"):
            found.append(Attachment.from_mapping(item, folder))
    return tuple(found)


def as_pose(value: PoseLike | None, key: str = "pose") -> Pose:
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
