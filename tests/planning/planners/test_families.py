"""What every planner of the package promises, whatever its algorithm."""

import numpy as np
import pytest

from safe_ompl import Scenario, planner_names
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import is_ours, needs_place
from safe_ompl.scene import find_scenario

OURS = [name for name in planner_names() if is_ours(name)]


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load(find_scenario("planar3"))


@pytest.fixture(scope="module")
def setup(scenario):
    return setup_scenario(scenario)


@pytest.mark.parametrize("planner", OURS)
def test_finds_a_proven_path_from_start_to_goal_the_same_for_the_same_seed(setup, scenario, planner):
    result, _, again = (setup.plan(planner, time=20.0, seed=seed) for seed in (5, 6, 5))
    assert result
    assert result.report.certified
    np.testing.assert_array_equal(result.path, again.path)
    np.testing.assert_array_equal(result.path[0], scenario.start_configuration(setup.robot))
    if needs_place(planner):
        tip = setup.robot.tip_pose(result.path[-1]).translation
        assert np.linalg.norm(tip - scenario.goal.position) <= scenario.goal.tolerance
    else:
        np.testing.assert_array_equal(result.path[-1], scenario.goal_configurations(setup.robot)[0])
