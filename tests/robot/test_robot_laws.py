"""What holds for robots of every make: bases, loads, mimics, cells; kinematics and copies."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from oracles.differences import slopes
from oracles.pinocchio_points import keypoint_jacobians
from self_pairs import self_pairs

from safe_ompl.robot import robot_hash

KINDS = ["panda", "kinova", "twin_arm", "slider", "gripper", "parallel", "placed", "loaded", "mobile", "cell"]
STEP = 1e-6  # [rad or m] of finite differences


@pytest.fixture(params=KINDS)
def robot(request, robot_named):
    return robot_named(request.param)


def drawn(robot, rng, count):
    return rng.uniform(robot.lower, robot.upper, (count, robot.n))


def test_key_points_and_tip_are_where_pinocchio_has_them(robot, rng):
    data, batch = robot.model.createData(), drawn(robot, rng, 4)
    np.testing.assert_allclose(robot.keypoints_batch(batch), [robot.keypoints(q) for q in batch], rtol=0, atol=1e-14)
    for q in batch:
        pin.framesForwardKinematics(robot.model, data, robot.pinocchio_configuration(q))
        points = robot.keypoints(q)
        assert points[-1] == pytest.approx(robot.tip_pose(q).translation, abs=1e-12)
        ends = [*zip(robot.segments[:, 1], robot.segment_names, strict=True), (-1, robot.tip)]
        for point, frame in ends:
            assert points[point] == pytest.approx(data.oMf[robot.model.getFrameId(frame)].translation, abs=1e-12)


def test_jacobians_are_slopes(robot, rng):
    batch = drawn(robot, rng, 3)
    for q in batch:
        jacobian = robot.tip_jacobian(q)
        for i, h in enumerate(STEP * np.eye(robot.n)):
            before, after = robot.tip_pose(q - h), robot.tip_pose(q + h)
            linear, angular = after.translation - before.translation, pin.log3(after.rotation @ before.rotation.T)
            np.testing.assert_allclose(jacobian[:, i], np.concatenate([linear, angular]) / (2 * STEP), atol=1e-7)
        np.testing.assert_allclose(
            keypoint_jacobians(robot, q), np.moveaxis(slopes(robot.keypoints, q), 0, -1), atol=1e-8
        )
    gradients = rng.normal(size=(3, *robot.keypoints(batch[0]).shape))
    expected = [np.einsum("kci,kc->i", keypoint_jacobians(robot, q), g) for q, g in zip(batch, gradients, strict=True)]
    np.testing.assert_allclose(robot.jacobian_transpose_product(batch, gradients), expected, atol=1e-12)


def test_copies_that_travel_are_the_same(robot, rng):
    copy = pickle.loads(pickle.dumps(robot))
    assert (repr(copy), robot_hash(copy), self_pairs(copy)) == (repr(robot), robot_hash(robot), self_pairs(robot))
    assert (copy.held_joints, copy.attached, copy.tip) == (robot.held_joints, robot.attached, robot.tip)
    (q,) = drawn(robot, rng, 1)
    np.testing.assert_array_equal(copy.keypoints(q), robot.keypoints(q))
    np.testing.assert_array_equal(copy.bounds.displacement_radii, robot.bounds.displacement_radii)
