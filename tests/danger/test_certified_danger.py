"""Certified danger: nothing on a motion is more dangerous than proven, and the proof is tight and cheap."""

from functools import cache

import numpy as np
import pytest
from ball import densely
from edges import random_path
from hypothesis import given, settings, strategies as st

from safe_ompl import CertifiedDanger, DangerField, DangerLimit, InputError, Verdict
from safe_ompl.danger.certified import KeypointRates, chords
from safe_ompl.danger.field import AGGREGATES
from safe_ompl.danger.link_field import segment_distances, segment_fields

ROBOTS = ["panda", "kinova", "twin_arm", "slider", "gripper", "parallel", "loaded", "mobile", "cell"]
ROUNDING = 1e-9

seeds = st.integers(0, 2**32 - 1)
robots = st.sampled_from(ROBOTS)


@cache
def points_around(robot, number=12):
    """Danger points at the reach of the robot, some of them near its links."""
    rng = np.random.default_rng(3)
    keypoints = robot.keypoints_batch(rng.uniform(robot.lower, robot.upper, (number, robot.n)))
    chosen = keypoints[np.arange(number), robot.segments[rng.integers(0, len(robot.segments), number), 1]]
    return chosen + rng.normal(scale=0.15, size=(number, 3))


@cache
def certified(robot, aggregate="max", weighting="unit"):
    points = points_around(robot)
    weights = np.linspace(0.5, 2.0, len(points))
    field = DangerField(robot, points, weights, aggregate=aggregate, weighting=weighting, sharpness=2.0)
    return CertifiedDanger(field)


# ------------------------------------------------------------------------------------------- moving key points


