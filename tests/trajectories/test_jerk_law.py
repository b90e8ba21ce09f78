"""Trajectories with limited jerk: all limits and caps hold at every instant, in stops too, and these are in time."""

import json
from itertools import pairwise

import numpy as np
import pytest
from test_people_caps import Limbs, adversary
from test_timing import POSTURE

from safe_ompl import DangerField, InputError, PathTimer, People, RateLimits, UnknownNameError, time_path
from safe_ompl.scene import MotionLimits
from safe_ompl.trajectories import BlendedCurve, Piece, blended
from safe_ompl.trajectories.time_law import SmoothLaw, SmoothLimits, velocity_cap

KEPT = 1 + 1e-9
FRANKA = ([2.175] * 4 + [2.61] * 3, np.array([15, 7.5, 10, 12.5, 15, 20, 20]))


@pytest.fixture(scope="module")
def limits(panda):
    """Return what Franka publishes for its first robot."""
    return RateLimits.of(panda, *FRANKA, 500 * FRANKA[1])


@pytest.fixture
def free(monkeypatch, shelf_motion):
    """Return a motion whose blends all count as proven."""
    monkeypatch.setattr("safe_ompl.trajectories.curve.Piece.is_free", lambda piece, motion: True)
    return shelf_motion


def instants(law, step=1e-3):
    """Densely, and just before, at and after all instants at which the plan enters or leaves a cell of the window."""
    edges = np.concatenate([x + w for x in (law.arrivals, law.leaves) for w in (0.0, law.window)])
    t = np.concatenate([np.arange(0, law.duration, step), *(edges + d for d in (-1e-9, 0, 1e-9))])
    return np.unique(np.clip(t, 0.0, law.duration))


def assert_within_limits(trajectory):
    t = instants(trajectory.law)
    state, limits = trajectory.at(t), trajectory.limits
    assert (abs(state.qd) <= limits.velocity * KEPT).all()
    assert (abs(state.qdd) <= limits.acceleration * KEPT).all()
    assert (abs(trajectory.jerks_at(t)) <= limits.jerk * KEPT).all()
    changes = abs(np.diff(state.qdd, axis=0))
    assert (changes <= limits.jerk * (1 + 1e-6) * np.diff(t)[:, None] + 1e-7).all()
    if trajectory.caps:
        cell, _, speed, _ = trajectory.law.at(t)
        assert (speed <= trajectory.speed_bounds()[cell] * KEPT + 1e-9).all()


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "twin_arm"])
@pytest.mark.parametrize("blend", [True, False])
def test_velocity_acceleration_and_jerk_hold_at_every_instant(robot_named, free, name, blend):
    robot = robot_named(name)
    rng = np.random.default_rng(3)
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    for _ in range(4):
        path = rng.uniform(low, high, (rng.integers(2, 6), robot.n))
        kinds = (rng.uniform(*span, robot.n) for span in ((0.5, 3), (1, 20), (5, 5000)))
        limits, motion = RateLimits.of(robot, *kinds), free if blend else None
        trajectory = time_path(path, robot, limits, motion=motion, tolerance=rng.uniform(0.01, 0.4))
        assert_within_limits(trajectory)
        assert len(trajectory.curve.stops) == (0 if blend else len(path) - 2)
        ends = trajectory.at([0.0, trajectory.duration])
        np.testing.assert_allclose(robot.difference(ends.q, path[[0, -1]]), 0, atol=1e-9)
        assert abs(ends.qd).max() < 1e-9


def test_each_derivative_is_that_of_the_one_before(panda, shelf_path, shelf_motion, limits):
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion)
    t, step = np.linspace(0.01, trajectory.duration - 0.01, 300), 1e-6
    before, now, after = (trajectory.at(t + side) for side in (-step, 0.0, step))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, atol=1e-5)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * step), now.qdd, atol=2e-2)
    slope = (after.qdd - before.qdd) / (2 * step)
    jumps = abs(slope - trajectory.jerks_at(t)).max(axis=1) > 1.0  # where a phase ends between
    assert jumps.mean() < 0.01


