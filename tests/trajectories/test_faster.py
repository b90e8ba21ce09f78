"""The search for paths that are driven faster: proven, never slower, and far better than where it began."""

from itertools import count, pairwise

import numpy as np
import pytest

from safe_ompl import PathTimer, People, RateLimits
from safe_ompl.trajectories import duration_of, faster
from safe_ompl.trajectories.local_changes import DurationEstimate, PathChanges

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


@pytest.fixture
def timer(panda, shelf_motion, panda_limits):
    """Return a function that makes what times paths past the operator."""
    return lambda limits=panda_limits, **caps: PathTimer(panda, limits, motion=shelf_motion, **caps)


def after(number):
    """Return a predicate that says stop when it has been asked so many times."""
    asked = count()
    return lambda: next(asked) >= number


def test_beside_a_person_every_better_path_is_proven_and_takes_what_is_said(timer, shelf_motion, shelf_path):
    told, beside = [], timer(people=People(speed=1.6, reaction_time=0.1))
    rng, note = np.random.default_rng(0), lambda found, duration: told.append((found, duration))
    best, least = faster(shelf_path, beside, shelf_motion, rng, after(150), note)
    assert least < 0.9 * duration_of(beside, shelf_path)
    assert least == told[-1][1]
    np.testing.assert_array_equal(best, told[-1][0])
    durations = [duration for _, duration in told]
    assert durations == sorted(durations, reverse=True)
    for found, duration in told:
        assert duration == beside.time(found).duration
        np.testing.assert_array_equal(found[[0, -1]], shelf_path[[0, -1]])
        assert all(shelf_motion.is_free(a, b) for a, b in pairwise(found))


def test_a_detour_that_nothing_asks_for_is_left_out(timer, shelf_motion):
    offsets = [[0.0] * 7, [0.3] * 7, [0.9, -0.3, 0.2, 0.3, 0, 0, 0], [0.6, 0, 0, 0, 0, 0, 0]]
    detour = HOME + np.array(offsets)
    assert all(shelf_motion.is_free(a, b) for a, b in pairwise(detour))
    straight = duration_of(timer(), detour[[0, -1]])
    assert duration_of(timer(), detour) > 1.5 * straight
    _, least = faster(detour, timer(), shelf_motion, np.random.default_rng(0), after(300))
    assert least < 1.05 * straight


def test_caps_that_the_estimate_does_not_know_are_heeded(timer, panda, shelf_motion, shelf_path):
    slow = timer(link_speed=0.4)
    best, least = faster(shelf_path, slow, shelf_motion, np.random.default_rng(0), after(60))
    assert least < duration_of(slow, shelf_path)
    assert least == slow.time(best).duration
    late = timer(people=People(reaction_time=5.0))  # nothing allows motion: it stays as it is
    best, least = faster(shelf_path, late, shelf_motion, np.random.default_rng(0), after(50))
    assert best is shelf_path
    assert least == np.inf
    assert np.isinf(DurationEstimate(late).times(shelf_path)).all()
    jerk = RateLimits.of(panda, acceleration=5.0, jerk=500.0)
    for other in (slow, timer(people=People(contact=True)), timer(tool_speed=0.5), timer(jerk)):
        assert not DurationEstimate(other).complete
    assert DurationEstimate(late).complete


@pytest.mark.parametrize("speed", [None, 1.6])
def test_the_estimate_tells_which_of_two_paths_takes_longer(timer, panda, shelf_path, speed):
    made = timer(people=None if speed is None else People(speed=speed))
    estimate, rng = DurationEstimate(made), np.random.default_rng(0)
    rows = []
    for _ in range(12):
        changed = shelf_path.copy()
        changed[1:-1] += rng.normal(0, 0.15, (2, panda.n))
        rows.append((estimate.times(changed).sum(), duration_of(made, changed)))
    ranks = np.argsort(np.argsort(rows, axis=0), axis=0)
    assert np.corrcoef(ranks.T)[0, 1] > 0.9
    if speed is None:
        np.testing.assert_allclose(*np.array(rows).T, rtol=0.2)
        assert estimate.away(HOME) is None
        return
    q = shelf_path[1]
    direction = estimate.away(q)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    before, later = made.distances.times_at(np.array([q, q + 0.05 * direction]))
    assert later > before


def test_a_single_short_edge(timer, panda):
    """From rest to rest within one sample: with a = 7.5 rad/s² the second joint takes 2 √(0.1/7.5) s for 0.1 rad."""
    path = np.array([HOME, HOME + 0.1 * np.eye(panda.n)[1]])
    assert DurationEstimate(timer()).times(path).sum() == pytest.approx(2 * np.sqrt(0.1 / 7.5))
    assert timer().time(path).duration == pytest.approx(2 * np.sqrt(0.1 / 7.5), rel=1e-3)


# ------------------------------------------------------------------------------------------------- random changes


@pytest.fixture
def changes(panda, timer):
    return PathChanges(panda, DurationEstimate(timer()), np.random.default_rng(0))


def test_ends_stay_limits_hold_and_new_edges_are_named(changes, panda):
    rng = np.random.default_rng(1)
    path = panda.lower + rng.uniform(0.3, 0.7, (9, panda.n)) * (panda.upper - panda.lower)
    path[2, 0], path[5, 3] = panda.lower[0], panda.upper[3]

    def edges(points):
        return {(a.tobytes(), b.tobytes()) for a, b in pairwise(points)}

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
        assert edges(change.path) - edges(path) <= edges(change.path[change.first : change.last])
    assert kept > 100
    assert refused
    assert shorter


def test_a_success_is_repeated_and_a_failure_reversed(changes):
    def moved(path):
        """Return the next change that moves way points, by a new direction."""
        return next(c for c in iter(lambda: changes.draw(path, None), 0) if c is not None and c.offset is not None)

    first = moved(np.linspace(HOME - 0.2, HOME + 0.2, 5))
    changes.succeeded(first)
    second = changes.draw(first.path, None)
    np.testing.assert_allclose(second.offset, 1.5 * first.offset)
    changes.failed(second)
    third = moved(first.path)
    changes.failed(third)
    np.testing.assert_array_equal(changes.draw(first.path, None).offset, -third.offset)


def test_most_changes_are_where_most_time_is_spent(changes):
    path, times = np.linspace(HOME - 0.2, HOME + 0.2, 12), np.full(11, 0.01)
    times[7] = 1.0
    drawn = [changes.draw(path, times) for _ in range(100)]
    most = [abs(c.offset).max(axis=1).argmax() for c in drawn if c is not None and c.offset is not None]
    assert np.isin(most, (7, 8)).mean() > 0.8
