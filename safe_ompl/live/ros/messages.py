"""Encoding and decoding of ROS 2 messages (CDR) without ROS, for logs and for the node.

A message to write is a mapping with the keys of its type; missing fields are zero, empty or false. A message that was
read has the fields of its type as attributes, and is converted to arrays in the world frame. The definitions are those
of ROS 2 Humble; later releases have the same definitions of all types used here. Times of messages are whole
nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.geometry import Obstacle, PointCloud, Pose, placed
from safe_ompl.live import Skeleton
from safe_ompl.motions import Motion
from safe_ompl.robot import Robot

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MARKERS = "visualization_msgs/msg/MarkerArray"
BOOL = "std_msgs/msg/Bool"
SECOND = 10**9  # [ns]
OK, WARN, ERROR = range(3)  # levels of diagnostic_msgs/DiagnosticStatus
WORLD = "world"
_SPHERE, _TRIANGLES = 2, 11  # types of markers
_DELETE, _DELETE_ALL = 2, 3  # actions of markers
# The diameter of the marker of a key point.
_KEYPOINT = 0.05  # [m]
_OBSTACLE_COLORS, _DANGEROUS = (0.8, 0.68, 0.53), (0.85, 0.45, 0.3)
_SEEN = (0.83, 0.43, 0.29)
_SEGMENTS = 24  # corners of round shapes
# Kinds of fields in rosbags.
_NAME, _SEQUENCES = 2, (3, 4)
_NUMBERS = {"float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}

Message = dict[str, Any]


@cache
def types_of_ros() -> Any:
    """Return the type store of ROS 2 Humble; this needs the extra `mcap`."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def nanoseconds(time: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return round(SECOND * time)


def encoded(kind: str, content: Mapping[str, Any]) -> bytes:
    """Return the bytes of a message of a type, such as `JOINT_STATE`."""
    return bytes(types_of_ros().serialize_cdr(_filled(kind, content), kind))


def decoded(kind: str, data: bytes) -> Any:
    """Decode the bytes of a message of a type; its fields are attributes, and sequences of numbers are arrays."""
    return types_of_ros().deserialize_cdr(data, kind)


def definition(kind: str) -> str:
    """Return the definition of a type, with those of the types of its fields."""
    return str(types_of_ros().generate_msgdef(kind, ros_version=2)[0])


def _filled(kind: str, content: Mapping[str, Any]) -> Any:
    fields = dict(types_of_ros().fielddefs[kind][1])
    assert set(content) <= set(fields), (kind, set(content) - set(fields))
    return types_of_ros().types[kind](**{name: _value(field, content.get(name)) for name, field in fields.items()})


def _value(field: Any, given: Any) -> Any:
    """Return the value of a field in the form of rosbags; None means the default value."""
    kind, detail = field
    if kind == _NAME:
        return _filled(detail, given or {})
    if kind in _SEQUENCES:
        inner, length = detail
        if inner[1][0] in _NUMBERS:
            return np.asarray([0] * (length if kind == 3 else 0) if given is None else given, inner[1][0])
        return [_value(inner, item) for item in given or ()]
    name = detail[0]
    empty: Any = "" if name == "string" else False if name == "bool" else 0
    return empty if given is None else float(given) if name.startswith("float") else given


# ------------------------------------------------------------------------------------------------------- parts


def stamp(time: int) -> Message:
    """Return a time [ns] as `builtin_interfaces/Time` or `Duration`."""
    seconds, rest = divmod(time, SECOND)
    return {"sec": seconds, "nanosec": rest}


def header(time: int, frame: str = "") -> Message:
    """Return a `std_msgs/Header` of a time [ns] and a frame."""
    return {"stamp": stamp(time), "frame_id": frame}


def vector(values: ArrayLike) -> Message:
    """Return three numbers as `geometry_msgs/Point` or `Vector3`."""
    x, y, z = np.asarray(values, dtype=float).tolist()
    return {"x": x, "y": y, "z": z}


