"""`FunctionPlanner`: a user's planning function, whose path is checked, repaired where it collides, and proven."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product, starmap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob

import safe_ompl.motions as motions
from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError, PlanningError, finite_array
from safe_ompl.planning.ompl import CertifiedMotionValidator
from safe_ompl.planning.planners.base import SafePlanner
from safe_ompl.planning.planners.rrt_connect import SafeRRTConnect
from safe_ompl.robot import Robot, ScratchState
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

# A function of robot, scene, start (n,) and goal (n,) that returns way points (N, n), or None if it finds no path.
PathFunction = Callable[[Robot, Scene, FloatArray, FloatArray], "ArrayLike | None"]

# Planners in single precision return rounded ends. The ends of a path may differ from start and goal by this much.
_END_ROUNDING = 1e-4  # [rad or m]


class FunctionPlanner(SafePlanner):
    """Plans by a function of the user's, such as a call of VAMP, of plainmp or of a learned planner.

    The function is called for each pair of start and goal, until one path can be proven. A path in collision or against
    a limit is repaired: pieces of it are moved aside as little as possible, and where this fails a `SafeRRTConnect`
    plans detours. The function is not interrupted when the time is over.

    Parameters
    ----------
    si : ob.SpaceInformation
        Space information with a `CollisionFreeValidity` and a `CertifiedMotionValidator`, as of a `SafeSetup`.
    function : callable
        Function of `(robot, scene, start, goal)` that returns way points (N, n) [rad or m] in the order of the robot's
        joints, or None if it finds no path. Start and goal are arrays (n,).
    name : str, optional
        Name in logs and results; by default the name of the function.
    range : float >= 0, default 0.0 [rad]
        Largest length of one extension of a detour; 0 means 7.5 % of the space's extent.

    Attributes
    ----------
    repaired : str
        How the last path was repaired, or "unchanged".
    """

    def __init__(self, si: Any, function: PathFunction, name: str | None = None, **parameters: Any) -> None:
        if not callable(function):
            raise InputError(f"function must be a function of robot, scene, start and goal, got {function!r}")
        self._function, self.repaired = function, ""
        super().__init__(si, name or getattr(function, "__name__", type(function).__name__), **parameters)

    def _search(self, ptc: Any) -> FloatArray | None:
        robot, validator = self._problem.robot, self.getSpaceInformation().getMotionValidator()
        if robot is None or type(validator) is not CertifiedMotionValidator:
            raise InputError(f"{self.getName()} needs a CollisionFreeValidity and a CertifiedMotionValidator")
        for start, goal in product(self._trees.start.roots, self._trees.goal.roots):
            if ptc():
                break
            found = self._function(robot, validator.checker.scene, start.copy(), goal.copy())
            path = None if found is None else self._proven(self._taken(found, start, goal), validator, ptc)
            if path is not None:
                return path
        return None

    def _taken(self, found: ArrayLike, start: FloatArray, goal: FloatArray) -> FloatArray:
        """Check the function's way points, and return them (N, n) with exact start and goal.

        Raises InputError for invalid way points, and PlanningError if the path does not lead from start to goal.
        """
        path = finite_array(found, (None, self._bridge.n), f"way points of {self.getName()}")
        if len(path) < 2:
            raise InputError(f"way points of {self.getName()} must be two or more, got {len(path)}")
        for end, row, word in ((start, 0, "begins"), (goal, -1, "ends")):
            away = self._bridge.difference(path[row], end)
            if np.abs(away).max() > _END_ROUNDING:
                raise PlanningError(f"{self.getName()} returned a path that {word} {np.abs(away).max():.3g} rad away")
            # A continuous joint may differ from the end by full turns, which are kept.
            path[row] = np.where(np.abs(path[row] - end) <= _END_ROUNDING, end, path[row] + away)
        # Planners may repeat way points.
        differ = np.diff(path[:-1].astype(np.float32), axis=0).any(axis=1)
        return np.asarray(path[np.concatenate([[True], differ, [True]])])

    def _proven(self, path: FloatArray, validator: CertifiedMotionValidator, ptc: Any) -> FloatArray | None:
        """Return the path (N, n) if it is proven, else the repaired path, or None if the repair fails."""

        def connect(start: FloatArray, goal: FloatArray) -> FloatArray | None:
            return self._way_round(start, goal, ptc)

        # Nothing can be proven of a user's checker, so it is called on the repaired path afterwards.
        constraints = replace(validator.getConstraints(), user=None)
        prover = MotionProver(validator.checker, separation=constraints.separation, limits=constraints.limits)
        repair = motions.repair_with(motions.Motion.through(path), prover, connect=connect)
        if not repair:
            _log.warning("%s: the path is not proven: %s", self.getName(), repair.how)
            return None
        if not all(starmap(self._problem.motion_is_free, pairwise(repair.path))):
            self.repaired = "planned anew, as the state validity checker refuses it"
            return connect(path[0], path[-1])
        self.repaired = repair.how
        if repair.how != "unchanged":
            self.repaired += f", by at most {repair.deviation:.2g} rad and {repair.tool_deviation:.0f} mm at the tip"
        return repair.path

    def _way_round(self, start: FloatArray, goal: FloatArray, ptc: Any) -> FloatArray | None:
        """Plan a free path (N, n) between two configurations (n,) with `SafeRRTConnect`; None if none is found."""
        si = self.getSpaceInformation()
        problem, ends = ob.ProblemDefinition(si), (ScratchState(self._bridge), ScratchState(self._bridge))
        problem.setStartAndGoalStates(ends[0].set(start), ends[1].set(goal))
        if (objective := self.getProblemDefinition().getOptimizationObjective()) is not None:
            problem.setOptimizationObjective(objective)
        planner = SafeRRTConnect(si, range=self.range)
        planner.setSeed(int(self._rng.integers(2**32)))
        planner.setProblemDefinition(problem)
        planner.solve(ptc)
        return self._bridge.way_points(problem.getSolutionPath()) if problem.hasExactSolution() else None
