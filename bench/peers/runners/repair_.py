"""safe_ompl: another planner's path, proven; where it cannot be, repaired."""

from __future__ import annotations

import logging
from time import process_time
from typing import Any

import numpy as np
from ompl import util as ou
from protocol import Waypoints, serve
from safe_ompl_ import scene_of

from safe_ompl import CollisionChecker, Motion, MotionProver, Robot, SafeSetup
from safe_ompl.motions import repair_with


class Repair:
    """Proof of a path that is given; where there is none, displacement, or a planner's way round."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        ou.setLogLevel(ou.LogLevel.LOG_ERROR)
        logging.disable(logging.WARNING)
        self._robot = Robot.from_urdf(robot["urdf"], robot["srdf"], tip=robot["tip"])
        self.remarks: dict[str, Any] = {}

    def build(self, problem: dict[str, Any]) -> None:
        self._scene, self._given = scene_of(problem), problem["given"]
        self._proof = MotionProver(CollisionChecker(self._robot, self._scene))

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        return self._given  # another planner's path: its time is added by the bench

    def smooth(self, path: Waypoints) -> Waypoints:
        motion, begin = Motion.through(np.array(path)), process_time()
        found = repair_with(motion, self._proof, connect=self._connect)
        proven = found.how == "unchanged"
        self.remarks = {"proven": proven, "proof": process_time() - begin if proven else None}
        if proven:
            return path
        self.remarks |= {"how": found.how, "repaired": bool(found), "deviation": found.deviation}
        self.remarks["tool_deviation"] = found.tool_deviation
        return found.motion.knots.tolist()

    def _connect(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray | None:
        setup = SafeSetup(self._robot, self._scene)
        setup.setConfigurations(start, goal)
        return setup.plan("SafeRRTConnect", time=5.0, seed=0, simplify=0.05).path


if __name__ == "__main__":
    serve(Repair)
