"""Points of a trajectory: what receivers make of them, cubics or quintics, keeps the limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import Motion, RateLimits, time_path
from safe_ompl.motions import rate_violations

RATES = (50.0, 123.4, 1000.0)


@pytest.mark.parametrize("jerk", [None, 100.0, 5000.0])
@pytest.mark.parametrize("blends", [True, False])
def test_limits_hold_between_points_at_any_rate(panda, shelf_path, shelf_motion, jerk, blends):
    limits = RateLimits.of(panda, acceleration=8.0, jerk=jerk)
    trajectory = time_path(shelf_path, panda, limits, motion=shelf_motion if blends else None)
    for rate in RATES:
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
        np.testing.assert_allclose(points["positions"][[0, -1]], [shelf_path[0], shelf_path[-1]], atol=1e-12)


def test_samples_at_a_rate_would_not_keep_them(panda, shelf_path, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits)
    times = np.append(np.arange(0.0, trajectory.duration, 0.01), trajectory.duration)
    for kinds in (2, 3):
        states = trajectory.at(times)[:kinds]
        assert rate_violations(Motion.hermite(times, *states), panda, panda_limits)
    proven = Motion.of(trajectory)
    assert not rate_violations(proven, panda, panda_limits)
    assert rate_violations(proven, panda, replace(panda_limits, acceleration=0.99 * panda_limits.acceleration))


def test_a_trajectory_is_checked_as_controllers_join_its_points(panda, shelf_path, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits)
    motion = Motion.of(trajectory)
    assert motion.joint_names == panda.joint_names
    assert motion.degree == 3
    assert np.array_equal(motion.times, trajectory.points()[0])
