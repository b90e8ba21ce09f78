"""MoveIt's files beside a robot: joint_limits.yaml, group states of the SRDF, soft limits, packages by name."""

import logging
import shutil

import numpy as np
import pytest
import yaml

from safe_ompl import InputError, RateLimits, Robot, Scenario
from safe_ompl.common.errors import warn_once
from safe_ompl.io.problems import built_robot, embedded_robot
from safe_ompl.robot import RobotSpec, robot_hash

ONE, TWO = "panda_joint1", "panda_joint2"
LIMITS = {
    ONE: {"has_velocity_limits": True, "max_velocity": 1.5, "has_acceleration_limits": True, "max_acceleration": 3.75},
    TWO: {"has_position_limits": True, "min_position": -1.0, "max_position": 5.0, "max_velocity": 9.0},
    "panda_joint3": {"has_velocity_limits": False, "max_velocity": 0.5, "has_jerk_limits": True, "max_jerk": 500.0},
    "panda_joint4": {"max_acceleration": 4.0, "max_deceleration": -2.0},
    "panda_finger_joint1": {"has_acceleration_limits": False, "max_acceleration": 0.0},
    "gripper": {"max_effort": 10.0},
}
MOVEIT = {"default_velocity_scaling_factor": 0.1, "joint_limits": LIMITS}


@pytest.fixture
def limits_file(tmp_path):
    def written(content):
        file = tmp_path / "joint_limits.yaml"
        file.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return file

    return written


@pytest.mark.parametrize(
    "content",
    [
        MOVEIT,
        {"robot_description_planning": MOVEIT},
        {"/**": {"ros__parameters": {"robot_description_planning": MOVEIT}}},
        {"move_group": {"ros__parameters": MOVEIT}},
    ],
    ids=["plain", "ROS 1", "all nodes", "one node"],
)
def test_the_narrower_limits_apply(limits_file, content, panda, caplog):
    warn_once.cache_clear()
    robot = Robot.from_example("panda", joint_limits=limits_file(content))
    assert [robot.lower[1], robot.upper[1]] == [-1.0, panda.upper[1]]
    assert np.delete(robot.lower, 1).tolist() == np.delete(panda.lower, 1).tolist()
    limits = RateLimits.of(robot)
    assert limits.velocity[:3].tolist() == [1.5, 2.175, 2.175]
    assert robot.accelerations == {ONE: 3.75, "panda_joint4": 2.0}
    assert limits.acceleration[[0, 3]].tolist() == [3.75, 2.0]
    # A jerk that the file limits is limited, that of the other joints only by what any joint may have.
    assert limits.jerk.tolist() == [1e8, 1e8, 500.0, 1e8, 1e8, 1e8, 1e8]
    assert RateLimits.of(panda).jerk is None
    assert "the robot has no such joint: gripper" in caplog.text
    assert f"{TWO}.max_velocity, {TWO}.max_position" in caplog.text


def test_limits_travel(limits_file, tmp_path):
    file = limits_file(MOVEIT)
    robot = Robot.from_example("panda", joint_limits=file)
    assert RobotSpec.from_mapping(robot.spec.to_mapping(tmp_path), tmp_path) == robot.spec
    assert robot.spec.to_mapping(tmp_path)["joint_limits"] == "joint_limits.yaml"
    carried = embedded_robot(robot)
    file.unlink()
    assert robot_hash(built_robot(carried)) == robot_hash(robot) != robot_hash(Robot.from_example("panda"))
    given = robot.with_limits({TWO: (-1.5, 1.5)}).with_accelerations({ONE: 1.0})
    assert [given.lower[1], given.accelerations[ONE]] == [-1.5, 1.0]
    cell = Robot.combined("cell", {"left": robot, "right": Robot.from_example("panda", base=(0, 1, 0))})
    assert cell.jerks == {"left_panda_joint3": 500.0}


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("joint_limits: [", r"joint_limits.yaml:2: malformed YAML"),
        ("- 1\n", r"must be a mapping of keys to values, got list \[1\]"),
        ("", "joint_limits: missing, but needed"),
        ({"robot_description_planning": 1}, "robot_description_planning: unknown key; .*valid keys: joint_limits"),
        ({"robot_description_planning": {"joint_limits": 1}}, "robot_description_planning.joint_limits: must be a map"),
        ({"joint_limits": {ONE: None}, "cartesian": 1}, "yaml:1: cartesian: unknown key"),
        ({"joint_limits": {ONE: 2}}, f"yaml:2: joint_limits.{ONE}: must be a mapping of keys to values, got int 2"),
        ({"joint_limits": {ONE: {"velocity": 2}}}, f"yaml:3: joint_limits.{ONE}.velocity: unknown key; did you mean"),
        ({"joint_limits": {ONE: {"max_velocity": "fast"}}}, "max_velocity: must be a finite number, got 'fast'"),
        ({"joint_limits": {ONE: {"max_velocity": -1.0}}}, "max_velocity: must be a finite number in .*got -1"),
        ({"joint_limits": {ONE: {"max_jerk": 0}}}, r"max_jerk: must be a finite number in \[0.1, .*got 0"),
        ({"joint_limits": {ONE: {"max_deceleration": 0}}}, "max_acceleration: must be a finite number in"),
        ({"joint_limits": {ONE: {"has_jerk_limits": 1}}}, "has_jerk_limits: must be true or false, got 1"),
        ({"joint_limits": {ONE: {"has_velocity_limits": True}}}, f"{ONE}.max_velocity: missing, but needed"),
        ({"joint_limits": {ONE: {"has_position_limits": True}}}, "min_position: missing, but needed"),
        ({"joint_limits": {ONE: {"min_position": 1, "max_position": 1}}}, "max_position: must be above the least"),
        ({"joint_limits": {ONE: {"min_position": 9}}}, "joint1: must overlap the position limits in .*panda.urdf"),
        ({"joint_limits": {"panda_joint": {"max_velocity": 1}}}, "unknown joint 'panda_joint'; did you mean 'panda_jo"),
        ({**MOVEIT, "default_velocity_scaling_factor": 1.5}, r"scaling_factor: must be a finite number in \(0, 1\]"),
    ],
)
def test_bad_limits_are_named_in_one_line(limits_file, content, said):
    with pytest.raises(InputError, match=said) as error:
        Robot.from_example("panda", joint_limits=limits_file(content))
    assert "joint_limits.yaml" in str(error.value)
    assert "\n" not in str(error.value)


