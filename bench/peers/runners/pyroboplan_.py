"""PyRoboPlan: its RRT-Connect and shortcuts in Python on Pinocchio and coal, checked at a step size."""

from __future__ import annotations

from typing import Any

import numpy as np
from pinocchio_world import World
from protocol import Waypoints, serve
from pyroboplan.planning.path_shortcutting import shortcut_path
from pyroboplan.planning.rrt import RRTPlanner, RRTPlannerOptions


class Pyroboplan:
    """Pinocchio's models, an RRT planner, shortcuts."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        self._world = World(robot)
        self._resolution = options["resolution"]

    def build(self, problem: dict[str, Any]) -> None:
        self._world.build(problem)
        self._problem = problem

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        options = RRTPlannerOptions(
            max_step_size=self._resolution,
            max_connection_dist=1.0,
            rrt_connect=True,
            bidirectional_rrt=True,
            max_planning_time=seconds,
            rng_seed=seed,
        )
        planner = RRTPlanner(self._world.model, self._world.geometry, options)
        path = planner.plan(np.array(self._problem["start"]), np.array(self._problem["goal"]))
        return None if path is None else [list(map(float, q)) for q in path]

    def smooth(self, path: Waypoints) -> Waypoints:
        rows = [np.array(q) for q in path]
        short = shortcut_path(self._world.model, self._world.geometry, rows, max_step_size=self._resolution)
        return [list(map(float, q)) for q in short]


serve(Pyroboplan)
