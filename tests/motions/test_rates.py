"""Extremes are bounds, and near what is taken; violations are found where they are."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.interpolate import BPoly

from safe_ompl import InputError, Motion, RateLimits
from safe_ompl.common.polynomials import peaks
from safe_ompl.motions import rate_violations
from safe_ompl.motions.rates import extremes

FINE = np.linspace(0.0, 1.0, 1001)


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.integers(0, 15))
def test_peaks_of_polynomials(seed, degree):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(20, degree + 1)) * 10.0 ** rng.integers(-6, 6, (20, 1))
    rows[0], rows[1, 1:] = 2.5, rows[1, 0]
    found = peaks(rows)
    size = np.abs(rows).max(axis=1)
    assert (found.bound - found.taken <= 1.001e-9 * size).all()
    for row, bound, taken, at in zip(rows, *found, strict=True):
        polynomial = BPoly(row[:, None], [0.0, 1.0])
        assert polynomial(FINE).max() <= bound
        assert polynomial(at) == pytest.approx(taken, abs=1e-12 * np.abs(row).max())


@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_no_sample_is_outside_the_extremes(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.05, 1.0, 6))
    motion = Motion.hermite(t, *rng.normal(size=(3, 6, 2)))
    for order in range(4):
        found = extremes(motion, order)
        for piece in range(motion.pieces):
            inside = t[piece] + np.diff(t)[piece] * FINE[:-1]
            values = motion.derivative(inside, order)
            slop = 1e-10 * np.abs(values).max()
            assert (values <= found.high[piece] + slop).all()
            assert (values >= found.low[piece] - slop).all()
        held = motion.derivative_coefficients(order)
        for bound, at in ((found.high, found.high_at), (found.low, found.low_at)):
            u = (at - t[:-1, None]) / np.diff(t)[:, None]
            taken = sum(held[:, k] * u**k for k in range(held.shape[1]))
            np.testing.assert_allclose(taken, bound, rtol=0, atol=1e-7 * np.abs(held).max())


@pytest.fixture(scope="module")
def limits(ur5):
    return RateLimits(ur5.joint_names, np.full(6, 1.0), np.full(6, 2.0), np.full(6, 10.0))


def trapezoid(push, span=0.5):
    """Return a motion of joint 0: faster for a time, at that speed for a time, slower again."""
    fast, braking = push * span, push * span**2 / 2
    q, v = np.zeros((2, 4, 6))
    q[:, 0], v[:, 0] = [0.0, braking, braking + 0.5 * fast, 2 * braking + 0.5 * fast], [0.0, fast, fast, 0.0]
    return Motion.hermite([0.0, span, span + 0.5, 2 * span + 0.5], q, v)


def test_limits_that_are_just_kept_are_kept(ur5, limits):
    hard = replace(limits, jerk=None)
    assert rate_violations(trapezoid(2.0), ur5, hard) == []
    found = rate_violations(trapezoid(2.0), ur5, limits)
    assert [(v.kind, v.at, v.value) for v in found] == [
        ("acceleration jump", 0.5, pytest.approx(-2.0))  # the second one, at 1 s, is as large and of the same stretch
    ]
    found = rate_violations(trapezoid(2.0 + 1e-5), ur5, hard)
    assert [(v.kind, v.at) for v in found] == [
        ("acceleration", 0.0),
        ("velocity", pytest.approx(0.5)),
        ("acceleration", 1.0),
    ]
    assert str(found[1]) == "velocity at 0.5 s: 'shoulder_pan_joint', 1.000005 rad/s (limit 1 rad/s)"


def test_every_stretch_has_its_worst_time(ur5, limits):
    t = np.arange(9.0)
    q = np.zeros((9, 6))
    q[[2, 6], 1] = -1.4, -1.5  # twice too far, and in between not
    low = ur5.with_limits({ur5.joint_names[1]: (-1.0, 1.0)})
    fast = RateLimits(ur5.joint_names, limits.velocity, np.full(6, 99.0))
    found = rate_violations(Motion.hermite(t, q, np.zeros((9, 6))), low, fast)
    kinds = [(v.kind, round(v.at, 6), round(v.value, 6)) for v in found]
    assert kinds[0] == ("velocity", 1.5, -2.1)
    assert [entry for entry in kinds if entry[0] == "position"] == [("position", 2, -1.4), ("position", 6, -1.5)]
    assert all(v.names[0] == "shoulder_lift_joint" for v in found)


def test_velocities_of_way_points_jump(ur5, limits):
    motion = Motion.through(np.cumsum(np.eye(6)[[0, 0, 1]], axis=0) * 0.5, [0.0, 1.0, 2.0])
    found = rate_violations(motion, ur5, replace(limits, jerk=None))
    assert {(v.kind, v.names[0], v.at, v.value) for v in found} == {
        ("velocity jump", "shoulder_pan_joint", 1.0, -0.5),
        ("velocity jump", "shoulder_lift_joint", 1.0, 0.5),
    }
    assert str(found[0]) == "velocity jump at 1 s: 'shoulder_lift_joint', 0.5 rad/s (limit 0 rad/s)"


def test_continuous_joints_have_no_limits_and_paths_no_rates(kinova, ur5, panda, limits):
    turn = np.zeros((2, 6))
    turn[1, kinova.continuous] = 7.0
    turn[:, ~kinova.continuous] = 0.5 * (kinova.lower + kinova.upper)[~kinova.continuous]
    assert rate_violations(Motion.hermite([0.0, 1.0], turn), kinova) == []
    assert rate_violations(Motion.through([[0.0] * 6, [1.0] * 6]), ur5, limits) == []
    beside = Motion.sampled([0.0, 1.0], [[6.2] * 6] * 2, 1.0)  # within limits, not with what lies between
    assert [(v.kind, v.value) for v in rate_violations(beside, ur5, limits)] == [("position", pytest.approx(6.7))] * 6
    with pytest.raises(InputError, match="limits: are of other joints than the robot's: shoulder_pan_joint"):
        rate_violations(Motion.through(np.zeros((2, 7)), [0, 1]), panda, limits)
