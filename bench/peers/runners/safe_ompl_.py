"""safe_ompl: SafeRRTConnect (`planner`) and simplification, until done or for so many seconds (`simplify`)."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pinocchio as pin
from ompl import util as ou
from protocol import Waypoints, serve

from safe_ompl import Box, Cylinder, Obstacle, Pose, Robot, SafeSetup, Scene, Sphere

SHAPES = {"box": Box, "cylinder": Cylinder, "sphere": Sphere}


class SafeOmpl:
    """Setup, planner, simplification."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        ou.setLogLevel(ou.LogLevel.LOG_ERROR)
        logging.disable(logging.WARNING)
        self._robot = Robot.from_urdf(robot["urdf"], robot["srdf"], tip=robot["tip"])
        self._planner = options.get("planner", "SafeRRTConnect")
        self._simplify = options.get("simplify")

    def build(self, problem: dict[str, Any]) -> None:
        self._setup = SafeSetup(self._robot, scene_of(problem))
        self._setup.setConfigurations(problem["start"], [problem["goal"]])

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        self._setup.prepare(self._planner, seed)
        self._setup.solve(seconds)
        return self._setup.solution().tolist() if self._setup.haveExactSolutionPath() else None

    def smooth(self, path: Waypoints) -> Waypoints:
        if self._simplify == 0:
            return path
        self._setup.simplifySolution(*([] if self._simplify is None else [self._simplify]))
        return self._setup.solution().tolist()


def scene_of(problem: dict[str, Any]) -> Scene:
    """Return the obstacles of a problem."""
    obstacles = []
    for item in problem["obstacles"]:
        shape = SHAPES[item["kind"]](*([item["size"]] if item["kind"] == "box" else item["size"]))
        place = pin.SE3(np.array(item["rotation"]), np.array(item["position"]))
        obstacles.append(Obstacle(item["name"], shape, Pose.of(place), weight=1.0))
    return Scene(tuple(obstacles))


if __name__ == "__main__":
    serve(SafeOmpl)
