"""VAMP: RRT-Connect and its simplification on SIMD lanes, with VAMP's own spheres of the Panda and its own step size.

Cylinders become capsules, or boxes in the problems of the family "box", as VAMP's `problem_dict_to_vamp` does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import vamp
from protocol import Waypoints, serve

# Each seed skips this many numbers of the Halton sequence, which has no seed.
SKIPPED = 1000
# VAMP allocates memory for all samples at each query. For its default, 1 000 000, this takes longer than planning.
SAMPLES = 50_000


class Vamp:
    """VAMP's module of the robot, an environment, RRT-Connect."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        configured = vamp.configure_robot_and_planner_with_kwargs(robot["name"], "rrtc")
        self._module, self._planner, self._settings, self._simplification = configured
        self._settings.max_iterations = self._settings.max_samples = SAMPLES

    def build(self, problem: dict[str, Any]) -> None:
        scene, boxes = vamp.Environment(), problem["name"].startswith("box ")
        for item in problem["obstacles"]:
            size, place = item["size"], (item["position"], _rpy(np.array(item["rotation"])))
            if item["kind"] == "box":
                scene.add_cuboid(vamp.Cuboid(*place, [edge / 2 for edge in size]))
            elif item["kind"] == "sphere":
                scene.add_sphere(vamp.Sphere(item["position"], *size))
            elif boxes:
                radius, length = size
                scene.add_cuboid(vamp.Cuboid(*place, [radius, radius, length / 2]))
            else:
                scene.add_capsule(vamp.Cylinder(*place, *size))
        self._scene, self._problem = scene, problem

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        start, goal = self._problem["start"], self._problem["goal"]
        for q in (start, goal):
            if not self._module.validate(q, self._scene):
                raise ValueError(f"in collision at {q}")
        self._random = self._module.halton()
        self._random.skip(seed * SKIPPED)
        self._path = self._planner(start, goal, self._scene, self._settings, self._random).path
        return _rows(self._path) or None

    def smooth(self, path: Waypoints) -> Waypoints:
        simplified = self._module.simplify(self._path, self._scene, self._simplification, self._random)
        return _rows(simplified.path)


def _rows(path: Any) -> Waypoints:
    return [[float(x) for x in path[k]] for k in range(len(path))]


def _rpy(rotation: np.ndarray) -> list[float]:
    """Return roll, pitch and yaw about the fixed axes of a rotation matrix (3, 3)."""
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    yaw, roll = np.arctan2(rotation[1, 0], rotation[0, 0]), np.arctan2(rotation[2, 1], rotation[2, 2])
    return [float(roll), float(pitch), float(yaw)]


serve(Vamp)
