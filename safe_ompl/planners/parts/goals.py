"""Goals that are taken before and while a planner plans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_FIRST_GOALS = 100  # taken before planning begins


def first_goals(inputs: Any, goal: Any, ptc: Any) -> Iterator[Any]:
    """Yield the goal states that a problem offers before planning: all there are, up to a hundred.

    Where there is none yet, this waits for the first until `ptc` fires.

    Parameters
    ----------
    inputs : ob.PlannerInputStates
        The planner's; the states that it yields hold until the next one.
    goal : ob.GoalSampleableRegion
        The goal.
    ptc : ob.PlannerTerminationCondition
        When to stop.
    """
    if not goal.maxSampleCount():
        yield inputs.nextGoal(ptc)
    for _ in range(_FIRST_GOALS):
        if ptc() or not inputs.haveMoreGoalStates():
            return
        yield inputs.nextGoal()


def later_goals(inputs: Any, nodes: int) -> Iterator[Any]:
    """Yield another goal state, or none; this never waits.

    Goals taken while planning stay fewer than half of the nodes, as in OMPL: a region may have goals without end.

    Parameters
    ----------
    inputs : ob.PlannerInputStates
        The planner's.
    nodes : int
        How many nodes there are.
    """
    if 2 * inputs.getSampledGoalsCount() < nodes:
        yield inputs.nextGoal()
