"""The search for paths that are driven faster: proven, never slower, and far better than where it began."""

from itertools import count, pairwise

import numpy as np
import pytest

from safe_ompl import PathTimer, People
from safe_ompl.trajectories import duration_of, faster

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


def after(number):
    """Return a predicate that says stop when it has been asked so many times."""
    asked = count()
    return lambda: next(asked) >= number


@pytest.fixture
def timer(panda, shelf_motion, panda_limits):
    return PathTimer(panda, panda_limits, motion=shelf_motion, people=People(speed=1.6, reaction_time=0.1))


def test_beside_a_person_every_better_path_is_proven_and_takes_what_is_said(timer, panda, shelf_motion, shelf_path):
    told = []
    path = np.array(shelf_path)
    best, least = faster(
        path,
        timer,
        shelf_motion,
        np.random.default_rng(0),
        after(150),
        lambda found, duration: told.append((found, duration)),
    )
    assert least < 0.9 * duration_of(timer, path)
    assert least == told[-1][1]
    np.testing.assert_array_equal(best, told[-1][0])
    durations = [duration for _, duration in told]
    assert durations == sorted(durations, reverse=True)
    for found, duration in told:
        assert duration == timer.time(found).duration
        np.testing.assert_array_equal(found[[0, -1]], path[[0, -1]])
        assert all(shelf_motion.is_free(a, b) for a, b in pairwise(found))


def test_a_detour_that_nothing_asks_for_is_left_out(panda, shelf_motion, panda_limits):
    offsets = [[0.0] * 7, [0.3] * 7, [0.9, -0.3, 0.2, 0.3, 0, 0, 0], [0.6, 0, 0, 0, 0, 0, 0]]
    detour = HOME + np.array(offsets)
    assert all(shelf_motion.is_free(a, b) for a, b in pairwise(detour))
    timer = PathTimer(panda, panda_limits, motion=shelf_motion)
    straight = duration_of(timer, detour[[0, -1]])
    assert duration_of(timer, detour) > 1.5 * straight
    _, least = faster(detour, timer, shelf_motion, np.random.default_rng(0), after(300))
    assert least < 1.05 * straight


def test_caps_that_the_estimate_does_not_know_are_heeded(panda, shelf_motion, panda_limits, shelf_path):
    slow = PathTimer(panda, panda_limits, motion=shelf_motion, link_speed=0.4)
    path = np.array(shelf_path)
    best, least = faster(path, slow, shelf_motion, np.random.default_rng(0), after(60))
    assert least < duration_of(slow, path)
    assert least == slow.time(best).duration


def test_a_path_on_which_nothing_allows_motion_stays_as_it_is(panda, shelf_motion, panda_limits, shelf_path):
    late = PathTimer(panda, panda_limits, motion=shelf_motion, people=People(reaction_time=5.0))
    path = np.array(shelf_path)
    best, least = faster(path, late, shelf_motion, np.random.default_rng(0), after(50))
    assert best is path
    assert least == np.inf