def test_continuous_joints_have_no_positions(crank_like, limits_file):
    file = limits_file({"joint_limits": {"elbow": {"max_position": 1.0}}})
    with pytest.raises(InputError, match="elbow: must not have position limits, as it is continuous"):
        Robot.from_urdf(crank_like(), joint_limits=file)
    assert RateLimits.of(Robot.from_urdf(crank_like(), joint_limits=limits_file(SLOW))).velocity.tolist() == [2.0, 1.0]


SLOW = {"joint_limits": {"elbow": {"max_velocity": 1.0}}}
STATES = """
<robot name="arm">
  <group name="arm"><joint name="shoulder"/><joint name="elbow"/></group>
  <group name="half"><joint name="shoulder"/></group>
  <group_state name="ready" group="arm"><joint name="shoulder" value="0.5"/><joint name="elbow" value="-1"/>
    <joint name="rail" value="0 0 1"/></group_state>
  <group_state name="home" group="arm"><joint name="shoulder" value="0"/><joint name="elbow" value="1"/></group_state>
  <group_state name="home" group="half"><joint name="shoulder" value="0.1"/></group_state>
  <group_state name="far" group="arm"><joint name="shoulder" value="2"/><joint name="elbow" value="0"/></group_state>
  <group_state name="part" group="half"><joint name="shoulder" value="0.2"/></group_state>
  <group_state name="odd" group="arm"><joint name="shoulder" value="a"/></group_state>
  <group_state name="none" group="arm"><joint name="shoulder"/></group_state>
  <group_state name="wild" group="arm"><joint name="shoulder" value="nan"/></group_state>
</robot>
"""


@pytest.fixture
def crank_like(tmp_path):
    """Return a function that writes an arm of two joints, one with a safety controller, with an SRDF beside it."""

    def written(safety="", mesh="", elbow="continuous"):
        file = tmp_path / "arm.urdf"
        shape = f'<mesh filename="{mesh}"/>' if mesh else '<box size="0.3 0.05 0.05"/>'
        limit = '<limit lower="-1" upper="1" velocity="2" effort="1"/>'
        file.write_text(
            '<robot name="arm"><link name="base"/>'
            + "".join(
                f'<link name="{name}"><collision><origin xyz="0.1 0 0"/><geometry>{shape}</geometry></collision></link>'
                for name in ("upper", "fore")
            )
            + '<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>'
            f'{limit}{safety}</joint><joint name="elbow" type="{elbow}"><parent link="upper"/><child link="fore"/>'
            f'<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>{limit}</joint></robot>'
        )
        (tmp_path / "arm.srdf").write_text(STATES)
        return file

    return written


@pytest.mark.parametrize(
    ("safety", "limits"),
    [
        ('soft_lower_limit="-0.5" soft_upper_limit="0.8" k_velocity="1"', [-0.5, 0.8]),
        ('soft_lower_limit="-2" soft_upper_limit="0.8" k_velocity="1"', [-1.0, 0.8]),
        ('soft_lower_limit="-0.5" k_velocity="1"', [-0.5, 0.0]),
        ('k_velocity="1"', [-1.0, 1.0]),
        ('soft_lower_limit="0.0" soft_upper_limit="0" k_velocity="1"', [-1.0, 1.0]),
    ],
)
def test_soft_limits_are_limits(crank_like, safety, limits):
    """As in MoveIt, but that gains alone leave a joint its range; what travels keeps them."""
    robot = Robot.from_urdf(crank_like(f"<safety_controller {safety}/>"))
    assert [robot.lower[0], robot.upper[0]] == limits
    assert robot_hash(built_robot(embedded_robot(robot))) == robot_hash(robot)
    assert [*robot.with_limits({"shoulder": (-1, 1)}).lower] == [-1.0, -np.pi]


