"""A path with the names of its joints: what goes to a controller or a spreadsheet."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, finite_array
from safe_ompl.common import documents as document
from safe_ompl.planning import PlanResult


@dataclass(frozen=True, eq=False)
class JointPath:
    """Way points of named joints.

    Parameters
    ----------
    joint_names : sequence of str
        The n joints; their names differ.
    points : array_like, shape (N, n)
        Way points [rad or m]; between them the joints move on straight lines, continuous joints the short way.

    Raises
    ------
    InputError
        If names repeat, or the way points have another shape or are not finite.
    """

    joint_names: tuple[str, ...]
    points: FloatArray

    def __post_init__(self) -> None:
        names = tuple(document.text("joint name", name) for name in self.joint_names)
        if len(set(names)) < len(names):
            raise InputError(f"must differ, got {', '.join(names)}", "joint names")
        points = np.array(finite_array(self.points, (None, len(names)), "path"))
        points.setflags(write=False)
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "points", points)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, JointPath):
            return NotImplemented
        return self.joint_names == other.joint_names and np.array_equal(self.points, other.points)

    def __hash__(self) -> int:
        return hash((self.joint_names, self.points.tobytes()))

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

    # ---------------------------------------------------------------------------------------------------- CSV

    @classmethod
    def from_csv(cls, file: str | Path) -> JointPath:
        """Read a path from CSV: a line with the names of the joints, then one line for each way point.

        Raises
        ------
        InputError
            If it cannot be read; names the line.
        """
        try:
            with Path(file).open(newline="", encoding="utf-8") as stream:
                rows = list(csv.reader(stream))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"cannot be read as CSV: {error}", str(file)) from None
        if not rows:
            raise InputError("is empty; the first line must name the joints", str(file))
        points = [_numbers(row, len(rows[0]), f"{file}:{k}") for k, row in enumerate(rows[1:], start=2)]
        with document.within(str(file), ": "):
            return cls(tuple(rows[0]), np.reshape(points, (-1, len(rows[0]))))

    def to_csv(self, file: str | Path) -> None:
        """Write the path as CSV, which `from_csv` reads back exactly."""
        with Path(file).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(self.joint_names)
            writer.writerows(self.points.tolist())

    # ------------------------------------------------------------------------------------------- other shapes

    def to_joint_trajectory(self) -> dict[str, Any]:
        """Return the path in the shape of ROS's trajectory_msgs/JointTrajectory, without times.

        A controller needs a `time_from_start` in every point: a path says where, not when.
        """
        points = [{"positions": q} for q in self.points.tolist()]
        return {"joint_names": list(self.joint_names), "points": points}

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        return {"joint_names": list(self.joint_names), "path": self.points.tolist()}

    @classmethod
    def from_mapping(cls, data: dict[str, Any]) -> JointPath:
        """Read a path from a document."""
        names = document.sequence("joint_names", document.require(data, "joint_names"))
        return cls(tuple(names), document.require(data, "path"))


def _numbers(row: Iterable[str], count: int, place: str) -> list[float]:
    try:
        values = [float(cell) for cell in row]
    except ValueError as error:
        raise InputError(f"must be numbers ({error})", place) from None
    if len(values) != count:
        raise InputError(f"must have {count} numbers, one for each joint, got {len(values)}", place)
    return values
