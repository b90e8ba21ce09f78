"""The robot, scene and danger that results and motions in time are about, as they travel in files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from safe_ompl import document
from safe_ompl.paths.certificate.robot_document import built_robot, carried_robot
from safe_ompl.paths.certificate.scene_document import built_scene, carried_scene
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene


class Problem(NamedTuple):
    """Robot, scene, and the options of the danger field."""

    robot: Robot
    scene: Scene
    danger: Mapping[str, Any] | None

    def to_mapping(self) -> dict[str, Any]:
        """Return it as plain data, which `from_mapping` reads."""
        return {
            "robot": carried_robot(self.robot),
            "scene": carried_scene(self.scene),
            "danger": None if self.danger is None else dict(self.danger),
        }

    @classmethod
    def from_mapping(cls, data: object, robot: Robot | None = None) -> Problem:
        """Read it from a document; `robot` is used where it is given, and else built.

        Raises
        ------
        InputError, CertificateError
            If a key is missing or has no meaning, or robot and scene cannot be built.
        """
        with document.within("problem"):
            carried = document.mapping("carried", data)
            with document.within("robot"):
                robot = built_robot(document.require(carried, "robot")) if robot is None else robot
            with document.within("scene"):
                scene = built_scene(document.require(carried, "scene"))
        return cls(robot, scene, carried.get("danger"))
