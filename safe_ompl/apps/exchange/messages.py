"""Messages of ROS 2 as plain data, and their bytes (CDR), without ROS: what logs and the node write.

A message is a mapping with the keys of its type; what is missing is zero, empty or false. The definitions are those of
ROS 2 Humble, which later releases share for all types that are used here. Times are whole nanoseconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.geometry import STANDING, Obstacle, Person

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MARKERS = "visualization_msgs/msg/MarkerArray"
SECOND = 10**9  # [ns]
OK, WARN, ERROR = range(3)  # levels of diagnostic_msgs/DiagnosticStatus
WORLD = "world"
SPHERE, _CYLINDER, _TRIANGLES = 2, 3, 11  # types of markers
DELETE_ALL = 3  # action of a marker
_KEYPOINT = 0.05  # [m] diameter of the marker of a key point
_STILL, _DANGEROUS = (0.8, 0.68, 0.53), (0.85, 0.45, 0.3)
_LIMB = (0.83, 0.43, 0.29)
_AROUND = 24  # corners of round shapes
_NAME, _SEQUENCES = 2, (3, 4)  # kinds of fields in rosbags
_NUMBERS = {"float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}

Message = dict[str, Any]


@cache
def types_of_ros() -> Any:
    """Return the types of ROS 2 Humble; needs the extra `mcap`, and whoever reads messages only does not ask."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def nanoseconds(time: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return round(SECOND * time)


def encoded(kind: str, content: Mapping[str, Any]) -> bytes:
    """Return the bytes of a message of a type, such as `JOINT_STATE`."""
    return bytes(types_of_ros().serialize_cdr(_filled(kind, content), kind))


def decoded(kind: str, data: bytes) -> Any:
    """Return the message of a type that bytes hold; its fields are attributes, numbers are arrays."""
    return types_of_ros().deserialize_cdr(data, kind)


def definition(kind: str) -> str:
    """Return the definition of a type, with those of the types of its fields."""
    return str(types_of_ros().generate_msgdef(kind, ros_version=2)[0])


def _filled(kind: str, content: Mapping[str, Any]) -> Any:
    fields = dict(types_of_ros().fielddefs[kind][1])
    assert set(content) <= set(fields), (kind, set(content) - set(fields))
    return types_of_ros().types[kind](**{name: _value(field, content.get(name)) for name, field in fields.items()})


def _value(field: Any, given: Any) -> Any:
    """Return the value of a field as rosbags wants it; None is the default."""
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


def joint_trajectory(time: int, names: Sequence[str], times: Iterable[float], **rows: Sequence[ArrayLike]) -> Message:
    """Return a `trajectory_msgs/JointTrajectory` that begins at a time [ns].

    Its points are `times` after that [s]; rows are positions, velocities and accelerations, each (K, n).
    """
    points = [
        {"time_from_start": stamp(nanoseconds(after)), **{key: row[k] for key, row in rows.items()}}
        for k, after in enumerate(times)
    ]
    return {"header": header(time), "joint_names": list(names), "points": points}


def people_markers(time: int, people: Mapping[str, Mapping[str, ArrayLike]]) -> Message:
    """Return people as a `visualization_msgs/MarkerArray`: one marker for each key point that is seen.

    The namespace is the person, the id the number of the key point in its skeleton, the text its name.
    """
    found = {}
    for who, points in people.items():
        look = {"type": SPHERE, "scale": vector([_KEYPOINT] * 3), "color": colour(_LIMB)}
        seen = {name: np.asarray(place, dtype=float) for name, place in points.items()}
        found[who] = [
            {"id": k, "pose": pose(place), "text": name, **look}
            for k, (name, place) in enumerate(seen.items())
            if np.isfinite(place).all()
        ]
    return _markers(time, found)


def diagnostics(time: int, name: str, tick: Mapping[str, Any]) -> Message:
    """Return what a tick says of the robot as a `diagnostic_msgs/DiagnosticArray`, with all that is not an array.

    The level is OK while the robot moves or has arrived, WARN while it brakes or stands, and ERROR after somebody moved
    farther than promised.
    """
    level = OK if tick["state"] in ("moving", "slowed", "done") else WARN
    level = ERROR if tick.get("obeyed") is False else level
    values = [
        {"key": key, "value": f"{value:.6g}" if isinstance(value, float) else str(value)}
        for key, value in tick.items()
        if isinstance(value, (str, float, int))
    ]
    said = f"{tick['state']}: {tick['reason']}" if tick.get("reason") else str(tick["state"])
    status = {"level": level, "name": f"safe_ompl: {name}", "hardware_id": name, "message": said}
    return {"header": header(time), "status": [{**status, "values": values}]}


# ---------------------------------------------------------------------------------------------------------- the scene


def obstacle_markers(time: int, obstacles: Iterable[Obstacle]) -> Message:
    """Return obstacles from a time [ns] on."""
    found = {}
    for obstacle in obstacles:
        look = obstacle.color or (_DANGEROUS if obstacle.weight > 0 else _STILL)
        vertices, faces = obstacle.shape.triangles(_AROUND)
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


def limb_markers(
    time: int, people: Mapping[str, Mapping[str, Any]], bodies: Mapping[str, Mapping[str, Any]]
) -> Message:
    """Return the limbs of people at a time [ns], as cylinders with round ends.

    `people` are key points in the world by name; `bodies` their heights and limbs, as the header of ticks has them.
    """
    found: dict[str, list[Message]] = {}
    for name, points in people.items():
        known = {point: place for point, place in points.items() if point in STANDING}
        person = Person(bodies[name]["height"], known, tuple(bodies[name].get("limbs") or ()))
        solids = found[name] = []
        for limb in person.limbs():
            wide, look = 2 * limb.radius, {"color": colour(_LIMB)}
            for end in sorted({tuple(limb.start.tolist()), tuple(limb.end.tolist())}):
                solids.append({"type": SPHERE, "pose": pose(end), "scale": vector([wide] * 3), **look})
            if limb.length > 0:
                size = vector([wide, wide, limb.length])
                turn = pin.Quaternion(limb.placement.rotation).coeffs()
                solids.append(
                    {"type": _CYLINDER, "pose": pose(limb.placement.translation, turn), "scale": size, **look}
                )
    return _markers(time, found)


def _markers(time: int, found: Mapping[str, Sequence[Message]]) -> Message:
    """Return markers by name, in the world and in the place of all before."""
    head = header(time, WORLD)
    markers: list[Message] = [{"header": head, "action": DELETE_ALL}]
    for name, solids in found.items():
        markers += [{"header": head, "ns": name, "id": k, **solid} for k, solid in enumerate(solids)]
    return {"markers": markers}
