"""Trajectories keep their limits at every instant, and are as fast as these allow."""

import json
from itertools import pairwise

import numpy as np
import pytest

from safe_ompl import DangerField, DangerLimit, InputError, RateLimits, time_path
from safe_ompl.collision import TipBounds
from safe_ompl.trajectories import blended

KEPT = 1 + 1e-9
POSTURE = [0.0, 0, 0, -1.5, 0, 1.5, 0]


def instants(trajectory, step=1e-3):
    """Densely, and just before, at and after every cell's edge."""
    edges = trajectory.law.times
    near = [edges * (1 + side) for side in (-1e-13, 0.0, 1e-13)]
    return np.concatenate([np.arange(0, trajectory.duration, step), *near])


def assert_within_limits(trajectory):
    state = trajectory.at(instants(trajectory))
    assert (np.abs(state.qd) <= trajectory.limits.velocity * KEPT).all()
    assert (np.abs(state.qdd) <= trajectory.limits.acceleration * KEPT).all()


@pytest.fixture
def free(monkeypatch, shelf_motion):
    """Return a motion whose blends all count as proven."""
    monkeypatch.setattr("safe_ompl.trajectories.curve.Piece.is_free", lambda piece, motion: True)
    return shelf_motion


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "twin_arm"])
@pytest.mark.parametrize("blend", [True, False])
def test_limits_hold_at_every_instant(robot_named, free, name, blend):
    robot = robot_named(name)
    rng = np.random.default_rng(5)
    for _ in range(6):
        low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
        path = rng.uniform(low, high, (rng.integers(2, 7), robot.n))
        limits = RateLimits.of(robot, rng.uniform(0.5, 3, robot.n), rng.uniform(1, 20, robot.n))
        trajectory = time_path(path, robot, limits, motion=free if blend else None, tolerance=rng.uniform(0, 0.4))
        assert_within_limits(trajectory)
        ends = trajectory.at([0.0, trajectory.duration])
        np.testing.assert_allclose(robot.difference(ends.q, path[[0, -1]]), 0, atol=1e-9)
        assert abs(ends.qd).max() < 1e-6


def test_velocity_and_acceleration_are_the_derivatives_of_the_position(panda, shelf_path, shelf_motion, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits, motion=shelf_motion)
    t = np.linspace(0.01, trajectory.duration - 0.01, 400)
    step = 1e-6
    before, now, after = (trajectory.at(t + side) for side in (-step, 0.0, step))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, atol=1e-4)
    slope = (after.qd - before.qd) / (2 * step)
    jumps = np.abs(slope - now.qdd).max(axis=1) > 1e-3  # where a cell ends between
    assert jumps.mean() < 0.01


def test_a_straight_motion_takes_what_the_bang_coast_law_says(panda):
    limits = RateLimits.of(panda, 1.0, 2.0)
    path = np.tile(POSTURE, (2, 1))
    path[1, 0] = 1.0
    trajectory = time_path(path, panda, limits)
    assert trajectory.duration == pytest.approx(1.0 / 1.0 + 1.0 / 2.0, rel=1e-3)
    assert trajectory.duration >= 1.5 - 1e-9
    halfway = trajectory.at(trajectory.duration / 2)
    assert halfway.q[0] == pytest.approx(0.5)
    assert halfway.qd[0] == pytest.approx(1.0)


def test_blends_stay_within_the_tolerance_and_are_proven_free(panda, shelf_path, shelf_motion):
    path = np.array(shelf_path)
    for tolerance in (0.02, 0.2):
        curve = blended(path, panda, tolerance, shelf_motion)
        assert sum(not piece.straight for piece in curve.pieces) == 2
        on = curve.at(np.linspace(0, curve.length, 2000))
        away = np.min([distance(on.q, *edge) for edge in pairwise(path)], axis=0)
        assert tolerance / 2 < away.max() <= tolerance * (1 + 1e-9)
        assert (np.linalg.norm(on.slope, axis=1) <= 1 + 1e-12).all()
        for q in on.q[::20]:
            assert not shelf_motion.checker.in_collision(q)


def distance(points, a, b):
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)


def test_blends_are_proven_with_what_certificates_need_to_spare(panda, shelf_path, shelf_motion):
    """Distances are 10 µm off at most, and a certificate is checked with as much again, as edges are."""
    curve = blended(np.array(shelf_path), panda, 0.2, shelf_motion)
    blend = next(piece for piece in curve.pieces if not piece.straight)
    at = np.linspace(0, blend.length, 2001)
    least = min(shelf_motion.checker.clearance(q).distance for q in blend.places(at).q)
    assert blend.is_free(shelf_motion.with_margin(least - 4e-5))
    assert not blend.is_free(shelf_motion.with_margin(least - 1.5e-5))
    assert len(blended(np.array(shelf_path), panda, 0.2, shelf_motion.with_margin(3.0)).stops) == 2