def pose(position: ArrayLike, quaternion_xyzw: ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> Message:
    """Return a `geometry_msgs/Pose`."""
    x, y, z, w = np.asarray(quaternion_xyzw, dtype=float).tolist()
    return {"position": vector(position), "orientation": {"x": x, "y": y, "z": z, "w": w}}


def colour(values: Sequence[float]) -> Message:
    """Return red, green and blue in [0, 1] as an opaque `std_msgs/ColorRGBA`."""
    red, green, blue = (float(value) for value in values)
    return {"r": red, "g": green, "b": blue, "a": 1.0}


# ------------------------------------------------------------------------------------------------- robot and people


def joint_state(time: int, names: Sequence[str], q: ArrayLike, qd: ArrayLike) -> Message:
    """Return a `sensor_msgs/JointState` of values and velocities (n,) at a time [ns]."""
    return {"header": header(time), "name": list(names), "position": q, "velocity": qd}


def joint_trajectory(names: Sequence[str], times: ArrayLike, **rows: Sequence[ArrayLike]) -> Message:
    """Return a `trajectory_msgs/JointTrajectory`: positions, velocities, accelerations (K, n) at times (K,) [s]."""
    given = np.asarray(times, dtype=float)
    points = [
        {"time_from_start": stamp(nanoseconds(after)), **{key: row[k] for key, row in rows.items()}}
        for k, after in enumerate((given - given[0]).tolist())
    ]
    return {"header": header(nanoseconds(float(given[0]))), "joint_names": list(names), "points": points}


def people_markers(time: int, people: Mapping[str, Mapping[str, ArrayLike]]) -> Message:
    """Return people as a `visualization_msgs/MarkerArray`: one marker for each key point that is seen.

    The namespace is the person, the id the number of the key point in its skeleton, the text its name.
    """
    found = {}
    for who, points in people.items():
        look = {"type": _SPHERE, "scale": vector([_KEYPOINT] * 3), "color": colour(_SEEN)}
        seen = {name: np.asarray(place, dtype=float) for name, place in points.items()}
        found[who] = [
            {"id": k, "pose": pose(place), "text": name, **look}
            for k, (name, place) in enumerate(seen.items())
            if np.isfinite(place).all()
        ]
    return _markers(time, found)


def diagnostics(time: int, name: str, tick: Mapping[str, Any]) -> Message:
    """Return a tick as a `diagnostic_msgs/DiagnosticArray`, with all values that are not arrays.

    The level is OK while the robot moves or has arrived, WARN while it brakes or stands, and ERROR after somebody left
    their reach set.
    """
    level = OK if tick["state"] in ("moving", "slowed", "done") else WARN
    level = ERROR if tick.get("obeyed") is False else level
    values = [
        {"key": key, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
        for key, value in tick.items()
        if isinstance(value, (str, float, int))
    ]
    status_text = f"{tick['state']}: {tick['reason']}" if tick.get("reason") else str(tick["state"])
    status = {"level": level, "name": f"safe_ompl: {name}", "hardware_id": name, "message": status_text}
    return {"header": header(time), "status": [{**status, "values": values}]}


# ---------------------------------------------------------------------------------------------------------- the scene


def obstacle_markers(time: int, obstacles: Iterable[Obstacle]) -> Message:
    """Return obstacles as markers from a time [ns] on."""
    found = {}
    for obstacle in obstacles:
        look = obstacle.color or (_DANGEROUS if obstacle.weight > 0 else _OBSTACLE_COLORS)
        vertices, faces = obstacle.shape.triangles(_SEGMENTS)
        found[obstacle.name] = [
            {
                "type": _TRIANGLES,
                "pose": pose(obstacle.pose.position, obstacle.pose.quaternion_xyzw),
                "scale": vector([1.0] * 3),
                "color": colour(look),
                "points": [vector(point) for point in np.round(vertices, 6)[np.asarray(faces).reshape(-1)]],
            }
        ]
    return _markers(time, found)


def _markers(time: int, found: Mapping[str, Sequence[Message]]) -> Message:
    """Return markers by name in the world frame; they replace all earlier markers."""
    head = header(time, WORLD)
    markers: list[Message] = [{"header": head, "action": _DELETE_ALL}]
    for name, solids in found.items():
        markers += [{"header": head, "ns": name, "id": k, **solid} for k, solid in enumerate(solids)]
    return {"markers": markers}


# ------------------------------------------------------------------------------------------------ what is read


class FramePlaces:
    """Poses of frames in the world: the world itself, links that the robot's joints do not move, and given frames.

    Other frames are looked up: `lookup(target, frame, header)` returns the pose of a frame in the target frame at the
    stamp of the header, or None if it is unknown.
    """

    def __init__(
        self, robot: Robot, given: Mapping[str, Pose], lookup: Callable[[str, str, Any], pin.SE3 | None] | None = None
    ) -> None:
        self._lookup = lookup
        fixed = [frame for frame in robot.shared.model.frames if frame.parentJoint == 0]
        self._places = {frame.name: frame.placement for frame in fixed if frame.name != "universe"}
        self._places |= {WORLD: pin.SE3.Identity(), **{name: pose.se3 for name, pose in given.items()}}

    def place(self, header: Any) -> pin.SE3:
        """Return the pose of a header's frame in the world; raise InputError if it is unknown."""
        if not header.frame_id:
            raise InputError("is empty: the frame must be named", "frame_id")
        name = header.frame_id.removeprefix("/")
        if name in self._places:
            return self._places[name]
        if self._lookup is not None:
            for target, place in self._places.items():
                found = self._lookup(target, name, header)
                if found is not None:
                    return place * found
        raise UnknownNameError("frame", name, self._places, "frame_id")


def in_metres(skeleton: Skeleton) -> Skeleton:
    """Return a skeleton in the units and axes of ROS messages: metres, x forward, y left, z up."""
    return Skeleton(skeleton.name, skeleton.points, skeleton.sources)


def seconds(time: Any) -> float:
    """Return a Time or Duration [s]."""
    return float(time.sec + 1e-9 * time.nanosec)


def stamp_of(header: Any) -> float:
    """Return the time of a header [s]; raise InputError if it has none."""
    if seconds(header.stamp) <= 0:
        raise InputError("is missing: the time of the measurement is needed", "stamp")
    return seconds(header.stamp)


def rows_of(trajectory: Any, robot: Robot) -> Iterator[list[FloatArray] | None]:
    """Yield the positions, velocities and accelerations (n,) of all points; None if no point has them.

    Errors as `by_name`.
    """
    for key in ("positions", "velocities", "accelerations"):
        rows = [getattr(point, key) for point in trajectory.points]
        names = trajectory.joint_names
        yield [by_name(names, row, robot.joint_names) for row in rows] if any(map(len, rows)) else None


def people_of_markers(message: Any, skeleton: Skeleton, frames: FramePlaces) -> tuple[float, dict[str, FloatArray]]:
    """Return the time [s] of a `MarkerArray` and the key points (J, 3) of its people [m]; NaN: not seen.

    The namespace is the name of the person. The text is the name of the key point; without a text the id is its index.
    Raises InputError if there is no marker, a stamp is missing, a frame is unknown, or a key point does not belong to
    the skeleton.
    """
    people: dict[str, FloatArray] = {}
    shown = [marker for marker in message.markers if marker.action not in (_DELETE, _DELETE_ALL)]
    if not shown:
        stamps = [stamp_of(marker.header) for marker in message.markers]
        if not stamps:
            raise InputError("has no markers, and so no time", "markers")
        return max(stamps), {}
    # The earliest stamp counts, because it allows the person the longest time to move.
    time = min(stamp_of(marker.header) for marker in shown)
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


def pose_of(message: Any, frames: FramePlaces) -> tuple[float, Pose]:
    """Return the time [s] of a `PoseStamped` and its pose in the world; raise InputError if one is invalid."""
    position, turn = message.pose.position, message.pose.orientation
    pose = Pose((position.x, position.y, position.z), (turn.x, turn.y, turn.z, turn.w))
    return stamp_of(message.header), Pose.of(frames.place(message.header) * pose.se3)


def proposal_of(message: Any, robot: Robot) -> tuple[Motion | FloatArray, float | None]:
    """Return the proposal in a `JointTrajectory`, and its beginning [s]; None, at once, if it has no stamp.

    The proposal is the motion that a controller would interpolate through the points. If the first point has no
    positions, the proposal is the velocities (n,) of this point. Raises InputError if a joint is missing or a number is
    not finite; other errors as `Motion.hermite`.
    """
    points = message.points
    if not points:
        raise InputError("has no points", "points")
    if not len(points[0].positions):
        return by_name(message.joint_names, points[0].velocities, robot.joint_names), None
    times = [seconds(point.time_from_start) for point in points]
    positions, velocities, accelerations = rows_of(message, robot)
    assert positions is not None
    begin = seconds(message.header.stamp)
    start = begin + times[0] if begin > 0 else None
    return Motion.hermite(times, positions, velocities, accelerations, robot.joint_names), start


def cloud_of(message: Any, radius: float, frames: FramePlaces) -> tuple[float, FloatArray]:
    """Return the time [s] of a `PointCloud2` and its finite points (M, 3) in the world [m]; errors as `PointCloud`."""
    points = PointCloud.from_message(message, radius).centres if message.width * message.height else np.zeros((0, 3))
    return stamp_of(message.header), placed(frames.place(message.header), points)


def _keypoint(place: Any, frame: pin.SE3) -> FloatArray:
    """Return the position (3,) of a key point in the world [m]; NaN: not seen."""
    given = np.array([place.x, place.y, place.z], dtype=float)
    if not np.isfinite(given).all() and not np.isnan(given).all():
        raise InputError(f"must be finite, or all NaN where it is not seen, got {given.tolist()}", "key point")
    return np.asarray(placed(frame, given[None])[0])


def by_name(names: Collection[str], values: Collection[float], wanted: Collection[str]) -> FloatArray:
    """Return the values (n,) of the `wanted` joints in their order; raise InputError if one is missing or NaN."""
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
    """Return the goal configuration (n,) of a message; errors as `by_name`, and InputError outside the limits."""
    q = by_name(names, position, robot.joint_names)
    for k in np.flatnonzero((q < robot.lower) | (q > robot.upper)):
        raise InputError(f"is out of the limits of {robot.joint_names[k]!r}: {q[k]:g}", "position")
    return q