def test_it_does_not_stop_on_its_way_and_costs_little(panda, free, limits):
    rng, ratios = np.random.default_rng(0), []
    hard = RateLimits(limits.joint_names, limits.velocity, limits.acceleration)
    low, high = np.maximum(panda.lower, -2.5), np.minimum(panda.upper, 2.5)
    for _ in range(5):
        path = rng.uniform(low, high, (5, 7))
        smooth, sharp = (time_path(path, panda, of, motion=free) for of in (limits, hard))
        between = smooth.at(np.linspace(0.1, smooth.duration - 0.1, 2000))
        assert np.linalg.norm(between.qd, axis=1).min() > 0.1
        ratios.append(smooth.duration / sharp.duration)
    assert 1.0 < np.median(ratios) < 1.03


def test_blends_bend_continuously_within_the_tolerance(panda, shelf_path, limits, free):
    path = np.array(shelf_path)
    curve = blended(path, panda, 0.2, free, limits)
    assert not curve.stops
    for before, after in pairwise(curve.pieces):
        end = before.places(np.array([before.length]))
        for value, begin in ((end.q, after.start), (end.slope, after.slope), (end.bend, after.bend)):
            np.testing.assert_allclose(value[0], begin, atol=1e-9)
    s, step = np.linspace(0.01, curve.length - 0.01, 500), 1e-5
    before, now, after = (curve.at(s + side) for side in (-step, 0.0, step))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.slope, atol=1e-6)
    np.testing.assert_allclose((after.slope - before.slope) / (2 * step), now.bend, atol=1e-2)
    cells = curve.cells(0.05, 0.4)
    on = curve.at(np.linspace(0, curve.length, 5000))
    at = np.clip(np.searchsorted(cells.edges, np.linspace(0, curve.length, 5000)) - 1, 0, None)
    for values, low, high in (
        (on.slope, cells.boxes.slope_low, cells.boxes.slope_high),
        (on.bend, cells.boxes.bend_low, cells.boxes.bend_high),
        (on.swing, -cells.swings, cells.swings),
    ):
        assert (values >= low[at] - 1e-9).all()
        assert (values <= high[at] + 1e-9).all()


def test_a_path_that_turns_back_is_driven_without_a_stop_of_the_law(panda, free, limits):
    path = np.tile(POSTURE, (3, 1))
    path[1, 0] = 1.0
    trajectory = time_path(path, panda, limits, motion=free)
    assert not trajectory.curve.stops
    assert_within_limits(trajectory)
    assert trajectory.at(np.linspace(0, trajectory.duration, 3000)).q[:, 0].max() == pytest.approx(0.95, abs=0.01)


def test_a_straight_motion_takes_little_more_than_the_law_of_seven_phases(panda):
    path = np.tile(POSTURE, (2, 1))
    path[1, 0] = 1.0
    made = time_path(path, panda, RateLimits.of(panda, 1.0, 2.0, 10.0))
    least = 1.0 / 1.0 + 1.0 / 2.0 + 2.0 / 10.0
    assert least < made.duration < 1.13 * least
    short = time_path([path[0], path[0] + [0.01, 0, 0, 0, 0, 0, 0]], panda, RateLimits.of(panda, 1.0, 2.0, 10.0))
    least = 4 * (0.01 / 2 / 10.0) ** (1 / 3)
    assert least < short.duration < 1.25 * least


@pytest.mark.parametrize("jerk", [1e6, 1e8])
def test_without_a_limit_that_binds_it_is_the_law_without_jerk(panda, shelf_path, jerk):
    fastest = time_path(shelf_path, panda, RateLimits.of(panda, acceleration=8.0))
    smooth = time_path(shelf_path, panda, RateLimits.of(panda, acceleration=8.0, jerk=jerk))
    assert_within_limits(smooth)
    assert smooth.duration == pytest.approx(fastest.duration, rel=1e-3)


