"""Distances of pairs that follow the joints, against coal's own."""

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, CollisionChecker, Obstacle, Pose, Scene, Sphere
from safe_ompl.collision import PairDistances, Proximity

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


def test_what_is_near_is_what_coal_calls_near(checker, path):
    distances = PairDistances(checker, WITHIN)
    found = list(distances.near(path, WITHIN))
    everything = list(distances.near(path, np.inf))
    assert len(everything) == len(path) * len(distances)
    assert found == [(row, pair, distance) for row, pair, distance in everything if distance < WITHIN]
    assert 0 < len(found) < len(everything)


def test_coal_is_asked_about_few_pairs_that_are_not_near(checker, path, monkeypatch):
    distances, asked, compute = PairDistances(checker, WITHIN), [], pin.computeDistance
    monkeypatch.setattr(pin, "computeDistance", lambda *args: asked.append(args[2]) or compute(*args))
    near = list(distances.near(path, WITHIN))
    assert 0 < len(near) <= len(asked) < 1.2 * len(near)


def test_witnesses_do_not_depend_on_what_was_asked_before(checker, path):
    before, fresh = Proximity(checker, WITHIN), Proximity(checker, WITHIN)
    for shift in (0.3, 0.02):
        before.witnesses(path + shift)
    found, expected = before.witnesses(path), fresh.witnesses(path)
    for name in ("rows", "joints", "points", "normals", "offsets"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_the_least_distance_below_what_is_asked(checker, path):
    distances = PairDistances(checker, 0.5)
    true = np.array([checker.clearance(q).distance for q in path])
    for part in (slice(0, 1), slice(0, 20), slice(20, None)):
        if true[part].min() > 0:
            assert distances.least(path[part], 0.4) == pytest.approx(min(0.4, true[part].min()), abs=2e-5)
