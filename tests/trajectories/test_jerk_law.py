"""Trajectories with limited jerk: all limits and caps hold at every instant, and the robot still stops in time."""

import json

import numpy as np
import pytest
from test_people_caps import Limbs, adversary
from test_timing import POSTURE

from safe_ompl import DangerField, InputError, PathTimer, People, RateLimits, UnknownNameError, time_path
from safe_ompl.scene import MotionLimits
from safe_ompl.trajectories import BlendedCurve, Piece
from safe_ompl.trajectories.time_law import Ramp, jerk_limited_law

KEPT = 1 + 1e-9


@pytest.fixture(scope="module")
def limits(panda):
    return RateLimits.of(panda, acceleration=[15, 7.5, 10, 12.5, 15, 20, 20], jerk=1000.0)


def instants(law, step=1e-3):
    """Densely, and just before, at and after all edges of cells and phases."""
    edges = np.concatenate([law.times, law.starts])
    return np.sort(
        np.concatenate([np.arange(0, law.duration, step), *(edges * (1 + d) for d in (-1e-13, 0, 1e-13))])
    )


def assert_within_limits(trajectory):
    t = instants(trajectory.law)
    state, limits = trajectory.at(t), trajectory.limits
    assert (abs(state.qd) <= limits.velocity * KEPT).all()
    assert (abs(state.qdd) <= limits.acceleration * KEPT).all()
    assert (abs(trajectory.jerks_at(t)) <= limits.jerk * KEPT).all()
    cell, _, speed, _ = trajectory.law.at(t)
    assert (speed <= trajectory.speed_bounds()[cell] * KEPT + 1e-9).all()


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "twin_arm"])
def test_velocity_acceleration_and_jerk_hold_at_every_instant(robot_named, name):
    robot = robot_named(name)
    rng = np.random.default_rng(3)
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    for _ in range(5):
        path = rng.uniform(low, high, (rng.integers(2, 6), robot.n))
        kinds = (rng.uniform(*span, robot.n) for span in ((0.5, 3), (1, 20), (5, 500)))
        trajectory = time_path(path, robot, RateLimits.of(robot, *kinds))
        assert_within_limits(trajectory)
        ends = trajectory.at([0.0, trajectory.duration])
        np.testing.assert_allclose(robot.difference(ends.q, path[[0, -1]]), 0, atol=1e-9)


def test_each_derivative_is_that_of_the_one_before(panda, shelf_path, limits):
    trajectory = time_path(shelf_path, panda, limits)
    t, step = np.linspace(0.01, trajectory.duration - 0.01, 300), 1e-5
    before, now, after = (trajectory.at(t + side) for side in (-step, 0.0, step))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, atol=1e-5)
    np.testing.assert_allclose((after.qd - before.qd) / (2 * step), now.qdd, atol=1e-2)
    assert abs(after.qdd - before.qdd).max() <= 2 * step * limits.jerk.max() * (1 + 1e-6)


def test_a_straight_motion_takes_what_the_law_of_seven_phases_says(panda):
    path = np.tile(POSTURE, (2, 1))
    path[1, 0] = 1.0
    made = time_path(path, panda, RateLimits.of(panda, 1.0, 2.0, 10.0))
    assert made.duration == pytest.approx(1.0 / 1.0 + 1.0 / 2.0 + 2.0 / 10.0, rel=1e-9)
    short = time_path(
        [path[0], path[0] + [0.01, 0, 0, 0, 0, 0, 0]], panda, RateLimits.of(panda, 1.0, 2.0, 10.0)
    )
    assert short.duration == pytest.approx(4 * (0.01 / 2 / 10.0) ** (1 / 3), rel=1e-6)


def test_without_a_limit_that_binds_it_is_the_law_without_jerk(panda, shelf_path):
    fastest = time_path(shelf_path, panda, RateLimits.of(panda, acceleration=8.0))
    smooth = time_path(shelf_path, panda, RateLimits.of(panda, acceleration=8.0, jerk=1e6))
    assert smooth.duration == pytest.approx(fastest.duration, rel=1e-3)


