"""sscbirrt: CBiRRT as it comes, with a collision check from Python on Pinocchio and coal; its path is smoothed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from pinocchio_world import World
from protocol import Waypoints, serve
from sscbirrt import CBiRRT, CBiRRTConfig, FiniteSet, JointSpace, PlanningProblem


class Model:
    """What the planner asks of a robot where nothing but configurations is planned."""

    def __init__(self, robot: dict[str, Any]) -> None:
        self.dof = len(robot["joints"])
        self.joint_limits = np.array(robot["lower"]), np.array(robot["upper"])


class Checker:
    """Collision checks of single configurations."""

    def __init__(self, world: World) -> None:
        self._model, self._geometry = world.model, world.geometry
        self._data, self._contacts = self._model.createData(), pin.GeometryData(self._geometry)

    def is_valid(self, q: np.ndarray) -> bool:
        """Return whether nothing touches."""
        return not pin.computeCollisions(self._model, self._data, self._geometry, self._contacts, q, True)


class Sscbirrt:
    """CBiRRT between two configurations."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._robot, self._world = robot, World(robot)

    def build(self, problem: dict[str, Any]) -> None:
        self._world.build(problem)
        self._problem = problem
        self._checker = Checker(self._world)

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        space = JointSpace(np.array(self._robot["lower"]), np.array(self._robot["upper"]))
        start, goal = (FiniteSet([np.array(self._problem[end])]) for end in ("start", "goal"))
        planner = CBiRRT(Model(self._robot), None, self._checker, CBiRRTConfig(timeout=seconds))
        result = planner.solve(PlanningProblem(space, start, goal, self._checker), seed)
        return None if not result.success else [list(map(float, q)) for q in result.path]

    def smooth(self, path: Waypoints) -> Waypoints:
        return path  # `solve` has smoothed it


serve(Sscbirrt)
