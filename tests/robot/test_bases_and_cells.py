"""Robots on bases, and several in one cell: kinematics, pairs, proofs."""

import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from self_pairs import self_pairs

from safe_ompl import CollisionChecker, InputError, Pose, Scene, Sphere, UnknownNameError
from safe_ompl.robot import Robot, robot_hash

BASE = Pose.from_rpy((0.5, -0.3, 0.8), (0.2, -0.1, 1.2))


@pytest.fixture
def mobile(robot_named):
    return robot_named("mobile")


@pytest.fixture
def cell(robot_named):
    return robot_named("cell")


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
def test_everything_moves_with_the_base(robot_named, body_points, rng, name):
    robot, world = robot_named(name), BASE.se3
    placed = Robot(replace(robot.spec, base=BASE))
    assert placed.joint_names == robot.joint_names
    np.testing.assert_array_equal(placed.lower, robot.lower)
    np.testing.assert_array_equal(placed.segments, robot.segments)
    np.testing.assert_allclose(placed.bounds.displacement_radii, robot.bounds.displacement_radii, atol=1e-9)
    for q in rng.uniform(robot.lower, robot.upper, (4, robot.n)):
        tip = world * robot.tip_pose(q)
        np.testing.assert_allclose(placed.tip_pose(q).homogeneous, tip.homogeneous, atol=1e-12)
        before = [robot.keypoints(q), *body_points(robot).at(q)]
        for old, new in zip(before, [placed.keypoints(q), *body_points(placed).at(q)], strict=True):
            np.testing.assert_allclose(new, old @ world.rotation.T + world.translation, atol=1e-12)
    assert self_pairs(placed) == self_pairs(robot)
    for old, new in zip(robot.model.frames, placed.model.frames, strict=True):
        assert (old.name, old.parentJoint, old.parentFrame) == (new.name, new.parentJoint, new.parentFrame)
        assert old.type == new.type
    for limits in ("velocityLimit", "effortLimit", "lowerPositionLimit", "upperPositionLimit"):
        np.testing.assert_array_equal(getattr(robot.model, limits), getattr(placed.model, limits))


def test_the_arm_rides_on_the_base(mobile, ur5, rng):
    assert mobile.joint_names == ("base_x", "base_y", "base_yaw", *ur5.joint_names)
    assert mobile.prismatic.tolist() == [True, True, *[False] * 7]
    assert mobile.continuous.tolist() == [False, False, True, *[False] * 6]
    assert (mobile.segment_names[1:], mobile.tip) == (ur5.segment_names, ur5.tip)
    for q in rng.uniform(mobile.lower, mobile.upper, (5, mobile.n)):
        ride = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, q[2]), np.array([q[0], q[1], 0.0]))
        expected = ride * ur5.tip_pose(q[3:])
        np.testing.assert_allclose(mobile.tip_pose(q).homogeneous, expected.homogeneous, atol=1e-12)


def test_limits_of_the_base_and_of_the_arm(mobile):
    other = mobile.with_limits({"base_x": (0.0, 0.5), "elbow_joint": (-1.0, 1.0)})
    assert (other.lower[0], other.upper[0]) == (0.0, 0.5)
    assert (other.lower[1], other.upper[1]) == (-0.5, 2.0)
    assert other.upper[list(other.joint_names).index("elbow_joint")] == 1.0
    with pytest.raises(InputError, match="joint 'base_yaw' is continuous: it has no limits"):
        mobile.with_limits({"base_yaw": (0.0, 1.0)})


def test_joints_links_and_tips_of_both(cell, panda, ur5, rng):
    assert cell.joint_names == tuple(
        [f"left_{name}" for name in panda.joint_names] + [f"right_{name}" for name in ur5.joint_names]
    )
    assert cell.tip == "left_panda_hand_tcp"
    assert set(cell.segment_names) == {f"left_{name}" for name in panda.segment_names} | {
        f"right_{name}" for name in ur5.segment_names
    }
    left = Robot.from_example("panda", base={"position": [0.0, 0.45, 0.0], "yaw": -1.5})
    right = Robot.from_example("ur5", base={"position": [0.0, -0.45, 0.0], "yaw": 1.5})
    for q in rng.uniform(cell.lower, cell.upper, (3, cell.n)):
        np.testing.assert_allclose(cell.tip_pose(q).homogeneous, left.tip_pose(q[:7]).homogeneous, atol=1e-12)
        both = np.vstack([left.keypoints(q[:7]), right.keypoints(q[7:])])
        np.testing.assert_allclose(
            sorted(cell.keypoints(q).round(9).tolist()), sorted(both.round(9).tolist()), atol=1e-8
        )


def test_pairs_of_each_and_all_between(cell, panda, ur5):
    bodies, expected = list(cell.collision_model.geometryObjects), set()
    for prefix, robot in (("left", panda), ("right", ur5)):
        expected |= {frozenset(f"{prefix}_{name}" for name in pair) for pair in self_pairs(robot)}
    left, right = ([b for b in bodies if b.name.startswith(side)] for side in ("left_", "right_"))
    expected |= {frozenset((a.name, b.name)) for a in left for b in right if a.parentJoint or b.parentJoint}
    assert self_pairs(cell) == expected
    assert {"left_panda_link0_0", "right_base_link_0"} <= {body.name for body in bodies if body.parentJoint == 0}


def test_cells_travel_and_keep_what_is_held(cell, panda):
    held = panda.with_attached("rod", Sphere(0.1))
    robot = Robot.combined("cell", {"left": held, "right": Robot.from_example("panda", base=(1.0, 0.0, 0.0))})
    assert [item.name for item in robot.attached] == ["left_rod"]
    assert robot_hash(pickle.loads(pickle.dumps(robot))) == robot_hash(robot)
    more = cell.with_attached("ball", Sphere(0.05), "right_tool0").with_limits({"right_elbow_joint": (0.0, 1.0)})
    assert more.upper[list(more.joint_names).index("right_elbow_joint")] == 1.0
    assert ("left_panda_link3", "ball") in CollisionChecker(more, Scene()).pair_names
    assert "left_panda_joint1" in repr(more)
    with pytest.raises(UnknownNameError, match="unknown prefix of the joint with limits 'elbow_joint'; known: left"):
        cell.with_limits({"elbow_joint": (0.0, 1.0)})


@pytest.mark.parametrize(
    ("names", "tip", "message"),
    [
        (["left"], None, "give two robots or more, not 1"),
        (["left", "right"], "middle", "unknown robot with the tip 'middle'; known: left, right"),
        (["arm", "arm_2"], None, "the prefixes 'arm' and 'arm_2' are ambiguous in 'arm_2_…'"),
    ],
)
def test_bad_cells(panda, names, tip, message):
    with pytest.raises(InputError, match=message):
        Robot.combined("cell", dict.fromkeys(names, panda), tip=tip)
    with pytest.raises(InputError, match="right: must be a Robot, not 'panda'"):
        Robot.combined("cell", {"left": panda, "right": "panda"})
