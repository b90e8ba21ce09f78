"""From a scenario to a setup, and from there to a result."""

import dataclasses

import numpy as np
import pytest
from ball import GOAL, IN_BALL, SCENE, START

from safe_ompl import InputError, Scenario, plan
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import RobotSpec
from safe_ompl.scene import find_scenario
from safe_ompl.scene.scenario import Goal


@pytest.fixture
def scenario():
    return Scenario(
        "ball",
        RobotSpec("ur5"),
        SCENE,
        tuple(START.tolist()),
        Goal((tuple(GOAL.tolist()),)),
        planners={"SafeRRTConnect": {"range": 0.2, "alpha": 0.0}},
    )


def test_a_scenario_in_one_call(scenario, tmp_path):
    result = plan(scenario, seed=4)
    assert result
    assert result.setup_time > 0
    assert plan(scenario, seed=4, simplify=True).report.length < result.report.length
    assert np.linalg.norm(np.diff(result.path, axis=0), axis=1).max() <= 0.2 + 1e-9, "its own parameters"
    file = tmp_path / "ball.yaml"
    scenario.save(file)
    np.testing.assert_array_equal(plan(file, seed=4).path, result.path)
    wide = plan(file, seed=4, parameters={"range": 1.0})
    assert np.linalg.norm(np.diff(wide.path, axis=0), axis=1).max() > 0.2


def test_a_scenario_whose_start_collides_names_file_and_pair(scenario, tmp_path):
    file = tmp_path / "bad.yaml"
    dataclasses.replace(scenario, start=tuple(IN_BALL.tolist())).save(file)
    with pytest.raises(InputError, match=r"bad.yaml: start is in collision: '.*_link' touches 'ball'"):
        plan(file)


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "RRTConnect", "SafeJTRRT"])
def test_a_scenario_may_name_a_place_alone(planner):
    scenario = Scenario.load(find_scenario("ur5_handover"))
    place = dataclasses.replace(scenario.goal, configurations=())
    setup = setup_scenario(dataclasses.replace(scenario, goal=place))
    result = setup.plan(planner, time=10.0, seed=1)
    assert result
    tip = setup.robot.tip_pose(result.path[-1]).translation
    assert np.linalg.norm(tip - place.position) <= place.tolerance
