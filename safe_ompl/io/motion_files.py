"""Motions from files: tables (CSV), arrays (NPZ), messages of ROS and MoveIt (JSON, YAML), and our own JSON."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import yaml

from safe_ompl.common import FloatArray, InputError
from safe_ompl.common import documents as document
from safe_ompl.io.files import kind_of, read_json, saved, strict_json
from safe_ompl.io.motions import JointPath, read_table
from safe_ompl.motions import Motion
from safe_ompl.robot import Robot

WRITABLE = (".json", ".csv", ".yaml", ".yml")
"""Endings of the files that motions are written to."""
_RATES = ("velocities", "accelerations")
_POINT = ("positions", *_RATES, "effort", "time_from_start")
_COLUMN = re.compile(r"(.+)_(position|velocity|acceleration)")
_LOGGED = re.compile(r"(.+)_(commanded|measured)")
_SAME = 1e-6  # [rad or m] by which what is read from a file may differ from what was written
_ARRAYS = ("joint_names", "times", "positions", *_RATES, "coefficients", "slack")
_EXPECTED = (
    "must hold joint_names and points (trajectory_msgs/JointTrajectory), a joint_trajectory with them "
    "(moveit_msgs/RobotTrajectory), or what safe_ompl.save writes"
)


def read_motion(file: str | Path, robot: Robot | None = None, *, degrees: bool = False) -> Motion:
    """Read a motion that something else made; files without times hold paths.

    What is between points is what ROS 2's joint_trajectory_controller makes of them (`Motion.hermite`).

    Parameters
    ----------
    file : path-like
        By its ending:

        .csv
            A line with names of columns, then numbers: `time` [s] or none; and a column for each joint, or columns
            `<joint>_position`, `_velocity` and `_acceleration`, as `Trajectory.to_csv` writes.
        .npz
            Arrays `positions` (N, n), and `times`, `velocities`, `accelerations`, `joint_names` as far as known; or
            `coefficients` and `times` of a `Motion`.
        .json, .yaml, .yml
            A message `trajectory_msgs/JointTrajectory` or `moveit_msgs/RobotTrajectory`; or JSON of `safe_ompl.save`
            and `safe-ompl plan --json` or `--trajectory`.
    robot : Robot, optional
        Put the columns in the order of its joints, as `Motion.for_robot`.
    degrees : bool
        Whether joints that turn are in degrees; which ones do only the robot knows.

    Raises
    ------
    InputError
        If the file is of another kind, or holds no motion; names file, place and value.
    """
    path = Path(file)
    readers = {
        ".csv": _from_table,
        ".npz": _from_arrays,
        ".json": _from_json,
        ".yaml": _from_yaml,
        ".yml": _from_yaml,
    }
    if path.suffix.lower() not in readers:
        raise InputError(f"must be a motion, with one of the endings {', '.join(readers)}", str(file))
    if degrees and robot is None:
        raise InputError("need the robot, which knows the joints that turn", "degrees")
    motion = readers[path.suffix.lower()](path)
    with document.within(str(file), ": "):
        return motion if robot is None else motion.for_robot(robot, degrees)


def read_log(file: str | Path) -> tuple[Motion, Motion]:
    """Return the commanded and the measured motion of a log; between samples they are straight.

    A table (CSV) with columns `time` [s], `<joint>_commanded` and `<joint>_measured`, or arrays of these names (NPZ);
    other columns are not looked at.

    Raises
    ------
    InputError
        If the file is of another kind, or a column is missing.
    """
    path = Path(file)
    kind = path.suffix.lower()
    if kind == ".csv":
        header, values = read_table(path)
        columns = {name.strip(): values[:, k] for k, name in enumerate(header)}
    elif kind == ".npz":
        columns = _arrays(path)
    else:
        raise InputError("must be a log, with one of the endings .csv, .npz", str(file))
    with document.within(str(file), ": "):
        parts = [found for name in columns if (found := _LOGGED.fullmatch(name))]
        names = tuple(dict.fromkeys(found[1] for found in parts))
        if not names:
            raise InputError("must be <joint>_commanded and <joint>_measured, got none", "columns")
        times = document.require(columns, "time")
        tables = (
            [document.require(columns, f"{name}_{what}") for name in names]
            for what in ("commanded", "measured")
        )
        commanded, measured = (Motion.hermite(times, np.transpose(table), names=names) for table in tables)
    return commanded, measured


def motion_text(motion: Motion, file: str | Path, *, message: bool = False) -> tuple[str, Motion]:
    """Return a motion as text for a file, and the motion that is read from it, which its proofs should be about.

    Parameters
    ----------
    motion : Motion
        Its joints have names.
    file : path-like
        By its ending: our own form (.json), a table (.csv), a message trajectory_msgs/JointTrajectory (.yaml, .yml).
        Tables and messages hold way points, with velocities from degree 2 on, and accelerations from degree 4 on.
    message : bool
        Whether JSON is a message, too.

    Raises
    ------
    InputError
        If the ending is another one, or points cannot hold the motion: its degree is above 5, or its velocities jump.
    """
    ending = Path(file).suffix.lower()
    if ending not in WRITABLE:
        raise InputError(f"must have one of the endings {', '.join(WRITABLE)}", str(file))
    if ending == ".json" and not message:
        return strict_json(saved(motion)), motion
    times, names = motion.times, motion.joint_names or ()
    if ending != ".csv" and motion.timed:  # whole nanoseconds
        times = np.array([_seconds(_stamp(t)) for t in times.tolist()])
    rows = [motion.derivative(motion.times, order) for order in range(1 + max(0, motion.degree) // 2)]
    back = _from_points(names, times if motion.timed else None, *rows[:3])
    held = np.zeros((motion.pieces, max(back.degree, motion.degree) + 1, motion.n))
    held[:, : motion.degree + 1] = motion.coefficients
    held[:, : back.degree + 1] -= back.coefficients
    if motion.degree > 5 or np.abs(held).max() > _SAME:
        raise InputError(
            "holds way points, and these cannot hold this motion: its degree is above 5, or its velocities or "
            "accelerations jump; give a file of ours (.json)",
            str(file),
        )
    if ending == ".csv":
        return _as_table(names, motion, rows), back
    keys = ("positions", *_RATES)
    points: list[dict[str, Any]] = [
        {key: row[k].tolist() for key, row in zip(keys, rows, strict=False)} for k in range(len(times))
    ]
    if motion.timed:
        for point, t in zip(points, motion.times.tolist(), strict=True):
            point["time_from_start"] = _stamp(t)
    content = {"joint_names": list(names), "points": points}
    return (strict_json(content) if ending == ".json" else yaml.safe_dump(content, sort_keys=False)), back


def _as_table(names: Sequence[str], motion: Motion, rows: Sequence[FloatArray]) -> str:
    kinds = ("position", "velocity", "acceleration")[: len(rows)]
    header = [f"{name}_{kind}" for kind in kinds for name in names] if len(rows) > 1 else list(names)
    columns = [motion.times[:, None]] * motion.timed + list(rows)
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time"] * motion.timed + header)
    writer.writerows(np.hstack(columns).tolist())
    return stream.getvalue()


def _stamp(time: float) -> dict[str, int]:
    seconds, rest = divmod(round(1e9 * time), 10**9)
    return {"sec": seconds, "nanosec": rest}


def _from_points(
    names: Sequence[str] | None, times: Any, positions: Any, velocities: Any = None, accelerations: Any = None
) -> Motion:
    """Return the motion through points, with velocities and accelerations or None; a path without times."""
    if times is not None:
        return Motion.hermite(times, positions, velocities, accelerations, names)
    if velocities is not None or accelerations is not None:
        raise InputError("are missing, but needed where there are velocities or accelerations", "times")
    return Motion.through(positions, names=names)


# ------------------------------------------------------------------------------------------------------- tables


def _from_table(path: Path) -> Motion:
    header, values = read_table(path)
    with document.within(str(path), ": "):
        columns = {name.strip(): values[:, k] for k, name in enumerate(header)}
        if len(columns) < len(header):
            raise InputError(f"must differ, got {', '.join(header)}", "names of columns")
        times = columns.pop("time", None)
        if not columns or any(_is_number(name) for name in columns):
            raise InputError(f"must name the joints, got {', '.join(header)}", "the first line")
        parts = [_COLUMN.fullmatch(name) for name in columns]
        if not all(parts):
            return _from_points(tuple(columns), times, np.stack([*columns.values()], axis=1))
        joints = tuple(dict.fromkeys(part[1] for part in parts if part))
        kinds = {part[2] for part in parts if part} | {"position"}
        tables = {
            kind: np.stack([document.require(columns, f"{joint}_{kind}") for joint in joints], axis=1)
            for kind in kinds
        }
        rates = (tables.get("velocity"), tables.get("acceleration"))
        return _from_points(joints, times, tables["position"], *rates)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


# ------------------------------------------------------------------------------------------------------- arrays


def _arrays(path: Path) -> dict[str, FloatArray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path)) from None
    except (AttributeError, BadZipFile, EOFError, TypeError, ValueError):
        raise InputError("is no archive of arrays of numbers and text (NPZ)", str(path)) from None


def _from_arrays(path: Path) -> Motion:
    held = _arrays(path)
    with document.within(str(path), ": "):
        document.check_keys(held, _ARRAYS)
        names = held.get("joint_names")
        if names is not None and (names.dtype.kind != "U" or names.ndim != 1):
            raise InputError(f"must be a list of text, got {names.dtype} {names.shape}", "joint_names")
        if "coefficients" in held:
            return Motion.from_mapping(held)
        joints = None if names is None else tuple(names.tolist())
        positions = document.require(held, "positions")
        return _from_points(joints, held.get("times"), positions, *(held.get(name) for name in _RATES))


# ---------------------------------------------------------------------------------------------------- documents


def _from_yaml(path: Path) -> Motion:
    try:
        text = path.read_text(encoding="utf-8").rstrip().removesuffix("\n---")  # as `ros2 topic echo` ends it
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as YAML: {error}", str(path)) from None
    with document.within(str(path), ": "):
        return motion_of_document(document.parse_document(text))


def _from_json(path: Path) -> Motion:
    content = read_json(path)
    with document.within(str(path), ": "):
        return motion_of_document(content)


def motion_of_document(content: Any) -> Motion:
    """Return the motion that JSON or YAML holds, or raise InputError; see `read_motion`."""
    if not isinstance(content, Mapping):
        raise InputError(f"{_EXPECTED}, got {document.kind_of(content)}")
    if "format" in content:
        return _from_own(content, kind_of(content))
    for key in ("trajectory", "joint_trajectory"):
        inner = content.get(key)
        if isinstance(inner, Mapping):
            others = content.get("multi_dof_joint_trajectory")
            if isinstance(others, Mapping) and others.get("points"):
                raise InputError(
                    "must be empty: joints of several axes are not known", "multi_dof_joint_trajectory"
                )
            with document.within(key):
                return motion_of_document(inner)
    if not {"joint_names", "points"} <= set(content):
        raise InputError(f"{_EXPECTED}, got the keys {', '.join(map(str, content)) or '(none)'}")
    return _from_message(content)


def _from_own(content: Mapping[str, Any], kind: str) -> Motion:
    """Return what is in a file of our own form."""
    if kind == "motion":
        return Motion.from_mapping(content)
    if kind == "path":
        return Motion.of(JointPath.from_mapping(dict(content)))
    if kind == "trajectory":
        return _from_message(content)
    if kind == "result" and content.get("path") is not None:
        return Motion.of(JointPath.from_mapping(dict(content)))
    reason = f"no path was found ({content.get('status')})" if kind == "result" else f"it holds a {kind}"
    raise InputError(f"must hold a motion, but {reason}", "kind")


def _from_message(content: Mapping[str, Any]) -> Motion:
    """Return what ROS's trajectory_msgs/JointTrajectory says, as plain data."""
    names = tuple(document.sequence("joint_names", document.require(content, "joint_names")))
    times: list[float | None] = []
    rows: dict[str, list[Any]] = {key: [] for key in ("positions", *_RATES)}
    for k, point in enumerate(document.sequence("points", document.require(content, "points"))):
        with document.within(f"points[{k}]"):
            held = document.mapping("point", point)
            document.check_keys(held, _POINT)
            document.require(held, "positions")
            times.append(_seconds(held.get("time_from_start")))
            if k and (times[0] is None) != (times[k] is None):
                raise InputError("must be there in all points, or in none", "time_from_start")
            for key, found in rows.items():
                values = held.get(key)
                is_there = key == "positions" or values not in (None, [])
                found.append(document.numbers(key, values, len(names)) if is_there else None)
    if not times:
        raise InputError("must be two at least, got 0", "points")
    rates = [None if not any(rows[key]) else rows[key] for key in _RATES]
    return _from_points(names, None if times[0] is None else times, rows["positions"], *rates)


def _seconds(value: Any) -> float | None:
    """Return a time [s] that is a number, or has the fields of ROS 2 or 1."""
    if isinstance(value, Mapping):
        seconds, rest = ("secs", "nsecs") if "secs" in value else ("sec", "nanosec")
        with document.within("time_from_start"):
            document.check_keys(value, (seconds, rest))
            parts = [document.number(key, value.get(key, 0)) for key in (seconds, rest)]
        return parts[0] + 1e-9 * parts[1]
    return None if value is None else document.number("time_from_start", value)
