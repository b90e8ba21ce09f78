"""Constraints of way points: joint limits, a fixed start, and a goal that is fixed or free on its set."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.robot.inverse_kinematics import Place, solve_from_seed
from safe_ompl.robot.robot import Robot

_DAMPING = 1e-6  # [m²/rad²] of the projection: keeps it defined where the arm is singular


class FeasibleSet:
    """The set of feasible paths: way points within the joint limits, between ends that are fixed.

    Parameters
    ----------
    robot : Robot
        Gives the limits; continuous joints have none.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._lower = np.where(robot.continuous, -np.inf, robot.lower)
        self._upper = np.where(robot.continuous, np.inf, robot.upper)

    def within(self, Q: FloatArray) -> FloatArray:
        """Return the configurations within limits that are nearest to `Q: (…, n)`."""
        return np.minimum(np.maximum(Q, self._lower), self._upper)

    def nearest(self, path: FloatArray) -> FloatArray:
        """Return the path within limits that is nearest to `path: (N, n)`."""
        return self.within(path)

    def holds(self, path: FloatArray) -> bool:
        """Return whether the end of `path: (N, n)` is where it may be; one that is fixed always is."""
        return True

    def tangent(self, path: FloatArray, change: FloatArray) -> FloatArray:
        """Return a change of the path (N, n) that leaves its end where it is."""
        change[-1] = 0.0
        return change


class GoalSet(Protocol):
    """A place of the tip and how near to it is near enough, such as a `WorkspaceGoal`."""

    place: Place
    tolerance: float


class FreeGoal(FeasibleSet):
    """The set of feasible paths whose last way point may be anywhere where the tip is at its place.

    Parameters
    ----------
    goal : GoalSet
        The set. Goals found are a tenth of its tolerance near.
    """

    def __init__(self, goal: GoalSet) -> None:
        super().__init__(goal.place.robot)
        self.place = goal.place
        self._tolerance = goal.tolerance
        self._precision = 0.1 * goal.tolerance

    def nearest(self, path: FloatArray) -> FloatArray:
        """Return the path within limits, its end brought to the place; an end that cannot be stays as it is."""
        allowed = self.within(path)
        end = solve_from_seed(self.place, allowed[-1], self._precision)
        if end is not None:
            allowed[-1] = end
        return allowed

    def holds(self, path: FloatArray) -> bool:
        """Return whether the end of `path: (N, n)` is near enough to the place."""
        return self.place.distance(path[-1]) <= self._tolerance

    def tangent(self, path: FloatArray, change: FloatArray) -> FloatArray:
        """Return a change of the path (N, n) whose last row is in the null space of the tip's Jacobian."""
        jacobian = self.place.jacobian(path[-1])
        square = jacobian @ jacobian.T + _DAMPING * np.eye(len(jacobian))
        change[-1] -= jacobian.T @ np.linalg.solve(square, jacobian @ change[-1])
        return change
