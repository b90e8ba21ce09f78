"""A Panda beside a shelf and a person, and a path there."""

import pytest

from safe_ompl import CollisionChecker, MotionProver, RateLimits, Scenario
from safe_ompl.scene import find_scenario


@pytest.fixture(scope="session")
def shelf():
    return Scenario.load(find_scenario("panda_shelf"))


@pytest.fixture(scope="session")
def shelf_motion(shelf, panda):
    return MotionProver(CollisionChecker(panda, shelf.scene))


@pytest.fixture(scope="session")
def shelf_path(shelf, panda):
    """Return a path that draws the arm in before it passes the person."""
    start, goal = shelf.start_configuration(panda), shelf.goal_configurations(panda)[0]
    return [start, [0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785], goal]


@pytest.fixture(scope="session")
def panda_limits(panda):
    return RateLimits.of(panda, acceleration=[15, 7.5, 10, 12.5, 15, 20, 20])
