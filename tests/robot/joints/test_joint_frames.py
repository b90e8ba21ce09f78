"""Poses of joints: the fast view shows what Pinocchio says, and where it does not, the plain way does."""

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl.robot.joints import joint_frames
from safe_ompl.robot.joints.joint_frames import JointFrames


def plain_poses(model, q):
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.array([pose.rotation for pose in data.oMi]), np.array([pose.translation for pose in data.oMi])


@pytest.fixture
def some_configurations(kinova, rng):
    return [pin.randomConfiguration(kinova.model, np.full(9, -3.0), np.full(9, 3.0)) for _ in range(5)]


def test_views_are_used_and_right(kinova, some_configurations, caplog):
    frames = JointFrames(kinova.model)
    seen = set()
    for q in some_configurations:
        poses = frames.forward(q)
        seen.add(poses[0].ctypes.data)
        for found, expected in zip(poses, plain_poses(kinova.model, q), strict=True):
            np.testing.assert_array_equal(found, expected)
    assert len(seen) == 1, "views on the same memory"
    assert not caplog.records


def wrong_numbers(array, shape, strides):
    return np.zeros(shape)


def test_views_that_show_other_numbers_are_not_used(kinova, some_configurations, caplog, monkeypatch):
    monkeypatch.setattr(joint_frames, "as_strided", wrong_numbers)
    frames = JointFrames(kinova.model)
    assert "keeps the poses of joints in another way than thought" in caplog.text
    for q in some_configurations:
        poses = frames.forward(q)
        for found, now, expected in zip(poses, frames.poses, plain_poses(kinova.model, q), strict=True):
            np.testing.assert_array_equal(found, expected)
            np.testing.assert_array_equal(now, expected)


def test_a_robot_without_the_views_is_the_same(kinova, monkeypatch):
    monkeypatch.setattr(joint_frames, "as_strided", wrong_numbers)
    slow = type(kinova)(kinova.blueprint, kinova.shared)
    Q = np.linspace(-1.0, 1.0, 3 * kinova.n).reshape(3, kinova.n) + (kinova.lower + kinova.upper) / 2
    np.testing.assert_array_equal(slow.keypoints_batch(Q), kinova.keypoints_batch(Q))
    np.testing.assert_array_equal(slow.keypoints(Q[0]), kinova.keypoints(Q[0]))
    for one, other in zip(slow.keypoint_motions(Q, Q), kinova.keypoint_motions(Q, Q), strict=True):
        np.testing.assert_array_equal(one, other)
