"""Which joints move and where the others are held: tip, group of the SRDF, locks."""

import logging
import pickle

import pytest

from safe_ompl import InputError, Robot

LEFT, RIGHT = ("left_shoulder", "left_elbow"), ("right_shoulder", "right_slide", "right_turn")
SRDF = """<robot name="twin_arm">
  <group name="left_arm"><chain base_link="torso" tip_link="left_hand"/></group>
  <group name="right_arm">
    <joint name="right_shoulder"/><link name="right_rail"/><joint name="right_turn"/><joint name="left_wrist"/>
  </group>
  <group name="both"><group name="left_arm"/><group name="right_arm"/></group>
  <group name="circle"><group name="circle"/></group>
  <group name="nothing"><joint name="left_wrist"/></group>
  <group name="apart"><chain base_link="right_arm" tip_link="left_hand"/></group>
  <group name="strange"><joint name="knee"/></group>
</robot>"""


@pytest.fixture
def build(data_folder, tmp_path):
    srdf = tmp_path / "twin.srdf"
    srdf.write_text(SRDF)
    return lambda **options: Robot.from_urdf(data_folder / "twin_arm.urdf", srdf, **options)


@pytest.mark.parametrize(
    ("group", "joints", "tip", "options"),
    [
        ("left_arm", LEFT, "left_hand", {}),
        ("right_arm", RIGHT, "right_hand", {}),
        ("both", LEFT + RIGHT, "right_hand", {}),
        ("both", LEFT + RIGHT, "left_hand", {"tip": "left_hand"}),
    ],
)
def test_a_group_chooses_the_joints(build, group, joints, tip, options):
    robot = build(group=group, **options)
    assert robot.joint_names == joints
    assert robot.tip == tip
    assert pickle.loads(pickle.dumps(robot)).joint_names == joints


def test_locks_win_over_zero_and_what_is_held_is_said(build, caplog):
    with caplog.at_level(logging.WARNING):
        robot = build(tip="left_hand", locked={"right_slide": 0.3, "lift": 0.2})
    assert robot.joint_names == LEFT
    assert robot.held_joints == {"lift": 0.2, "right_slide": 0.3, "right_shoulder": 0.0, "right_turn": 0.0}
    assert "right_turn = 0 (" in caplog.text
    assert "right_slide" not in caplog.text.replace("–", "")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"group": "legs"}, r"unknown group 'legs'; known: left_arm, right_arm, both, "),
        ({"group": "circle"}, "group 'circle' contains itself"),
        ({"group": "nothing"}, "group 'nothing' has no movable joint"),
        ({"group": "apart"}, "group 'apart': 'left_hand' is not above 'right_arm'"),
        ({"group": "strange"}, "unknown joint of group 'strange' 'knee'"),
    ],
)
def test_what_does_not_exist(build, options, message):
    with pytest.raises(InputError, match=message):
        build(**options)


def test_without_an_srdf(data_folder):
    with pytest.raises(InputError, match="group is defined in an SRDF: give the SRDF"):
        Robot.from_urdf(data_folder / "twin_arm.urdf", group="left_arm")