def test_any_caps_are_kept(panda):
    """Whatever caps of cells are, not only such as robots have; `time_path` is not asked."""
    rng = np.random.default_rng(1)
    limits = RateLimits.of(panda, 2.0, 5.0, 60.0)
    forward, still = np.full(7, 7**-0.5), np.zeros(7)
    curve = BlendedCurve([Piece(still, forward, still, still, 2.0)], [])
    cells = curve.cells(0.02)
    for scale, window in ((0.05, 0.02), (0.5, 0.1), (5.0, 0.4)):
        caps = np.minimum(5.2, scale * 10 ** rng.uniform(-1, 1, len(cells)))
        caps[rng.integers(0, len(cells), 3)] = 1e-3
        law = SmoothLimits.of(cells, limits, velocity_cap(cells, limits), window).law(limits, caps)
        t = instants(law)
        _, s, speed, push = law.at(t)
        at = np.clip(np.searchsorted(cells.edges, s - 1e-12) - 1, 0, len(caps) - 1)
        after = np.clip(np.searchsorted(cells.edges, s + 1e-12) - 1, 0, len(caps) - 1)
        assert (speed <= np.maximum(caps[at], caps[after]) * KEPT).all()
        assert abs(push).max() <= 5.0 * 7**0.5 * KEPT
        assert abs(law.jerks(t)).max() <= 60.0 * 7**0.5 * KEPT
        assert (np.diff(s) >= -1e-12).all()
        assert s[-1] == pytest.approx(2.0)
        assert np.sqrt(law.squares[[0, -1]]) == pytest.approx(0, abs=1e-9)
        middles = (cells.edges[1:] + cells.edges[:-1]) / 2
        low, high = law.rates_between(np.sort(np.concatenate([cells.edges, middles])))
        part = np.minimum((s / 0.01).astype(int), len(low) - 1)
        assert (low[part] - 1e-6 <= speed).all()
        assert (speed <= high[part] + 1e-6).all()


def test_the_law_is_the_average_of_its_plan():
    edges = np.array([0.0, 0.5, 0.9, 1.0, 2.0])
    squares = np.array([0.0, 1.0, 0.0, 0.4, 0.0])
    law = SmoothLaw.averaged(edges, squares, np.array([2]), 0.3)
    t = np.linspace(-0.3, law.duration, 20001)
    grid = np.sort(np.concatenate([law.arrivals, law.leaves]))
    speeds = np.interp(t, grid, np.repeat(np.sqrt(squares), 2))
    place = np.concatenate([[0], np.cumsum((speeds[1:] + speeds[:-1]) / 2 * np.diff(t))])
    area = np.concatenate([[0], np.cumsum((place[1:] + place[:-1]) / 2 * np.diff(t))])
    at = np.linspace(0, law.duration, 57)
    wanted = (np.interp(at, t, area) - np.interp(at - 0.3, t, area)) / 0.3
    cell, s, _, _ = law.at(at)
    np.testing.assert_allclose(s, wanted, atol=1e-6)
    assert (s >= edges[cell]).all()
    assert (s <= edges[cell + 1]).all()
    assert (np.diff(cell) >= 0).all()
    leaves = law.leaves[2]  # it stands in the corner
    corner = law.at(np.array([leaves - 1e-9, leaves, leaves + 1e-9]))
    assert corner[0].tolist() == [1, 2, 2]
    np.testing.assert_allclose(corner[1], 0.9, atol=1e-9)
    np.testing.assert_allclose(corner[2], 0.0, atol=1e-8)
    np.testing.assert_allclose(law.at(law.times)[1], edges, atol=1e-9)


@pytest.mark.parametrize("jerk", [500 * FRANKA[1], 1000.0])
def test_beside_people_it_still_stops_before_anyone_is_reached(panda, shelf, shelf_path, shelf_motion, jerk):
    people = People(speed=1.0)
    limits = RateLimits.of(panda, *FRANKA, jerk)
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion, people=people)
    assert_within_limits(trajectory)
    assert 0 < adversary(trajectory, Limbs(panda, shelf.scene["operator"]), people, 100) < 0.1
    hard = RateLimits(limits.joint_names, limits.velocity, limits.acceleration)
    stopping = time_path(shelf_path, panda, hard, motion=shelf_motion, people=people)
    assert stopping.duration < trajectory.duration < 1.3 * stopping.duration


