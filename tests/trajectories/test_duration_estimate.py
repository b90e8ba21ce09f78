"""The quick estimate of a duration: near to the trajectory's, and cheap."""

import numpy as np
import pytest

from safe_ompl import PathTimer, People, RateLimits
from safe_ompl.trajectories import duration_of
from safe_ompl.trajectories.estimate import DurationEstimate

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


@pytest.fixture
def beside(panda, shelf_motion, panda_limits):
    return PathTimer(panda, panda_limits, motion=shelf_motion, people=People(speed=1.0))


@pytest.fixture
def path(shelf_path):
    return np.array(shelf_path)


@pytest.mark.parametrize("speed", [None, 1.6])
def test_it_tells_which_of_two_paths_takes_longer(panda, shelf_motion, panda_limits, path, speed):
    people = None if speed is None else People(speed=speed)
    timer = PathTimer(panda, panda_limits, motion=shelf_motion, people=people)
    estimate, rng = DurationEstimate(timer), np.random.default_rng(0)
    rows = []
    for _ in range(12):
        changed = path.copy()
        changed[1:-1] += rng.normal(0, 0.15, (2, panda.n))
        rows.append((estimate.times(changed).sum(), duration_of(timer, changed)))
    ranks = np.argsort(np.argsort(rows, axis=0), axis=0)
    assert np.corrcoef(ranks.T)[0, 1] > 0.9


def test_without_people_it_is_near_the_duration_of_the_trajectory(panda, shelf_motion, panda_limits, path):
    timer = PathTimer(panda, panda_limits, motion=shelf_motion)
    assert DurationEstimate(timer).times(path).sum() == pytest.approx(timer.time(path).duration, rel=0.2)


def test_a_single_short_edge(panda, panda_limits):
    """From rest to rest within one sample: with a = 7.5 rad/s² the second joint takes 2 √(0.1/7.5) s for 0.1 rad."""
    q = HOME
    there = q + 0.1 * np.eye(panda.n)[1]
    timer = PathTimer(panda, panda_limits)
    times = DurationEstimate(timer).times(np.array([q, there]))
    assert times.sum() == pytest.approx(2 * np.sqrt(0.1 / 7.5))
    assert times.sum() == pytest.approx(timer.time([q, there]).duration, rel=1e-3)


def test_where_people_allow_no_motion_it_takes_for_ever(panda, shelf, shelf_motion, panda_limits, path):
    timer = PathTimer(panda, panda_limits, motion=shelf_motion, people=People(speed=1.6, reaction_time=5.0))
    assert np.isinf(DurationEstimate(timer).times(path)).all()


def test_away_from_people_they_need_longer(beside, panda, panda_limits, path):
    q = path[1]
    direction = DurationEstimate(beside).away(q)
    before, after = beside.distances.times_at(np.array([q, q + 0.05 * direction]))
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert after > before
    assert DurationEstimate(PathTimer(panda, panda_limits)).away(q) is None


def test_it_says_what_it_does_not_know(beside, panda, shelf_motion, panda_limits):
    assert DurationEstimate.knows(beside)
    assert DurationEstimate.knows(PathTimer(panda, panda_limits))
    contact = People(contact=True)
    jerk = RateLimits.of(panda, acceleration=5.0, jerk=500.0)
    for timer in (
        PathTimer(panda, panda_limits, motion=shelf_motion, people=contact),
        PathTimer(panda, panda_limits, tool_speed=0.5),
        PathTimer(panda, panda_limits, link_speed=0.5),
        PathTimer(panda, jerk),
    ):
        assert not DurationEstimate.knows(timer)