def test_blends_keep_the_limit_of_danger(panda, shelf, shelf_path, shelf_motion):
    field = DangerField(panda, shelf.scene.danger_points()[0])
    curve = blended(np.array(shelf_path), panda, 0.2, shelf_motion)
    blend = next(piece for piece in curve.pieces if not piece.straight)
    peak = field.values(blend.places(np.linspace(0, blend.length, 200)).q).max()
    assert blend.is_free(shelf_motion.with_limits([DangerLimit(field, 1.01 * peak)]))
    assert not blend.is_free(shelf_motion.with_limits([DangerLimit(field, 0.99 * peak)]))


def test_blends_keep_limits_of_the_tool(panda, shelf_path, shelf_motion):
    blend = next(p for p in blended(np.array(shelf_path), panda, 0.2, shelf_motion).pieces if not p.straight)
    tips = [panda.tip_pose(q).translation for q in blend.places(np.linspace(0, blend.length, 400)).q]
    low, high = np.min(tips, axis=0), np.max(tips, axis=0)
    for spare, held in ((1e-3, True), (-1e-3, False)):
        limit = TipBounds(panda, low - spare, high + 1.0)
        assert blend.is_free(shelf_motion.with_limits([limit])) is held


def test_without_proof_it_stops_in_corners_and_a_way_point_on_the_way_is_none(panda, panda_limits):
    path = np.tile(POSTURE, (4, 1))
    path[1:, 0] = [0.3, 0.6, 0.6]
    path[3, 1] = 0.5
    trajectory = time_path(path, panda, panda_limits)
    assert len(trajectory.curve.stops) == 1
    corner = np.searchsorted(trajectory.law.edges, 0.6 - 1e-9)
    assert trajectory.law.squares[corner] == 0
    at = np.searchsorted(trajectory.law.edges, 0.3 - 1e-9)
    assert trajectory.law.squares[at] > 0


def test_exports_have_the_shape_of_a_joint_trajectory(panda, shelf_path, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits)
    told = json.loads(trajectory.to_json(rate=50))
    assert told["joint_names"] == list(panda.joint_names)
    times = [point["time_from_start"] for point in told["points"]]
    assert times[0] == 0
    assert times[-1] == told["duration"]
    assert np.diff(times).max() < 0.02 * 1.001
    assert set(told["points"][3]) == {"time_from_start", "positions", "velocities"}
    np.testing.assert_allclose(told["points"][0]["positions"], shelf_path[0], atol=1e-12)
    assert told["limits"]["velocity"][panda.joint_names[0]] == panda_limits.velocity[0]
    assert told["caps"][0]["name"] == "joint velocity"
    rows = trajectory.to_csv(rate=50).splitlines()
    assert len(rows) == len(times) + 1
    assert rows[0].split(",")[:2] == ["time", f"{panda.joint_names[0]}_position"]
    assert len(rows[1].split(",")) == 15
    with pytest.raises(InputError, match="rate must be a positive"):
        trajectory.points(0)
    with pytest.raises(InputError, match="time must be"):
        trajectory.at(np.nan)


def test_outside_its_time_it_rests_at_its_ends(panda, shelf_path, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits)
    for t, end in ((-1.0, shelf_path[0]), (1e3, shelf_path[-1])):
        state = trajectory.at(t)
        np.testing.assert_allclose(state.q, end, atol=1e-9)
        assert not np.any(state.qd)
        assert not np.any(state.qdd)


def test_it_says_which_cap_binds_where(panda):
    path = np.tile(POSTURE, (2, 1))
    path[1, 0] = 1.0
    names = time_path(path, panda, RateLimits.of(panda, 1.0, 4.0)).binding()
    assert names[0] is None
    assert names[len(names) // 2] == "joint velocity"


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([[0.0] * 7], "two way points at least, got 1"),
        ([[0.0] * 7, [np.nan] * 7], "path must be finite"),
        ([[0, 0, 0, -1, 0, 1, 0.0]] * 2, "the path does not move"),
        ([[0, 0, 0, -1, 0, 1, 0], [9, 0, 0, -1, 0, 1, 0]], "way point 1: joint 'panda_joint1' = 9 is outside"),
        (np.zeros((0, 7)), "got 0"),
    ],
)
def test_paths_that_are_none(panda, panda_limits, path, message):
    with pytest.raises(InputError, match=message):
        time_path(path, panda, panda_limits)


def test_limits_of_another_robot(ur5, panda_limits):
    with pytest.raises(InputError, match="the limits are for the joints"):
        time_path(np.zeros((2, 6)), ur5, panda_limits)


def test_corners_that_hardly_turn(panda, shelf_path, shelf_motion, panda_limits):
    first, second = np.array(shelf_path[0]), np.array(shelf_path[1])
    middle = (first + second) / 2
    for turn in (1e-8, 1e-6, 1e-4):
        aside = middle + turn * np.array([0, 1, 0, 0, 0, 0, 0])
        with np.errstate(all="raise"):
            trajectory = time_path([first, aside, second], panda, panda_limits, motion=shelf_motion)
        straight = time_path([first, second], panda, panda_limits, motion=shelf_motion)
        assert trajectory.duration == pytest.approx(straight.duration, rel=5e-3)
