"""Joint limits of trajectories: where they come from, and what is refused."""

import logging

import numpy as np
import pytest
from crank import CRANK

from safe_ompl import InputError, Motion, RateLimits, Robot, UnknownNameError, time_path
from safe_ompl.live.replanning import SpeedLimits
from safe_ompl.robot import RobotSpec, robot_hash
from safe_ompl.scene import MotionLimits


def test_velocities_come_from_the_urdf_and_the_default_accelerations_are_said_aloud_once(panda, caplog):
    with caplog.at_level(logging.WARNING):
        limits = RateLimits.of(panda)
        RateLimits.of(panda)
    assert limits.velocity.tolist() == list(panda.shared.model.velocityLimit)
    np.testing.assert_allclose(limits.acceleration, limits.velocity / 0.25)
    assert [record.message.count("give accelerations") for record in caplog.records] == [1]


def test_some_joints_one_for_all_or_all(panda, caplog):
    limits = RateLimits.of(panda, 1.5, dict.fromkeys(panda.joint_names, 5.0))
    assert limits.velocity.tolist() == [1.5] * 7
    assert limits.acceleration.tolist() == [5.0] * 7
    assert not caplog.records
    one = RateLimits.of(panda, {panda.joint_names[2]: 0.5}, range(1, 8))
    assert one.velocity[2] == 0.5
    assert one.acceleration.tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert one.as_dict()["velocity"][panda.joint_names[2]] == 0.5


def test_jerks_are_those_of_all_joints(panda):
    names = panda.joint_names
    with pytest.raises(InputError, match="acceleration limit"):
        RateLimits.of(panda, acceleration=np.nan)
    with pytest.raises(InputError, match=f"joint '{names[1]}' has no jerk limit"):
        RateLimits.of(panda, 1.0, 1.0, {names[0]: 10.0})
    for wrong in ({"velocity": {"elbow": 1.0}}, {"jerk": {**dict.fromkeys(names, 1.0), "elbow": 1.0}}):
        with pytest.raises(UnknownNameError, match="unknown joint 'elbow'"):
            RateLimits.of(panda, **wrong)
    assert RateLimits.of(panda, 1.0, 1.0, dict.fromkeys(names, 5.0)).jerk.tolist() == [5.0] * 7
    assert "jerk" not in RateLimits.of(panda, 1.0, 1.0).as_dict()
    assert MotionLimits.from_mapping({"jerk": 100}).to_mapping() == {"jerk": 100}


def absurd(robot):
    """Return everything that takes limits, by what it says that is wrong."""
    joint = robot.joint_names[1]
    return {
        f"velocity limit of joint '{joint}'": lambda x: RateLimits.of(robot, {joint: x}),
        "velocity limit of joint": lambda x: RateLimits.of(robot, [x] * robot.n, 1.0),
        "jerk limit": lambda x: RateLimits.of(robot, jerk=1e6 * x),
        rf"accelerations\.{joint}": lambda x: robot.with_accelerations({joint: 1e3 * x}),
        f"accelerations.{joint}": lambda x: RobotSpec(example="panda", accelerations={joint: 1e3 * x}),
        "velocity": lambda x: MotionLimits(velocity=x),
        r"velocity\[1\]": lambda x: MotionLimits(velocity=[1.0, x]),
        f"acceleration.{joint}": lambda x: MotionLimits(acceleration={joint: 1e3 * x}),
        "link_speed": lambda x: MotionLimits(link_speed=x),
        "link speed": lambda x: SpeedLimits(RateLimits.of(robot), link_speed=x),
        "tool speed": lambda x: time_path([robot.lower, robot.upper], robot, tool_speed=x),
        "largest velocity": lambda x: Motion.sampled([0, 1], np.zeros((2, robot.n)), x),
    }


@pytest.mark.parametrize("wrong", [0.0, -1.0, 1000.0, 3e6, 1e300])
def test_absurd_limits_are_refused_in_a_line_wherever_they_are_given(panda, wrong):
    for said, given in absurd(panda).items():
        with pytest.raises(InputError, match=f"^{said}:? .*must be a finite number .*in .*, got") as caught:
            given(wrong)
        assert len(str(caught.value)) < 200


def test_a_urdf_without_velocities_asks_for_them(tmp_path):
    (tmp_path / "arm.urdf").write_text(CRANK.replace('velocity="1"', 'velocity="0"'))
    robot = Robot.from_urdf(tmp_path / "arm.urdf")
    with pytest.raises(InputError, match="has no velocity limit in its URDF"):
        RateLimits.of(robot, acceleration=1.0)
    assert (RateLimits.of(robot, 2.0, 1.0).velocity == 2.0).all()


def test_accelerations_that_the_robot_knows(panda, caplog, tmp_path):
    first, second, *_ = panda.joint_names
    robot = panda.with_accelerations({first: 15.0, second: 7.5})
    assert robot.with_accelerations({first: 3.0}).accelerations == {first: 3.0, second: 7.5}
    assert panda.accelerations == {}
    assert RateLimits.of(robot).acceleration[:2].tolist() == [15.0, 7.5]
    assert first not in caplog.text
    assert panda.joint_names[2] in caplog.text
    assert RateLimits.of(robot, acceleration={second: 1.0}).acceleration[:2].tolist() == [15.0, 1.0]
    assert RateLimits.of(robot, acceleration=2.0).acceleration.tolist() == [2.0] * 7
    with pytest.raises(UnknownNameError, match="unknown joint 'elbow'"):
        panda.with_accelerations({"elbow": 1.0})
    said = {"example": "panda", "accelerations": {first: 12.0}}
    spec = RobotSpec.from_mapping(said, tmp_path)
    assert spec.to_mapping(tmp_path) == said
    assert Robot(spec).accelerations == {first: 12.0}
    assert robot_hash(Robot(spec)) == robot_hash(panda)
    cell = Robot.combined("cell", {"left": Robot(spec), "right": Robot.from_example("panda", base=(0, 1, 0))})
    assert cell.accelerations == {f"left_{first}": 12.0}
