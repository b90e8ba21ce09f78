"""What every planner of the package promises, whatever its algorithm."""

from __future__ import annotations

import numpy as np
import pytest

from safe_ompl import SafeSetup, Scenario, planner_names
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import is_ours, needs_place
from safe_ompl.scene import find_scenario

OURS = [name for name in planner_names() if is_ours(name)]
BASELINES = ["TRRT", "BiTRRT", "GradienTRRT", "HRRT"]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.load(find_scenario("planar3"))


@pytest.fixture(scope="module")
def setup(scenario: Scenario) -> SafeSetup:
    return setup_scenario(scenario)


@pytest.mark.parametrize("planner", [*OURS, *BASELINES])
def test_finds_a_proven_path_from_start_to_goal(setup: SafeSetup, scenario: Scenario, planner: str) -> None:
    result = setup.plan(planner, time=20.0, seed=3)
    assert result
    assert result.report.certified
    np.testing.assert_array_equal(result.path[0], scenario.start_configuration(setup.robot))
    if needs_place(planner):
        tip = setup.robot.tip_pose(result.path[-1]).translation
        assert np.linalg.norm(tip - scenario.goal.position) <= scenario.goal.tolerance
    else:
        np.testing.assert_array_equal(result.path[-1], scenario.goal_configurations(setup.robot)[0])


@pytest.mark.parametrize("planner", [*OURS, *BASELINES])
def test_same_seed_same_path(setup: SafeSetup, planner: str) -> None:
    first, _, again = (setup.plan(planner, time=20.0, seed=seed) for seed in (5, 6, 5))
    np.testing.assert_array_equal(first.path, again.path)
