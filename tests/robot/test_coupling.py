"""Mimic joints move with what they mimic, and what is proven with them is true."""

import logging
import pickle

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, CollisionChecker, InputError, MotionProver, Obstacle, Pose, Robot, Scene
from safe_ompl.robot import Mimic, robot_hash
from safe_ompl.robot.joint_tables import Coupling, resolved

GRIP = 2


@pytest.fixture(scope="module")
def gripper(robot_named):
    return robot_named("gripper")


@pytest.fixture(params=["gripper", "parallel"])
def robot(request, robot_named):
    return robot_named(request.param)


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


def test_limits_shrink_until_the_mimic_keeps_to_its_own(robot_named, edited, caplog):
    parallel = robot_named("parallel")
    assert (parallel.lower[1], parallel.upper[1]) == pytest.approx((-1.65, 1.35))
    with caplog.at_level(logging.INFO):
        Robot.from_urdf(edited("gripper_arm.urdf", 'lower="0" upper="0.08"', 'lower="0" upper="0.031"'))
    assert "grip keeps to [0, 0.02], so that grip_mirror keeps to its limits" in caplog.text


def test_a_mimic_of_a_continuous_joint_is_refused(edited):
    urdf = edited("gripper_arm.urdf", '<joint name="grip" type="prismatic">', '<joint name="grip" type="continuous">')
    with pytest.raises(InputError, match="'grip_mirror' mimics 'grip', which is continuous: lock one of them"):
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
    proof, plain, free = MotionProver(CollisionChecker(robot, bars)), plain_check(robot, bars), 0
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
    faster = Robot.from_urdf(edited("gripper_arm.urdf", 'multiplier="1.5"', 'multiplier="1.4"'), tip="finger_1")
    assert robot_hash(faster) != robot_hash(gripper)
