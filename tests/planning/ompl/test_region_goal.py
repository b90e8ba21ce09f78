"""RegionGoal: what planners get to sample, and that they arrive in the region."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from ompl import base as ob

from safe_ompl import Box, GoalRegion, InputError, Obstacle, Pose, RegionGoal, SafeSetup, Scene, Sphere

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
SHELF = GoalRegion(Pose((0.4, -0.4, 0.35)), x=(-0.1, 0.1), y=(-0.1, 0.1), z=(0.0, 0.1))
RING = GoalRegion(  # about a pole, the hand downwards but for 0.3 rad
    Pose.from_rpy((0.45, -0.35, 0.3), (np.pi, 0.0, 0.0)), radius=(0.08, 0.12), roll=(-0.3, 0.3), pitch=(-0.3, 0.3)
)
REGIONS = [pytest.param(SHELF, id="shelf"), pytest.param(RING, id="ring")]


@pytest.fixture
def setup(ur5):
    ball = Obstacle("ball", Sphere(0.12), Pose((0.5, 0.0, 0.55)), weight=1.0)
    shelf = Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1)))
    setup = SafeSetup(ur5, Scene((ball, shelf)))
    setup.setStartConfiguration(START)
    return setup


def draw(setup, region, number, seed=0):
    goal = RegionGoal(setup.getSpaceInformation(), setup.robot, region, field=setup.field, seed=seed)
    state = setup.getStateSpace().allocState()
    drawn = []
    for _ in range(number):
        goal.sampleGoal(state)
        drawn.append(state[0 : setup.robot.n])
        assert goal.distanceGoal(state) <= 0.05 * goal.tolerance
    return np.array(drawn)


@pytest.mark.parametrize("region", REGIONS)
def test_the_solutions_are_valid_and_all_over_the_region(setup, region):
    drawn = draw(setup, region, 12)
    tips = np.array([setup.robot.tip_pose(q).translation for q in drawn])
    assert np.ptp(tips, axis=0)[:2].min() > 0.05
    for q in drawn:
        assert region.distance(setup.robot.tip_pose(q)) < 1e-4
        assert setup.robot.within_limits(q, 0.0).all()
        assert not setup.checker.in_collision(q)


def test_the_same_seed_draws_the_same(setup):
    assert np.array_equal(draw(setup, RING, 6, seed=3), draw(setup, RING, 6, seed=3))
    assert not np.array_equal(draw(setup, RING, 6, seed=3), draw(setup, RING, 6, seed=4))


@pytest.mark.parametrize("region", REGIONS)
def test_the_distance_is_that_of_the_tip_from_the_region(setup, region, rng):
    goal = RegionGoal(setup.getSpaceInformation(), setup.robot, region)
    state = setup.getStateSpace().allocState()
    for q in rng.uniform(-2, 2, (10, setup.robot.n)):
        state[0 : setup.robot.n] = q.tolist()
        assert goal.distanceGoal(state) == region.distance(setup.robot.tip_pose(q))
        assert goal.isSatisfied(state) == (goal.distanceGoal(state) < goal.tolerance)


@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("planner", ["SafeRRTConnect", "SafeJTRRT", "SafePRM", "BubblePlanner", "RRTConnect"])
def test_planners_arrive_in_the_region(setup, planner, region):
    setup.setGoalRegion(region)
    result = setup.plan(planner, seed=1, time=20.0)
    assert result
    tip = setup.robot.tip_pose(result.path[-1])
    assert region.distance(tip) <= 1e-3


def test_a_region_takes_the_place_of_a_place(setup):
    setup.setWorkspaceGoal([1.1, 0.0, 0.5])  # out of reach
    setup.setGoalRegion(SHELF)
    assert setup.plan("SafeJTRRT", seed=1, time=20.0)
    assert setup.getGoal().region is SHELF


def test_out_of_reach_there_is_no_solution(setup):
    with pytest.raises(InputError, match="out of reach"):
        setup.setGoalRegion(GoalRegion(Pose((2.0, 0.0, 0.5)), x=(-0.1, 0.1)))
    setup.setGoalRegion(GoalRegion(Pose((1.15, 0.0, 0.5)), x=(-0.05, 0.1)))
    assert setup.solve(0.3) == ob.PlannerStatus.TIMEOUT


def test_what_is_no_region_is_refused(setup):
    with pytest.raises(InputError, match="region must be a GoalRegion, got"):
        setup.setGoalRegion(pin.SE3.Identity())
    with pytest.raises(InputError, match="tolerance must be a positive length"):
        setup.setGoalRegion(SHELF, tolerance=0.0)
