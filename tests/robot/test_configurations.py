"""Configurations as people have them: lists, other kinds of numbers, mappings; and what is none."""

import numpy as np
import pytest

from safe_ompl import InputError, UnknownNameError
from safe_ompl.robot import JointLimits

ASKED = ("keypoints", "keypoint_jacobians", "tip_jacobian", "displacement_radii_at", "pinocchio_configuration")


def method_of(robot, name):
    return getattr(robot.bounds if hasattr(robot.bounds, name) else robot, name)


@pytest.mark.parametrize("name", ["panda", "kinova"])
@pytest.mark.parametrize("method", ASKED)
def test_lists_and_other_numbers(robot_named, name, method):
    robot = robot_named(name)
    q = np.round((robot.lower + robot.upper) / 2, 1).astype(np.float32)
    ask = method_of(robot, method)
    expected = ask(q.astype(np.float64))
    for other in (q, q.tolist(), tuple(q.tolist()), np.stack([q, q], axis=1)[:, 0]):
        np.testing.assert_array_equal(ask(other), expected)


@pytest.mark.parametrize("method", [*ASKED, "tip_pose"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([0.0] * 6, r"must have shape \(7\), got \(6,\)"),
        (np.zeros((1, 7)), r"must have shape \(7\), got \(1, 7\)"),
        (["zero"] * 7, "must be numbers, got "),
        ([0.0] * 6 + [float("nan")], "must be finite"),
        (None, "must"),
    ],
)
def test_what_is_no_configuration(panda, method, value, message):
    with pytest.raises(InputError, match=message):
        method_of(panda, method)(value)


def test_mappings_from_names(panda):
    q = np.linspace(-0.5, -0.1, 7)
    named = dict(zip(panda.joint_names, q, strict=True))
    np.testing.assert_array_equal(panda.configuration(named), q)
    np.testing.assert_array_equal(panda.keypoints(named), panda.keypoints(q))
    with pytest.raises(UnknownNameError, match="unknown joint 'panda_joint9'; did you mean 'panda_joint"):
        panda.configuration({"panda_joint9": 0.0})
    with pytest.raises(InputError, match="configuration: no value for 'panda_joint2', 'panda_joint3'"):
        panda.configuration({"panda_joint1": 0.0})


def test_batches(panda):
    Q = np.linspace(-0.9, -0.1, 14).reshape(2, 7)
    np.testing.assert_array_equal(panda.keypoints_batch(Q.tolist()), panda.keypoints_batch(Q))
    with pytest.raises(InputError, match=r"configurations must have shape \(any, 7\), got \(7,\)"):
        panda.keypoints_batch(Q[0])


@pytest.mark.parametrize("name", ["ur5", "kinova", "twin_arm"])
def test_as_the_robot_says(robot_named, rng, name):
    robot = robot_named(name)
    limits, answers = JointLimits(robot), set()
    for q in rng.uniform(1.2 * robot.lower - 0.01, 1.2 * robot.upper + 0.01, (200, robot.n)):
        answers.add(limits.hold(q))
        assert limits.hold(q) is bool(robot.within_limits(q).all())
    assert answers == {True, False}
    assert robot.within_limits(robot.upper + 0.01).tolist() == robot.continuous.tolist()
    inside = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    assert limits.hold(inside)
    for bad in (np.nan, np.inf, -np.inf):
        for joint in np.diag(np.ones(robot.n, dtype=bool)):
            assert limits.hold(np.where(joint, bad, inside)) is False
            assert not robot.within_limits(np.where(joint, bad, inside)).all()
