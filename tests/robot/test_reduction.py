"""Which joints of a URDF move, which are held and where, and what cannot be."""

import logging

import numpy as np
import pinocchio as pin
import pytest
from self_pairs import self_pairs

from safe_ompl import CollisionChecker, InputError, Robot, Scene
from safe_ompl.robot import default_tip, finger_joints, robots_folder


def test_what_is_held_takes_what_mimics_it_and_the_log_says_so(data_folder, caplog):
    with caplog.at_level(logging.INFO):
        robot = Robot.from_urdf(data_folder / "gripper_arm.urdf", locked={"grip": 0.02})
        tipped = Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="hand")
    assert robot.joint_names == tipped.joint_names == ("turn", "elbow")
    fingers = {b.name: b.placement.translation for b in robot.collision_model.geometryObjects}
    assert fingers["finger_1_0"][1] == pytest.approx(0.005 + 0.02)
    assert fingers["finger_2_0"][1] == pytest.approx(-0.005 - (1.5 * 0.02 + 0.001))
    assert robot.tip == "hand"
    for said in ("0.031", "as not moving 'hand': grip = 0 ", "grip_mirror = 0.001", "fingers (finger_1, finger_2)"):
        assert said in caplog.text


@pytest.mark.parametrize(
    ("primary", "message"),
    [
        ("grab", "unknown joint that 'grip_mirror' mimics 'grab'; known: turn, elbow"),
        ("grip_mirror", "joints mimic each other in a circle: grip_mirror"),
    ],
)
def test_mimics_of_nothing_and_in_a_circle(edited, primary, message):
    with pytest.raises(InputError, match=message):
        Robot.from_urdf(edited("gripper_arm.urdf", '<mimic joint="grip"', f'<mimic joint="{primary}"'))


def test_a_transmission_that_names_a_joint_does_not_hide_what_it_mimics(edited):
    named = '<transmission name="t"><joint name="grip_mirror"/></transmission></robot>'
    robot = Robot.from_urdf(edited("gripper_arm.urdf", "</robot>", named))
    assert robot.joint_names == ("turn", "elbow", "grip")


def test_a_chain_of_mimics_follows(edited):
    text = '<mimic joint="grip_mirror" multiplier="2"/>'
    third = (
        '<link name="finger_3"/><joint name="aaa" type="prismatic"><parent link="hand"/><child link="finger_3"/>'
        f'<axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/>{text}</joint></robot>'
    )
    robot = Robot.from_urdf(edited("gripper_arm.urdf", "</robot>", third), tip="hand", locked={"grip": 0.02})
    frame = robot.model.frames[robot.model.getFrameId("finger_3")]
    hand = robot.model.frames[robot.model.getFrameId("hand")]
    assert (frame.placement.translation - hand.placement.translation)[0] == pytest.approx(2 * 0.031)


def test_the_skeleton_passes_through_locked_joints(data_folder):
    robot = Robot.from_urdf(data_folder / "twin_arm.urdf", tip="left_hand", locked={"left_elbow": 0.4})
    assert robot.joint_names == ("lift", "left_shoulder")
    assert robot.segment_names == ("left_shoulder", "left_elbow", "left_hand")


