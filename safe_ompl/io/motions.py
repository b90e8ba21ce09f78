"""Paths of named joints, for controllers and spreadsheets; and motions in time with their robot and scene."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, documents as document, finite_array, float_array, listed, shown
from safe_ompl.io.problems import CarriedProblem
from safe_ompl.motions import RATE, Trajectory
from safe_ompl.planning import PlanResult
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_OF_JOINT = re.compile("_(position|velocity|acceleration)$")


@dataclass(frozen=True, eq=False)
class JointPath:
    """Way points of named joints.

    Parameters
    ----------
    joint_names : sequence of str
        The n joints; their names differ.
    points : array_like, shape (N, n)
        Way points [rad or m]; between them the joints move on straight lines, as their numbers stand.

    Raises
    ------
    InputError
        If names repeat, or the way points have another shape or are not finite.
    """

    joint_names: tuple[str, ...]
    points: FloatArray

    if TYPE_CHECKING:  # what is given, which becomes what the fields say

        def __init__(self, joint_names: Iterable[str], points: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        names = tuple(document.text("joint name", name) for name in self.joint_names)
        if len(set(names)) < len(names):
            raise InputError(f"must differ, got {', '.join(names)}", "joint names")
        points = np.array(finite_array(self.points, (None, len(names)), "path"))
        points.setflags(write=False)
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "points", points)

    @classmethod
    def of(cls, result: PlanResult) -> JointPath:
        """Return the path of a result.

        Raises
        ------
        InputError
            If it is not solved.
        """
        if result.path is None:
            raise InputError(f"{result.planner} found no path: {result.status}")
        return cls(result.joint_names, result.path)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        return {"joint_names": list(self.joint_names), "path": self.points.tolist()}

    @classmethod
    def from_mapping(cls, data: dict[str, Any]) -> JointPath:
        """Read a path from a document."""
        names = document.sequence("joint_names", document.require(data, "joint_names"))
        return cls(tuple(names), document.require(data, "path"))


def read_table(
    file: str | Path, names: Sequence[str] | None = None, ignored: Sequence[str] = ()
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names (m) of the columns of a table, and the numbers below them (N, m).

    Between columns are tabs, semicolons, commas or spaces: the first of these that the first line has. Lines that begin
    with # are comments. The `names` of columns are needed where the first line has numbers. Columns are `ignored` by
    their own name, or that of their joint.

    Raises InputError if it cannot be read; names the line.
    """
    try:
        content = Path(file).read_text(encoding="utf-8-sig")  # as spreadsheets write it
        lines = [(k, line) for k, line in enumerate(content.splitlines(), start=1) if line.strip()]
        lines = [(k, line) for k, line in lines if not line.lstrip().startswith("#")]
        delimiter = next((mark for mark in "\t;," if lines and mark in lines[0][1]), None)
        rows = [(k, _cells(line, delimiter)) for k, line in lines]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot be read as a table: {error}", str(file)) from None
    if not rows:
        raise InputError("is empty; the first line must name the joints", str(file))
    first = rows[0][1]
    if not any(_is_number(cell) for cell in first):
        if names is not None:
            raise InputError(f"names its columns itself; leave out {listed(names)}", f"{file}: joints")
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
    """Return which columns are not ignored, by their own name or by that of their joint."""
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
"""What bounds the speed where no cap is reached."""


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """T samples of a trajectory, the speed along its path, and what bounds it; InputError if they do not fit."""

    robot: Robot  # Who moves, and among what
    scene: Scene
    times: FloatArray  # (T,), instants, increasing from 0 [s]
    configurations: FloatArray  # (T, n), joint values [rad or m]
    speeds: FloatArray  # (T,), speed ṡ along the path [rad/s]
    # Name of a cap → the largest ṡ that it allows [rad/s]; +inf where it allows any
    bounds: Mapping[str, FloatArray] = field(default_factory=dict)
    # T names: the cap that the speed reaches; None where accelerations bind
    binding: tuple[str | None, ...] = ()
    danger: Mapping[str, Any] | None = None  # Options of the danger field
    name: str = ""  # Who planned it
    # T lines, what there is to say of each sample; by default how fast it is, and what bounds that
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.times)
        times = finite_array(self.times, (count,), "times")
        if count < 2 or times[0] != 0.0 or (np.diff(times) <= 0).any():
            raise InputError(f"must increase from 0, two at least, got {count}", "times")
        finite_array(self.configurations, (count, self.robot.n), "configurations")
        finite_array(self.speeds, (count,), "speeds")
        for to, values in self.bounds.items():
            float_array(values, (count,), f"bounds by {to}")
        for key, rows in (("binding", self.binding), ("remarks", self.remarks or self.binding)):
            if len(rows) != count:
                raise InputError(f"must have {count} entries, got {len(rows)}", key)

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        robot: Robot,
        scene: Scene,
        *,
        rate: float = RATE,
        danger: Mapping[str, Any] | None = None,
        name: str = "",
    ) -> TimedMotion:
        """Return the points of a trajectory, a rate [Hz] at least."""
        times, states = trajectory.points(rate)
        cells, _, speeds, _ = trajectory.law.at(times * (trajectory.duration / times[-1]))
        binding = trajectory.binding()
        return cls(
            robot,
            scene,
            times,
            states["positions"],
            speeds,
            {cap.name: cap.speeds[cells] for cap in trajectory.caps},
            tuple(binding[cell] for cell in cells),
            danger,
            name,
        )

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    def at(self, times: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at times (S,) [s]; at rest before and after."""
        columns = self.robot.unrolled(self.configurations).T
        return np.stack([np.interp(times, self.times, column) for column in columns], axis=1)

    def sample(self, time: float) -> int:
        """Return the number of the sample at a time [s], or before it."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))

    def remark(self, time: float) -> str:
        """Return what there is to say of it at a time [s]."""
        sample = self.sample(time)
        said = f"{self.speeds[sample]:.2f} rad/s, bounded by {self.binding[sample] or ACCELERATION}"
        return f"{min(time, self.duration):.2f} s: {self.remarks[sample] if self.remarks else said}"

    def to_mapping(self) -> dict[str, Any]:
        """Return what a file holds besides the points of the trajectory; `from_mapping` reads both."""
        return {
            "planner": self.name,
            "speeds": self.speeds.tolist(),
            "bounds": {name: values.tolist() for name, values in self.bounds.items()},
            "binding": list(self.binding),
            "problem": CarriedProblem(self.robot, self.scene, self.danger).to_mapping(),
        }

    @classmethod
    def from_mapping(
        cls, data: Mapping[str, Any], robot: Robot | None = None, package_dirs: Sequence[Path] = ()
    ) -> TimedMotion:
        """Read the file of a trajectory, as `safe-ompl plan --trajectory` writes it; see `load`."""
        about = CarriedProblem.from_mapping(document.require(data, "problem"), robot, package_dirs)
        points = document.sequence("points", document.require(data, "points"))
        bounds = document.by_name("bounds", document.require(data, "bounds"), document.sequence)
        return cls(
            about.robot,
            about.scene,
            *_points(points, about.robot.n),
            np.array(document.numbers("speeds", document.require(data, "speeds"))),
            {  # null is +inf in a file
                name: np.array([np.inf if v is None else document.number(f"bounds.{name}", v) for v in values])
                for name, values in bounds.items()
            },
            document.each("binding", document.require(data, "binding"), _name_or_none),
            about.danger,
            str(data.get("planner") or ""),
        )


def _name_or_none(key: str, value: Any) -> str | None:
    return None if value is None else document.text(key, value)


def _points(points: Sequence[Any], n: int) -> tuple[FloatArray, FloatArray]:
    """Return instants (T,) and configurations (T, n) of the points of a trajectory."""
    times, configurations = [], []
    for k, point in enumerate(points):
        with document.within(f"points[{k}]"):
            held = document.mapping("point", point)
            times.append(document.number("time_from_start", document.require(held, "time_from_start")))
            configurations.append(document.numbers("positions", document.require(held, "positions"), n))
    return np.array(times), np.array(configurations).reshape(-1, n)
