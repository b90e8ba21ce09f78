"""Distances of pairs that follow the joints, against coal's own."""

from collections import defaultdict
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, CollisionChecker, Obstacle, PointCloud, Pose, Scene, Sphere
from safe_ompl.collision import PairDistances
from safe_ompl.geometry import ConvexBodies

WITHIN = 0.1


@pytest.fixture(scope="module")
def checker(panda):
    shelf = Obstacle("shelf", Box((0.5, 0.8, 0.02)), Pose((0.55, 0.0, 0.45)))
    return CollisionChecker(panda, Scene((shelf, Obstacle("ball", Sphere(0.1), Pose((0.3, 0.4, 0.7))))))


@pytest.fixture
def path(panda, rng):
    """Return configurations that follow each other by small steps, along and across the shelf."""
    middle = np.array([0.0, 0.5, 0.0, -1.9, 0.0, 2.4, 0.8])
    ends = middle + rng.uniform(-0.4, 0.4, (4, 7))
    return np.concatenate([np.linspace(a, b, 15) for a, b in pairwise(ends)])


def by_coal(plain, checker, q, reach):
    """Return the distances (K,) of the pairs of a link and an obstacle, as coal has them."""
    found = defaultdict(list)  # a link has several bodies
    for name, distance in zip(plain.pairs, plain.distances(q), strict=True):
        found[name].append(distance)
    pairs = checker.pairs_within(reach)
    return np.array([found[pairs.names[k]].pop(0) for k in np.flatnonzero(pairs.meets_obstacle)])


def test_what_is_near_is_what_coal_calls_near(checker, path, plain_check):
    plain = plain_check(checker.robot, checker.scene)
    distances = PairDistances(checker, WITHIN)
    found, everything = distances.near(path, WITHIN), distances.near(path, np.inf)
    assert len(everything.rows) == len(path) * len(distances)
    expected = np.array([by_coal(plain, checker, q, WITHIN) for q in path])
    apart = everything.table[:, 2] > 0
    np.testing.assert_allclose(everything.table[:, 2][apart], expected.ravel()[apart], rtol=0, atol=2e-5)
    assert (expected.ravel()[~apart] < 2e-5).all()
    near = everything.table[:, 2] < WITHIN
    assert 0 < near.sum() < len(near)
    np.testing.assert_array_equal(found.rows, everything.rows[near])
    np.testing.assert_array_equal(found.pairs, everything.pairs[near])
    np.testing.assert_allclose(found.table[:, 2], everything.table[:, 2][near], rtol=1e-5)


def test_what_is_not_convex_is_measured_by_coal(panda, path, plain_check):
    hollow = coal.BVHModelOBBRSS()
    hollow.beginModel(1, 3)
    hollow.addTriangle(np.array([0.0, 0.0, 0.0]), np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.2, 0.0]))
    hollow.endModel()
    shapes = hollow, coal.Box(0.1, 0.2, 0.3), coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    parts = [pin.GeometryObject("part", 0, pin.SE3.Identity(), shape) for shape in shapes]
    np.testing.assert_array_equal(ConvexBodies.of(parts).exact, [False, True, False])
    steps = np.array([[0.0, 0.0], [0.1, 0.3], [0.3, 0.3], [0.3, 0.0]])
    scan = np.c_[np.repeat(steps, 40, axis=0), np.tile(np.linspace(0, 0.4, 40), 4)]
    cloud = PointCloud(0.01, points=scan)
    checker = CollisionChecker(panda, Scene((Obstacle("scan", cloud, Pose((0.4, -0.2, 0.3))),)))
    found, plain = PairDistances(checker, WITHIN).near(path, np.inf), plain_check(panda, checker.scene)
    expected = np.array([by_coal(plain, checker, q, WITHIN) for q in path]).ravel()
    apart = expected > 1e-3
    assert apart.any()
    np.testing.assert_allclose(found.table[:, 2][apart], expected[apart], rtol=0, atol=2e-5)


def test_witnesses_do_not_depend_on_what_was_asked_before(checker, path):
    before, fresh = PairDistances(checker, WITHIN), PairDistances(checker, WITHIN)
    for shift in (0.3, 0.02):
        before.near(path + shift, WITHIN)
    found, expected = before.near(path, WITHIN).table, fresh.near(path, WITHIN).table
    np.testing.assert_array_equal(found[:, :3], expected[:, :3])
    np.testing.assert_array_equal(found[found[:, 2] > 0], expected[found[:, 2] > 0])


def test_the_least_distance_below_what_is_asked(checker, path):
    distances = PairDistances(checker, 0.5)
    true = np.array([checker.clearance(q).distance for q in path])
    for part in (slice(0, 1), slice(0, 20), slice(20, None)):
        if true[part].min() > 0:
            assert distances.least(path[part], 0.4) == pytest.approx(min(0.4, true[part].min()), abs=2e-5)
