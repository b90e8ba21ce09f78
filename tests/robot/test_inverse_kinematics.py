"""The tip at a target: errors and Jacobians, joint steps within limits, inverse kinematics."""

import numpy as np
import pinocchio as pin
import pytest
from oracles.differences import slopes

from safe_ompl import InputError, Robot, Scenario
from safe_ompl.robot import (
    METRES_PER_RADIAN,
    Frames,
    TargetPose,
    Tip,
    approach,
    limited_step,
    motion_limits,
    pseudoinverse_step,
    transpose_step,
)
from safe_ompl.robot.ik import damped_step

ROBOTS = ("ur5", "panda", "kinova", "slider")


def random_configuration(robot, rng, margin=0.1):
    reach = robot.upper - robot.lower
    return robot.lower + reach * (margin + (1 - 2 * margin) * rng.random(robot.n))


def target_pose(robot, q, pose):
    tip = robot.tip_pose(q)
    return TargetPose(robot, tip.translation, tip.rotation if pose else None)


def test_the_distance_of_a_pose_counts_metres_and_radians(ur5):
    q = np.array([0.3, -1.2, 1.0, -0.7, 0.9, 0.2])
    tip = ur5.tip_pose(q)
    away, turned = np.add(tip.translation, [0.3, 0.0, 0.0]), pin.exp3(np.array([0.0, 0.4, 0.0])) @ tip.rotation
    assert TargetPose(ur5, away).distance(q) == pytest.approx(0.3)
    assert TargetPose(ur5, tip.translation, turned).distance(q) == pytest.approx(0.4 * METRES_PER_RADIAN)
    assert TargetPose(ur5, away, turned).distance(q) == pytest.approx(np.hypot(0.3, 0.4 * METRES_PER_RADIAN))


@pytest.mark.parametrize("pose", [False, True])
@pytest.mark.parametrize("name", ROBOTS)
def test_the_jacobian_is_the_gradient_of_the_distance(robot_named, rng, name, pose):
    """∇ ½‖Δx‖² = −JᵀΔx, by central differences; wherever the goal is."""
    robot = robot_named(name)
    for _ in range(5):
        q, goal = random_configuration(robot, rng), random_configuration(robot, rng)
        target = target_pose(robot, goal, pose)
        half_square = slopes(lambda at, target=target: target.distance(at) ** 2 / 2, q)
        np.testing.assert_allclose(-target.jacobian(q).T @ target.error(q), half_square, atol=1e-7)


@pytest.mark.parametrize(("name", "pose", "left"), [("ur5", 0, 3), ("ur5", 1, 0), ("panda", 1, 1), ("slider", 0, 2)])
def test_redundancy(robot_named, rng, name, pose, left):
    robot = robot_named(name)
    assert target_pose(robot, random_configuration(robot, rng), pose).redundancy == left


@pytest.mark.parametrize(
    ("position", "rotation", "message"),
    [
        ([0.1, 0.2], None, r"position of the tip: must have shape \(3\), got \(2,\)"),
        ([0.1, np.nan, 0.2], None, "position of the tip: must be finite"),
        ([0.1, 0.2, 0.3], np.eye(2), r"rotation of the tip: must have shape \(3, 3\)"),
        ([0.1, 0.2, 0.3], np.diag([1.0, 1.0, -1.0]), "orthonormal with determinant 1"),
        ([0.1, 0.2, 0.3], 1.01 * np.eye(3), "orthonormal with determinant 1"),
    ],
)
def test_places_that_make_no_sense(ur5, position, rotation, message):
    with pytest.raises(InputError, match=message):
        TargetPose(ur5, position, rotation)


def test_the_pseudoinverse_step_equals_the_formula(panda, rng):
    q, error, drift = random_configuration(panda, rng), rng.normal(size=3), rng.normal(size=7)
    J = panda.tip_jacobian(q)[:3]
    inverse = np.linalg.pinv(J)
    expected = inverse @ error + (np.eye(7) - inverse @ J) @ drift
    np.testing.assert_allclose(pseudoinverse_step(J, error, drift), expected, atol=1e-12)


def test_singular_directions_are_damped():
    """With the arm nearly stretched out the tip hardly moves along it: the step stays small, other ways exact."""
    J = np.array([[0.8, 0.4, 0.1], [0.0, 0.5, 0.2], [0.0, 0.0, 0.002]])
    steep = pseudoinverse_step(J, np.array([0.0, 0.0, 0.01]), np.zeros(3))
    assert np.linalg.norm(np.linalg.solve(J, [0.0, 0.0, 0.01])) > 5
    assert np.linalg.norm(steep) < 0.02
    way = np.array([0.03, 0.01, 0.0])
    np.testing.assert_allclose(J @ pseudoinverse_step(J, way, np.zeros(3)), way, atol=1e-4)


