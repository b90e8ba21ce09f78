"""Inputs as people have them: by name, single precision, quaternions, poses; and limits that meet a start."""

import logging

import numpy as np
import pinocchio as pin
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import MotionProver, SafeRRTConnect, SafeSetup, Scene, check, planner_data, time_path
from safe_ompl.common import CollisionError, InputError, UnknownNameError
from safe_ompl.geometry import Box, Obstacle, Pose, Sphere
from safe_ompl.planning.ompl import ScratchState, StateBridge
from safe_ompl.robot import inverse_kinematics

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
IN_BALL = START * [0, 1, 1, 1, 1, 1]


@pytest.fixture
def setup(ur5):
    scene = Scene((Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),))
    return SafeSetup(ur5, scene)


@pytest.mark.parametrize(
    "form",
    [
        lambda robot, q: q.tolist(),
        lambda robot, q: tuple(q),
        lambda robot, q: q.astype(np.float32),
        lambda robot, q: robot.named(q),
        lambda robot, q: [np.float32(value) for value in q],
    ],
)
def test_forms_of_a_configuration(setup, form):
    start, goal = form(setup.robot, START), form(setup.robot, GOAL)
    setup.setConfigurations(start, goal)
    np.testing.assert_allclose(setup.problem.start, START, atol=1e-6)
    np.testing.assert_allclose(setup.wiring.bridge.read(setup.getGoal().getState(0)), GOAL, atol=1e-6)
    setup.setConfigurations(start, [goal, goal])
    assert setup.getGoal().getStateCount() == 2
    assert setup.plan(seed=np.int64(0), time=np.float32(20.0))


def test_names_that_are_wrong(setup):
    named = setup.robot.named(START)
    with pytest.raises(UnknownNameError, match="start configuration: unknown joint 'elbow'; did you mean 'elbow_j"):
        setup.setStartConfiguration({**named, "elbow": 1.0})
    del named["elbow_joint"]
    with pytest.raises(InputError, match="goal configuration: no value for 'elbow_joint'"):
        setup.setConfigurations(START, named)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda robot, scene: SafeSetup(robot, {}), "scene must be a Scene, got {}"),
        (lambda robot, scene: SafeSetup("ur5", scene), "robot must be a Robot, got 'ur5'"),
        (lambda robot, scene: SafeSetup(robot, scene).setConstraints([1]), "constraints must be a Constraints"),
        (lambda robot, scene: check([START, GOAL], robot, scene, constraints=[1]), "constraints must be a Con"),
        (lambda robot, scene: check([START, GOAL], robot, scene, limits=5.0), "limits must be a RateLimits, got"),
        (lambda robot, scene: time_path([START, GOAL], robot, 5.0), "limits must be a RateLimits, got 5.0"),
        (lambda robot, scene: time_path([START, GOAL], 5.0), "robot must be a Robot, got 5.0"),
        (
            lambda robot, scene: SafeSetup(robot, scene).setStartConfiguration(np.degrees(START)),
            "start: joint 'shoulder_pan_joint' = 45.8366 is outside its limits [-3.14159, 3.14159]; "
            "degrees? 45.8366° are 0.8 rad",
        ),
        (
            lambda robot, scene: SafeSetup(robot, scene).setStartConfiguration(1000 * START),
            "start: joint 'shoulder_pan_joint' = 800 is outside its limits [-3.14159, 3.14159]",
        ),
    ],
)
def test_what_is_of_the_wrong_kind(ur5, wrong, message):
    with pytest.raises(InputError) as caught:
        wrong(ur5, Scene(()))
    assert str(caught.value).startswith(message)
    assert ("degrees?" in str(caught.value)) == ("degrees?" in message)


def test_one_warning_for_many_goals_in_collision(setup, caplog):
    with caplog.at_level(logging.WARNING):
        setup.setConfigurations(START, [IN_BALL] * 20 + [GOAL])
    (record,) = caplog.records
    assert record.getMessage().startswith("20 of 21 goals do not count: goal 0 is in collision: ")
    assert record.getMessage().endswith("; and 19 more")


def pose(robot):
    return robot.tip_pose(GOAL)


@pytest.mark.parametrize(
    "form",
    [
        lambda pose: (pose,),
        lambda pose: (pose.translation, pose.rotation),
        lambda pose: (pose.translation.tolist(), pin.Quaternion(pose.rotation)),
        lambda pose: (pose.translation.astype(np.float32), pin.Quaternion(pose.rotation).coeffs().tolist()),
    ],
)
def test_forms_of_a_pose(setup, form):
    setup.setWorkspaceGoal(*form(pose(setup.robot)))
    place = setup.getGoal().place
    np.testing.assert_allclose(place.position, pose(setup.robot).translation, atol=1e-6)
    np.testing.assert_allclose(place.rotation, pose(setup.robot).rotation, atol=1e-6)
    assert place.dimension == 6


