"""A check that a path begins at a start and ends in the goal, or it is no solution."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import PlanningError
from safe_ompl.plugins.states import ScratchState, StateBridge

END_TOLERANCE = 1e-6  # [rad or m] in joint space


def check_endpoints(path: FloatArray, problem: Any, bridge: StateBridge, name: str) -> None:
    """Raise an error if a path (N, n) does not begin at a start of the problem, or does not end in its goal.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        What a planner calls an exact solution.
    problem : ob.ProblemDefinition
        What it was to solve.
    bridge : StateBridge
        Of the space.
    name : str
        Name of the planner, for the error.

    Raises
    ------
    PlanningError
        Names the distance.
    """
    starts = start_configurations(problem, bridge)
    distance = min(
        (float(np.linalg.norm(bridge.difference(start, path[0]))) for start in starts), default=np.inf
    )
    if not distance <= END_TOLERANCE:
        raise PlanningError(f"{name} returned a path that begins {distance:.3g} rad away from every start")
    goal, last = problem.getGoal(), ScratchState(bridge)
    state = last.set(path[-1])
    if isinstance(goal, ob.GoalRegion):
        short, unit = float(goal.distanceGoal(state)), "m" if hasattr(goal, "place") else "rad"
        if not short <= max(END_TOLERANCE, goal.getThreshold()):
            raise PlanningError(f"{name} returned a path that ends {short:.3g} {unit} away from the goal")
    elif not goal.isSatisfied(state):
        raise PlanningError(f"{name} returned a path that does not end in the goal")


def start_configurations(problem: Any, bridge: StateBridge) -> Sequence[FloatArray]:
    """Return the valid starts (n,) of a problem."""
    inputs, starts = ob.PlannerInputStates(), list[FloatArray]()
    inputs.use(problem)
    while inputs.haveMoreStartStates():
        state = inputs.nextStart()
        if state is None:
            break
        starts.append(bridge.read(state))
    return starts
