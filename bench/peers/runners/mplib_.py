"""MPlib: OMPL's RRTConnect on FCL in C++, as its `Planner.plan_qpos` runs it."""

from __future__ import annotations

from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import mplib
import numpy as np
from mplib.collision_detection import fcl
from protocol import Waypoints, serve


class Mplib:
    """MPlib's planner with the obstacles as objects of its planning world."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        with TemporaryDirectory() as folder:
            urdf = _with_convex_meshes(Path(robot["urdf"]), Path(folder))
            self._planner = mplib.Planner(urdf=urdf, srdf=robot["srdf"], move_group=robot["tip"], use_convex=True)
        self._base = robot["base"]
        self._names: list[str] = []

    def build(self, problem: dict[str, Any]) -> None:
        world = self._planner.planning_world
        for name in self._names:
            world.remove_object(name)
        self._names = []
        for item in problem["obstacles"]:
            shape = {"box": lambda x, y, z: fcl.Box([x, y, z]), "cylinder": fcl.Cylinder, "sphere": fcl.Sphere}[
                item["kind"]
            ](*item["size"])
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = item["rotation"], item["position"]
            body = fcl.CollisionObject(shape)
            part = fcl.FCLObject(item["name"], mplib.Pose(place), [body], [mplib.Pose()])
            world.add_object(part)
            world.get_allowed_collision_matrix().set_entry(self._base, item["name"], True)
            self._names.append(item["name"])
        self._problem = problem

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        status, path = self._planner.planner.plan(
            np.array(self._problem["start"]),
            [np.array(self._problem["goal"])],
            time=seconds,
            range=0.0,
            verbose=False,
            simplify=False,
        )
        self._path = np.asarray(path)
        return self._path.tolist() if status == "Exact solution" else None

    def smooth(self, path: Waypoints) -> Waypoints:
        return np.asarray(self._planner.planner.simplify_path(np.array(path))).tolist()


def _with_convex_meshes(urdf: Path, folder: Path) -> Path:
    """Write the URDF with meshes beside it, under the names that MPlib takes for convex ones."""
    root = ET.parse(urdf).getroot()
    for mesh in root.iter("mesh"):
        source = Path(mesh.get("filename", ""))
        copyfile(source, folder / f"{source.name}.convex.stl")
        mesh.set("filename", source.name)
    ET.ElementTree(root).write(folder / urdf.name)
    return folder / urdf.name


serve(Mplib)
