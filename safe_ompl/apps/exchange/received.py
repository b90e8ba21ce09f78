"""What messages of ROS say of people, joints, obstacles and clouds, as arrays in the world, newest first; without ROS.

Messages are objects with the fields of their types, as `messages.decoded` and rclpy have them. Measurements may come
late, out of order or not at all: see `Sightings`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.apps.exchange.messages import WORLD
from safe_ompl.collision import robot_points
from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.geometry import Obstacle, PointCloud, Pose, placed
from safe_ompl.motions import Motion
from safe_ompl.people import Skeleton, Surroundings
from safe_ompl.robot import Robot

DELETIONS = (2, 3)  # actions of a marker
CLOUD = "cloud"
_NEAR_PEOPLE = 0.15  # [m] points that are nearer to a tracked limb are the person's
_NEW = 3.0  # radii: points that are farther from all points of the cloud before are new
_FEW = 10  # new points that are taken for noise


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


# ------------------------------------------------------------------------------------------------- what was seen last


class Sightings:
    """The newest measurement of each of some people and objects.

    The replanner takes all of them as of one time T. That is the oldest of the newest measurements. For who was seen
    later, at s > T, reach sets that begin at T hold those that begin at s: they have had more time to grow. Who was not
    seen for `lost_after` [s] does not count; the replanner stops for them. Clocks of sensors may be off by
    `clock_error` [s]: all measurements are taken to be so much older.
    """

    def __init__(self, names: Collection[str], lost_after: float, clock_error: float) -> None:
        self._names, self._lost_after, self._error = tuple(names), lost_after, clock_error
        self._newest: dict[str, tuple[float, Any]] = {}
        self._fed = -np.inf

    def add(self, name: str, stamp: float, now: float, value: Any) -> None:
        """Take a measurement of a time [s] if it is newer than that before; raise InputError if it is of the future."""
        time = stamp - self._error
        if time > now:
            raise InputError(f"{name!r} was measured {stamp - now:.3f} s in the future: the clocks differ", "stamp")
        if name not in self._newest or time > self._newest[name][0]:
            self._newest[name] = time, value

    def restart(self) -> None:
        """Begin anew: nobody was told of anything yet."""
        self._fed = -np.inf

    def due(self, now: float) -> tuple[float, dict[str, Any]] | None:
        """Return what the replanner should be told, and of which time [s]; None: nothing new."""
        if not self._names:
            return now, {}
        fresh = [time for time, _ in self._newest.values() if time > now - self._lost_after]
        if not fresh or min(fresh) <= self._fed:
            return None
        self._fed = min(fresh)
        return self._fed, {name: value for name, (time, value) in self._newest.items() if time >= self._fed}


class Joints(NamedTuple):
    """Measured joints."""

    time: float  # [s]
    q: FloatArray
    qd: FloatArray


class CloudView(NamedTuple):
    """Points of the newest cloud that are neither the robot's nor a tracked person's, in the world."""

    points: FloatArray  # (M, 3) [m]
    radius: float  # Of the ball about each point [m]

    @classmethod
    def seen(
        cls, points: FloatArray, radius: float, robot: Robot, q: FloatArray, around: Surroundings | None
    ) -> CloudView:
        """Return what is left of points (M, 3), seen while the robot was at `q: (n,)`."""
        kept = points[np.isfinite(points).all(axis=1)]
        kept = kept[~robot_points(kept, robot, q, radius)]
        for person in () if around is None else around.people.values():
            if person.keypoints is None or not len(kept):
                continue
            ends = person.tracker.body.ends(person.keypoints)
            for (start, end), width in zip(ends, person.tracker.body.radii(ends), strict=True):
                kept = kept[_from_segment(kept, start, end) > width + _NEAR_PEOPLE]
        return cls(kept, radius)

    def obstacle(self) -> Obstacle | None:
        """Return the points as an obstacle; None if there are none."""
        return Obstacle(CLOUD, PointCloud(self.radius, points=self.points)) if len(self.points) else None

    def news(self, before: CloudView | None) -> int:
        """Return how many points are far from all points of the cloud before; 0 if they are as few as noise."""
        edge = _NEW * self.radius
        old = np.zeros((0, 3)) if before is None else before.points
        known = {tuple(cell) for cell in np.floor(old / edge).astype(int).tolist()}
        cells = np.floor(self.points / edge).astype(int)
        steps = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
        new = sum(not any((x + i, y + j, z + k) in known for i, j, k in steps) for x, y, z in cells.tolist())
        return new if new > _FEW else 0


def _from_segment(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the distances (M,) of points from a segment [m]."""
    way = end - start
    share = np.clip((points - start) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * way, axis=1))


def by_name(names: Collection[str], values: Collection[float], wanted: Collection[str]) -> FloatArray:
    """Return the values of the wanted joints (n,), whatever their order; raise InputError if one is missing or NaN."""
    if len(names) != len(values):
        raise InputError(f"must be as many as the {len(names)} names, got {len(values)}", "position")
    given: Mapping[str, float] = dict(zip(names, values, strict=True))
    missing = [name for name in wanted if name not in given]
    if missing:
        raise InputError(f"{', '.join(missing)} missing, but needed", "name")
    found = np.array([given[name] for name in wanted], dtype=float)
    if not np.isfinite(found).all():
        raise InputError(f"must be finite, got {found.tolist()}", "position")
    return found


def goal_of(robot: Robot, names: Collection[str], position: Collection[float]) -> FloatArray:
    """Return the configuration (n,) of a message; raise InputError as `by_name`, and outside the limits."""
    q = by_name(names, position, robot.joint_names)
    for k in np.flatnonzero((q < robot.lower) | (q > robot.upper)):
        raise InputError(f"is out of the limits of {robot.joint_names[k]!r}: {q[k]:g}", "position")
    return q