@settings(max_examples=10)
@given(robots, seeds)
def test_velocity_and_acceleration_of_key_points(robot_named, name, seed):
    robot, h = robot_named(name), 1e-4
    rng = np.random.default_rng(seed)
    Q, delta = rng.uniform(robot.lower, robot.upper, (3, robot.n)), rng.normal(size=(3, robot.n))
    position, velocity, acceleration = robot.keypoint_motions(Q, delta)
    before, here, after = (robot.keypoints_batch(Q + step * delta) for step in (-h, 0, h))
    np.testing.assert_allclose(position, here, atol=1e-12)
    np.testing.assert_allclose(velocity, (after - before) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(acceleration, (after - 2 * here + before) / h**2, atol=1e-5)


@settings(max_examples=30)
@given(robots, seeds)
def test_rates_are_bounds(robot_named, name, seed):
    robot = robot_named(name)
    path = random_path(robot, seed, 1, 1.0)
    Q, delta = densely(robot, path, 50), robot.difference(path[:1], path[1:])
    rates = KeypointRates.of(robot, delta)
    _, velocity, acceleration = robot.keypoint_motions(Q, np.repeat(delta, len(Q), 0))
    jerk = np.linalg.norm(np.diff(acceleration, axis=0), axis=2) * (len(Q) - 1)
    assert (np.linalg.norm(velocity, axis=2) <= rates.speed + ROUNDING).all()
    assert (np.linalg.norm(acceleration, axis=2) <= rates.acceleration + ROUNDING).all()
    assert (jerk <= rates.jerk + 1e-7).all()
    sizes = np.linalg.norm([velocity, acceleration], axis=3)  # (2, Q, K)
    for number in (10, 50):  # between two configurations whose rates are known, part of the edge or all of it
        first, last, part = sizes[:, 0], sizes[:, number - 1], np.array([(number - 1) / 49])
        near = rates.between(np.zeros(1, dtype=int), part, first[None], last[None])
        assert all((size[:number] <= bound + ROUNDING).all() for size, bound in zip(sizes, near, strict=True))


# -------------------------------------------------------------------------------------------------------- chords


@settings(max_examples=60)
@given(seeds, st.floats(0.0, 0.5))
def test_chords_lie_above_the_field_of_a_moving_link(seed, duration):
    rng = np.random.default_rng(seed)
    begin, velocity, acceleration = rng.normal(size=(3, 2, 3)) * [[[0.5]], [[1.0]], [[2.0]]]
    t = np.linspace(0, duration, 50)[:, None, None]
    keypoints = begin + t * velocity + t**2 / 2 * acceleration
    speed = np.linalg.norm(velocity + t * acceleration, axis=2).max()
    links, points = np.array([[0, 1]]), rng.normal(size=(5, 3))
    fields = segment_fields(keypoints, links, points)
    distances = segment_distances(keypoints, links, points)
    first, last = (np.stack([fields[side], distances[side]]) for side in (0, -1))
    push = np.linalg.norm(acceleration, axis=1).max()
    low, high = chords(first, last, duration, np.array([speed]), np.array([push]), np.ones(1))
    along = np.linspace(0, 1, 50)[1:-1, None, None]
    assert (fields[1:-1] <= (low * (1 - along) + high * along) * (1 + ROUNDING)).all()
    assert (fields[0] <= low).all()
    assert (fields[-1] <= high).all()


# --------------------------------------------------------------------------------------------- edges and paths


@settings(max_examples=50)
@given(
    robots,
    st.sampled_from(AGGREGATES),
    st.sampled_from(["unit", "length"]),
    seeds,
    st.integers(1, 3),
    st.floats(0.0, 2.0),
)
def test_no_configuration_is_more_dangerous_than_proven(robot_named, name, aggregate, weighting, seed, edges, length):
    robot = robot_named(name)
    danger = certified(robot, aggregate, weighting)
    path = random_path(robot, seed, edges, length)
    bounds = danger.of_path(path)
    dense = danger.field.values(densely(robot, path)).max()
    assert dense <= bounds.upper * (1 + ROUNDING)
    assert bounds.lower <= bounds.upper
    where = path[bounds.edge] + bounds.at * robot.difference(path[bounds.edge], path[bounds.edge + 1])
    assert bounds.lower == pytest.approx(danger.field.value(where), rel=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_bounds_agree_within_the_tolerance(robot_named, name):
    danger = certified(robot_named(name))
    for seed in range(5):
        bounds = danger.of_path(random_path(robot_named(name), seed, 3, 1.0))
        assert bounds.upper <= 1.05 * bounds.lower * (1 + 1e-6)


def test_a_link_that_passes_through_a_danger_point_is_not_bounded(panda):
    start, end = panda.lower + 0.5, panda.lower + 0.9
    inside = panda.keypoints(start + 0.3 * (end - start))[-2:].mean(axis=0)
    danger = CertifiedDanger(DangerField(panda, [inside]))
    assert danger.of_path([start, end]).upper == np.inf
    verdict = DangerLimit(danger.field, 1e4).check(start, end)
    assert verdict.verdict is not Verdict.FREE
    assert verdict.at == pytest.approx(0.3, abs=0.01)


# -------------------------------------------------------------------------------------------------------- limits


@settings(max_examples=30)
@given(robots, seeds, st.floats(0.7, 1.3))
def test_verdicts_on_limits(robot_named, name, seed, share):
    robot = robot_named(name)
    danger = certified(robot)
    start, end = random_path(robot, seed, 1, 1.0)
    values = danger.field.values(densely(robot, np.array([start, end])))
    limit = share * values.max()
    checked = DangerLimit(danger.field, limit)
    found = checked.check(start, end)
    assert [checked.allows(q) for q in (start, end)] == [danger.field.value(q) <= limit for q in (start, end)]
    if found.verdict is Verdict.FREE:
        assert values.max() <= limit
        assert (found.at, found.pair) == (None, None)
    elif found.verdict is Verdict.BLOCKED:
        at = start + found.at * robot.difference(start, end)
        assert danger.field.value(at) > limit * (1 - 1e-9)
        assert found.pair == ("danger", "its limit")
    else:
        assert share == pytest.approx(1.0, abs=1e-2)


# -------------------------------------------------------------------------------------------------------- errors


def test_paths_beyond_the_limits_of_sliding_joints_are_refused(robot_named):
    danger = certified(robot_named("slider"))
    inside, outside = [0.2, 0.0, 0.3, 0.0], [0.2, 0.0, 0.36, 0.0]
    assert np.isfinite(danger.of_path([inside, inside]).upper)
    with pytest.raises(InputError, match=r"joint 'right_slide' = 0.36 is outside its limits"):
        danger.of_path([inside, outside])


@pytest.mark.parametrize("points", [[], None])
def test_the_peak_of_one_configuration_and_without_danger_points(panda, points):
    field = certified(panda).field if points is None else DangerField(panda, points)
    path = random_path(panda, 1, 3, 1.0)
    bounds = CertifiedDanger(field).of_path(path[:1])
    assert bounds.lower == field.value(path[0])
    assert bounds.upper == pytest.approx(bounds.lower, rel=1e-7)
    if points is not None:
        assert CertifiedDanger(field).of_path(path).upper == 0.0
        assert DangerLimit(field, 0.1).check(path[0], path[1]).verdict is Verdict.FREE


@settings(max_examples=25)
@given(robots, st.sampled_from(["unit", "length"]), seeds, st.floats(0.0, 0.2))
def test_what_holds_within_a_box_of_configurations(robot_named, name, weighting, seed, width):
    robot, rng = robot_named(name), np.random.default_rng(seed)
    field = certified(robot, weighting=weighting).field
    steps = width * rng.uniform(size=robot.n)
    q = rng.uniform(robot.lower + steps, np.maximum(robot.upper - steps, robot.lower + steps))
    worst = field.values(np.clip(q + steps * rng.choice([-1, 0.5, 1], (50, robot.n)), robot.lower, robot.upper)).max()
    assert not DangerLimit(field, worst * (1 - 1e-6)).holds_within(q, steps)
    constant = field.weighting == "unit" or not robot.joint_prismatic.any()
    assert DangerLimit(field, field.value(q) * 1.001).holds_within(q, 0 * steps) == constant
