"""Queries without a solution: every planner ends at its time limit, says so, and keeps its memory in bounds."""

import resource

import numpy as np
import pytest

from safe_ompl import SafeSetup, planner_names
from safe_ompl.planning.planners import is_ours, needs_place

OURS = [name for name in planner_names() if is_ours(name)]
LIMIT = 0.25  # [s]


def megabytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.parametrize("planner", [name for name in OURS if not needs_place(name)])
def test_a_goal_behind_a_wall(arm_between_walls, planner):
    arm_between_walls.plan(planner, time=0.05)  # loads kernels
    before = megabytes()
    result = arm_between_walls.plan(planner, time=LIMIT)
    assert not result
    assert result.status == "Timeout"
    assert megabytes() - before < 50


@pytest.mark.parametrize("planner", OURS)
def test_a_place_behind_a_wall(planar2, arm_between_walls, planner):
    setup = SafeSetup(planar2, arm_between_walls.scene, danger=None)
    setup.setStartConfiguration([0.0, 0.0])
    setup.setWorkspaceGoal(planar2.tip_pose(np.array([3.0, 0.0])).translation)
    setup.plan(planner, time=0.05)  # loads kernels
    before = megabytes()
    result = setup.plan(planner, time=LIMIT)
    assert not result
    assert result.status == "Timeout"
    assert megabytes() - before < 50
