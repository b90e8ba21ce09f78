"""OMPL's RRTConnect and path simplifier with a plain state check from Python, at 0.02 rad (`resolution`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from ompl import base as ob, geometric as og, util as ou
from pinocchio_world import World
from protocol import Waypoints, serve


class Ompl:
    """SimpleSetup as its tutorials have it."""

    def __init__(self, robot: dict[str, Any], options: dict[str, Any]) -> None:
        ou.setLogLevel(ou.LogLevel.LOG_ERROR)
        self._world = World(robot)
        self._lower, self._upper = robot["lower"], robot["upper"]
        self._resolution = options.get("resolution", 0.02)

    def build(self, problem: dict[str, Any]) -> None:
        self._world.build(problem)
        n = len(self._lower)
        space = ob.RealVectorStateSpace(n)
        bounds = ob.RealVectorBounds(n)
        for k in range(n):
            bounds.setLow(k, self._lower[k])
            bounds.setHigh(k, self._upper[k])
        space.setBounds(bounds)
        space.setLongestValidSegmentFraction(self._resolution / space.getMaximumExtent())
        self._setup = og.SimpleSetup(space)
        model, geometry = self._world.model, self._world.geometry
        data, contacts = model.createData(), pin.GeometryData(geometry)
        # Without contacts coal misses some overlaps of cylinders.
        for request in contacts.collisionRequests:
            request.enable_contact = True

        def valid(state: Any) -> bool:
            q = np.array([state[k] for k in range(n)])
            return not pin.computeCollisions(model, data, geometry, contacts, q, True)

        self._setup.setStateValidityChecker(valid)
        start, goal = (self._setup.getSpaceInformation().allocState(), self._setup.getSpaceInformation().allocState())
        for k in range(n):
            start[k], goal[k] = problem["start"][k], problem["goal"][k]
        self._setup.setStartAndGoalStates(start, goal)
        self._setup.setPlanner(og.RRTConnect(self._setup.getSpaceInformation()))

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        self._setup.solve(seconds)
        return self._path() if self._setup.haveExactSolutionPath() else None

    def smooth(self, path: Waypoints) -> Waypoints:
        self._setup.simplifySolution()
        return self._path()

    def _path(self) -> Waypoints:
        n = len(self._lower)
        return [[state[k] for k in range(n)] for state in self._setup.getSolutionPath().getStates()]


serve(Ompl)
