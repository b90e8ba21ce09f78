"""Proofs of edges by distance bounds: what they prove is free, and they change no verdict."""

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from crank import CRANK
from edges import random_edge

from safe_ompl import Box, CollisionChecker, Mesh, MotionProver, Obstacle, Pose, Robot, Scene, Verdict
from safe_ompl.collision import FLOOR, Required, Separation
from safe_ompl.collision.proofs import ALLOWANCE, BoundsProof, DistanceBounds
from safe_ompl.common import Counts
from safe_ompl.geometry import ConvexBodies

WEDGE = Path(__file__).parents[1] / "data" / "wedge.obj"
ROBOTS = ["panda", "ur5", "kinova", "twin_arm", "slider"]


def edges(robot, number, longest=1.2):
    """Return random edges within the limits, and the motions along them."""
    lengths = np.random.default_rng(0).uniform(0, longest, number)
    found = [random_edge(robot, seed, length) for seed, length in enumerate(lengths)]
    return [(start, robot.difference(start, end)) for start, end in found]


def proof(pairs, start, delta):
    return pairs.bounds.prove((start, delta), Required(np.full(len(pairs.names), ALLOWANCE)), FLOOR)


# --------------------------------------------------------------------------------------------------- what is proven


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("name", ROBOTS)
def test_what_stands_still_in_the_middle_is_not_proven_if_it_touches_at_its_ends(robot_named, clutter, name, alone):
    robot, rng, touching = robot_named(name), np.random.default_rng(0), 0
    checker = CollisionChecker(robot, Scene() if alone else clutter)
    for _ in range(250):
        middle, out = rng.uniform(robot.lower, robot.upper), rng.normal(size=robot.n)
        out *= 0.3 / np.linalg.norm(out)
        if checker.touches(middle + out) and not checker.touches(middle):
            touching += 1
            least = Required(np.full(len(checker.pairs.names), ALLOWANCE))
            assert not checker.pairs.bounds.prove((middle + out, -4 * out, 4 * out), least, FLOOR).proven
    assert touching >= 3


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("enough", [0.1, np.inf])
def test_no_pair_is_nearer_than_its_bound(robot_named, clutter, name, enough):
    robot = robot_named(name)
    checker = CollisionChecker(robot, clutter)
    pairs, Q = checker.pairs, np.array([q for q, _ in edges(robot, 40) if not checker.touches(q)])
    bounds, clearances = pairs.bounds.of(Q, np.arange(len(pairs.names)), enough), pairs.bounds.clearances(Q, enough)
    assert (bounds > 0.0).mean() > 0.9
    assert ((clearances > 0.0) & (clearances <= enough)).mean() > 0.9
    for q, bound, clearance in zip(Q, bounds, clearances, strict=True):
        assert not pairs.within_margins(q, np.maximum(bound - ALLOWANCE, 0.0))
        assert not pairs.within_margins(q, pairs.margins(max(0.0, float(clearance) - ALLOWANCE)))


def test_what_only_holds_a_body_blocks_nothing(ur5):
    room = Obstacle("room", Mesh(WEDGE, (9.0, 9.0, 9.0), convex=False), Pose((-3.0, 0.0, 0.0)))
    inside, alone = (MotionProver(CollisionChecker(ur5, scene)) for scene in (Scene((room,)), Scene()))
    asked = [(start, start + delta) for start, delta in edges(ur5, 40)]
    found = [inside.is_free(*edge) for edge in asked]
    assert found == [alone.is_free(*edge) for edge in asked]
    assert 5 < sum(found) < 35


# ------------------------------------------------------------------------------------------------- what it changes


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_verdicts_are_those_of_coal_alone(robot_named, clutter, monkeypatch, name, margin):
    robot = robot_named(name)
    checker = CollisionChecker(robot, clutter)
    motion = MotionProver(checker, separation=Separation(margin=margin))
    asked = [(start, start + delta) for start, delta in edges(robot, 60)]
    found = [motion.check(*edge).verdict for edge in asked]
    by_bounds = replace(checker.counts)
    checker.counts.reset()
    monkeypatch.setattr(MotionProver, "_by_bounds", lambda *_: BoundsProof(False, -1.0, [[0.0, 1.0]]))
    assert [motion.check(*edge).verdict for edge in asked] == found
    for (start, end), verdict in zip(asked[:30], found, strict=False):
        way = robot.difference(start, end)
        assert motion.check_curve([start, way]) == motion.check(start, end)
        # Another timing of the same motion is divided elsewhere.
        curved = motion.check_curve([start, 0.5 * way, 0.5 * way]).verdict
        assert Verdict.UNDECIDED in (curved, verdict) or curved is verdict
    assert {Verdict.FREE, Verdict.BLOCKED} <= set(found)
    assert by_bounds.margin_queries + by_bounds.collision_queries < 0.5 * checker.counts.queries


