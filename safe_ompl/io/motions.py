"""Read tables of numbers, and save and load timed motions with their robot, scene and speeds."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, documents as document, finite_array, float_array, listed, shown
from safe_ompl.io.problems import EmbeddedProblem
from safe_ompl.motions import RATE, Motion, Trajectory
from safe_ompl.robot import PackageDir, Robot

_OF_JOINT = re.compile("_(position|velocity|acceleration)$")


def read_table(
    file: str | Path, names: Sequence[str] | None = None, ignored: Sequence[str] = ()
) -> tuple[tuple[str, ...], FloatArray]:
    """Read a table: return the names (m) of its columns and the numbers (N, m).

    Columns are separated by tabs, semicolons, commas or spaces; the first of these that occurs in the first line is
    used. Lines that begin with # are comments. `names` names the columns of a table without a header line. `ignored`
    lists columns to leave out, by column name or by joint name.

    Raises InputError, which names the line, if the table cannot be read.
    """
    try:
        content = Path(file).read_text(encoding="utf-8-sig")  # as spreadsheets write
        lines = [(k, line) for k, line in enumerate(content.splitlines(), start=1) if line.strip()]
        lines = [(k, line) for k, line in lines if not line.lstrip().startswith("#")]
        delimiter = next((mark for mark in "\t;," if lines and mark in lines[0][1]), None)
        rows = [(k, _cells(line, delimiter)) for k, line in lines]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read as a table: {error}", str(file)) from None
    if not rows:
        raise InputError("is empty: the first line must name the joints", str(file))
    first = rows[0][1]
    if not any(_is_number(cell) for cell in first):
        if names is not None:
            raise InputError(f"already names its columns; leave out {listed(names)}", f"{file}: joints")
        names, rows = first, rows[1:]
    elif names is None:
        raise InputError(
            f"must name the joints, got {listed(first)}; or name the columns with joints=, --joints",
            f"{file}: the first line",
        )
    elif len(names) != len(first):
        raise InputError(f"must name the {len(first)} columns, got {len(names)}", f"{file}: joints")
    with document.within(str(file), ": "):
        kept = kept_columns(names, ignored)
    values = [_numbers(row, len(names), kept, f"{file}:{k}") for k, row in rows]
    return tuple(names[k] for k in kept), np.reshape(values, (-1, len(kept)))


def kept_columns(names: Sequence[str], ignored: Sequence[str]) -> list[int]:
    """Return the indices of the columns that are not ignored. A column is ignored by its name or its joint's name."""
    both = [{name, _OF_JOINT.sub("", name)} for name in names]
    for name in ignored:
        if not any(name in known for known in both):
            raise InputError(f"unknown column {shown(name)}; known: {listed(names)}", "to ignore")
    return [k for k, known in enumerate(both) if not known & set(ignored)]