@pytest.mark.parametrize("rule", [pseudoinverse_step, transpose_step, damped_step])
@pytest.mark.parametrize("name", ROBOTS)
def test_steps_respect_limits_and_length(robot_named, rng, name, rule):
    robot = robot_named(name)
    limits = motion_limits(robot)
    for _ in range(50):
        target = target_pose(robot, random_configuration(robot, rng), pose=True)
        q = np.clip(random_configuration(robot, rng, margin=-0.1), robot.lower, robot.upper)
        step = limited_step(rule, target, q, limits, 0.3, rng.normal(size=robot.n))
        assert np.linalg.norm(step) <= 0.3 + 1e-12
        assert robot.within_limits(q + step).all()


def test_a_joint_at_its_limit_leaves_the_way_to_the_others(panda):
    q = np.array([0.3, 0.2, 0.1, -1.5, 0.4, 1.4, 0.2])
    q[3] = panda.upper[3]
    J = panda.tip_jacobian(q)[:3]
    way = 1e-3 * J[:, 3]
    target = TargetPose(panda, panda.tip_pose(q).translation + way)
    assert pseudoinverse_step(J, way, np.zeros(7))[3] > 0
    step = limited_step(pseudoinverse_step, target, q, motion_limits(panda))
    assert step[3] == 0
    assert target.distance(q + step) < 0.1 * target.distance(q)


@pytest.mark.parametrize("pose", [False, True])
@pytest.mark.parametrize(("name", "share"), [("ur5", 0.8), ("panda", 0.35), ("kinova", 0.6), ("slider", 0.1)])
def test_solutions_reach_the_place_within_limits(robot_named, rng, name, share, pose):
    robot = robot_named(name)
    found = 0
    for _ in range(30):
        target = target_pose(robot, random_configuration(robot, rng, 0.0), pose)
        q, distance = approach(target, random_configuration(robot, rng, 0.0), 1e-5)
        if distance <= 1e-5:
            found += 1
            tip = robot.tip_pose(q)
            assert np.linalg.norm(tip.translation - target.position) <= 1e-5
            assert not pose or np.linalg.norm(pin.log3(target.rotation.T @ tip.rotation)) <= 1e-4
            assert (q >= robot.lower).all()
            assert (q <= robot.upper).all()
    assert found >= 30 * share


def angle_between(own, wanted, axis):
    """Return the angle between two orientations, or between an axis of both."""
    if axis is None:
        return np.linalg.norm(pin.log3(wanted @ own.T))
    a, b = own @ axis, wanted @ axis
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


@pytest.mark.parametrize("name", ["panda", "ur5", "planar3"])
@pytest.mark.parametrize("free", [None, 0, 1, 2])
def test_solutions_are_found_from_where_the_tip_is_half_a_turn_off(rng, name, free):
    """As often as from a bit less than half a turn: the error has a direction there, which joints can follow."""
    robot = Robot(Scenario.load(name).robot) if name == "planar3" else Robot.from_example(name)
    tip, solved = Tip(robot, None if free is None else np.eye(3)[free]), []
    Q = rng.uniform(robot.lower, robot.upper, (60, robot.n))
    state = tip.at(Q)
    for turn in (pin.utils.rotate("z", np.pi), pin.utils.rotate("z", np.pi - 0.1)):
        poses = state.positions * 0.8, turn @ state.rotations
        frames = Frames(*poses, np.zeros((60, 3)), np.zeros((60, 3)))
        found, arrived = tip.solved(Q, frames, 1e-6, 60)
        for q, position, rotation in zip(found[arrived], *(part[arrived] for part in poses), strict=True):
            there = robot.tip_pose(q)
            assert np.linalg.norm(there.translation - position) < 1e-5
            assert angle_between(there.rotation, rotation, tip.free_axis) < 1e-5
        solved.append(arrived.sum())
    assert solved[0] >= 0.8 * solved[1] > 3
    _, jacobians = tip.task(state, frames)
    still = tip.null_motion(jacobians, rng.normal(size=Q.shape))
    np.testing.assert_allclose(np.einsum("bxn,bn->bx", jacobians, still), 0.0, atol=1e-3)
