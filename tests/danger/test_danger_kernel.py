"""The compiled danger and its gradient against Pinocchio's kinematics and NumPy's field, for all kinds of robots."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import numpy_danger

from safe_ompl.danger.field import AGGREGATES, DangerField
from safe_ompl.maths.segments import WEIGHTINGS
from safe_ompl.robot.robot import Robot

ROBOTS = ("panda", "ur5", "kinova", "twin_arm", "slider")  # continuous and sliding joints, branches


def some(robot, rng, number):
    return rng.uniform(robot.lower, robot.upper, (number, robot.n))


def agree(danger, Q):
    values, gradients = danger.values_and_gradients(Q)
    expected, slopes = numpy_danger.danger_and_gradient(danger, Q)
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    np.testing.assert_allclose(danger.values(Q), values, rtol=0)
    np.testing.assert_allclose(gradients, slopes, rtol=1e-10, atol=1e-11 * np.abs(slopes).max())


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_the_same_for_every_robot(robot_named, rng, name, aggregate, weighting):
    robot = robot_named(name)
    points, weights = rng.normal(size=(9, 3)), rng.uniform(0.5, 2.0, 9)
    agree(
        DangerField(robot, points, weights, aggregate=aggregate, weighting=weighting, k1=0.7),
        some(robot, rng, 4),
    )


def test_the_same_with_joints_that_mimic(data_folder, rng):
    robot = Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="finger_1")
    assert not robot.coupling.trivial
    agree(DangerField(robot, rng.normal(size=(5, 3)), aggregate="softmax"), some(robot, rng, 5))


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), number=st.integers(1, 300), aggregate=st.sampled_from(AGGREGATES))
def test_the_same_for_any_number_of_points(robot_named, seed, number, aggregate):
    rng = np.random.default_rng(seed)
    robot = robot_named("panda")
    agree(DangerField(robot, rng.normal(size=(number, 3)), aggregate=aggregate), some(robot, rng, 2))


def test_the_same_with_points_from_a_callable(robot_named, rng):
    robot = robot_named("ur5")
    agree(
        DangerField(robot, lambda q: [[q[0], 0.5, 0.5], [0.5, q[1], 0.9]], [1.0, 2.0], aggregate="mean"),
        some(robot, rng, 6),
    )


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_infinite_where_a_link_meets_a_point(robot_named, rng, aggregate):
    robot = robot_named("panda")
    q = some(robot, rng, 2)
    met = robot.keypoints(q[0])[robot.segments[-1, 1]]
    danger = DangerField(robot, np.vstack([met, rng.normal(size=(3, 3))]), aggregate=aggregate)
    values, gradients = danger.values_and_gradients(q)
    assert np.isinf(values).tolist() == [True, False]
    assert np.isfinite(gradients).all()


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("number", [3, 200])
def test_a_batch_is_one_by_one(robot_named, rng, aggregate, number):
    robot = robot_named("ur5")
    danger = DangerField(robot, rng.normal(size=(number, 3)), aggregate=aggregate)
    Q = some(robot, rng, 7)
    values, gradients = danger.values_and_gradients(Q)
    for q, value, gradient in zip(Q, values, gradients, strict=True):
        assert danger.value(q) == value
        np.testing.assert_array_equal(danger.gradient(q), gradient)
