"""Problems that planners are tested on."""

import numpy as np
import pytest
from plane import PlaneProblem, SlopedHotSpot

from safe_ompl import Box, Obstacle, Pose, SafeRRTConnect, SafeSetup, Scenario, Scene
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.problem import PlanningProblem


@pytest.fixture(scope="package")
def scenario():
    """Return the scenario planar3: three joints, a start, a place of the tip."""
    return Scenario.load("planar3")


@pytest.fixture(scope="package")
def planar3(scenario):
    return setup_scenario(scenario)


@pytest.fixture(scope="package")
def shelf():
    return setup_scenario(Scenario.load("panda_shelf"))


@pytest.fixture(scope="package")
def arm_between_walls():
    """Return an arm between two walls from the base to beyond its reach: the goal lies behind one of them."""
    planar2 = Scenario.load("planar2").build_robot()
    reach = 1.2 * float(np.linalg.norm(planar2.tip_pose(np.zeros(planar2.n)).translation))
    walls = [
        Obstacle(
            f"wall {a:.0f}",
            Box((reach, 0.02, 0.4)),
            Pose.from_rpy((0.6 * reach * np.cos(a), 0.6 * reach * np.sin(a), 0.0), (0.0, 0.0, a)),
            weight=1.0,
        )
        for a in (np.pi / 2, -np.pi / 2)
    ]
    setup = SafeSetup(planar2, Scene(tuple(walls)), danger={"spacing": 0.2})
    setup.setConfigurations([0.0, 0.0], [3.0, 0.0])
    return setup


@pytest.fixture
def plane():
    """Return a point in an empty plane with a sloped hot spot."""
    si = PlaneProblem(SafeRRTConnect).si
    problem = PlanningProblem(si)
    problem.take(SlopedHotSpot(si))
    return problem
