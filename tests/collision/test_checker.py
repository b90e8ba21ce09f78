"""Collision, margin and distance queries against plain coal calls over every pair."""

import gc
import weakref

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, Cylinder, Obstacle, Person, PointCloud, Pose, Robot, Scene, Sphere
from safe_ompl.collision import Clearance, CollisionChecker, MotionProver
from safe_ompl.common import Counts
from safe_ompl.geometry import DISTANCE_ERROR

ROBOTS = ["panda", "ur5", "kinova", "twin_arm"]
TOLERANCE = 3e-5  # [m]; contacts this near the limit may be called either way


def configurations(robot, rng, count):
    return rng.uniform(robot.lower, robot.upper, (count, robot.n))


def pairs_to_check(checker, plain):
    """Index in `plain` of every pair that the checker asks about."""
    free = {}
    for k, pair in enumerate(plain.pairs):
        free.setdefault(pair, []).append(k)
    return np.array([free[pair].pop(0) for pair in checker.pair_names])


# ----------------------------------------------------------------------------------------------------- collisions


CLOUD = PointCloud(0.02, points=np.random.default_rng(1).uniform(-0.2, 0.2, (50, 3)).tolist())
SCENES = {
    "cloud and person": Scene(
        (Obstacle("cloud", CLOUD, Pose((0.4, -0.3, 0.5))), Obstacle("person", Person(), Pose((0.75, 0.4, -0.3))))
    ),
    "a body without volume": Scene((Obstacle("sheet", Box((2.0, 2.0, 5e-324)), Pose((0.0, 0.0, 0.5))),)),
}


@pytest.mark.parametrize(("name", "scene"), [*((name, None) for name in ROBOTS), *(("panda", key) for key in SCENES)])
def test_collisions_are_those_of_plain_coal_over_all_pairs(robot_named, plain_check, clutter, rng, name, scene):
    robot, scene = robot_named(name), SCENES.get(scene, clutter)
    checker, plain = CollisionChecker(robot, scene), plain_check(robot, scene)
    hits, named = 0, set()
    for q in configurations(robot, rng, 60):
        found, pair = plain.distances(q), checker.colliding_pair(q)
        hits += found.min() < 0
        assert (pair is not None) == checker.in_collision(q)
        if abs(found.min()) > TOLERANCE:
            assert (pair is not None) == (found.min() < 0)
        if pair is not None:
            assert min(found[k] for k, other in enumerate(plain.pairs) if other == pair) < TOLERANCE
            named.add(pair[1])
    assert 6 < hits < 57, "the scene tests both answers"
    assert named & set(scene.names)


def test_deep_overlap_is_never_called_free(ur5, plain_check):
    # Asked without margin, coal ends at a distance of a micrometre here, and calls the configuration free.
    q = np.array([-2.618254308580995, -1.705494553837177, -2.5484491995989127])
    q = np.append(q, [0.9230572005178308, -2.3352302450355187, -0.6605724885943527])
    assert plain_check(ur5, Scene()).nearest(q) < -0.015
    assert CollisionChecker(ur5, Scene()).in_collision(q)


def test_the_fixed_base_may_stand_on_an_obstacle(ur5):
    floor = Scene((Obstacle("floor", Box((2.0, 2.0, 0.1)), Pose((0.0, 0.0, -0.049))),))
    checker = CollisionChecker(ur5, floor)
    upright = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    assert not checker.in_collision(upright)
    assert not any("base_link" in pair and "floor" in pair for pair in checker.pair_names)
    lying = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    assert checker.colliding_pair(lying)[1] == "floor"


def test_a_robot_without_obstacles(robot_named):
    slider = robot_named("slider")
    checker = CollisionChecker(slider, Scene())
    assert checker.colliding_pair(np.array([0.0, 0.0, 0.3, 0.0])) is None
    assert checker.colliding_pair(np.array([0.0, 0.0, 0.0, 0.0])) == ("torso", "right_rail")
    assert checker.clearance(slider.lower) == Clearance(float("inf"), None, None)
    assert checker.distances(slider.lower).shape == (0,)


