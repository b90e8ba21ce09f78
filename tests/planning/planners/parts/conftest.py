"""Planning problems on which parts of planners are tested alone."""

import pytest
from plane import PlaneProblem, SlopedHotSpot

from safe_ompl import SafeRRTConnect, Scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.scene import find_scenario


@pytest.fixture
def plane():
    """Return a point in an empty plane with a sloped hot spot."""
    si = PlaneProblem(SafeRRTConnect).si
    problem = PlanningProblem(si)
    problem.take(SlopedHotSpot(si), None)
    return problem


@pytest.fixture(scope="package")
def shelf():
    return setup_scenario(Scenario.load(find_scenario("panda_shelf")))


@pytest.fixture
def shelf_problem(shelf):
    problem = PlanningProblem(shelf.getSpaceInformation())
    problem.take(shelf.getProblemDefinition().getOptimizationObjective(), None)
    return problem
