"""Planning problems on which parts of planners are tested alone."""

from __future__ import annotations

import pytest
from plane import PlaneProblem, SlopedHotSpot

from safe_ompl.planners import SafeRRTConnect
from safe_ompl.planners.parts.problem import PlanningProblem
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.setup.from_scenario import setup_scenario
from safe_ompl.setup.safe_setup import SafeSetup


@pytest.fixture
def plane() -> PlanningProblem:
    """Return a point in an empty plane with a sloped hot spot."""
    si = PlaneProblem(SafeRRTConnect).si
    problem = PlanningProblem(si)
    problem.take(SlopedHotSpot(si), None)
    return problem


@pytest.fixture(scope="package")
def shelf() -> SafeSetup:
    return setup_scenario(Scenario.load(find_scenario("panda_shelf")))


@pytest.fixture
def shelf_problem(shelf: SafeSetup) -> PlanningProblem:
    problem = PlanningProblem(shelf.getSpaceInformation())
    problem.take(shelf.getProblemDefinition().getOptimizationObjective(), None)
    return problem