def _cells(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers(row: Sequence[str], count: int, kept: Sequence[int], place: str) -> list[float]:
    if len(row) != count:
        raise InputError(f"must have {count} numbers, one for each column, got {len(row)}", place)
    for k in kept:
        if not _is_number(row[k]):
            raise InputError(f"must be numbers, got {shown(row[k])}", place)
    return [float(row[k]) for k in kept]


ACCELERATION = "joint acceleration"
"""The limit that bounds the speed wherever no velocity limit is reached."""


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """A timed motion as it is saved and shown, with its robot, scene, speeds and speed limits.

    Parameters
    ----------
    problem : EmbeddedProblem
        Robot, scene and options of the danger field.
    motion : Motion
        A timed motion with T knots that begins at time 0.
    speeds : array_like, shape (T,)
        The speed ṡ along the path at the knots [rad/s].
    bounds : mapping of str to array_like, shape (T,)
        For each velocity limit, by name, the largest ṡ that it allows at the knots [rad/s]; +inf if it allows any ṡ.
    binding : sequence of str or None
        T names: the active velocity limit at each knot; None where an acceleration limit is active.
    name : str
        The name of the planner.
    remarks : sequence of str
        T texts that are shown with the knots. By default they give the speed and the active limit.

    Raises
    ------
    InputError
        If the lengths differ, or the motion is not timed from 0 on.
    """

    problem: EmbeddedProblem
    motion: Motion
    speeds: FloatArray
    bounds: Mapping[str, FloatArray] = field(default_factory=dict)
    binding: tuple[str | None, ...] = ()
    name: str = ""
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.motion.times)
        if not self.motion.timed or self.motion.times[0] != 0.0:
            raise InputError("must be timed, with times from 0 on", "motion")
        finite_array(self.speeds, (count,), "speeds")
        for to, values in self.bounds.items():
            float_array(values, (count,), f"bounds by {to}")
        for key, rows in (("binding", self.binding), ("remarks", self.remarks or self.binding)):
            if len(rows) != count:
                raise InputError(f"must have {count} entries, got {len(rows)}", key)

    @classmethod
    def of(
        cls, trajectory: Trajectory, problem: EmbeddedProblem, *, rate: float = RATE, name: str = ""
    ) -> MotionRecord:
        """Sample a trajectory with at least `rate` [Hz] points per second; the joints are linear in between."""
        times, states = trajectory.points(rate)
        cells, _, speeds, _ = trajectory.law.at(times * (trajectory.duration / times[-1]))
        binding = trajectory.binding()
        return cls(
            problem,
            Motion.through(states["positions"], times, trajectory.joint_names),
            speeds,
            {limit.name: limit.speeds[cells] for limit in trajectory.velocity_limits},
            tuple(binding[cell] for cell in cells),
            name,
        )

    def knot(self, time: float) -> int:
        """Return the index of the last knot at or before a time [s]."""
        times = self.motion.times
        return int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 1))

    def remark(self, time: float) -> str:
        """Return the time, and the remark of the last knot at or before this time [s]."""
        k = self.knot(time)
        speed_text = f"{self.speeds[k]:.2f} rad/s, bounded by {self.binding[k] or ACCELERATION}"
        return f"{min(time, self.motion.duration):.2f} s: {self.remarks[k] if self.remarks else speed_text}"

    def to_mapping(self) -> dict[str, Any]:
        """Return the content of a file except the points of the trajectory. `from_mapping` reads both."""
        return {
            "planner": self.name,
            "speeds": self.speeds.tolist(),
            "bounds": {name: values.tolist() for name, values in self.bounds.items()},
            "binding": list(self.binding),
            "problem": self.problem.to_mapping(),
        }

    @classmethod
    def from_mapping(
        cls, data: Mapping[str, Any], robot: Robot | None = None, package_dirs: Sequence[PackageDir] = ()
    ) -> MotionRecord:
        """Read the document that `safe-ompl plan --trajectory` writes; see `load`."""
        problem = EmbeddedProblem.from_mapping(document.require(data, "problem"), robot, package_dirs)
        points = document.sequence("points", document.require(data, "points"))
        times, configurations = _points(points, problem.robot.n)
        bounds = document.mapping_of("bounds", document.require(data, "bounds"), document.sequence)
        return cls(
            problem,
            Motion.through(configurations, times, problem.robot.joint_names),
            np.array(document.numbers("speeds", document.require(data, "speeds"))),
            {  # null means +inf
                name: np.array([np.inf if v is None else document.number(f"bounds.{name}", v) for v in values])
                for name, values in bounds.items()
            },
            document.list_of("binding", document.require(data, "binding"), _name_or_none),
            str(data.get("planner") or ""),
        )


def _name_or_none(key: str, value: Any) -> str | None:
    return None if value is None else document.text(key, value)


def _points(points: Sequence[Any], n: int) -> tuple[FloatArray, FloatArray]:
    """Return the times (T,) [s] and configurations (T, n) of the points of a trajectory."""
    times, configurations = [], []
    for k, point in enumerate(points):
        with document.within(f"points[{k}]"):
            held = document.mapping("point", point)
            times.append(document.number("time_from_start", document.require(held, "time_from_start")))
            configurations.append(document.numbers("positions", document.require(held, "positions"), n))
    return np.array(times), np.array(configurations).reshape(-1, n)
