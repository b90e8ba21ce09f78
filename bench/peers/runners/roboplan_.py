"""roboplan: its RRT-Connect and shortcutting, checked at a step size (`resolution`)."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from protocol import Waypoints, serve
from roboplan.core import (
    Box,
    Cylinder,
    JointConfiguration,
    PathShortcutter,
    PathShortcuttingOptions,
    Scene,
    Sphere,
    loadUrdfSceneDescription,
)
from roboplan.rrt import RRT, RRTOptions

COLOR = np.ones(4)


class Roboplan:
    """A scene with obstacles that come and go, RRT-Connect, shortcuts."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._names = robot["joints"]
        self._base = robot["base"]
        self._resolution = options["resolution"]
        self._description = loadUrdfSceneDescription(robot["urdf"])
        self._srdf = Path(robot["srdf"]).read_text()

    def build(self, problem: dict[str, Any]) -> None:
        scene = Scene("bench", self._description)
        scene.importSrdf(self._srdf)
        for item in problem["obstacles"]:
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = item["rotation"], item["position"]
            place = np.asfortranarray(place)
            shape = {"box": Box, "cylinder": Cylinder, "sphere": Sphere}[item["kind"]](*item["size"])
            add = {
                "box": scene.addBoxGeometry,
                "cylinder": scene.addCylinderGeometry,
                "sphere": scene.addSphereGeometry,
            }[item["kind"]]
            add(item["name"], "universe", shape, place, COLOR)
        names = [item["name"] for item in problem["obstacles"]]
        scene.setCollisions([*combinations(names, 2), *((self._base, name) for name in names)], False)
        self._scene, self._problem = scene, problem

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        options = RRTOptions(
            group_name="arm",
            max_nodes=1_000_000,
            collision_check_step_size=self._resolution,
            max_planning_time=seconds,
            rrt_connect=True,
        )
        planner = RRT(self._scene, options)
        planner.setRngSeed(seed)
        start, goal = (JointConfiguration(self._names, np.array(self._problem[end])) for end in ("start", "goal"))
        try:
            self._path = planner.plan(start, goal)
        except RuntimeError as error:
            print(error)
            return None
        return self._rows(self._path)

    def smooth(self, path: Waypoints) -> Waypoints:
        options = PathShortcuttingOptions(group_name="arm", max_step_size=self._resolution)
        return self._rows(PathShortcutter(self._scene, options).shortcut(self._path))

    def _rows(self, path: Any) -> Waypoints:
        order = [list(path.joint_names).index(name) for name in self._names]
        return [[float(q[k]) for k in order] for q in path.positions]


serve(Roboplan)
