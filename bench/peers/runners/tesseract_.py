"""tesseract: TrajOpt on another planner's path, with a cost for being nearer than a margin (`margin`)."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from protocol import Waypoints, serve
from scene_urdf import scene_srdf, scene_urdf
from tesseract_robotics import tesseract_command_language as language, tesseract_motion_planners_trajopt as trajopt
from tesseract_robotics.tesseract_common import FilesystemPath, GeneralResourceLocator, ManipulatorInfo
from tesseract_robotics.tesseract_environment import Environment
from tesseract_robotics.tesseract_motion_planners import PlannerRequest

TRAJOPT = "TrajOptMotionPlannerTask"
STEP = 0.3  # [rad] between way points
PLUGINS = """
contact_manager_plugins:
  search_libraries: [tesseract_collision_bullet_factories]
  discrete_plugins:
    default: BulletDiscreteBVHManager
    plugins: {BulletDiscreteBVHManager: {class: BulletDiscreteBVHManagerFactory}}
  continuous_plugins:
    default: BulletCastBVHManager
    plugins: {BulletCastBVHManager: {class: BulletCastBVHManagerFactory}}
"""


class Tesseract:
    """An environment with the obstacles, and TrajOpt."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._robot = robot
        self._margin = options["margin"]
        self._locator = GeneralResourceLocator()

    def build(self, problem: dict[str, Any]) -> None:
        with TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "plugins.yaml").write_text(PLUGINS)
            (folder / "scene.urdf").write_text(scene_urdf(self._robot, problem))
            (folder / "scene.srdf").write_text(self._srdf(problem, folder))
            self._environment = Environment()
            files = (FilesystemPath(str(folder / f"scene.{kind}")) for kind in ("urdf", "srdf"))
            if not self._environment.init(*files, self._locator):
                raise RuntimeError("the environment does not take the scene")
        self._problem = problem

    def _srdf(self, problem: dict[str, Any], folder: Path) -> str:
        root = ET.fromstring(scene_srdf(self._robot, problem))
        root.remove(root.find("group"))
        group = ET.SubElement(root, "group", name="arm")
        ET.SubElement(group, "chain", base_link=self._robot["base"], tip_link=self._robot["tip"])
        ET.SubElement(root, "contact_managers_plugin_config", filename=str(folder / "plugins.yaml"))
        return ET.tostring(root, encoding="unicode")

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        return self._problem["given"]  # another planner's path: its time is added by the bench

    def smooth(self, path: Waypoints) -> Waypoints:
        self._environment.setState(self._robot["joints"], np.array(self._problem["start"]))
        profile = trajopt.TrajOptDefaultCompositeProfile()
        profile.collision_constraint_config.safety_margin = 0.0  # ends may be nearer than the default
        profile.collision_cost_config.safety_margin = self._margin
        profiles = [(TRAJOPT, trajopt.TrajOptDefaultPlanProfile()), (TRAJOPT, profile)]
        answer = self._solve(trajopt.TrajOptMotionPlanner(TRAJOPT), self._program(path), profiles)
        return path if answer is None else _rows(answer)

    def _program(self, path: Waypoints) -> Any:
        """Return way points no farther apart than STEP; those between the ends are free."""
        program = language.CompositeInstruction("DEFAULT")
        info = ManipulatorInfo()
        info.tcp_frame, info.manipulator = self._robot["tip"], "arm"
        info.working_frame = self._robot["base"]
        program.setManipulatorInfo(info)
        rows = _dense(np.array(path))
        for k, q in enumerate(rows):
            target = language.JointWaypoint(self._robot["joints"], q)
            target.setIsConstrained(k in (0, len(rows) - 1))
            point = language.JointWaypointPoly_wrap_JointWaypoint(target)
            move = language.MoveInstruction(point, language.MoveInstructionType_FREESPACE, "DEFAULT")
            program.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
        return program

    def _solve(self, planner: Any, program: Any, profiles: list[tuple[str, Any]]) -> Any:
        request = PlannerRequest()
        request.instructions, request.env = program, self._environment
        request.profiles = language.ProfileDictionary()
        for namespace, profile in profiles:
            request.profiles.addProfile(namespace, "DEFAULT", profile)
        answer = planner.solve(request)
        if not answer.successful:
            print(answer.message)
        return answer if answer.successful else None  # its results live as long as itself


def _dense(path: np.ndarray) -> np.ndarray:
    rows = [path[:1]]
    for start, end in pairwise(path):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / STEP)))
        rows.append(start + np.linspace(0, 1, count + 1)[1:, None] * (end - start))
    return np.concatenate(rows)


def _rows(answer: Any) -> Waypoints:
    rows = []
    for instruction in answer.results.flatten():
        move = language.InstructionPoly_as_MoveInstructionPoly(instruction)  # lives as long as what it holds is used
        point = move.getWaypoint()
        if point.isStateWaypoint():
            held = language.WaypointPoly_as_StateWaypointPoly(point)
        else:
            held = language.WaypointPoly_as_JointWaypointPoly(point)
        rows.append([float(x) for x in np.array(held.getPosition()).flatten()])
    return rows


serve(Tesseract)