def test_a_ramp_reaches_its_speeds_where_it_says():
    for low, high in ((0.0, 0.3), (0.2, 2.0), (0.5, 0.5)):
        ramp = Ramp(low, high, 3.0, 20.0)
        t = np.linspace(0, 2 * ramp.bend + ramp.straight, 20001)
        push = np.clip(np.minimum(20 * t, 20 * (t[-1] - t)), 0, 20 * ramp.bend)
        speed = low + np.concatenate([[0], np.cumsum((push[1:] + push[:-1]) / 2 * np.diff(t))])
        place = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t))])
        assert ramp.distance == pytest.approx(place[-1], abs=1e-7)
        np.testing.assert_allclose(ramp.reach(speed[10:-10:50]), place[10:-10:50], atol=1e-6)


def test_any_caps_are_kept(panda):
    """Whatever caps of cells are, not only such as robots have; `time_path` is not asked."""
    rng = np.random.default_rng(1)
    limits = RateLimits.of(panda, 2.0, 5.0, 60.0)
    forward = np.full(7, 7**-0.5)
    curve = BlendedCurve([Piece(np.zeros(7), forward, np.zeros(7), 2.0, 0.0)], [])
    cells = curve.cells(0.02)
    for scale in (0.05, 0.5, 5.0):
        caps = np.minimum(5.2, scale * 10 ** rng.uniform(-1, 1, len(cells)))
        caps[rng.integers(0, len(cells), 3)] = 1e-3
        law = jerk_limited_law(cells, limits, caps)
        t = instants(law)
        _, s, speed, push = law.at(t)
        at = np.clip(np.searchsorted(cells.edges, s - 1e-12) - 1, 0, len(caps) - 1)
        after = np.clip(np.searchsorted(cells.edges, s + 1e-12) - 1, 0, len(caps) - 1)
        assert (speed <= np.maximum(caps[at], caps[after]) * KEPT).all()
        assert abs(push).max() <= 5.0 * 7**0.5 * KEPT
        assert abs(law.jerks(t)).max() <= 60.0 * 7**0.5 * KEPT
        assert (np.diff(s) >= 0).all()
        assert s[-1] == pytest.approx(2.0)
        assert (law.squares[[0, -1]] == 0).all()
        rising = np.sqrt(law.squares)
        inside = law.at((law.times[1:] + law.times[:-1]) / 2)[2]
        assert (inside <= np.maximum(rising[1:], rising[:-1]) + 1e-9).all()
        assert (inside >= np.minimum(rising[1:], rising[:-1]) - 1e-9).all()


def test_beside_people_it_still_stops_before_anyone_is_reached(
    panda, shelf, shelf_path, shelf_motion, limits
):
    people = People()
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion, people=people)
    assert_within_limits(trajectory)
    assert adversary(trajectory, Limbs(panda, shelf.scene["operator"]), people, 150) > 0
    hard = RateLimits(limits.joint_names, limits.velocity, limits.acceleration)
    stopping = time_path(shelf_path, panda, hard, motion=shelf_motion, people=people, tolerance=0.0)
    assert stopping.duration < trajectory.duration < 1.15 * stopping.duration
    for begin in np.linspace(0, trajectory.duration, 20):
        stop = trajectory.stop_from(begin)
        np.testing.assert_allclose(stop.at(0).q, trajectory.at(begin).q, atol=1e-9)
        assert stop.limits.jerk is None


def test_speeds_of_links_and_danger_are_kept(panda, shelf, shelf_path, shelf_motion, limits):
    field = DangerField(panda, shelf.scene.danger_points()[0], k2=0.25, gamma=1.0)
    free = time_path(shelf_path, panda, limits, motion=shelf_motion)
    most = 0.5 * (free.danger(field.moving).peak + field.values(free.at(free.law.times).q).max())
    trajectory = time_path(
        shelf_path, panda, limits, motion=shelf_motion, tool_speed=0.5, danger=field.moving, max_danger=most
    )
    assert_within_limits(trajectory)
    danger = trajectory.danger(field.moving)
    assert danger.peak <= danger.proven_peak
    assert danger.peak <= most * KEPT
    t = np.linspace(0, trajectory.duration, 400)
    tips = np.array([panda.tip_pose(q).translation for q in trajectory.at(t).q])
    assert (np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(t)).max() <= 0.5 * KEPT


def test_exports_name_the_limit(panda, shelf_path, limits):
    told = json.loads(time_path(shelf_path, panda, limits).to_json(rate=20))
    assert set(told["limits"]["jerk"].values()) == {1000.0}
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
    with pytest.raises(InputError, match="jerk limit must be a positive number"):
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
