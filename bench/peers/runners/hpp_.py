"""hpp-core: its bidirectional RRT with continuous path validation (`validation`), then random shortcuts."""

from __future__ import annotations

from typing import Any

import numpy as np
from pinocchio import SE3
from protocol import Waypoints, serve
from pyhpp import core
from pyhpp.pinocchio import Device
from pyhpp.pinocchio.urdf import loadModelFromString
from scene_urdf import scene_srdf, scene_urdf

TOLERANCES = {"progressive": 0.001, "dichotomy": 0.0}  # [m]; how deep bodies may be in each other


class Hpp:
    """A device with the obstacles on its base, a problem, a planner."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._robot = robot
        self._tolerance = TOLERANCES[options["validation"]]
        self._validation = {"progressive": core.Progressive, "dichotomy": core.Dichotomy}[options["validation"]]

    def build(self, problem: dict[str, Any]) -> None:
        device = Device("robot")
        urdf, srdf = scene_urdf(self._robot, problem), scene_srdf(self._robot, problem)
        loadModelFromString(device, 0, "", "anchor", urdf, srdf, SE3.Identity())
        self._problem = core.Problem(device)
        self._problem.pathValidation(self._validation(device, self._tolerance))
        self._problem.initConfig(np.array(problem["start"]))
        self._problem.addGoalConfig(np.array(problem["goal"]))

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        planner = core.BiRRTPlanner(self._problem)
        planner.timeOut(seconds)
        try:
            self._path = planner.solve()
        except RuntimeError as error:
            print(error)
            return None
        return _rows(self._path)

    def smooth(self, path: Waypoints) -> Waypoints:
        return _rows(core.RandomShortcut(self._problem).optimize(self._path))


def _rows(path: Any) -> Waypoints:
    """Return the way points of a vector of paths."""
    count = path.numberPaths()
    rows = [path.pathAtRank(k).initial() for k in range(count)] + [path.pathAtRank(count - 1).end()]
    return [list(map(float, row)) for row in rows]


serve(Hpp)
