"""The default tip: the end of the arm, and not a finger."""

import logging

import pinocchio as pin
import pytest

from safe_ompl import Robot
from safe_ompl.robot import default_tip
from safe_ompl.robot.arm import finger_links
from safe_ompl.robot.loading import robots_folder


@pytest.mark.parametrize(
    ("file", "tip"),
    [
        ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
        ("ur_description/urdf/ur5_joint_limited_robot.urdf", "ee_link"),
        ("tiago_description/robots/tiago_no_hand.urdf", "wrist_ft_tool_link"),
    ],
)
def test_tips_of_robots_as_they_come(file, tip):
    model = pin.buildModelFromUrdf(str(robots_folder() / file))
    assert default_tip(model, model) == tip


def test_a_hand_is_the_tip_and_the_log_says_so(data_folder, caplog):
    with caplog.at_level(logging.INFO):
        robot = Robot.from_urdf(data_folder / "gripper_arm.urdf", locked={"grip": 0.01})
    assert robot.tip == "hand"
    assert "tip: hand, the body before the fingers (finger_1, finger_2)" in caplog.text


def test_two_arms_are_no_fingers(data_folder, twin_arm):
    assert finger_links(pin.buildModelFromUrdf(str(data_folder / "twin_arm.urdf"))) == frozenset()
    assert twin_arm.tip == "right_hand"


def test_fingers_on_a_standing_base_are_the_robot(data_folder, edited):
    urdf = edited("gripper_arm.urdf", 'name="turn" type="revolute"', 'name="turn" type="fixed"')
    urdf.write_text(urdf.read_text().replace('name="elbow" type="revolute"', 'name="elbow" type="fixed"'))
    assert finger_links(pin.buildModelFromUrdf(str(urdf))) == frozenset()
