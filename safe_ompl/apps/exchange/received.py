"""What messages of ROS say of people, joints, obstacles and clouds, as arrays in the world; without ROS.

Messages are objects with the fields of their types, as `messages.decoded` and rclpy have them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.apps.exchange.sightings import by_name
from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.geometry import PointCloud, Pose, placed
from safe_ompl.motions import Motion
from safe_ompl.people import Skeleton
from safe_ompl.robot import Robot

WORLD = "world"
DELETIONS = (2, 3)  # actions of a marker


class Frames:
    """Where frames are in the world: the world itself, links that the robot's joints do not move, and given ones."""

    def __init__(self, robot: Robot, given: Mapping[str, Pose]) -> None:
        fixed = [frame for frame in robot.shared.model.frames if frame.parentJoint == 0]
        self._places = {frame.name: frame.placement for frame in fixed if frame.name != "universe"}
        self._places |= {WORLD: pin.SE3.Identity(), **{name: pose.se3 for name, pose in given.items()}}

    def place(self, header: Any) -> pin.SE3:
        """Return where the frame of a header is; raise InputError if that is not known."""
        if not header.frame_id:
            raise InputError("is empty: say in which frame it is", "frame_id")
        name = header.frame_id.removeprefix("/")
        if name not in self._places:
            raise UnknownNameError("frame", name, self._places, "frame_id")
        return self._places[name]


def in_metres(skeleton: Skeleton) -> Skeleton:
    """Return a skeleton as messages of ROS have it, whoever made them: in metres, x forward, y left, z up."""
    return Skeleton(skeleton.name, skeleton.points, skeleton.sources)


def stamp_of(header: Any) -> float:
    """Return the time of a header [s]; raise InputError if it has none."""
    time = header.stamp.sec + 1e-9 * header.stamp.nanosec
    if time <= 0:
        raise InputError("is missing, but needed: when was it measured?", "stamp")
    return float(time)


def people_of_markers(message: Any, skeleton: Skeleton, frames: Frames) -> tuple[float, dict[str, FloatArray]]:
    """Return the time [s] of a `MarkerArray` and the key points (J, 3) of its people [m]; NaN: not seen.

    The namespace is the person. The text is the name of the key point; without a text the id is its number. Raises
    InputError if there is no marker, a stamp is missing, a frame is not known, or a key point is not one of the
    skeleton's.
    """
    people: dict[str, FloatArray] = {}
    shown = [marker for marker in message.markers if marker.action not in DELETIONS]
    if not shown:
        stamps = [stamp_of(marker.header) for marker in message.markers]
        if not stamps:
            raise InputError("has no markers, and so no time", "markers")
        return max(stamps), {}
    time = min(stamp_of(marker.header) for marker in shown)  # who was seen later could go farther since then
    index = {name: k for k, name in enumerate(skeleton.points)}
    for marker in shown:
        points = people.setdefault(marker.ns, np.full((len(index), 3), np.nan))
        if marker.text:
            if marker.text not in index and marker.text != "pelvis":
                raise UnknownNameError(f"key point of {skeleton.name}", marker.text, index, marker.ns)
            k = index.get(marker.text, -1)
        else:
            k = marker.id
            if not 0 <= k < len(index):
                raise InputError(f"{skeleton.name} has {len(index)} key points, got {k}", f"{marker.ns}: id")
        if k >= 0:
            points[k] = _keypoint(marker.pose.position, frames.place(marker.header))
    return time, people


def person_of_poses(message: Any, skeleton: Skeleton, frames: Frames) -> tuple[float, FloatArray]:
    """Return the time [s] of a `PoseArray` and the key points (J, 3) that its poses are [m]; errors as for markers."""
    if len(message.poses) != len(skeleton.points):
        raise InputError(f"{skeleton.name} has {len(skeleton.points)} key points, got {len(message.poses)}", "poses")
    frame = frames.place(message.header)
    return stamp_of(message.header), np.array([_keypoint(pose.position, frame) for pose in message.poses])


def pose_of(message: Any, frames: Frames) -> tuple[float, Pose]:
    """Return the time [s] of a `PoseStamped` and the pose in the world; raise InputError if there is none."""
    position, turn = message.pose.position, message.pose.orientation
    pose = Pose((position.x, position.y, position.z), (turn.x, turn.y, turn.z, turn.w))
    return stamp_of(message.header), Pose.of(frames.place(message.header) * pose.se3)


def proposal_of(message: Any, robot: Robot) -> tuple[Motion | FloatArray, float | None]:
    """Return what a `JointTrajectory` proposes, and when it begins [s]; None: at once, where it has no stamp.

    It is the motion that a controller would make of its points; or, where the first point has no positions, the
    velocities (n,) of that point. Raises InputError if a joint is missing, a number is not finite, or it is no motion
    as `Motion.hermite` says.
    """
    points = message.points
    if not points:
        raise InputError("has no points", "points")
    if not len(points[0].positions):
        return by_name(message.joint_names, points[0].velocities, robot.joint_names), None
    times = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points]
    positions, velocities, accelerations = (
        [by_name(message.joint_names, getattr(point, key), robot.joint_names) for point in points]
        if any(len(getattr(point, key)) for point in points)
        else None
        for key in ("positions", "velocities", "accelerations")
    )
    assert positions is not None
    begin = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    start = begin + times[0] if begin > 0 else None
    return Motion.hermite(times, positions, velocities, accelerations, robot.joint_names), start


def cloud_of(message: Any, radius: float, frames: Frames) -> tuple[float, FloatArray]:
    """Return the time [s] of a `PointCloud2` and its finite points (M, 3) in the world [m]; errors as `PointCloud`."""
    points = PointCloud.from_message(message, radius).centres if message.width * message.height else np.zeros((0, 3))
    return stamp_of(message.header), placed(frames.place(message.header), points)


def _keypoint(place: Any, frame: pin.SE3) -> FloatArray:
    """Return where a key point of a frame is in the world (3,); NaN: not seen."""
    given = np.array([place.x, place.y, place.z], dtype=float)
    if not np.isfinite(given).all() and not np.isnan(given).all():
        raise InputError(f"must be finite, or all NaN where it is not seen, got {given.tolist()}", "key point")
    return np.asarray(placed(frame, given[None])[0])
