"""Read and write motions. The table `FORMS` maps each file extension to its reader and writer."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from math import pi, remainder
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, InputError, documents as document, files, listed, warn_once
from safe_ompl.io.motions import kept_columns, read_table
from safe_ompl.io.schema import kind_of, strict_json, with_header
from safe_ompl.motions import Motion
from safe_ompl.robot import Robot

_log = logging.getLogger(__name__)

_RATES = ("velocities", "accelerations")
_MESSAGE_KEYS = ("positions", *_RATES, "effort", "time_from_start")
_COLUMN = re.compile(r"(.+)_(position|velocity|acceleration)")
_LOGGED = re.compile(r"(.+)_(commanded|measured)")
# The motion read back from a file may differ from the written motion by at most this, in every coefficient.
_SAME = 1e-6  # [rad or m]
_ARRAY_KEYS = ("joint_names", "times", "positions", *_RATES)
# Allowed difference between the start state in a message and the first point. MoveIt's default when it executes a
# trajectory (allowed_start_tolerance).
_START = 0.01  # [rad or m]
_EXPECTED = (
    "must hold joint_names and points (trajectory_msgs/JointTrajectory), a joint_trajectory with them "
    "(moveit_msgs/RobotTrajectory), a list of these (moveit_msgs/DisplayTrajectory), or what safe_ompl.save writes"
)


class Form(NamedTuple):
    """A file format. `read` takes path, column names and columns to ignore; `write` takes arrays of way points."""

    read: Callable[[Path, Sequence[str] | None, Sequence[str]], Motion]
    write: Callable[[Mapping[str, Any]], str | bytes] | None = None


def read_motion(
    file: str | Path,
    robot: Robot | None = None,
    *,
    degrees: bool = False,
    joints: Sequence[str] | None = None,
    ignore: Sequence[str] = (),
) -> Motion:
    """Read a motion from a file of safe-ompl or of another program. A file without times is read as a path.

    Between points the motion is interpolated as by ROS 2's joint_trajectory_controller (`Motion.hermite`).

    Parameters
    ----------
    file : path-like
        The extension selects the format:

        .csv, .tsv, .txt
            Columns separated by commas, semicolons, tabs or spaces. Lines that begin with # are comments. An optional
            header line names the columns; rows of numbers follow. The columns are an optional `time` [s], and for each
            joint either its position, or `<joint>_position`, `_velocity` and `_acceleration`.
        .npz
            Array `positions` (N, n), and optionally `times`, `velocities`, `accelerations`, `joint_names`.
        .npy
            One array (N, m) with the numbers of a table.
        .json, .yaml, .yml
            A message `trajectory_msgs/JointTrajectory`, `moveit_msgs/RobotTrajectory` or
            `moveit_msgs/DisplayTrajectory`, as `ros2 topic echo --full-length` prints it; or JSON of `safe_ompl.save`,
            `safe-ompl plan --json` or `--trajectory`.
    robot : Robot, optional
        If given, the columns are sorted in the order of this robot's joints (`Motion.for_robot`).
    degrees : bool
        Whether revolute joints are in degrees. This needs `robot`, which says which joints are revolute.
    joints : sequence of str, optional
        Names of the columns (including `time`) for a file without a header line.
    ignore : sequence of str
        Joints or columns to leave out, such as a gripper's.

    Raises
    ------
    InputError
        If the extension is unknown or the file holds no motion. The message names file, key and value.
    """
    path = Path(file)
    if path.suffix.lower() not in FORMS:
        raise InputError(f"must be a motion, with one of the endings {', '.join(FORMS)}", str(file))
    if degrees and robot is None:
        raise InputError("need the robot, to know which joints are revolute", "degrees")
    motion = FORMS[path.suffix.lower()].read(path, joints, ignore)
    with document.within(str(file), ": "):
        return motion if robot is None else motion.for_robot(robot, degrees)


def read_log(file: str | Path) -> tuple[Motion, Motion]:
    """Read the commanded and the measured motion of a log file, interpolated linearly between samples.

    The file is a table (.csv, .tsv, .txt) with columns `time` [s], `<joint>_commanded` and `<joint>_measured`, or holds
    arrays of these names (.npz). Other columns are ignored. Raises InputError if the extension is unknown or a column
    is missing.
    """
    path = Path(file)
    kind = path.suffix.lower()
    if kind in _TABLES:
        header, values = read_table(path)
        columns = {name: values[:, k] for k, name in enumerate(header)}
    elif kind == ".npz":
        columns = files.read_arrays(path)
    else:
        raise InputError(f"must be a log, with one of the endings {', '.join(_TABLES)}, .npz", str(file))
    with document.within(str(file), ": "):
        parts = [found for name in columns if (found := _LOGGED.fullmatch(name))]
        names = tuple(dict.fromkeys(found[1] for found in parts))
        if not names:
            raise InputError("must contain <joint>_commanded and <joint>_measured, got none", "columns")
        times = document.require(columns, "time")
        tables = ([document.require(columns, f"{name}_{what}") for name in names] for what in ("commanded", "measured"))
        commanded, measured = (Motion.hermite(times, np.transpose(table), names=names) for table in tables)
    return commanded, measured


def motion_content(motion: Motion, file: str | Path, *, message: bool = False) -> tuple[str | bytes, Motion]:
    """Return the content of a file for `motion`, and the motion that a reader gets back from this content.

    If a robot executes the file, prove the returned motion, not `motion`. Tables, arrays and ROS messages hold way
    points: positions, velocities if the degree is 2 or more, accelerations if it is 4 or more. With `message`, a .json
    file holds a ROS message, like .yaml; without it, a motion in the format of safe-ompl. Raises InputError if the
    extension is unknown, way points cannot represent the motion, or joint names are missing (.npz does not need them).
    """
    ending = Path(file).suffix.lower()
    write = FORMS[ending].write if ending in FORMS else None
    if write is None:
        raise InputError(f"must have one of the endings {', '.join(WRITABLE)}", str(file))
    if ending == ".json" and not message:
        return strict_json(with_header("motion", motion.to_mapping())) + "\n", motion
    times = motion.times
    # ROS messages hold times in whole nanoseconds, so the times are rounded first.
    if ending in (".json", ".yaml", ".yml") and motion.timed:
        times = np.array([_seconds(_stamp(t)) for t in times.tolist()])
    rows = [motion.derivative(motion.times, order) for order in range(1 + max(0, motion.degree) // 2)]
    values = [motion.joint_names, times if motion.timed else None, *rows[:3]]
    points = {key: value for key, value in zip(_ARRAY_KEYS, values, strict=False) if value is not None}
    back = _from_points(points)
    difference = np.zeros((motion.pieces, max(back.degree, motion.degree) + 1, motion.n))
    difference[:, : motion.degree + 1] = motion.coefficients
    difference[:, : back.degree + 1] -= back.coefficients
    if motion.degree > 5 or np.abs(difference).max() > _SAME:
        raise InputError(
            "holds way points, which cannot represent this motion: its degree is above 5, or its velocities or "
            "accelerations jump; give a .json file",
            str(file),
        )
    if motion.joint_names is None and ending != ".npz":
        raise InputError("needs the names of the joints, but the motion has none", str(file))
    return write(points), back


def _as_table(points: Mapping[str, Any], delimiter: str) -> str:
    names, tables = points["joint_names"], [points[key] for key in _ARRAY_KEYS[2:] if key in points]
    kinds = ("position", "velocity", "acceleration")[: len(tables)]
    header = [f"{name}_{kind}" for kind in kinds for name in names] if len(tables) > 1 else list(names)
    if "times" in points:
        header, tables = ["time", *header], [points["times"][:, None], *tables]
    return files.table(header, np.hstack(tables).tolist(), delimiter)


def _as_arrays(arrays: Mapping[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def _as_message(points: Mapping[str, Any], write: Callable[[Any], str]) -> str:
    kinds = [key for key in ("positions", *_RATES) if key in points]
    rows = zip(*(points[key].tolist() for key in kinds), strict=True)
    message_points: list[dict[str, Any]] = [dict(zip(kinds, row, strict=True)) for row in rows]
    for point, t in zip(message_points, points.get("times", ()), strict=False):
        point["time_from_start"] = _stamp(float(t))
    return write({"joint_names": list(points["joint_names"]), "points": message_points})


def _stamp(time: float) -> dict[str, int]:
    seconds, rest = divmod(round(1e9 * time), 10**9)
    return {"sec": seconds, "nanosec": rest}


def _from_points(points: Mapping[str, Any]) -> Motion:
    """Return the motion through way points; velocities and accelerations are optional. Without times it is a path."""
    names, positions = points.get("joint_names"), document.require(points, "positions")
    velocities, accelerations = (points.get(key) for key in _RATES)
    if points.get("times") is not None:
        return Motion.hermite(points["times"], positions, velocities, accelerations, names)
    if velocities is not None or accelerations is not None:
        raise InputError("are missing, but velocities and accelerations need times", "times")
    return Motion.through(positions, names=names)


def _without(motion: Motion, ignored: Sequence[str]) -> Motion:
    """Remove the ignored joints from a motion. Raise InputError if a name is not one of its joints."""
    if not ignored:
        return motion
    names = motion.joint_names or ()
    kept = kept_columns(names, ignored)
    slack, rounding = (None if errors is None else errors[:, kept] for errors in (motion.slack, motion.rounding))
    chosen = tuple(names[k] for k in kept)
    return replace(
        motion, coefficients=motion.coefficients[:, :, kept], joint_names=chosen, slack=slack, rounding=rounding
    )


# ------------------------------------------------------------------------------------------------------- tables


def _from_table(path: Path, names: Sequence[str] | None, ignored: Sequence[str]) -> Motion:
    header, values = read_table(path, names, ignored)
    with document.within(str(path), ": "):
        return _of_columns(header, values)


def _of_columns(header: Sequence[str], values: FloatArray) -> Motion:
    columns = {name: values[:, k] for k, name in enumerate(header)}
    if len(columns) < len(header):
        raise InputError(f"must differ, got {listed(header)}", "names of columns")
    times = columns.pop("time", None)
    if not columns:
        raise InputError(f"must name the joints, got {listed(header)}", "the first line")
    parts = [_COLUMN.fullmatch(name) for name in columns]
    if not all(parts):
        table = np.stack([*columns.values()], axis=1)
        return _from_points({"joint_names": tuple(columns), "times": times, "positions": table})
    joints = tuple(dict.fromkeys(part[1] for part in parts if part))
    kinds = {part[2] for part in parts if part} | {"position"}
    points: dict[str, Any] = {"joint_names": joints, "times": times}
    for key, kind in zip(_ARRAY_KEYS[2:], ("position", "velocity", "acceleration"), strict=True):
        if kind in kinds:
            points[key] = np.stack([document.require(columns, f"{joint}_{kind}") for joint in joints], axis=1)
    return _from_points(points)


# ------------------------------------------------------------------------------------------------------- arrays


def _from_arrays(path: Path, names: Sequence[str] | None, ignored: Sequence[str]) -> Motion:
    held: dict[str, Any] = files.read_arrays(path)
    with document.within(str(path), ": "):
        document.check_keys(held, _ARRAY_KEYS)
        own = held.get("joint_names")
        if own is not None:
            if own.dtype.kind != "U" or own.ndim != 1:
                raise InputError(f"must be a list of text, got {own.dtype} {own.shape}", "joint_names")
            _refuse_names(names)
            names = own.tolist()
        held["joint_names"] = None if names is None else tuple(names)
        return _without(_from_points(held), ignored)


def _from_array(path: Path, names: Sequence[str] | None, ignored: Sequence[str]) -> Motion:
    try:
        values = np.load(path, allow_pickle=False)
        values = values.astype(float) if isinstance(values, np.ndarray) else None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path)) from None
    except (EOFError, TypeError, ValueError):
        values = None
    with document.within(str(path), ": "):
        if values is None or values.ndim != 2:
            raise InputError("must be an array of numbers with two dimensions (N, m)")
        if names is None:
            return _without(Motion.through(values), ignored)
        if len(names) != values.shape[1]:
            raise InputError(f"must name the {values.shape[1]} columns, got {len(names)}", "joints")
        kept = kept_columns(names, ignored)
        return _of_columns([names[k] for k in kept], values[:, kept])


def _refuse_names(names: Sequence[str] | None) -> None:
    if names is not None:
        raise InputError(f"must not be given, since the file names its columns; got {listed(names)}", "joints")


# ---------------------------------------------------------------------------------------------------- documents


def _read_yaml(path: Path) -> Any:
    with document.within(str(path), ": "):
        # `ros2 topic echo` ends each message with the line "---".
        text = files.file_text(path).rstrip().removesuffix("\n---")
        return files.parse_document(text)


def _from_document(
    path: Path, names: Sequence[str] | None, ignored: Sequence[str], read: Callable[[Path], Any]
) -> Motion:
    content = read(path)
    with document.within(str(path), ": "):
        _refuse_names(names)
        return _without(motion_of_document(content), ignored)


def plain_message(value: Any) -> Any:
    """Convert a ROS message object (of rclpy or rosbags) to mappings, lists and numbers."""
    if is_dataclass(value):
        names = [item.name for item in fields(value) if item.name[0] != "_"]
    elif hasattr(value, "get_fields_and_field_types"):
        names = list(value.get_fields_and_field_types())
    elif hasattr(value, "tolist"):
        return value.tolist()
    else:
        return [plain_message(item) for item in value] if isinstance(value, (list, tuple)) else value
    return {name: plain_message(getattr(value, name)) for name in names}


def motion_of_document(content: Any) -> Motion:
    """Return the motion in parsed JSON, parsed YAML or a ROS message, or raise InputError; see `read_motion`."""
    content = content if isinstance(content, Mapping) else plain_message(content)
    if not isinstance(content, Mapping):
        raise InputError(f"{_EXPECTED}, got {document.described(content)}")
    if "format" in content:
        return _from_own(content, kind_of(content))
    if isinstance(content.get("trajectory"), (list, tuple)):
        return _from_display(content)
    for key in ("trajectory", "joint_trajectory"):
        inner = content.get(key)
        if isinstance(inner, Mapping):
            others = content.get("multi_dof_joint_trajectory")
            if isinstance(others, Mapping) and others.get("points"):
                raise InputError("must be empty: multi-DOF joints are not supported", "multi_dof_joint_trajectory")
            with document.within(key, ": "):
                return motion_of_document(inner)
    if not {"joint_names", "points"} <= set(content):
        raise InputError(f"{_EXPECTED}, got the keys {listed(content) or '(none)'}")
    return _from_message(content)


def _from_display(content: Mapping[str, Any]) -> Motion:
    """Concatenate the trajectories of a moveit_msgs/DisplayTrajectory."""
    motion: Motion | None = None
    for k, part in enumerate(content["trajectory"]):
        with document.within(f"trajectory[{k}]", ": "):
            given = document.mapping("trajectory", part)
            parts = [given.get("joint_trajectory", {}), given.get("multi_dof_joint_trajectory", {})]
            # MoveIt sends an empty trajectory for a plan step without motion.
            if all(isinstance(one, Mapping) and not one.get("points") for one in parts):
                continue
            found = motion_of_document(given)
            motion = found if motion is None else motion.then(found)
    if motion is None:
        raise InputError("must hold points, got none", "trajectory")
    with document.within("trajectory_start"):
        state = document.mapping("state", content.get("trajectory_start") or {})
        if held := state.get("attached_collision_objects"):
            names = listed(item.get("object", {}).get("id") if isinstance(item, Mapping) else item for item in held)
            warn_once(
                _log,
                f"the trajectory begins with objects in the gripper ({names}): attach them to the robot before a check",
            )
        _check_start(motion, document.mapping("joint_state", state.get("joint_state") or {}))
    return motion


def _check_start(motion: Motion, state: Mapping[str, Any]) -> None:
    """Raise InputError if a motion does not begin at the joint values of a sensor_msgs/JointState."""
    names = document.sequence("joint_state.name", state.get("name") or ())
    values = document.numbers("joint_state.position", state.get("position") or (), len(names))
    there = dict(zip(map(str, names), values, strict=True))
    for name, begin in zip(motion.joint_names or (), motion.knots[0].tolist(), strict=True):
        # The values of a continuous joint may differ by multiples of 2π. For simplicity multiples of 2π are ignored for
        # all joints.
        if name in there and abs(remainder(begin - there[name], 2 * pi)) > _START:
            raise InputError(
                f"joint {name!r} is at {there[name]:g}, but the trajectory begins at {begin:g}; they may differ by at "
                f"most {_START:g}",
                "joint_state.position",
            )


def _from_own(content: Mapping[str, Any], kind: str) -> Motion:
    """Return the motion of a document in the format of safe-ompl."""
    if kind == "motion":
        return Motion.from_mapping(content)
    if kind == "trajectory":
        return _from_message(content)
    if kind == "path" or (kind == "result" and content.get("path") is not None):
        names = document.sequence("joint_names", document.require(content, "joint_names"))
        return Motion.through(document.require(content, "path"), names=names)
    reason = f"no path was found ({listed([content.get('status')])})" if kind == "result" else f"it holds a {kind}"
    raise InputError(f"must hold a motion, but {reason}", "kind")


def _from_message(content: Mapping[str, Any]) -> Motion:
    """Return the motion of a trajectory_msgs/JointTrajectory that is given as mappings and lists."""
    names = tuple(document.sequence("joint_names", document.require(content, "joint_names")))
    times: list[float | None] = []
    rows: dict[str, list[Any]] = {key: [] for key in ("positions", *_RATES)}
    for k, point in enumerate(document.sequence("points", document.require(content, "points"))):
        with document.within(f"points[{k}]"):
            held = document.mapping("point", point)
            document.check_keys(held, _MESSAGE_KEYS)
            document.require(held, "positions")
            times.append(_seconds(held.get("time_from_start")))
            if k and (times[0] is None) != (times[k] is None):
                raise InputError("must be given in all points or in none", "time_from_start")
            for key, found in rows.items():
                values = held.get(key)
                is_there = key == "positions" or values not in (None, [])
                found.append(document.numbers(key, values, len(names)) if is_there else None)
    if not times:
        raise InputError("must be at least two, got 0", "points")
    rates = [None if not any(rows[key]) else rows[key] for key in _RATES]
    values = [names, None if times[0] is None else times, rows["positions"], *rates]
    return _from_points(dict(zip(_ARRAY_KEYS, values, strict=True)))


def _seconds(value: Any) -> float | None:
    """Return a time [s] from a number, or from a ROS 1 or ROS 2 duration; None stays None."""
    if isinstance(value, Mapping):
        seconds, rest = ("secs", "nsecs") if "secs" in value else ("sec", "nanosec")
        with document.within("time_from_start"):
            document.check_keys(value, (seconds, rest))
            parts = [document.number(key, value.get(key, 0)) for key in (seconds, rest)]
        return parts[0] + 1e-9 * parts[1]
    return None if value is None else document.number("time_from_start", value)


_YAML = Form(partial(_from_document, read=_read_yaml), partial(_as_message, write=files.dump_document))
FORMS: dict[str, Form] = {
    ".csv": Form(_from_table, partial(_as_table, delimiter=",")),
    ".tsv": Form(_from_table, partial(_as_table, delimiter="\t")),
    ".txt": Form(_from_table, partial(_as_table, delimiter="\t")),
    ".npz": Form(_from_arrays, _as_arrays),
    ".npy": Form(_from_array),
    ".json": Form(partial(_from_document, read=files.read_json), partial(_as_message, write=strict_json)),
    ".yaml": _YAML,
    ".yml": _YAML,
}
"""The file formats of motions, by file extension."""
WRITABLE = tuple(ending for ending, form in FORMS.items() if form.write is not None)
_TABLES = (".csv", ".tsv", ".txt")