@pytest.mark.parametrize("locked", ["turn", "elbow"])
def test_a_joint_may_have_the_name_of_a_link(edited, locked):
    urdf = edited("gripper_arm.urdf", '"elbow"', '"upper"')
    robot = Robot.from_urdf(urdf, tip="hand", locked={locked.replace("elbow", "upper"): 0.3})
    plain = Robot.from_urdf(edited("gripper_arm.urdf", '"elbow"', '"elbow"'), tip="hand", locked={locked: 0.3})
    np.testing.assert_allclose(robot.keypoints(np.array([0.2])), plain.keypoints(np.array([0.2])))
    assert self_pairs(robot) == self_pairs(plain)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tip": "nose"}, r"unknown tip frame 'nose'; known: base, turn, upper, elbow, lower, "),
        ({"locked": {"knee": 0.0}}, r"unknown joint to lock 'knee'; known: turn, elbow, grip, grip_mirror"),
        ({"locked": {"elbow": float("nan")}}, "locked.elbow: must be a finite number, got nan"),
        ({"locked": {"elbow": 3.0}}, r"locked joint 'elbow': 3 is outside its limits \[-2.5, 2.5\]"),
        ({"limits": {"knee": (0, 1)}}, "unknown joint with limits 'knee'"),
        ({"limits": {"elbow": (1, 0)}, "tip": "hand"}, r"joint 'elbow' has the limits \[1.0, 0.0\]"),
        ({"limits": {"elbow": (0, float("nan"))}, "tip": "hand"}, r"limits.elbow: must be a finite number, got nan"),
        ({"tip": "base"}, "no joint is free to move"),
    ],
)
def test_bad_options(data_folder, options, message):
    with pytest.raises(InputError, match=message):
        Robot.from_urdf(data_folder / "gripper_arm.urdf", **options)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joints_that_cannot_be_planned_for(edited, kind):
    urdf = edited("gripper_arm.urdf", '"elbow" type="revolute"', f'"elbow" type="{kind}"')
    with pytest.raises(InputError, match=r"joint 'elbow' is a JointModel.*: lock it"):
        Robot.from_urdf(urdf, tip="hand")
    with pytest.raises(InputError, match=r"locked joint 'elbow': a JointModel.* can be locked at 0 only"):
        Robot.from_urdf(urdf, tip="hand", locked={"elbow": 1.0})
    assert Robot.from_urdf(urdf, tip="hand", locked={"elbow": 0.0}).joint_names == ("turn",)


def test_joints_whose_limits_leave_no_range_are_held(edited, caplog):
    limits = '<limit lower="-2.5" upper="2.5"'
    urdf = edited("gripper_arm.urdf", limits, '<limit lower="0.2" upper="0.2"')
    robot = Robot.from_urdf(urdf, tip="hand", locked={"grip": 0.0})
    assert robot.joint_names == ("turn",)
    assert robot.held_joints["elbow"] == 0.2
    assert "held, as their limits leave no range (limits= gives others): elbow = 0.2" in caplog.text
    freed = Robot.from_urdf(urdf, tip="hand", locked={"grip": 0.0}, limits={"elbow": (-1.0, 1.0)})
    assert freed.joint_names == ("turn", "elbow")
    with pytest.raises(InputError, match="no joint is free to move: the limits of elbow leave no range"):
        Robot.from_urdf(urdf, tip="hand", locked={"grip": 0.0, "turn": 0.1})
    with pytest.raises(InputError, match=r"joint 'turn' has the limits \[0.1, 0.1\]: no range to plan in"):
        freed.with_limits({"turn": (0.1, 0.1)})


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


def test_two_arms_are_no_fingers(data_folder, twin_arm):
    assert finger_joints(pin.buildModelFromUrdf(str(data_folder / "twin_arm.urdf"))) == frozenset()
    assert twin_arm.tip == "right_hand"


def test_fingers_on_a_standing_base_are_the_robot(edited):
    urdf = edited("gripper_arm.urdf", 'name="turn" type="revolute"', 'name="turn" type="fixed"')
    urdf.write_text(urdf.read_text().replace('name="elbow" type="revolute"', 'name="elbow" type="fixed"'))
    assert finger_joints(pin.buildModelFromUrdf(str(urdf))) == frozenset()


# --------------------------------------------------------------------------------------------------------- mimic joints


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
    assert checker.pairs.radii[fingers] == pytest.approx([0.0, 0.0, 1.0 + 1.5])
    open_, closed = plain.distances([0.0, 0.0, 0.04]), plain.distances([0.0, 0.0, 0.0])
    assert open_[fingers] - closed[fingers] == pytest.approx(2.5 * 0.04, abs=1e-4)
