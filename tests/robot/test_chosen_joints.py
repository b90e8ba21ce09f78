"""Which joints move and where the others are held: tip, group, locks, states of the SRDF."""

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
  <group_state name="home" group="left_arm"><joint name="left_elbow" value="0.5"/></group_state>
  <group_state name="home" group="right_arm">
    <joint name="right_shoulder" value="-0.4"/><joint name="right_slide" value="0.2"/>
    <joint name="root" value="0 0 0 0 0 0 1"/>
  </group_state>
  <group_state name="all" group="both">
    <joint name="lift" value="0.1"/><joint name="left_shoulder" value="0.2"/><joint name="left_elbow" value="0.3"/>
    <joint name="right_shoulder" value="0.4"/><joint name="right_slide" value="0.05"/>
    <joint name="right_turn" value="0.6"/>
  </group_state>
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


def held(robot):
    return {name: pytest.approx(value) for name, value in robot.held_joints.items()}


def test_a_state_is_the_posture_of_what_is_held(build, caplog):
    with caplog.at_level(logging.WARNING):
        robot = build(tip="left_hand", locked_state="home")
    assert held(robot) == {"right_shoulder": -0.4, "right_slide": 0.2, "right_turn": 0.0}
    assert "right_turn = 0 (" in caplog.text
    assert "right_slide" not in caplog.text.replace("–", "")
    again = pickle.loads(pickle.dumps(robot))
    assert held(again) == robot.held_joints


def test_locks_win_over_the_state(build):
    robot = build(tip="left_hand", locked={"right_slide": 0.3, "lift": 0.2}, locked_state="all")
    assert robot.joint_names == LEFT
    assert held(robot) == {"lift": 0.2, "right_slide": 0.3, "right_shoulder": 0.4, "right_turn": 0.6}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"group": "legs"}, r"unknown group 'legs'; known: left_arm, right_arm, both, "),
        ({"group": "circle"}, "group 'circle' contains itself"),
        ({"group": "nothing"}, "group 'nothing' has no movable joint"),
        ({"group": "apart"}, "group 'apart': 'left_hand' is not above 'right_arm'"),
        ({"group": "strange"}, "unknown joint of group 'strange' 'knee'"),
        ({"tip": "left_hand", "locked_state": "rest"}, "unknown state 'rest'; known: home, all"),
        ({"locked_state": "home"}, "give a tip or a group"),
    ],
)
def test_what_does_not_exist(build, options, message):
    with pytest.raises(InputError, match=message):
        build(**options)


def test_without_an_srdf(data_folder):
    with pytest.raises(InputError, match="group is a name of an SRDF: give the SRDF"):
        Robot.from_urdf(data_folder / "twin_arm.urdf", group="left_arm")
