"""MotionBenchMaker problems in the JSON form of the VAMP planner.

Reference: C. Chamzas et al., MotionBenchMaker: a tool to generate and benchmark motion planning datasets,
IEEE Robotics and Automation Letters, 2022.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, documents as document, files
from safe_ompl.robot import Robot
from safe_ompl.scene.scenario import configuration_for
from safe_ompl.scene.scene import Scene

MBM_FILES_ORIGIN = (
    "such files come from VAMP's repository: resources/ROBOT/problems.tar.bz2, made into problems.json by its script "
    "resources/problem_tar_to_pkl_json.py"
)
# Joint limits are widened for goals that exceed them by at most this, because the files contain rounded goals.
_SLIGHTLY = 0.1  # [rad or m]


@dataclass(frozen=True)
class MbmProblem:
    """One planning problem of a MotionBenchMaker file, with its `index` in a family of scenes.

    Joint values [rad or m] are in the order of `joint_names`, or of the robot's joints if the file has no names. The
    planner may choose any goal. All obstacles have the danger weight 1. The source is file and key, for errors.
    """

    family: str
    index: int
    joint_names: tuple[str, ...]
    start: tuple[float, ...]
    goals: tuple[tuple[float, ...], ...]
    scene: Scene
    source: str = field(compare=False)

    def start_configuration(self, robot: Robot) -> FloatArray:
        """Return the start (n,) in the order of the robot's joints.

        Raises InputError if the joints are not those of the robot, or a value is outside its limits.
        """
        return self._for(robot, "start", self.start)

    def goal_configurations(self, robot: Robot) -> FloatArray:
        """Return the goals (G, n) in the order of the robot's joints. Raises as `start_configuration`."""
        return np.array([self._for(robot, f"goals[{k}]", goal) for k, goal in enumerate(self.goals)])

    def widened_limits(self, robot: Robot) -> dict[str, tuple[float, float]]:
        """Return wider limits for the joints whose limits a goal slightly exceeds."""
        limits = {
            name: (float(low), float(high))
            for name, low, high in zip(robot.joint_names, robot.lower, robot.upper, strict=True)
        }
        wider: dict[str, tuple[float, float]] = {}
        for goal in self.goals:
            for name, value in zip(self.joint_names or robot.joint_names, goal, strict=False):
                low, high = wider.get(name, limits[name])
                if 0 < max(low - value, value - high) <= _SLIGHTLY:
                    wider[name] = (min(low, value), max(high, value))
        return {name: wider[name] for name in wider if not robot.continuous[robot.joint_names.index(name)]}

    def _for(self, robot: Robot, key: str, values: tuple[float, ...]) -> FloatArray:
        given = dict(zip(self.joint_names, values, strict=True)) if self.joint_names else values
        with document.within(self.source):
            return configuration_for(robot, key, given, is_start=key == "start")


@dataclass(frozen=True)
class MbmFile:
    """A MotionBenchMaker file: problems by family, for the robot and the joints that it names."""

    path: Path
    robot: str
    joint_names: tuple[str, ...]
    spacing: float
    _families: Mapping[str, list[Any]] = field(repr=False)

    @classmethod
    def load(cls, path: str | Path, spacing: float = 0.1) -> MbmFile:
        """Read a file. The danger points of its scenes are `spacing` [m] apart.

        Raises InputError if the file cannot be read, is not JSON, or does not contain lists of problems by family.
        """
        with document.within(str(path), ": "):
            try:
                data = document.mapping("document", files.parse_json(files.file_text(Path(path))))
                families = document.mapping("problems", document.require(data, "problems"))
            except InputError as error:
                raise InputError(f"{error}; {MBM_FILES_ORIGIN}") from None
            with document.within("problems"):
                lists = {family: document.sequence(family, items) for family, items in families.items()}
            names = document.sequence("joints", data.get("joints", ()))
            joints = tuple(document.text("joints", name) for name in names)
            robot = document.text("robot", data["robot"]) if "robot" in data else ""
        return cls(Path(path), robot, joints, spacing, lists)

    @property
    def families(self) -> dict[str, int]:
        """Number of problems of each family, in the order of the file."""
        return {family: len(items) for family, items in self._families.items()}

    def problem(self, family: str, k: int) -> MbmProblem:
        """Return the k-th problem of a family. Raises InputError with file, key and value if it is malformed."""
        place = f"problems.{family}[{k}]"
        with document.within(str(self.path), ": "):
            data = document.mapping(place, self._families[family][k])
            with document.within(place):
                index = document.whole_number("index", data.get("index", k))
                goals = document.sequence("goals", document.require(data, "goals"))
                if not goals:
                    raise InputError("must hold at least one goal", "goals")
                count = len(self.joint_names) or None
                return MbmProblem(
                    family,
                    index,
                    self.joint_names,
                    document.numbers("start", document.require(data, "start"), count),
                    tuple(document.numbers(f"goals[{i}]", goal, count) for i, goal in enumerate(goals)),
                    Scene.from_mbm(data, self.spacing),
                    f"{self.path}: {place}",
                )
