"""Depth cameras: intrinsics, pose, noise and rate, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import InputError, Section, documents as document, files, key
from safe_ompl.geometry import Pose

_PLACE = ("position", "quaternion_xyzw", "rpy", "yaw", "at")


@dataclass(frozen=True)
class DepthCamera(Section):
    """A pinhole camera that measures depths along its axis; raises InputError if a value is out of its range."""

    width: int = key(document.whole_number, at_least=1)
    height: int = key(document.whole_number, at_least=1)
    focal: tuple[float, float] = key(document.numbers, count=2)  # fx and fy of the rectified image [px]
    middle: tuple[float, float] = key(document.numbers, count=2, at_least=0.0)  # cx and cy, its principal point [px]
    pose: Pose = field(default_factory=Pose)  # Of its optical frame in the world: x right, y down, z forward
    near: float = key(document.number, default=0.2, above=0.0)  # Depths that are less say nothing [m]
    far: float = key(document.number, default=6.0)  # Larger depths count as this [m]
    # A depth z is wrong by at most noise[0] + noise[1] · z² [m]; default: 4 σ of a Kinect (Nguyen, Izadi & Lovell 2012)
    noise: tuple[float, float] = key(document.numbers, default=(0.005, 0.0076), count=2, at_least=0.0)
    # How far points may be off because of the pose, besides [m]
    error: float = key(document.number, default=0.005, at_least=0.0)
    block: int = key(document.whole_number, default=4, at_least=1)  # Pixels on a side of the blocks that are looked at
    rate: float = key(document.number, default=30.0, above=0.0)  # Images a second, in simulations

    def check(self) -> None:
        document.number("focal", min(self.focal), above=0.0)
        if not (self.middle[0] < self.width and self.middle[1] < self.height):
            size = f"{self.width} × {self.height} pixels"
            raise InputError(f"{list(self.middle)} lies outside of the image of {size}", "middle")
        document.number("far", self.far, above=self.near)

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any], folder: Path | None = None) -> DepthCamera:
        """Read a camera: ``size`` and ``focal``, its ``position`` with ``at``, a point it looks at, or with a turn.

        All else has defaults, ``middle`` is the middle of the image. Errors as of the class; they start with the key.
        """
        own = ("near", "far", "noise", "error", "block", "rate")
        document.check_keys(data, ("size", "focal", "middle", *own, *_PLACE))
        size = document.require(data, "size")
        width, height = document.each("size", size, document.whole_number, count=2, at_least=1)
        middle = data.get("middle", ((width - 1) / 2, (height - 1) / 2))
        position = document.numbers("position", document.require(data, "position"), 3)
        if "at" in data:
            pose = looking(position, document.numbers("at", data["at"], 3))
        else:
            pose = Pose.from_mapping({key: data[key] for key in _PLACE if key in data})
        more = {key: data[key] for key in own if key in data}
        return cls(width, height, document.require(data, "focal"), middle, pose, **more)


def read_cameras(file: str | Path) -> dict[str, DepthCamera]:
    """Read the cameras of a file (YAML) by name; an InputError names file, line, key and value that it cannot use."""
    with files.reading(Path(file)) as data:
        document.check_keys(data, ("cameras",))
        read = partial(document.section, kind=DepthCamera)
        return document.by_name("cameras", document.require(data, "cameras"), read, least="camera")


def looking(place: tuple[float, ...], at: tuple[float, ...]) -> Pose:
    """Return the pose of an optical frame at a place that looks at a point, with the image upright [m]."""
    ahead = np.array(at) - place
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    if not np.linalg.norm(right) > 1e-6 * np.linalg.norm(ahead) > 0.0:
        raise InputError(f"must not be above or below {list(place)}, got {list(at)}: give a turn instead", "at")
    ahead, right = ahead / np.linalg.norm(ahead), right / np.linalg.norm(right)
    return Pose.of(pin.SE3(np.column_stack([right, np.cross(ahead, right), ahead]), np.array(place)))


class DepthFrame(NamedTuple):
    """What a camera saw at an instant.

    Depths (H, W), in metres or as unsigned whole numbers in millimetres; or points (N, 3), in its optical frame [m].
    """

    depths: ArrayLike
    time: float  # When [s]
    q: ArrayLike  # Where the robot was then (n,)
    pose: Pose | None = None  # Where the camera was then, if it moves; default: its own
