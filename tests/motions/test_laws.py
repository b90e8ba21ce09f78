"""Trajectories keep their limits at every instant, with and without jerk, and are as fast as these allow."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import linprog

from safe_ompl import DangerField, DangerLimit, InputError, Motion, RateLimits, TipBounds, time_path
from safe_ompl.collision import Separation
from safe_ompl.motions import SmoothLimits, blended, first_unproven, joint_velocity_limit, rate_violations
from safe_ompl.motions.laws import fastest

HOME = np.array([0.0, 0, 0, -1.5, 0, 1.5, 0])


def along(*steps):
    """Return way points that move the first joint by these steps."""
    path = np.tile(HOME, (len(steps) + 1, 1))
    path[1:, 0] = np.cumsum(steps)
    return path


@pytest.fixture(scope="module")
def franka(panda):
    """Return what Franka publishes for its first robot."""
    accelerations = np.array([15, 7.5, 10, 12.5, 15, 20, 20])
    return RateLimits.of(panda, [2.175] * 4 + [2.61] * 3, accelerations, 500 * accelerations)


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
@pytest.mark.parametrize("blend", [True, False])
@pytest.mark.parametrize("jerk", [True, False])
def test_limits_hold_at_every_instant(robot_named, free, name, blend, jerk, assert_within_limits):
    robot, rng = robot_named(name), np.random.default_rng(3)
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    for _ in range(3):
        path = robot.unrolled(rng.uniform(low, high, (rng.integers(2, 6), robot.n)))
        kinds = (rng.uniform(*span, robot.n) for span in ((0.5, 3), (1, 20), (5, 5000))[: 2 + jerk])
        limits, motion = RateLimits.of(robot, *kinds), free if blend else None
        trajectory = time_path(path, robot, limits, motion=motion, tolerance=rng.uniform(0.01, 0.4))
        assert_within_limits(trajectory)
        assert len(trajectory.curve.corners) == (0 if blend else len(path) - 2)
        ends = trajectory.at([0.0, trajectory.duration])
        np.testing.assert_allclose(robot.difference(ends.q, path[[0, -1]]), 0, atol=1e-9)
        assert abs(ends.qd).max() < 1e-6


@pytest.mark.parametrize("jerk", [True, False])
def test_each_derivative_is_that_of_the_one_before(panda, shelf_path, shelf_motion, franka, jerk):
    limits = franka if jerk else replace(franka, jerk=None)
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion)
    t, step = np.linspace(0.01, trajectory.duration - 0.01, 300), 1e-6
    before, now, after = (trajectory.at(t + side) for side in (-step, 0.0, step))
    np.testing.assert_allclose((after.q - before.q) / (2 * step), now.qd, atol=1e-4)
    apart = abs((after.qd - before.qd) / (2 * step) - now.qdd)
    assert (apart.max(axis=1) > 2e-2).mean() < (1e-9 if jerk else 0.01)  # where a cell ends between
    if jerk:
        apart = abs((after.qdd - before.qdd) / (2 * step) - trajectory.jerks_at(t))
        assert (apart.max(axis=1) > 1.0).mean() < 0.01
    for time, end in ((-1.0, shelf_path[0]), (1e3, shelf_path[-1])):
        rest = trajectory.at(time)
        np.testing.assert_allclose(rest.q, end, atol=1e-9)
        assert not np.any([rest.qd, rest.qdd])


@pytest.mark.parametrize(
    ("step", "jerk", "least", "most"),
    [
        (1.0, None, 1.5, 1.0015),  # bang, coast, bang
        (1.0, 10.0, 1.0 + 0.5 + 0.2, 1.13),  # seven phases
        (0.01, 10.0, 4 * (0.01 / 2 / 10.0) ** (1 / 3), 1.25),
    ],
)
def test_a_straight_motion_takes_little_more_than_the_fastest_law(panda, step, jerk, least, most):
    limits = RateLimits.of(panda, 1.0, 2.0, jerk)
    made = time_path(along(step), panda, limits)
    assert least - 1e-9 <= made.duration < most * least
    halfway = made.at(made.duration / 2)
    assert halfway.q[0] == pytest.approx(step / 2, abs=1e-6)
    names = made.binding()
    assert names[0] is None
    assert step < 1 or names[len(names) // 2] == "joint velocity"


def test_a_limit_of_the_jerk_costs_little_and_nothing_where_it_does_not_bind(panda, free, franka, assert_within_limits):
    rng, ratios = np.random.default_rng(0), []
    hard = replace(franka, jerk=None)
    low, high = np.maximum(panda.lower, -2.5), np.minimum(panda.upper, 2.5)
    for _ in range(4):
        path = rng.uniform(low, high, (5, 7))
        smooth, sharp = (time_path(path, panda, of, motion=free) for of in (franka, hard))
        between = smooth.at(np.linspace(0.1, smooth.duration - 0.1, 2000))
        assert np.linalg.norm(between.qd, axis=1).min() > 0.1  # it does not stop on its way
        ratios.append(smooth.duration / sharp.duration)
    assert 1.0 < np.median(ratios) < 1.03
    for jerk in (1e6, 1e8):
        smooth = time_path(path, panda, replace(hard, jerk=np.full(7, jerk)))
        assert_within_limits(smooth)
        assert smooth.duration == pytest.approx(time_path(path, panda, hard).duration, rel=1e-3)
    back = time_path(along(1.0, -1.0), panda, franka, motion=free)
    assert not back.curve.corners
    assert_within_limits(back)
    assert back.at(np.linspace(0, back.duration, 3000)).q[:, 0].max() == pytest.approx(0.95, abs=0.01)


def test_any_caps_are_kept(panda):
    """Whatever the velocity limits of the cells are, not only such as robots have; `time_path` is not asked."""
    rng = np.random.default_rng(1)
    limits = RateLimits.of(panda, 2.0, 5.0, 60.0)
    forward, still = np.full(7, 7**-0.5), np.zeros(7)
    curve = Motion([0.0, 2.0], [[still, 2.0 * forward]], timed=False)
    cells = curve.cells(0.02)
    for scale, window in ((0.05, 0.02), (0.5, 0.1), (5.0, 0.4)):
        velocity_limits = np.minimum(5.2, scale * 10 ** rng.uniform(-1, 1, len(cells)))
        velocity_limits[rng.integers(0, len(cells), 3)] = 1e-3
        law = SmoothLimits.of(cells, limits, joint_velocity_limit(cells, limits), window).law(limits, velocity_limits)
        t = np.unique(np.clip(np.append(np.arange(0.0, law.duration, 1e-3), law.knots), 0.0, law.duration))
        _, s, speed, push = law.at(t)
        at, after = (
            np.clip(np.searchsorted(cells.edges, s + x) - 1, 0, len(velocity_limits) - 1) for x in (-1e-12, 1e-12)
        )
        assert (speed <= np.maximum(velocity_limits[at], velocity_limits[after]) * (1 + 1e-9)).all()
        assert abs(push).max() <= 5.0 * 7**0.5 * (1 + 1e-9)
        assert abs(law.jerks(t)).max() <= 60.0 * 7**0.5 * (1 + 1e-9)
        assert (np.diff(s) >= -1e-12).all()
        assert s[-1] == pytest.approx(2.0)
        assert np.sqrt(law.squared_speeds[[0, -1]]) == pytest.approx(0, abs=1e-9)
        low, high = law.rates_between(np.sort(np.concatenate([cells.edges, cells.centres])))
        part = np.minimum((s / 0.01).astype(int), len(low) - 1)
        assert (low[part] - 1e-6 <= speed).all()
        assert (speed <= high[part] + 1e-6).all()


# ------------------------------------------------------------------------------------------------------------- blends


@pytest.mark.parametrize("tolerance", [0.02, 0.2])
@pytest.mark.parametrize("jerk", [True, False])
def test_blends_stay_within_the_tolerance(panda, shelf_path, shelf_motion, franka, jerk, tolerance):
    curve = blended(shelf_path, panda, tolerance, shelf_motion, franka if jerk else None)
    assert curve.coefficients[:, 2:].any(axis=(1, 2)).sum() >= 2
    for order in range(2 + jerk):
        np.testing.assert_allclose(curve.jumps(order), 0.0, atol=1e-9)
    s = np.linspace(0, curve.length, 4000)
    on = curve.places(s)
    away = np.min([distance(on.q, *edge) for edge in pairwise(shelf_path)], axis=0)
    assert tolerance / 3 < away.max() <= tolerance * (1 + 1e-9)
    assert (np.linalg.norm(on.dq_ds, axis=1) <= 1 + 1e-12).all()
    assert not any(map(shelf_motion.checker.in_collision, on.q[::40]))


def distance(points, a, b):
    t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - t[:, None] * (b - a), axis=1)


def test_blends_keep_what_edges_keep(panda, shelf, shelf_path, shelf_motion):
    """Distances are 10 µm off at most, and a certificate is checked with as much again, as edges are."""
    curve = blended(shelf_path, panda, 0.2, shelf_motion)
    k = int(np.flatnonzero(curve.coefficients[:, 2:].any(axis=(1, 2)))[0])
    blend = curve.part(*curve.times[k : k + 2])
    places = blend.places(np.linspace(0, blend.length, 601)).q
    least = min(shelf_motion.checker.clearance(q).distance for q in places)
    field = DangerField(panda, shelf.scene.danger_points()[0])
    tips = np.array([panda.tip_pose(q).translation for q in places[::5]])
    peak, low, high = field.values(places).max(), tips.min(axis=0), tips.max(axis=0) + 1.0
    for proof, held in (
        (replace(shelf_motion, separation=Separation(margin=least - 4e-5)), True),
        (replace(shelf_motion, separation=Separation(margin=least - 1.5e-5)), False),
        (replace(shelf_motion, limits=[DangerLimit(field, 1.01 * peak)]), True),
        (replace(shelf_motion, limits=[DangerLimit(field, 0.99 * peak)]), False),
        (replace(shelf_motion, limits=[TipBounds(panda, low - 1e-3, high)]), True),
        (replace(shelf_motion, limits=[TipBounds(panda, low + 1e-3, high)]), False),
    ):
        assert (first_unproven(blend, proof) is None) is held
    far = replace(shelf_motion, separation=Separation(margin=3.0))
    assert len(blended(shelf_path, panda, 0.2, far).corners) == 2


@pytest.mark.parametrize("spare", [0.0, 1e-15, 1e-12, 1e-9, 1e-7, 1e-3])
def test_no_line_between_blends_is_so_short_that_rounding_is_a_steep_jump(panda, shelf_path, shelf_motion, spare):
    unit = np.eye(panda.n)
    steps = 0.02 * unit[0], (0.02 + spare) * unit[1], 0.02 * unit[0]
    path = shelf_path[0] + np.vstack([np.zeros(panda.n), np.cumsum(steps, axis=0)])
    curve = blended(path, panda, 0.2, shelf_motion)
    assert not curve.corners
    assert np.diff(curve.times).min() > 9e-6
    assert curve.length == pytest.approx(0.06 + spare, abs=0.02)


def test_without_proof_it_stops_in_corners_and_a_way_point_on_the_way_is_none(panda, panda_limits, caplog):
    path = along(0.3, 0.3, 0.0)
    path[3, 1] = 0.5
    with caplog.at_level("INFO"):
        trajectory = time_path(path, panda, panda_limits)
    assert "stops at 1 of 2 corners" in caplog.text
    assert len(trajectory.curve.corners) == 1
    way_point, corner = np.searchsorted(trajectory.law.edges, [0.3 - 1e-9, 0.6 - 1e-9])
    assert trajectory.law.squared_speeds[way_point] > trajectory.law.squared_speeds[corner] == 0


def test_corners_that_hardly_turn(panda, shelf_path, shelf_motion, panda_limits):
    first, second = shelf_path[:2]
    for turn in (1e-8, 1e-6, 1e-4):
        aside = (first + second) / 2 + turn * np.eye(7)[1]
        with np.errstate(all="raise"):
            trajectory = time_path([first, aside, second], panda, panda_limits, motion=shelf_motion)
        straight = time_path([first, second], panda, panda_limits, motion=shelf_motion)
        assert trajectory.duration == pytest.approx(straight.duration, rel=5e-3)


# ------------------------------------------------------------------------------------------------- what is exported


@pytest.mark.parametrize("jerk", [None, 100.0, 5000.0])
@pytest.mark.parametrize("blends", [True, False])
def test_limits_hold_between_points_at_any_rate(panda, shelf_path, shelf_motion, jerk, blends):
    limits = RateLimits.of(panda, acceleration=8.0, jerk=jerk)
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion if blends else None)
    for rate in (50.0, 123.4):
        times, points = trajectory.points(rate)
        assert list(points) == ["positions", "velocities", "accelerations"][: 2 if jerk is None else 3]
        motion = Motion.hermite(times, *points.values(), names=panda.joint_names)
        assert not rate_violations(motion, panda, limits)
        assert np.diff(times).max() <= 1.003 / rate
        assert np.diff(times)[-1] > 0.2 / rate
        assert trajectory.duration - 1e-9 <= times[-1] <= 1.003 * trajectory.duration
        assert np.abs(times * 1e9 - np.round(times * 1e9)).max() < 1e-3  # as messages have them
        fine = np.linspace(0.0, times[-1], 3000)
        apart = motion.at(fine) - trajectory.at(fine * (trajectory.duration / times[-1])).q
        assert np.abs(apart).max() < 0.3 / rate**2
        assert not points["velocities"][[0, -1]].any()
        np.testing.assert_allclose(points["positions"][[0, -1]], shelf_path[[0, -1]], atol=1e-12)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ([[0.0] * 7], "at least two way points, got 1"),
        ([[0.0] * 7, [np.nan] * 7], "path: must be finite"),
        ([[0, 0, 0, -1, 0, 1, 0.0]] * 2, "all way points are equal"),
        ([[0, 0, 0, -1, 0, 1, 0], [9, 0, 0, -1, 0, 1, 0]], "way point 1: joint 'panda_joint1' = 9 is outside"),
        (np.zeros((0, 7)), "got 0"),
    ],
)
def test_paths_that_are_none(panda, panda_limits, path, message):
    with pytest.raises(InputError, match=message):
        time_path(path, panda, panda_limits)


def test_bad_requests(panda, ur5, shelf_path, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits)
    for ask, message in (
        (lambda: time_path(np.zeros((2, 6)), ur5, panda_limits), "the limits are for the joints"),
        (lambda: trajectory.points(0), "rate: must be a positive"),
        (lambda: trajectory.at(np.nan), "time must be"),
        (lambda: trajectory.jerks_at(0.1), "the jerk of the trajectory is not limited"),
    ):
        with pytest.raises(InputError, match=message):
            ask()


def test_the_first_rate_is_the_optimum_of_a_linear_programme(rng):
    """In one cell, with ṡ² at both of its ends as unknowns; half of the boxes have an edge at 0."""
    for _ in range(40):
        slopes, bends = np.sort(rng.normal(size=(2, 2, 1, 4)) * (rng.uniform(size=(1, 1, 1, 4)) < 0.8), axis=1)
        h, limits, most = rng.uniform(0.01, 0.3), rng.uniform(0.5, 3, 4), np.array([9.0, rng.uniform(0, 3)])
        p, c = (part.ravel() for part in np.broadcast_arrays(slopes[:, None, 0] / (2 * h), bends[None, :, 0]))
        rows = np.concatenate([np.stack([c - p, p], axis=1), np.stack([-p, c + p], axis=1)])
        bounds = np.tile(limits, len(rows) // len(limits))
        best = linprog(
            [-1, 0], np.vstack([rows, -rows]), np.append(bounds, bounds), bounds=[(0, most[0]), (0, most[1])]
        )
        found = fastest(np.array([h]), (*slopes, *bends), limits, most)
        np.testing.assert_allclose(found[0], best.x[0], rtol=1e-8)