def test_a_robot_without_pairs(crank):
    checker = CollisionChecker(crank, Scene())
    assert checker.pair_names == ()
    assert not checker.pairs.within_margins(np.zeros(1), np.zeros(0))
    assert not checker.in_collision(np.zeros(1))


# ----------------------------------------------------------------------------------------------- pairs left out


@pytest.mark.parametrize("name", ROBOTS)
def test_pairs_that_are_left_out_never_meet(robot_named, plain_check, rng, name):
    robot = robot_named(name)
    boxes = [
        Obstacle(f"box{k}", Box((0.2, 0.15, 0.1)), Pose(tuple(place)))
        for k, place in enumerate(rng.uniform(-1.2, 1.2, (25, 3)))
    ]
    scene = Scene((*boxes, Obstacle("moon", Sphere(1.0), Pose((0.0, 0.0, 9.0)))))
    checker, plain = CollisionChecker(robot, scene), plain_check(robot, scene)
    left_out = np.delete(np.arange(len(plain.pairs)), pairs_to_check(checker, plain))
    assert len(left_out) > 10
    assert not any("moon" in pair for pair in checker.pair_names)
    for q in configurations(robot, rng, 100):
        assert plain.distances(q)[left_out].min() > 0


def test_what_a_sliding_joint_reaches_at_its_limit_is_checked(robot_named):
    slider = robot_named("slider")
    out = np.array([0.4, 0.0, 0.35, 0.0])
    outward = slider.keypoints(out)[-1] - slider.keypoints(out * [1, 1, 0, 1])[-1]
    hand = slider.tip_pose(out).act(np.array([0.1, 0.02, 0.0]))  # a ball of 0.06 m
    place = hand + 0.085 * outward / np.linalg.norm(outward)
    checker = CollisionChecker(slider, Scene((Obstacle("ball", Sphere(0.03), Pose(tuple(place))),)))
    assert checker.colliding_pair(out) == ("right_hand", "ball")
    assert checker.colliding_pair(out - [0, 0, 0.01, 0]) is None


# -------------------------------------------------------------------------------------------------------- margins


@pytest.mark.parametrize("name", ROBOTS)
def test_margins_are_exact(robot_named, plain_check, clutter, rng, name):
    robot = robot_named(name)
    checker, plain = CollisionChecker(robot, clutter), plain_check(robot, clutter)
    index = pairs_to_check(checker, plain)
    near = 0
    for q in configurations(robot, rng, 100):
        distances = plain.distances(q)[index]
        margins = rng.uniform(0, 0.3, len(index)) * (rng.random(len(index)) < 0.1)
        slack = float((distances - margins).min())
        near += slack < 0
        if abs(slack) > TOLERANCE:
            assert checker.pairs.within_margins(q, margins) == (slack < 0)
    assert 10 < near < 100


def test_margins_are_those_of_the_question(panda, clutter):
    """Neither those of the question before, nor what the same array held then."""
    pairs = CollisionChecker(panda, clutter).pairs
    q = np.array([0.0, -0.6, 0.0, -2.0, 0.0, 1.5, 0.5])
    none, wide = pairs.margins(0.0), pairs.margins(1.0)
    changing = np.zeros(len(pairs.names))
    for margins, expected in ((none, False), (wide, True), (none, False), (changing, False), (wide, True)):
        assert pairs.within_margins(q, margins) is expected
    for value in (0.0, 1.0, 0.0):
        changing[:] = value
        assert pairs.within_margins(q, changing) is bool(value)
    view = changing[:]  # of an array that changes
    view.setflags(write=False)
    for value in (0.0, 1.0, 0.0):
        changing[:] = value
        assert pairs.within_margins(q, view) is bool(value)


def test_what_is_handed_out_cannot_be_written_to(panda, clutter):
    pairs = CollisionChecker(panda, clutter).pairs_within(0.1)
    for array in (pairs.radii, pairs.bodies, pairs.meets_obstacle, pairs.margins(0.1)):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