def test_rotations_that_are_none(setup):
    with pytest.raises(InputError, match=r"quaternion \(x, y, z, w\) must be of unit length"):
        setup.setWorkspaceGoal([0.4, 0.1, 0.5], [0, 0, 0, 2])
    with pytest.raises(InputError, match="the pose has one already"):
        setup.setWorkspaceGoal(pose(setup.robot), np.eye(3))


# ------------------------------------------------------------------------------------------------ inverse kinematics


def test_inverse_kinematics_reaches_the_pose(ur5):
    q = inverse_kinematics(ur5, pose(ur5))
    assert ur5.within_limits(q).all()
    np.testing.assert_allclose(ur5.tip_pose(q).homogeneous, pose(ur5).homogeneous, atol=1e-3)
    np.testing.assert_array_equal(q, inverse_kinematics(ur5, pose(ur5)))


def test_inverse_kinematics_takes_the_nearest(ur5):
    q = inverse_kinematics(ur5, pose(ur5), near=GOAL + 0.05)
    np.testing.assert_allclose(q, GOAL, atol=0.01)


def test_inverse_kinematics_takes_what_is_valid(setup):
    place = setup.robot.tip_pose(IN_BALL).translation
    assert inverse_kinematics(setup.robot, place, near=IN_BALL) is not None

    def valid(q):
        return not setup.checker.in_collision(q)

    assert inverse_kinematics(setup.robot, place, near=IN_BALL, valid=valid) is None, "it is inside the ball"


def test_inverse_kinematics_says_what_is_wrong(ur5):
    assert inverse_kinematics(ur5, [9.0, 0.0, 0.0]) is None
    with pytest.raises(InputError, match="seeds must be"):
        inverse_kinematics(ur5, [0.4, 0.1, 0.5], seeds=0)
    with pytest.raises(InputError, match="near must have shape"):
        inverse_kinematics(ur5, [0.4, 0.1, 0.5], near=[0.0])


# --------------------------------------------------------------------------------------------- obstacles that move


def test_moving_obstacles_must_leave_the_start_free(setup):
    setup.setConfigurations(START, GOAL)
    with pytest.raises(CollisionError, match="start is too near: 'ball' may move 1000 mm, and come to '"):
        setup.setMovingObstacles({"ball": 1.0}, 1.0)
    assert not setup.getConstraints().separation.speeds
    setup.setMovingObstacles({"ball": 0.01}, 1.0)
    assert setup.getConstraints().separation.speeds == {"ball": 0.01}
    near = setup.checker.clearance(START).distance
    setup.setMovingObstacles({"ball": 0.9 * near}, 1.0)
    with pytest.raises(CollisionError, match=r"goal is too near|goal is in collision"):
        setup.setConfigurations(START, START * [0.3, 1, 1, 1, 1, 1])


# -------------------------------------------------------------------------------------- spaces wider than the robot


def test_a_wider_space_does_not_widen_the_limits(slider):
    """Beyond its stroke the carriage meets a wall that it never meets within: that pair is not looked at."""
    joint = int(np.flatnonzero(slider.prismatic)[0])
    middle = 0.5 * (slider.lower + slider.upper)
    beyond = middle.copy()
    beyond[joint] = slider.upper[joint] + 1.0
    tip = 0.5 * (slider.tip_pose(middle).translation + slider.tip_pose(beyond).translation)
    setup = SafeSetup(slider, Scene((Obstacle("wall", Box((0.01, 0.01, 0.01)), Pose(tuple(tip + 5.0))),)), danger=None)
    space = setup.getStateSpace()
    for part in [space] if isinstance(space, ob.RealVectorStateSpace) else space.getSubspaces():
        if isinstance(part, ob.RealVectorStateSpace):
            bounds = ob.RealVectorBounds(part.getDimension())
            for k in range(part.getDimension()):
                bounds.setLow(k, -10.0)
                bounds.setHigh(k, 10.0)
            part.setBounds(bounds)
    si, bridge = setup.getSpaceInformation(), StateBridge(space)
    start, end = space.allocState(), space.allocState()
    bridge.write(middle, start)
    bridge.write(beyond, end)
    assert space.satisfiesBounds(end)
    assert not si.isValid(end)
    assert not si.checkMotion(start, end)
    assert not MotionProver(setup.checker).is_free(middle, beyond)


@pytest.fixture(scope="session")
def slider(robot_named):
    return robot_named("slider")


# ----------------------------------------------------------------------------------------------------- planner data


def test_planner_data_outside_a_safe_setup(setup):
    plain = og.SimpleSetup(setup.getSpaceInformation())
    plain.addStartState(ScratchState(setup.wiring.bridge).set(START))
    plain.setGoalState(ScratchState(setup.wiring.bridge).set(GOAL))
    planner = SafeRRTConnect(plain.getSpaceInformation())
    plain.setPlanner(planner)
    assert plain.solve(20.0)
    assert planner_data(planner).numVertices() == len(planner.plannerGraph().configurations) > 2
    own = og.RRTConnect(plain.getSpaceInformation())
    plain.setPlanner(own)
    plain.clear()
    assert plain.solve(20.0)
    assert planner_data(own).numVertices() > 2
