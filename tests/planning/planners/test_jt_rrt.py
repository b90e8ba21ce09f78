"""SafeJTRRT: what it solves, how it steps, what danger changes, and what it says where it cannot plan."""

import numpy as np
import pinocchio as pin
import pytest
from ompl import base as ob

from safe_ompl import Box, Obstacle, Pose, SafeSetup, Scene, Sphere, make_planner

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
POSITION = np.array([0.35, -0.45, 0.35])
ROTATION = pin.rpy.rpyToMatrix(3.0, 0.2, -0.4)

PANDA_START = np.array([1.2, 0.1, 0.0, -1.7, 0.0, 2.0, 0.785])
PANDA_POSITION = np.array([0.25, -0.5, 0.4])


@pytest.fixture(scope="module")
def scene():
    ball = Obstacle("ball", Sphere(0.12), Pose((0.5, 0.0, 0.55)), weight=1.0)
    return Scene((ball, Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1)))))


@pytest.fixture
def setup(ur5, scene):
    setup = SafeSetup(ur5, scene)
    setup.setStartConfiguration(START)
    setup.setWorkspaceGoal(POSITION)
    return setup


@pytest.fixture
def far_from_danger(panda):
    """Return a setup with danger, but nothing in the way."""
    setup = SafeSetup(panda, Scene((Obstacle("ball", Sphere(0.02), Pose((0.9, 0.0, 0.9)), weight=1.0),)))
    setup.setStartConfiguration(PANDA_START)
    setup.setWorkspaceGoal(PANDA_POSITION)
    return setup


def tips(robot, path):
    return np.array([robot.tip_pose(q).translation for q in path])


# ------------------------------------------------------------------------------------------------ what it can solve


def to_any_place(robot, rng):
    """Return a setup for a robot in an empty scene, with a start and a place where it collides with nothing."""
    setup = SafeSetup(robot, Scene(()), danger=None)
    drawn = rng.uniform(robot.lower, robot.upper, (50, robot.n))
    start, end = [q for q in drawn if not setup.checker.in_collision(q)][:2]
    setup.setStartConfiguration(start)
    setup.setWorkspaceGoal(robot.tip_pose(end).translation)
    return setup


@pytest.mark.parametrize("case", [None, ROTATION, "panda", "kinova", "slider"])
@pytest.mark.parametrize("planner", ["SafeJTRRT", "ClassicJTRRT"])
def test_the_path_leads_from_the_start_to_the_place(setup, robot_named, rng, planner, case):
    if isinstance(case, str):
        setup = to_any_place(robot_named(case), rng)
    else:
        setup.setWorkspaceGoal(POSITION, case, tolerance=0.005)
    for seed in range(1 if isinstance(case, str) else 5):
        result = setup.plan(planner, time=10.0, seed=seed)
        assert result.status == "Exact solution"
        np.testing.assert_array_equal(result.path[0], setup.query.start)
        assert setup.getGoal().target.distance(result.path[-1]) < setup.getGoal().tolerance
        assert result.report.certified
        assert all(setup.robot.within_limits(q, 0.0).all() for q in result.path)
        assert result.counts.nodes > 0


def test_with_nothing_in_the_way_the_tip_goes_straight(panda, far_from_danger):
    """The known answer: J† takes the tip along the line, whatever the null space does for safety."""
    result = far_from_danger.plan("SafeJTRRT", parameters={"goal_bias": 1.0, "step": 0.05})
    path = tips(panda, result.path)
    way = path[-1] - path[0]
    offset = path - path[0]
    along = offset @ way / (way @ way)
    assert (np.diff(along) > 0).all()
    assert np.linalg.norm(offset - along[:, None] * way, axis=1).max() < 0.01
    assert np.linalg.norm(way - (PANDA_POSITION - path[0])) < 0.01
    assert result.counts.nodes == len(path) - 1


# ------------------------------------------------------------------------------------------------------------ danger


def test_null_space_motion_makes_the_way_safer(far_from_danger):
    """Everything else equal: the same straight way of the tip, with and without k₁."""
    choices = ({"goal_bias": 1.0, "null_space_gain": k1} for k1 in (1.0, 0.0))
    safe, plain = (far_from_danger.plan("SafeJTRRT", parameters=choice).report.danger for choice in choices)
    assert safe.mean < plain.mean
    assert safe.profile[-1] < 0.98 * plain.profile[-1]


# -------------------------------------------------------------------------------------------------- what it cannot do


@pytest.mark.parametrize("place_first", [True, False])
def test_solve_plans_to_the_place_though_there_are_goal_configurations_too(setup, place_first):
    place = setup.getGoal().target
    setup.setConfigurations(START, START * [-1, 1, 1, 1, 1, 1])
    if not place_first:
        setup.setWorkspaceGoal(POSITION)
    setup.setPlanner(make_planner("SafeJTRRT", setup.getSpaceInformation()))
    assert setup.solve(10.0).asString() == "Exact solution"
    assert place.distance(setup.solution()[-1]) < setup.getGoal().tolerance
    setup.simplifySolution(0.1)
    assert place.distance(setup.solution()[-1]) < setup.getGoal().tolerance


@pytest.mark.parametrize("own", [True, False])
def test_goal_configurations_are_refused(setup, caplog, own):
    setup.setConfigurations(START, START * [-1, 1, 1, 1, 1, 1])
    if own:
        setup.setGoal(ob.GoalStates(setup.getSpaceInformation()))
    else:
        setup = SafeSetup(setup.robot, Scene(()), danger=None)
        setup.setConfigurations(START, START * [-1, 1, 1, 1, 1, 1])
    setup.setPlanner(make_planner("SafeJTRRT", setup.getSpaceInformation()))
    assert setup.solve(1.0).asString() == "Unrecognized goal type"
    assert "SafeJTRRT plans to a WorkspaceGoal, not to a GoalStates" in caplog.text
