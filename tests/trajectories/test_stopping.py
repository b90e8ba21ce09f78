"""Speeds from which stops end in time, against stops driven from everywhere in every cell."""

import numpy as np
import pytest

from safe_ompl.trajectories.kernels import stopping_speeds


def drive(start, square, cell, edges, brakes):
    """Yield for each cell that a stop comes to: when it leaves it or stands, and how fast it comes in."""
    time, brake, at, x = 0.0, np.inf, start, square
    for k in range(cell, len(brakes)):
        brake = min(brake, brakes[k])
        left = max(x - 2 * brake * (edges[k + 1] - at), 0.0)
        entry = x
        time += (np.sqrt(x) - np.sqrt(left)) / brake
        yield k, time, np.sqrt(entry)
        if not left:
            return
        at, x = edges[k + 1], left
    raise AssertionError("the stop does not end on the path")


@pytest.mark.parametrize("contact", [False, True])
def test_stops_from_everywhere_are_in_time_or_harmless(contact):
    rng = np.random.default_rng(4)
    bounded = 0
    for _ in range(60):
        n, bodies = rng.integers(5, 25), rng.integers(1, 4)
        sizes = rng.uniform(0.005, 0.05, n)
        brakes = rng.uniform(1.0, 10.0, n)
        times = np.cumsum(rng.normal(0, 0.03, (n, bodies)), axis=0) + rng.uniform(0.05, 0.3)
        harmless = rng.uniform(0, 0.4, (n, bodies)) * contact
        caps, ends = rng.uniform(0.5, 2.0, n), np.full(n, n - 1)
        speeds, body, _ = stopping_speeds(sizes, brakes, times, harmless, caps, ends)
        assert (speeds <= caps).all()
        bounded += (body >= 0).sum()
        edges = np.concatenate([[0.0], np.cumsum(sizes)])
        squares = (
            np.minimum(np.append(speeds, 0.0), np.append(0.0, speeds)) ** 2
        )  # grid points keep both cells' bounds
        for _ in range(100):
            j, share = rng.integers(n), rng.uniform()
            most = squares[j] + share * (squares[j + 1] - squares[j])
            square = most * rng.choice([1.0, 1.0, rng.uniform()])
            if square <= 1e-9:
                continue
            for k, time, entry in drive(edges[j] + share * sizes[j], square * (1 - 1e-9), j, edges, brakes):
                late = time > times[k] + 1e-9
                assert not (late & (entry > harmless[k] + 1e-9)).any()
    assert bounded > 100


def test_speeds_are_no_less_than_they_must_be():
    sizes, brakes = np.full(2000, 1e-3), np.full(2000, 4.0)
    times, nothing = np.full((2000, 1), 0.25), np.zeros((2000, 1))
    speeds, *_ = stopping_speeds(sizes, brakes, times, nothing, np.full(2000, 9.0), np.full(2000, 1999))
    np.testing.assert_allclose(speeds[:1500], 1.0, rtol=1e-3)  # stands after 0.25 s at 4 rad/s²
    assert (speeds[1999] <= np.sqrt(2 * 4.0 * 1e-3) * (1 + 1e-12)).all()
