"""Mimic joints move with what they mimic, and what is proven with them is true."""

import logging
import pickle

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, CertifiedMotion, CollisionChecker, InputError, Obstacle, Pose, Robot, Scene
from safe_ompl.robot import Mimic, robot_hash
from safe_ompl.robot.joint_tables import Coupling, resolved

GRIP = 2


@pytest.fixture(scope="module")
def gripper(data_folder):
    """Two links and a gripper: grip_mirror = 1.5·grip + 0.001."""
    return Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="finger_1")


@pytest.fixture(scope="module")
def parallel(data_folder, tmp_path_factory):
    """Two links and a hand that turns back by twice the angle of the elbow, less 0.3."""
    text = (data_folder / "gripper_arm.urdf").read_text()
    wrist = '<joint name="wrist" type="fixed">'
    assert wrist in text
    text = text.replace(wrist, '<joint name="wrist" type="revolute">').replace(
        '<origin xyz="0.42 0 0"/>',
        '<origin xyz="0.42 0 0"/><axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>'
        '<mimic joint="elbow" multiplier="-2" offset="-0.3"/>',
    )
    path = tmp_path_factory.mktemp("parallel") / "parallel.urdf"
    path.write_text(text)
    return Robot.from_urdf(path)


@pytest.fixture(params=["gripper", "parallel"])
def robot(request):
    return request.getfixturevalue(request.param)


def spread(robot, rng, count):
    return rng.uniform(robot.lower, robot.upper, (count, robot.n))


def test_mimic_joints_are_not_planned_for_and_follow(gripper):
    assert gripper.joint_names == ("turn", "elbow", "grip")
    full = gripper.pinocchio_configuration(np.array([0.1, 0.2, 0.02]))
    np.testing.assert_allclose(full, [0.1, 0.2, 0.02, 0.031])


def test_both_fingers_move(gripper):
    model, data = gripper.model, gripper.model.createData()
    apart = []
    for grip in (0.0, 0.04):
        pin.framesForwardKinematics(model, data, gripper.pinocchio_configuration([0.3, -0.2, grip]))
        one, other = (data.oMf[model.getFrameId(f"finger_{k}")].translation for k in (1, 2))
        apart.append(float(np.linalg.norm(one - other)))
    assert apart == pytest.approx([0.01 + 0.001, 0.01 + 0.001 + 2.5 * 0.04])


def test_limits_shrink_until_the_mimic_keeps_to_its_own(parallel, edited, caplog):
    assert (parallel.lower[1], parallel.upper[1]) == pytest.approx((-1.65, 1.35))
    with caplog.at_level(logging.INFO):
        Robot.from_urdf(edited("gripper_arm.urdf", 'lower="0" upper="0.08"', 'lower="0" upper="0.031"'))
    assert "grip keeps to [0, 0.02], so that grip_mirror keeps to its limits" in caplog.text


def test_a_mimic_of_a_continuous_joint_is_refused(edited):
    urdf = edited(
        "gripper_arm.urdf", '<joint name="grip" type="prismatic">', '<joint name="grip" type="continuous">'
    )
    with pytest.raises(
        InputError, match="'grip_mirror' mimics 'grip', which is continuous: lock one of them"
    ):
        Robot.from_urdf(urdf)


def test_a_primary_off_the_tip_stays_free_if_its_mimic_moves_the_tip(data_folder):
    robot = Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="finger_2")
    assert robot.joint_names == ("turn", "elbow", "grip")
    assert robot.tip_jacobian([0.0, 0.0, 0.01])[:3, GRIP] == pytest.approx([0.0, -1.5, 0.0])


def test_chains_of_mimics():
    chain = {"b": Mimic("a", 2.0, 1.0), "c": Mimic("b", -3.0, 0.5)}
    assert resolved(chain, "x")["c"] == Mimic("a", -6.0, -2.5)
    coupling = Coupling.of(["c", "a", "b"], resolved(chain, "x"))
    np.testing.assert_allclose(coupling.values(np.array([0.5])), [-5.5, 0.5, 2.0])
    np.testing.assert_allclose(coupling.radii(np.array([1.0, 1.0, 1.0])), [9.0])