# ------------------------------------------------------------------------------------------------------ distances


@pytest.mark.parametrize("name", ROBOTS)
def test_distances_are_those_of_plain_coal(robot_named, plain_check, clutter, rng, name):
    robot = robot_named(name)
    checker, plain = CollisionChecker(robot, clutter), plain_check(robot, clutter)
    against_obstacles = [k for k, pair in enumerate(plain.pairs) if pair[1] in clutter.names]
    q = configurations(robot, rng, 1)[0]
    expected = dict(zip(against_obstacles, plain.distances(q)[against_obstacles], strict=True))
    assert sorted(checker.distance_names) == sorted(plain.pairs[k] for k in against_obstacles)
    np.testing.assert_allclose(sorted(checker.distances(q)), sorted(expected.values()), atol=1e-6)
    nearest = min(expected, key=expected.get)
    clearance = checker.clearance(q)
    assert (clearance.link, clearance.obstacle) == plain.pairs[nearest]
    assert clearance.distance == pytest.approx(expected[nearest], abs=1e-6)
    if clearance.distance > 0:
        assert np.linalg.norm(np.subtract(*clearance.points)) == pytest.approx(clearance.distance, abs=1e-4)


# ----------------------------------------------------------------------------------------------- the broad phase


def test_queries_outlive_what_they_were_made_from(data_folder, rng):
    def build():
        robot = Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="hand")
        scene = Scene((Obstacle("post", Cylinder(0.1, 1.0), Pose((0.7, 0.0, 0.0))),))
        checker = CollisionChecker(robot, scene)
        return checker.in_collision, checker.clearance, checker.distances, weakref.ref(checker)

    in_collision, clearance, distances, checker = build()
    gc.collect()
    ballast = [np.random.default_rng(k).normal(size=1000) for k in range(100)]  # to overwrite what was freed
    assert in_collision(np.zeros(2))
    assert clearance(np.zeros(2)).distance < 0
    assert distances(np.zeros(2)).min() < 0
    assert not in_collision(np.array([np.pi / 2, 0.0]))
    assert checker() is not None
    del in_collision, clearance, distances, ballast
    gc.collect()
    assert checker() is None


def test_queries_are_counted(panda, clutter):
    counts = Counts()
    checker = CollisionChecker(panda, clutter, counts)
    assert counts == Counts()
    q = np.zeros(7)
    checker.in_collision(q)
    checker.colliding_pair(q)
    checker.pairs.within_margins(q, checker.pairs.margins(0.01))
    checker.clearance(q)
    assert counts == Counts(collision_queries=2, margin_queries=1, distance_queries=1)
    assert Counts(collision_queries=1, margin_queries=2, distance_queries=8, bound_queries=4).queries == 7


def test_error_of_distances_covers_the_tolerance_of_coal(panda):
    contacts = pin.GeometryData(panda.collision_model)
    assert all(request.gjk_tolerance < DISTANCE_ERROR / 5 for request in contacts.collisionRequests)


@pytest.mark.parametrize(("depth", "touches"), [(0.0004, True), (0.0006, False)])
def test_pairs_that_may_touch_are_not_checked_but_no_link_gets_deeper(depth, touches):
    robot = Robot.from_example("panda").with_attached("ball", Sphere(0.05))
    q = np.array([0, -0.3, 0, -2.2, 0, 2, 0.8])
    x, y, z = robot.tip_pose(q).translation
    scene = Scene([Obstacle("table", Box([0.2, 0.2, 0.02]), Pose([x, y, z - 0.05 - 0.01 + 0.0005]))])
    assert CollisionChecker(robot, scene).colliding_pair(q) == ("ball", "table")
    checker = CollisionChecker(robot, scene.touched([("ball", "table")], depth))
    assert ("ball", "table") not in {*checker.pair_names, *checker.distance_names}
    assert checker.in_collision(q) == touches
    assert checker.clearance(q).distance == pytest.approx(depth - 0.0005, abs=1e-5)
    assert MotionProver(checker).is_free(q, q - 0.05 * np.eye(7)[1]) != touches
