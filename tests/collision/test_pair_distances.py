"""Distances of pairs that follow the joints, against coal's own."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.pair_distances import PairDistances
from safe_ompl.collision.witnesses import Proximity
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.basic import Box, Sphere

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


def test_bounds_hold_after_every_step_and_what_is_near_is_exact(checker, path):
    distances, exact = PairDistances(checker, WITHIN), PairDistances(checker, WITHIN)
    bounds = np.full(len(distances), -np.inf)
    near = 0
    for before, q in pairwise(np.concatenate([path[:1], path])):
        bounds = distances.moved(bounds, q - before)
        found = distances.refine(q, bounds, WITHIN)
        true = np.full(len(exact), -np.inf)
        exact.refine(q, true, np.inf)
        assert (bounds <= true + 1e-5).all()
        np.testing.assert_array_equal(found, np.flatnonzero(true < WITHIN))
        np.testing.assert_array_equal(bounds[found], true[found])
        near += len(found)
    assert near, "or the test shows nothing"


def test_fewer_distances_than_pairs_are_asked_for(checker, path, monkeypatch):
    proximity = Proximity(checker, WITHIN)
    proximity.witnesses(path)
    asked, compute = [], pin.computeDistance
    monkeypatch.setattr(pin, "computeDistance", lambda *args: asked.append(args[2]) or compute(*args))
    proximity.witnesses(path + 1e-3)
    assert 0 < len(asked) < 0.4 * len(path) * len(PairDistances(checker, WITHIN))


def test_witnesses_do_not_depend_on_what_was_asked_before(checker, path):
    before, fresh = Proximity(checker, WITHIN), Proximity(checker, WITHIN)
    for shift in (0.3, 0.02):
        before.witnesses(path + shift)
    found, expected = before.witnesses(path), fresh.witnesses(path)
    for name in ("rows", "joints", "points", "normals", "offsets"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_the_least_distance_below_what_is_asked(checker, path):
    distances = PairDistances(checker, 0.5)
    for q in path[::7]:
        true = checker.clearance(q).distance
        if true > 0:
            assert distances.least(q, 0.4) == pytest.approx(min(0.4, true), abs=2e-5)