def test_jacobians_against_finite_differences(robot, rng):
    step = 1e-6
    for q in spread(robot, rng, 5):
        numeric, tip = np.zeros((len(robot.keypoints(q)), 3, robot.n)), np.zeros((3, robot.n))
        for i, h in enumerate(step * np.eye(robot.n)):
            numeric[:, :, i] = (robot.keypoints(q + h) - robot.keypoints(q - h)) / (2 * step)
            tip[:, i] = (robot.tip_pose(q + h).translation - robot.tip_pose(q - h).translation) / (2 * step)
        np.testing.assert_allclose(robot.keypoint_jacobians(q), numeric, atol=1e-7)
        np.testing.assert_allclose(robot.tip_jacobian(q)[:3], tip, atol=1e-7)
        gradients = rng.normal(size=(1, len(numeric), 3))
        np.testing.assert_allclose(
            robot.pull_back(q[None], gradients)[0], np.einsum("kci,kc->i", numeric, gradients[0]), atol=1e-6
        )


def test_motions_of_key_points_against_finite_differences(robot, rng):
    q, delta, step = spread(robot, rng, 1)[0], rng.uniform(-0.3, 0.3, robot.n), 1e-4
    before, here, after = (robot.keypoints(q + t * delta) for t in (-step, 0.0, step))
    points, speed, push = (values[0] for values in robot.keypoint_motions(q[None], delta[None]))
    np.testing.assert_allclose(points, here, atol=1e-12)
    np.testing.assert_allclose(speed, (after - before) / (2 * step), atol=1e-6)
    np.testing.assert_allclose(push, (after - 2 * here + before) / step**2, atol=1e-5)


def test_points_of_bodies_against_finite_differences(robot, rng):
    q, step = spread(robot, rng, 1), 1e-6
    joints = np.arange(1, robot.model.njoints)
    points, rows = rng.normal(size=(len(joints), 3)), np.zeros(len(joints), dtype=np.intp)
    _, jacobians = robot.body_points(q, rows, joints, points)
    for i, h in enumerate(step * np.eye(robot.n)):
        after, before = (robot.body_points(q + s * h, rows, joints, points)[0] for s in (1, -1))
        np.testing.assert_allclose(jacobians[:, i], (after - before) / (2 * step), atol=1e-7)


def test_no_body_moves_farther_than_its_radii_allow(robot, body_points, rng):
    bodies = body_points(robot)
    for _ in range(200):
        start, end = spread(robot, rng, 2)
        end = start + rng.uniform(0.001, 1.0) * (end - start)
        delta = np.abs(end - start)
        constant, at_start = (
            robot.bounds.displacement_radii @ delta,
            robot.bounds.displacement_radii_at(start) @ delta,
        )
        for k, (old, new) in enumerate(zip(bodies.at(start), bodies.at(end), strict=True)):
            moved = np.linalg.norm(new - old, axis=1).max()
            assert moved <= min(constant[k], at_start[k]) + 1e-9


def test_a_body_and_one_that_mimics_its_motion_approach_each_other(gripper, plain_check):
    checker, plain = CollisionChecker(gripper, Scene()), plain_check(gripper, Scene())
    fingers = checker.pair_names.index(("finger_1", "finger_2"))
    assert checker.pair_radii[fingers] == pytest.approx([0.0, 0.0, 1.0 + 1.5])
    open_, closed = plain.distances([0.0, 0.0, 0.04]), plain.distances([0.0, 0.0, 0.0])
    assert open_[fingers] - closed[fingers] == pytest.approx(2.5 * 0.04, abs=1e-4)


@pytest.fixture(scope="module")
def bars():
    """Thin bars that fingers and hand must thread."""
    return Scene(
        tuple(
            Obstacle(f"bar_{k}", Box((0.02, 0.02, 0.6)), Pose((0.8 * np.cos(a), 0.8 * np.sin(a), 0.2)))
            for k, a in enumerate(np.linspace(-2.5, 2.5, 7))
        )
    )


def test_no_motion_that_is_proven_free_collides(robot, bars, plain_check, rng):
    proof, plain, free = CertifiedMotion(CollisionChecker(robot, bars)), plain_check(robot, bars), 0
    for _ in range(300):
        start, end = spread(robot, rng, 2)
        end = start + rng.uniform(0.02, 0.5) * (end - start)
        if proof.is_free(start, end):
            free += 1
            assert plain.first_contact(start, end, 0.02) is None
    assert 50 < free < 290


def test_pickle_and_fingerprint(gripper, edited):
    other = pickle.loads(pickle.dumps(gripper))
    assert robot_hash(other) == robot_hash(gripper)
    np.testing.assert_array_equal(other.bounds.displacement_radii, gripper.bounds.displacement_radii)
    faster = Robot.from_urdf(
        edited("gripper_arm.urdf", 'multiplier="1.5"', 'multiplier="1.4"'), tip="finger_1"
    )
    assert robot_hash(faster) != robot_hash(gripper)
