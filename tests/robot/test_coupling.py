"""Mimic joints move with what they mimic, and what is proven with them is true."""

import logging

import pytest

from safe_ompl import CollisionChecker, InputError, Robot, Scene

GRIP = 2


@pytest.fixture(scope="module")
def gripper(robot_named):
    return robot_named("gripper")


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


def test_a_body_and_one_that_mimics_its_motion_approach_each_other(gripper, plain_check):
    checker, plain = CollisionChecker(gripper, Scene()), plain_check(gripper, Scene())
    fingers = checker.pair_names.index(("finger_1", "finger_2"))
    assert checker.pair_radii[fingers] == pytest.approx([0.0, 0.0, 1.0 + 1.5])
    open_, closed = plain.distances([0.0, 0.0, 0.04]), plain.distances([0.0, 0.0, 0.0])
    assert open_[fingers] - closed[fingers] == pytest.approx(2.5 * 0.04, abs=1e-4)
