"""pydynorrt (dynoRRT): RRT-Connect in C++ on Pinocchio and hpp-fcl, and its shortcuts."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pydynorrt as dynorrt
from protocol import Waypoints, serve
from scene_urdf import scene_srdf, scene_urdf

OPTIONS = """
[RRTConnect_options]
max_it = 1000000
max_step = 1.0
collision_resolution = {resolution}
max_compute_time_ms = {milliseconds}
max_num_configs = 1000000
"""
SOLVED = ("GOAL_REACHED", "MAX_IT_GOAL_REACHED", "MAX_TIME_GOAL_REACHED", "MAX_NUM_CONFIGS_GOAL_REACHED")


class Dynorrt:
    """Collision manager on a URDF with the obstacles, RRT-Connect, shortcuts."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._robot = robot
        self._resolution = options["resolution"]

    def build(self, problem: dict[str, Any]) -> None:
        with TemporaryDirectory() as folder:
            urdf, srdf = Path(folder) / "scene.urdf", Path(folder) / "scene.srdf"
            urdf.write_text(scene_urdf(self._robot, problem))
            srdf.write_text(scene_srdf(self._robot, problem))
            self._manager = dynorrt.Collision_manager_pinocchio()
            self._manager.set_urdf_filename(str(urdf))
            self._manager.set_srdf_filename(str(srdf))
            self._manager.build()
        self._problem = problem

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        dynorrt.srand(seed)
        planner = dynorrt.PlannerRRTConnect_Rn()
        planner.set_start(np.array(self._problem["start"]))
        planner.set_goal(np.array(self._problem["goal"]))
        planner.init(len(self._robot["joints"]))
        planner.set_is_collision_free_fun_from_manager(self._manager)
        planner.set_bounds_to_state(self._robot["lower"], self._robot["upper"])
        planner.read_cfg_string(OPTIONS.format(resolution=self._resolution, milliseconds=1e3 * seconds))
        if planner.plan().name not in SOLVED:
            return None
        return [list(map(float, q)) for q in planner.get_path()]

    def smooth(self, path: Waypoints) -> Waypoints:
        shortcut = dynorrt.PathShortCut_RX()
        shortcut.init(len(self._robot["joints"]))
        shortcut.set_bounds_to_state(np.array(self._robot["lower"]), np.array(self._robot["upper"]))
        shortcut.set_initial_path([np.array(q) for q in path])
        shortcut.set_is_collision_free_fun_from_manager(self._manager)
        shortcut.shortcut()
        return [list(map(float, q)) for q in shortcut.get_path()]


serve(Dynorrt)