def test_soft_limits_apart_from_the_limits(crank_like):
    safety = '<safety_controller soft_lower_limit="2" soft_upper_limit="3"/>'
    with pytest.raises(InputError, match=r"joint 'shoulder': .*soft limits \[2, 3\] must overlap its limits \[-1, 1\]"):
        Robot.from_urdf(crank_like(safety))


def test_states_have_names(crank_like, tmp_path):
    urdf = crank_like()
    robot = Robot.from_urdf(urdf, tmp_path / "arm.srdf")
    assert robot.configuration("ready").tolist() == [0.5, -1.0]
    assert Robot.from_urdf(urdf, tmp_path / "arm.srdf", group="arm").configuration("home").tolist() == [0.0, 1.0]
    cell = Robot.combined("cell", {"a": robot, "b": Robot.from_urdf(urdf, tmp_path / "arm.srdf", base=(0, 5, 0))})
    assert cell.configuration("ready").tolist() == [0.5, -1.0, 0.5, -1.0]
    said = {"robot": {"urdf": "arm.urdf", "srdf": "arm.srdf"}, "start": "ready", "goal": {"configurations": ["part"]}}
    scenario = scenario_of(tmp_path, said)
    assert scenario.start_configuration(robot).tolist() == [0.5, -1.0]
    scenario.save(tmp_path / "again.yaml")
    assert Scenario.load(tmp_path / "again.yaml").start == "ready"


def scenario_of(folder, said):
    file = folder / "scenario.yaml"
    file.write_text(yaml.safe_dump(said))
    return Scenario.load(file)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ("redy", r"scenario.yaml: start: .*arm.srdf: unknown group state 'redy'; did you mean 'ready'\? known: ready"),
        ("home", "start: .*arm.srdf: 'home' is a state of the groups arm, half, with other values of 'shoulder'"),
        ("part", "start: no value for 'elbow'"),
        ("far", "start: joint 'shoulder' = 2 .*"),
        ("odd", "group_state 'odd': joint shoulder: must have a finite number as its value, got 'a'"),
        ("none", "joint shoulder: must have a finite number as its value, got ''"),
        ("wild", "joint shoulder: must have a finite number as its value, got 'nan'"),
        ("", "start: must be text on one line"),
    ],
)
def test_states_that_cannot_be_used(crank_like, tmp_path, state, said):
    robot = Robot.from_urdf(crank_like(), tmp_path / "arm.srdf")
    content = {"robot": "panda", "start": state, "goal": {"configuration": "ready"}}
    with pytest.raises(InputError, match=said):
        scenario_of(tmp_path, content).start_configuration(robot)


def test_states_need_an_srdf(crank_like):
    with pytest.raises(InputError, match="start: 'ready' is the name of a state in an SRDF: give the robot an SRDF"):
        Robot.from_urdf(crank_like()).configuration("ready", "start")


def test_packages_have_names(crank_like, tmp_path, data_folder, caplog):
    folder = tmp_path / "elsewhere" / "checkout"
    folder.mkdir(parents=True)
    shutil.copy(data_folder / "wedge.obj", folder / "link.obj")
    urdf = crank_like(mesh="package://arm_description/link.obj")
    with pytest.raises(InputError, match=r"arm_description/link.obj' not found; .*or the package by its name"):
        Robot.from_urdf(urdf)
    robot = Robot.from_urdf(urdf, package_dirs=[{"arm_description": folder}])
    said = robot.spec.to_mapping(tmp_path)
    assert said["package_dirs"] == [{"arm_description": "elsewhere/checkout"}]
    assert RobotSpec.from_mapping(said, tmp_path) == robot.spec
    carried = embedded_robot(robot)
    with caplog.at_level(logging.ERROR):
        assert robot_hash(built_robot(carried, package_dirs=robot.spec.package_dirs)) == robot_hash(robot)
    for wrong, words in (
        ([{"arm_description": tmp_path / "none"}], "package folder .*none' does not exist"),
        ([{}], r"package_dirs\[0\]: must map the name of one package to its folder, got 0 names"),
        ([{"": "."}], r"package_dirs\[0\]: must be text"),
        ([{"a": 1}], r"package_dirs\[0\].a: must be a file name, got int 1"),
        ([{"other": folder}], "not found"),
    ):
        with pytest.raises(InputError, match=words):
            Robot.from_urdf(urdf, package_dirs=wrong)