def test_nothing_is_kept_from_one_edge_to_the_next(ur5, clutter):
    checker = CollisionChecker(ur5, clutter)
    asked = edges(ur5, 30)
    first = [proof(checker.pairs, *edge) for edge in asked]
    again = [proof(checker.pairs, *edge) for edge in reversed(asked)]
    assert first == again[::-1]
    assert first == [proof(CollisionChecker(ur5, clutter).pairs, *edge) for edge in asked]


# --------------------------------------------------------------------------------------------------- special cases


def test_a_motion_along_a_surface_takes_few_places(panda):
    q = np.array([-0.5, 0.3, 0.0, -1.5, 0.0, 1.8, 0.7])
    high = CollisionChecker(panda, Scene((Obstacle("ceiling", Box((4.0, 4.0, 0.1)), Pose((0.0, 0.0, 3.0))),)))
    gap = 0.001 - high.clearance(q).distance
    scene = Scene((Obstacle("ceiling", Box((4.0, 4.0, 0.1)), Pose((0.0, 0.0, 3.0 + gap))),))
    checker = CollisionChecker(panda, scene)
    assert MotionProver(checker).is_free(q, q + np.eye(7)[0])
    assert checker.counts.bound_queries < 40


def test_accelerations_count_where_velocities_lead_past_a_surface(tmp_path):
    """A ball on a circle of 1 m moves along a plate at first, and bends into it by 1 mm before 0.0447 rad."""
    urdf = tmp_path / "swing.urdf"
    urdf.write_text(CRANK.replace('xyz="0.5 0 0"', 'xyz="1 0 0"'))
    plate = Obstacle("plate", Box((0.1, 1.0, 0.1)), Pose((1 - 0.05 - 0.001 - 0.05, 0.0, 0.0)))
    motion = MotionProver(CollisionChecker(Robot.from_urdf(urdf), Scene((plate,))))
    assert motion.is_free([-0.044], [0.044])
    assert not motion.is_free([-0.047], [0.047])


def test_without_pairs_everything_is_free(ur5):
    nothing = np.zeros((0, 2), np.intp), np.zeros((0, ur5.n))
    bounds = DistanceBounds(ur5, ur5.bounds.convex_bodies, *nothing, Counts())
    assert bounds.prove(edges(ur5, 1)[0], Required(np.zeros(0)), FLOOR).proven


def test_what_has_no_end_is_left_to_coal(ur5):
    geometry = ur5.collision_model.copy()  # the robot hands out the same one to every test
    plane = pin.GeometryObject("plane", 0, pin.SE3.Identity(), coal.Halfspace(np.array([0.0, 0.0, 1.0]), -9.0))
    number = geometry.addGeometryObject(plane)
    bounds = DistanceBounds(
        ur5, ConvexBodies.of(list(geometry.geometryObjects)), np.array([[3, number]]), np.ones((1, ur5.n)), Counts()
    )
    found = bounds.prove(edges(ur5, 1)[0], Required(np.zeros(1)), FLOOR)
    assert not found.proven
    assert not found.covers(0.4, 0.6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_not_proven(ur5, clutter, bad):
    pairs = CollisionChecker(ur5, clutter).pairs
    start, delta = edges(ur5, 1)[0]
    for k in range(ur5.n):
        broken = start.copy()
        broken[k] = bad
        assert not proof(pairs, broken, delta).proven
        assert not proof(pairs, start, broken - start).proven


def test_groups_of_obstacles_change_no_verdict(panda, rng):
    places = [p for p in rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.2], (800, 3)) if np.hypot(*p[:2]) > 0.25]
    scene = Scene([Obstacle(str(k), Box((0.02, 0.03, 0.04)), Pose(place)) for k, place in enumerate(places)])
    grouped, one_by_one = CollisionChecker(panda, scene), CollisionChecker(panda, scene)
    groups = one_by_one.pairs.bounds.groups
    assert np.isfinite(groups["radius"]).sum() > 20
    assert set(groups["run_from_here"]) >= {1, 4, 8}, "a body has a run of eight, and one of those that are left"
    # No group is left out, as none would be of obstacles that may be anywhere.
    groups["radius"] = groups["run_radius"] = np.inf
    assert np.isfinite(grouped.pairs.bounds.groups["radius"]).any()
    np.testing.assert_array_equal(grouped.pairs.bodies, one_by_one.pairs.bodies)
    proven = touching = 0
    for start, delta in edges(panda, 400, longest=0.4):
        found, expected = (proof(checker.pairs, start, delta) for checker in (grouped, one_by_one))
        assert (found.proven, found.blocked) == (expected.proven, expected.blocked)
        assert grouped.pairs.touching(start) == one_by_one.pairs.touching(start)
        proven += found.proven
        touching += grouped.in_collision(start)
    assert 20 < proven < 380
    assert 20 < touching < 380
