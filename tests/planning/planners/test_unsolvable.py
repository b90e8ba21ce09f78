"""Queries without a solution: every planner ends at its time limit, says so, and keeps its memory in bounds."""

import resource

import pytest

from safe_ompl.planning.planners.registry import is_ours, needs_place, planner_names
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.scene.scene import Scene

OURS = [name for name in planner_names() if is_ours(name)]
BASELINES = ["TRRT", "BiTRRT", "GradienTRRT"]
LIMIT = 0.8  # [s]


def megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("planner", [name for name in [*OURS, *BASELINES] if not needs_place(name)])
def test_a_goal_behind_a_wall(arm_between_walls, planner):
    before = megabytes()
    result = arm_between_walls.plan(planner, time=LIMIT)
    assert not result
    assert result.status == "Timeout"
    assert megabytes() - before < 100


@pytest.mark.parametrize("planner", OURS)
def test_a_place_out_of_reach(planar2, planner):
    setup = SafeSetup(planar2, Scene(()), danger=None)
    setup.setStartConfiguration([0.0, 0.0])
    setup.setWorkspaceGoal([0.3, 0.0, 0.5])  # out of the plane in which the tip moves
    before = megabytes()
    result = setup.plan(planner, time=LIMIT)
    assert not result
    assert result.status == "Timeout"
    assert megabytes() - before < 100
