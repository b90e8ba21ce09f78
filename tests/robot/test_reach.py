"""Displacement radii are bounds: no body moves farther, wherever the joints are, and no body leaves its reach."""

from functools import cache

import coal
import numpy as np
import pinocchio as pin
import pytest
from edges import kept_within_limits
from hypothesis import given, settings, strategies as st

from safe_ompl import CollisionChecker, Scene
from safe_ompl.geometry import ConvexBodies, Hull, bounding_hull
from safe_ompl.robot.displacement_bounds import JointChain

SIMPLE = ["panda", "ur5", "kinova", "twin_arm", "slider"]
ROBOTS = [*SIMPLE, "gripper", "parallel", "loaded", "mobile", "cell"]
ROUNDING = 1e-9  # [m]

seeds = st.integers(0, 2**32 - 1)


def motion(robot, seed, scale):
    """Two configurations within limits, and the motion between them, up to `scale` of the joint ranges."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(robot.lower, robot.upper)
    step = scale * rng.uniform(-1, 1, robot.n) * rng.integers(0, 2, robot.n) * (robot.upper - robot.lower)
    end = kept_within_limits(robot, start + step)
    return start, end, np.abs(end - start)


def contains(cylinder, points):
    """Whether the cylinder holds the points, up to rounding."""
    arms = points - cylinder.center
    along = arms @ cylinder.axis
    radial = np.linalg.norm(arms - along[:, None] * cylinder.axis, axis=1)
    return bool(
        (radial <= cylinder.radius + ROUNDING).all() and (np.abs(along) <= cylinder.half_length + ROUNDING).all()
    )


@pytest.mark.parametrize(
    ("shape", "corners", "radius"),
    [
        (coal.Sphere(0.3), 1, 0.3),
        (coal.Capsule(0.1, 0.8), 2, 0.1),
        (coal.Box(0.2, 0.4, 0.6), 8, 0.0),
        (coal.Cylinder(0.1, 0.5), 8, 0.0),
        (coal.Cone(0.1, 0.5), 8, 0.0),
        (coal.Ellipsoid(0.1, 0.2, 0.3), 8, 0.0),
    ],
)
@pytest.mark.parametrize("coarse", [False, True])
def test_hulls_enclose_their_shapes(shape, corners, radius, coarse):
    hull = bounding_hull(shape, coarse=coarse)
    assert (len(hull.points), hull.radius) == (corners, radius)
    shape.computeLocalAABB()
    low = (hull.points - radius).min(axis=0)
    high = (hull.points + radius).max(axis=0)
    np.testing.assert_allclose(low, np.ravel(shape.aabb_local.min_), atol=1e-12)
    np.testing.assert_allclose(high, np.ravel(shape.aabb_local.max_), atol=1e-12)


def two_links(first_prismatic=False):
    """Links of 0.5 m along x: joint 1 about z (or along x), joint 2 about z."""
    axes = np.array([[1.0, 0, 0] if first_prismatic else [0, 0, 1.0], [0, 0, 1.0]])
    placements = [pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.5, 0, 0]))]
    return JointChain(
        [0, 1], placements, axes, np.array([first_prismatic, False]), np.array([-0.2, -2.0]), np.array([0.3, 2.0])
    )


def radii(chain, joint, body):
    return chain.radii(chain.regions(joint, body))


def reach(chain, joint, body):
    return chain.reach(chain.regions(joint, body))


def test_radii_of_a_planar_arm():
    ball_at_the_end = Hull(np.array([[0.4, 0.0, 0.0]]), 0.1)
    np.testing.assert_allclose(radii(two_links(), 2, ball_at_the_end), [1.0, 0.5])
    np.testing.assert_allclose(radii(two_links(), 1, ball_at_the_end), [0.5, 0.0])
    np.testing.assert_allclose(radii(two_links(), 0, ball_at_the_end), [0.0, 0.0])
    np.testing.assert_allclose(radii(two_links(first_prismatic=True), 2, ball_at_the_end), [1.0, 0.5])
    turned = reach(two_links(), 2, ball_at_the_end)
    assert (turned.radius, turned.half_length) == pytest.approx((1.0, 0.1))
    slid = reach(two_links(first_prismatic=True), 2, ball_at_the_end)
    low, high = slid.center[0] - slid.half_length, slid.center[0] + slid.half_length
    assert (low, high) == pytest.approx((-0.2 + 0.5 - 0.5, 0.3 + 0.5 + 0.5))


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=12)
@given(seed=seeds, scale=st.floats(0.001, 1.0))
def test_no_body_moves_farther_than_its_radii_allow(robot_named, body_points, name, seed, scale):
    robot = robot_named(name)
    bodies = body_points(robot)
    start, end, delta = motion(robot, seed, scale)
    before, after = bodies.at(start), bodies.at(end)
    constant = robot.bounds.displacement_radii @ delta
    at_start = robot.bounds.displacement_radii_at(start) @ delta
    for body, (old, new) in enumerate(zip(before, after, strict=True)):
        moved = np.linalg.norm(new - old, axis=1).max()
        assert moved <= constant[body] + ROUNDING
        assert moved <= at_start[body] + ROUNDING


def test_joints_that_carry_both_links_do_not_count(twin_arm):
    checker = CollisionChecker(twin_arm, Scene())
    joints = {joint: k for k, joint in enumerate(twin_arm.joint_names)}
    hands = checker.pairs.radii[checker.pair_names.index(("left_hand", "right_hand"))]
    assert hands[joints["lift"]] == 0, "the lift carries both"
    assert (np.delete(hands, joints["lift"]) > 0).all(), "joints of both branches count"
    arm = checker.pairs.radii[checker.pair_names.index(("torso", "left_forearm"))]
    assert np.flatnonzero(arm).tolist() == [joints["left_shoulder"], joints["left_elbow"]]
    base = checker.pairs.radii[checker.pair_names.index(("base", "right_rail"))]
    assert np.flatnonzero(base).tolist() == [joints[j] for j in ("lift", "right_shoulder", "right_slide")]
    assert base[joints["lift"]] == 1.0


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=20)
@given(seed=seeds)
def test_no_body_leaves_its_reach(robot_named, body_points, name, seed):
    robot = robot_named(name)
    bodies = body_points(robot)
    rng = np.random.default_rng(seed)
    at_limits = rng.integers(0, 3, robot.n)
    q = np.choose(at_limits, [robot.lower, rng.uniform(robot.lower, robot.upper), robot.upper])
    for joint, hull, points in zip(bodies.joints, bodies.hulls, bodies.at(q), strict=True):
        if joint:
            assert contains(reach(robot.shared.chain, joint, hull), points)


@pytest.mark.parametrize("name", SIMPLE)
@settings(max_examples=20)
@given(seed=seeds, radius=st.floats(0.0, 0.3))
def test_no_obstacle_is_farther_from_an_axis_than_said(robot_named, name, seed, radius):
    robot = robot_named(name)
    rng = np.random.default_rng(seed)
    shape = (coal.Box(*rng.uniform(0.1, 1.0, 3)), coal.Capsule(0.2, 0.7), coal.Sphere(0.3))[seed % 3]
    place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    obstacle = bounding_hull(shape).moved(place)
    shape.setSweptSphereRadius(radius)
    radius += obstacle.radius
    (farthest,) = robot.shared.chain.axis_distances(ConvexBodies.of([pin.GeometryObject("", 0, place, shape)]))
    assert np.isinf(farthest[robot.prismatic]).all()
    data = robot.model.createData()
    q = rng.uniform(robot.lower, robot.upper)
    pin.forwardKinematics(robot.model, data, robot.pinocchio_configuration(q))
    for i in np.flatnonzero(~robot.prismatic):
        joint = data.oMi[int(i) + 1]
        across = np.cross(obstacle.points - joint.translation, joint.rotation @ robot.shared.chain.axes[i])
        actual = np.linalg.norm(across, axis=1).max() + radius
        assert actual <= farthest[i] + ROUNDING
        if robot.shared.chain.parents[i] == 0:
            assert actual == pytest.approx(farthest[i])


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "twin_arm", "gripper", "mobile"])
@settings(max_examples=15)
@given(seed=seeds, scale=st.floats(0.001, 0.3))
def test_no_pair_approaches_faster_than_it_may(robot_named, clutter, name, seed, scale):
    """Links and obstacles, and links among each other."""
    robot = robot_named(name)
    checker = _checker(robot, clutter)
    start, end, delta = motion(robot, seed, scale)
    before, after = checker.pair_distances(start), checker.pair_distances(end)
    apart = (before > 0) & (after > 0)
    assert (np.abs(after - before) <= checker.pairs.radii @ delta + 2e-5)[apart].all()
    assert (np.abs(after - before) <= checker.pair_radii_at(start) @ delta + 2e-5)[apart].all()


@cache
def _checker(robot, scene):
    return CollisionChecker(robot, scene)
