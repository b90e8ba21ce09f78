"""The danger of a robot in motion: bounds over cells, the velocity limit, and the profile of a trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import DangerField, InputError, KinetostaticField, RateLimits, StandstillError, time_path
from safe_ompl.motions.danger import cell_danger

POINTS = [[0.6, 0.4, 0.5], [-0.5, 0.3, 0.2], [0.1, -0.7, 0.9], [0.7, 0.0, 0.3]]
ROBOTS = ("panda", "twin_arm", "slider", "kinova")


def random_path(robot, seed, number=3):
    low, high = np.maximum(robot.lower, -1.5), np.minimum(robot.upper, 1.5)
    return np.random.default_rng(seed).uniform(low, high, (number, robot.n))


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("weighting", ["unit", "length"])
@pytest.mark.parametrize("gamma", [0.0, 1.0])
def test_no_instant_of_a_cell_is_more_dangerous_than_its_bound(robot_named, free, name, weighting, gamma):
    robot = robot_named(name)
    field = KinetostaticField(DangerField(robot, POINTS, weighting=weighting, k1=2.0, gamma=gamma))
    curve = time_path(random_path(robot, 2), robot, RateLimits.of(robot, 1.0, 1.0), motion=free).curve
    cells = curve.cells(0.1)
    rng = np.random.default_rng(0)
    for enough in (-np.inf, 1e9):
        bounds = cell_danger(field, curve, cells, np.arange(len(cells)), np.ones(len(cells)), enough)
        for speed in (0.0, 0.5, 3.0):
            s = cells.edges[:-1] + cells.sizes * rng.uniform(1e-3, 1 - 1e-3, len(cells))
            place = curve.places(s)
            danger = field.values(place.q, place.dq_ds * speed)
            bound = bounds.at(np.full(len(cells), speed))
            assert (danger <= bound).all()
            if enough < 0 and name == "panda":
                assert np.median(bound / danger) < 1.3


@pytest.mark.parametrize("aggregate", ["max", "mean", "softmax"])
def test_the_cap_keeps_the_danger_and_costs_little(panda, free, panda_limits, aggregate):
    field = KinetostaticField(DangerField(panda, POINTS, [1.0, 2.0, 0.5, 1.0], aggregate=aggregate))
    path = random_path(panda, 5)
    alone = time_path(path, panda, panda_limits, motion=free)
    danger = alone.danger(field)
    limit = (danger.peak + field.field.values(alone.at(danger.times).q).max()) / 2
    limited = time_path(path, panda, panda_limits, motion=free, danger=field, max_danger=limit)
    assert limited.velocity_limits[-1].name == "danger"
    assert "danger" in limited.binding()
    smooth = replace(panda_limits, jerk=500 * panda_limits.acceleration)
    assert time_path(path, panda, smooth, motion=free, danger=field, max_danger=limit).danger(field).peak <= limit
    state = limited.at(np.linspace(0, limited.duration, 5000))
    danger = field.values(state.q, state.qd)
    assert 0.95 * limit < danger.max() <= limit
    assert alone.duration < limited.duration
    loose = time_path(path, panda, panda_limits, motion=free, danger=field, max_danger=1e3)
    assert loose.velocity_limits[-1].least == np.inf


def test_the_danger_of_a_trajectory(panda, free, panda_limits):
    field = KinetostaticField(DangerField(panda, POINTS))
    ratios = []
    for seed in range(4):
        trajectory = time_path(random_path(panda, seed), panda, panda_limits, motion=free)
        danger = trajectory.danger(field)
        t = np.linspace(0, trajectory.duration, 3000)
        state = trajectory.at(t)
        values = field.values(state.q, state.qd)
        assert values.max() <= danger.proven_peak
        assert values.max() == pytest.approx(danger.peak, rel=2e-3)
        assert np.trapezoid(values, t) / trajectory.duration == pytest.approx(danger.mean, rel=2e-3)
        ratios.append(danger.proven_peak / danger.peak)
    assert np.median(ratios) <= 1.05


def test_where_the_danger_at_rest_is_too_high_it_says_so(panda, panda_limits):
    field = KinetostaticField(DangerField(panda, POINTS))
    with pytest.raises(StandstillError, match=r"danger of the robot at rest is .* is allowed") as caught:
        time_path(random_path(panda, 0), panda, panda_limits, danger=field, max_danger=0.5)
    assert caught.value.standstill.person is None


def test_what_cannot_be_bounded_is_refused(panda, panda_limits):
    path, field = random_path(panda, 0), KinetostaticField(DangerField(panda, POINTS))
    with pytest.raises(InputError, match="max_danger: give both danger and max_danger"):
        time_path(path, panda, panda_limits, danger=field)
    with pytest.raises(InputError, match="danger: give both danger"):
        time_path(path, panda, panda_limits, max_danger=3.0)
    with pytest.raises(InputError, match="max_danger"):
        time_path(path, panda, panda_limits, danger=field, max_danger=0.0)
