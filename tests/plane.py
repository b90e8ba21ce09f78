"""A point in a plane, of plain OMPL parts: the world in which tests watch planners step by step."""

from itertools import pairwise

import numpy as np
from ompl import base as ob

EXACT, TIMEOUT = ob.PlannerStatus.EXACT_SOLUTION, ob.PlannerStatus.TIMEOUT
APPROXIMATE = ob.PlannerStatus.APPROXIMATE_SOLUTION
START, GOAL = (-0.8, 0.0), (0.8, 0.0)


# ------------------------------------------------------------------------------------------------- what is forbidden


class Walls(ob.StateValidityChecker):
    """Forbids what a function of (x, y) forbids; remembers what it was asked."""

    def __init__(self, si, forbidden):
        super().__init__(si)
        self.forbidden = forbidden
        self.asked = []

    def isValid(self, state):
        x, y = state[0:2]
        self.asked.append((x, y))
        return not self.forbidden(x, y)


def nowhere(x, y):
    return False


def wall_with_a_gap(x, y):
    return abs(x) < 0.1 and not 0.55 < y < 0.75


def walled_in(x, y):
    return 0.1 < max(abs(x - GOAL[0]), abs(y - GOAL[1])) < 0.15


# ------------------------------------------------------------------------------------------------ what is dangerous


class PlaneCost(ob.OptimizationObjective):
    """A cost of points, given by `values` of many at once."""

    def stateCost(self, state):
        return ob.Cost(float(self.values(np.array([state[0:2]]))[0]))

    def motionCost(self, start, end):
        return ob.Cost(0.0)


class HotSpot(PlaneCost):
    """A cost with a peak in the middle of the plane."""

    def values(self, Q):
        return np.exp(-4 * (Q**2).sum(axis=1))


class SlopedHotSpot(HotSpot):
    """The same, with gradients."""

    def values_and_gradients(self, Q):
        values = self.values(Q)
        return values, -8 * Q * values[:, None]


class ForbiddenCorner(PlaneCost):
    """Costs that are not finite on one side."""

    def values(self, Q):
        return np.where(Q[:, 1] > 0, np.inf, np.where(Q[:, 0] > 0, np.nan, 1.0 + Q[:, 0]))


# ----------------------------------------------------------------------------------------------------- what is asked


class PlaneProblem:
    """The way from starts to goals in the square of side 2, and one planner that `make_planner(si, …)` makes for it."""

    def __init__(
        self, make_planner, forbidden=nowhere, objective=None, starts=(START,), goals=(GOAL,), seed=0, **parameters
    ):
        space = ob.RealVectorStateSpace(2)
        space.setBounds(-1, 1)
        self.si = ob.SpaceInformation(space)
        self.walls = Walls(self.si, forbidden)
        self.si.setStateValidityChecker(self.walls)
        self.si.setStateValidityCheckingResolution(0.005)
        self.si.setup()
        self.problem = ob.ProblemDefinition(self.si)
        self.ask(starts, goals)
        if objective is not None:
            self.problem.setOptimizationObjective(objective(self.si))
        self.planner = make_planner(self.si, **parameters)
        self.planner.setSeed(seed)
        self.planner.setProblemDefinition(self.problem)
        self.planner.setup()
        self.walls.asked.clear()

    def ask(self, starts, goals):
        self.problem.clearStartStates()
        for start in starts:
            self.problem.addStartState(self.state(start))
        region = ob.GoalStates(self.si)
        for goal in goals:
            region.addState(self.state(goal))
        self.problem.setGoal(region)

    def ask_again(self, starts=(START,), goals=(GOAL,)):
        self.problem.clearSolutionPaths()
        self.ask(starts, goals)
        self.planner.clearQuery()
        self.walls.asked.clear()

    def state(self, point):
        state = self.si.getStateSpace().allocState()
        state[0:2] = list(point)
        return state

    def solve(self, time=60.0):
        return self.planner.solve(time).getStatus()

    @property
    def path(self):
        path = self.problem.getSolutionPath()
        return np.array([path.getState(k)[0:2] for k in range(path.getStateCount())])


def dense(path):
    """Return 400 configurations on each edge of a path."""
    return np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(path)])


class Stop:
    """A termination condition that fires when it was asked so often; says how much was checked after that."""

    def __init__(self, walls, questions):
        self._walls, self._left, self._checked = walls, questions, 0

    @property
    def condition(self):
        return ob.PlannerTerminationCondition(self._fires)  # kept here it would never be freed

    def _fires(self):
        self._left -= 1
        if self._left == 0:
            self._checked = len(self._walls.asked)
        return self._left <= 0

    @property
    def checked_too_late(self):
        """How many states were checked after it fired."""
        assert self._left <= 0, "it never fired"
        return len(self._walls.asked) - self._checked
