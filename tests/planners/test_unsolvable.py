"""Queries without a solution: every planner ends at its time limit, says so, and keeps its memory in bounds."""

import resource

import numpy as np
import pytest

from safe_ompl.planners.registry import is_ours, needs_place, planner_names
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.basic import Box
from safe_ompl.setup.safe_setup import SafeSetup

OURS = [name for name in planner_names() if is_ours(name)]
BASELINES = ["TRRT", "BiTRRT", "GradienTRRT"]
LIMIT = 0.8  # [s]


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Scenario.load(find_scenario("planar2")).build_robot()


@pytest.fixture(scope="module")
def walled_in(robot) -> SafeSetup:
    """Return an arm between two walls from the base to beyond its reach: the goal lies behind one of them."""
    reach = 1.2 * float(np.linalg.norm(robot.tip_pose(np.zeros(robot.n)).translation))
    walls = [
        Obstacle(
            f"wall {k}",
            Box((reach, 0.02, 0.4)),
            Pose.from_rpy((0.6 * reach * np.cos(a), 0.6 * reach * np.sin(a), 0.0), (0.0, 0.0, a)),
            weight=1.0,
        )
        for k, a in enumerate((np.pi / 2, -np.pi / 2))
    ]
    setup = SafeSetup(robot, Scene(tuple(walls)), danger={"spacing": 0.2})
    setup.setConfigurations([0.0, 0.0], [3.0, 0.0])
    return setup


def megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("planner", [name for name in [*OURS, *BASELINES] if not needs_place(name)])
def test_a_goal_behind_a_wall(walled_in, planner):
    before = megabytes()
    result = walled_in.plan(planner, time=LIMIT)
    assert not result
    assert result.status == "Timeout"
    assert result.planning_time < LIMIT + 5.0
    assert megabytes() - before < 100


@pytest.mark.parametrize("planner", OURS)
def test_a_place_out_of_reach(robot, planner):
    setup = SafeSetup(robot, Scene(()), danger=None)
    setup.setStartConfiguration([0.0, 0.0])
    setup.setWorkspaceGoal([50.0, 0.0, 0.0])
    before = megabytes()
    result = setup.plan(planner, time=LIMIT)
    assert not result
    assert result.status == "Timeout"
    assert result.planning_time < LIMIT + 5.0
    assert megabytes() - before < 100
