"""Random changes of paths: what stays, what is new, and what comes after a success and a failure."""

from itertools import pairwise

import numpy as np
import pytest

from safe_ompl import PathTimer
from safe_ompl.trajectories.estimate import DurationEstimate
from safe_ompl.trajectories.local_changes import PathChanges

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


@pytest.fixture
def changes(panda, panda_limits):
    estimate = DurationEstimate(PathTimer(panda, panda_limits))
    return PathChanges(panda, estimate, np.random.default_rng(0))


@pytest.fixture
def path(panda):
    """Return nine way points, two of them at the limits of joints."""
    rng = np.random.default_rng(1)
    points = panda.lower + rng.uniform(0.3, 0.7, (9, panda.n)) * (panda.upper - panda.lower)
    points[2, 0], points[5, 3] = panda.lower[0], panda.upper[3]
    return points


def edges(path):
    return {(a.tobytes(), b.tobytes()) for a, b in pairwise(path)}


def test_ends_stay_limits_hold_and_new_edges_are_named(changes, path, panda):
    kept = refused = shorter = 0
    for _ in range(300):
        change = changes.draw(path, np.ones(8))
        changes.failed(change)
        if change is None:
            refused += 1
            continue
        kept += 1
        shorter += len(change.path) < len(path)
        np.testing.assert_array_equal(change.path[[0, -1]], path[[0, -1]])
        assert len(change.path) >= 3
        assert all(panda.within_limits(q).all() for q in change.path)
        named = edges(change.path[change.first : change.last])
        assert edges(change.path) - edges(path) <= named
    assert kept > 100
    assert refused
    assert shorter


def moved(changes, path):
    """Return the next change that moves way points, by a new direction."""
    while True:
        change = changes.draw(path, None)
        if change is not None and change.offset is not None:
            return change


def test_a_success_is_repeated_and_a_failure_reversed(changes, panda):
    path = np.linspace(HOME - 0.2, HOME + 0.2, 5)
    first = moved(changes, path)
    changes.succeeded(first)
    second = changes.draw(first.path, None)
    np.testing.assert_allclose(second.offset, 1.5 * first.offset)
    changes.failed(second)
    third = moved(changes, first.path)
    changes.failed(third)
    np.testing.assert_array_equal(changes.draw(first.path, None).offset, -third.offset)


def test_most_changes_are_where_most_time_is_spent(changes, panda):
    path = np.linspace(HOME - 0.2, HOME + 0.2, 12)
    times = np.full(11, 0.01)
    times[7] = 1.0
    most = []
    for _ in range(100):
        change = changes.draw(path, times)
        if change is not None and change.offset is not None:
            most.append(int(np.linalg.norm(change.offset, axis=1).argmax()))
    assert np.isin(most, (7, 8)).mean() > 0.8
