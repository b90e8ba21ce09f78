"""Robots in scenario files: on bases, with objects in the gripper, several in one cell."""

import numpy as np
import pytest

from safe_ompl import Box, Cylinder, InputError, Pose, Robot
from safe_ompl.common import files
from safe_ompl.robot import RobotSpec, robot_hash

PLACED = """
urdf: twin_arm.urdf
base: {position: [0.1, 0.2, 0.3], yaw: 0.5}
mobile_base: [[-1, 1], [-2, 2]]
attached:
  - {name: rod, link: right_hand, cylinder: {radius: 0.02, length: 0.4}, position: [0, 0, 0.2], danger: true}
  - {name: lid, link: right_hand, box: {size: [0.1, 0.1, 0.01]}, touch_links: [right_rail]}
"""
CELL = """
name: twins
tip: b
robots:
  a: ur5
  b: {example: ur5, base: {position: [1, 0, 0]}, attached: [{name: pen, link: tool0, sphere: {radius: 0.02}}]}
"""


def read(text, folder):
    return RobotSpec.from_mapping(files.parse_document(text), folder)


def test_a_robot_on_a_base_with_its_hands_full(data_folder):
    expected = (
        Robot.from_urdf(
            data_folder / "twin_arm.urdf",
            base=Pose.from_rpy((0.1, 0.2, 0.3), (0.0, 0.0, 0.5)),
            mobile_base=((-1, 1), (-2, 2)),
        )
        .with_attached("rod", Cylinder(0.02, 0.4), "right_hand", (0.0, 0.0, 0.2), danger=True)
        .with_attached("lid", Box((0.1, 0.1, 0.01)), "right_hand", touch_links=("right_rail",))
    )
    robot = Robot(read(PLACED, data_folder))
    assert robot_hash(robot) == robot_hash(expected)
    assert [item.name for item in robot.attached] == ["rod", "lid"]


def test_a_cell_of_two():
    robot = Robot(read(CELL, None))
    assert (robot.name, robot.tip, robot.n) == ("twins", "b_tool0", 12)
    assert [item.name for item in robot.attached] == ["b_pen"]
    one, other = (robot.keypoints(np.zeros(12))[robot.segments[k, 1]] for k in (0, 5))
    assert np.abs(one - other).max() > 0.5


@pytest.mark.parametrize("text", [PLACED, CELL])
def test_written_and_read_again(data_folder, text):
    spec = read(text, data_folder)
    written = files.dump_document(spec.to_mapping(data_folder))
    assert read(written, data_folder) == spec


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{example: ur5, robots: {a: ur5, b: ur5}}", "give either example or urdf, one of the two"),
        ("{robots: {a: ur5, b: {exampel: ur5}}}", r"robots\.b\.exampel: unknown key; did you mean 'example'"),
        ("{robots: {a: ur5, b: ur5}, tip: c}", "tip: unknown robot with the tip 'c'; known: a, b"),
        ("{example: ur5, base: {position: [0, 0]}}", r"base\.position: must be 3 numbers"),
        ("{example: ur5, mobile_base: [[0, 1]]}", "mobile_base: must be the limits in x and in y"),
        ("{example: ur5, mobile_base: [[-1, .inf], [0, 1]]}", "mobile_base: must be a finite number"),
        ("{example: ur5, mobile_base: [[-1, 1], [1, 1]]}", r"mobile_base: must be \[low, high\] with low < high"),
        ("{example: ur5, attached: [{name: a, sphere: {radius: 1}}]}", r"attached\[0\]\.link: missing, but"),
        ("{example: ur5, attached: [{name: a, link: tool0, ball: 1}]}", r"attached\[0\]\.ball: unknown key"),
        ("{example: ur5, attached: [{name: a, link: b, sphere: {radius: -1}}]}", r"\.sphere\.radius: must be .*got -1"),
        ("{example: panda, joint_limits: limits.txt}", r"joint_limits: .*must end in \.yaml"),
        ("{example: panda, joint_limits: none.yaml}", "joint_limits: .*does not exist"),
        ("{example: panda, joint_limits: 3}", "joint_limits: .*must be a file"),
        ("{example: ur5, name: mine}", "name: an example robot has its own"),
    ],
)
def test_bad_robots(data_folder, text, message):
    with pytest.raises(InputError, match=message):
        read(text, data_folder)