def test_stops_keep_the_jerk_from_any_acceleration(panda, shelf_path, shelf_motion, limits):
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion, people=People(speed=1.0))
    pushed = False
    for begin in np.linspace(0, trajectory.duration, 40):
        stop, now = trajectory.stop_from(begin), trajectory.at(begin)
        for value, wanted, most in zip(stop.at(0.0), now, (1e-9, 1e-9, 1e-6), strict=True):
            np.testing.assert_allclose(value, wanted, atol=most)
        pushed |= abs(now.qdd).max() > 2
        assert_within_limits(stop)
        end = stop.at(stop.duration)
        assert max(abs(end.qd).max(), abs(end.qdd).max()) < 1e-9
        assert stop.duration < 0.5
    assert pushed


def test_speeds_of_links_and_danger_are_kept(panda, shelf, shelf_path, shelf_motion, limits):
    field = DangerField(panda, shelf.scene.danger_points()[0], k2=0.25, gamma=1.0)
    free = time_path(shelf_path, panda, limits, motion=shelf_motion)
    most = 0.5 * (free.danger(field.moving).peak + field.values(free.at(free.law.times).q).max())
    trajectory = time_path(
        shelf_path, panda, limits, motion=shelf_motion, tool_speed=0.5, danger=field.moving, max_danger=most
    )
    assert_within_limits(trajectory)
    danger = trajectory.danger(field.moving)
    assert danger.peak <= danger.proven_peak <= 1.1 * danger.peak
    assert danger.peak <= most * KEPT
    t = np.linspace(0, trajectory.duration, 400)
    tips = np.array([panda.tip_pose(q).translation for q in trajectory.at(t).q])
    assert (np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(t)).max() <= 0.5 * KEPT


def test_exports_name_the_limit(panda, shelf_path, limits):
    told = json.loads(time_path(shelf_path, panda, limits).to_json(rate=20))
    assert told["limits"]["jerk"]["panda_joint2"] == 3750.0
    assert "jerk" not in RateLimits.of(panda, 1.0, 1.0).as_dict()


def test_the_rest_is_timed_anew_from_rest_only(panda, shelf_path, shelf_motion, limits):
    timer = PathTimer(panda, limits, motion=shelf_motion)
    trajectory = timer.time(shelf_path)
    assert timer.retimed(trajectory).duration == pytest.approx(trajectory.duration)
    with pytest.raises(InputError, match="from rest"):
        timer.retimed(trajectory, trajectory.duration / 3)
    blends = time_path(shelf_path, panda, RateLimits.of(panda, 1.0, 1.0), motion=shelf_motion)
    with pytest.raises(InputError, match="only a motion that has one"):
        timer.retimed(blends)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_limits_that_are_none_are_refused(panda, wrong):
    with pytest.raises(InputError, match="jerk limit must be a finite number in"):
        RateLimits.of(panda, 1.0, 1.0, wrong)
    with pytest.raises(InputError, match="jerk"):
        RateLimits(("a",), np.ones(1), np.ones(1), np.array([wrong]))
    with pytest.raises(InputError, match="jerk: must be"):
        MotionLimits(jerk=wrong)


def test_some_joints_are_not_enough_and_jerk_needs_a_limit(panda, shelf_path):
    names = panda.joint_names
    with pytest.raises(InputError, match=f"joint '{names[1]}' has no jerk limit"):
        RateLimits.of(panda, 1.0, 1.0, {names[0]: 10.0})
    with pytest.raises(UnknownNameError, match="unknown joint 'elbow'"):
        RateLimits.of(panda, 1.0, 1.0, {**dict.fromkeys(names, 1.0), "elbow": 1.0})
    assert RateLimits.of(panda, 1.0, 1.0, dict.fromkeys(names, 5.0)).jerk.tolist() == [5.0] * 7
    with pytest.raises(InputError, match="the jerk of the trajectory is not limited"):
        time_path(shelf_path, panda, RateLimits.of(panda, 1.0, 1.0)).jerks_at(0.1)
    assert MotionLimits.from_mapping({"jerk": 100}).to_mapping() == {"jerk": 100}


def test_contact_with_a_limit_of_the_jerk_is_refused(panda, shelf_motion, limits):
    with pytest.raises(InputError, match=r"^people.contact: contact is not proven .* leave one out"):
        PathTimer(panda, limits, motion=shelf_motion, people=People(contact=True))
