"""Motions of one tick and their stops: within bounds, in time, and at rest where they must be."""

import numpy as np
import pytest

from safe_ompl.motions import ceilings, drive
from safe_ompl.motions.laws import stopping_speeds


def random_path(rng):
    sizes = rng.uniform(0.005, 0.05, rng.integers(5, 30))
    squares, brakes = rng.uniform(0.1, 3.0, len(sizes)), rng.uniform(1.0, 10.0, len(sizes))
    stops = rng.choice(np.arange(1, len(sizes)), rng.integers(0, 2), replace=False)
    edges = np.concatenate([[0.0], np.cumsum(sizes)])
    return edges, squares, brakes, stops, ceilings(sizes, squares, brakes, stops)


@pytest.mark.parametrize("seed", range(10))
def test_motions_keep_their_bounds_and_end_at_rest(seed):
    rng = np.random.default_rng(seed)
    edges, squares, brakes, stops, ceiling = random_path(rng)
    s = x = 0.0
    for _ in range(400):
        push = rng.choice([1.0, 1.0, 0.5, 0.0, -0.5, -1.0])
        tick = 0.05
        cells, S, X, T = drive(edges, squares, brakes, ceiling, s, x, push, tick)
        if not len(cells):
            assert x == 0
            assert push <= 0 or s >= edges[-1] - 1e-9
            continue
        assert (np.diff(S) >= 0).all()
        assert (np.diff(T) >= 0).all()
        assert S[0] == s
        assert X[0] == x
        assert X[-1] == 0  # it stands at its end
        assert S[-1] <= edges[-1] + 1e-9
        for k, a, b, u, v, span in zip(cells, S[:-1], S[1:], X[:-1], X[1:], np.diff(T), strict=True):
            assert edges[k] - 1e-9 <= a <= b <= edges[k + 1] + 1e-9
            assert max(u, v) <= squares[k] * (1 + 1e-6)
            assert abs(v - u) <= 2 * brakes[k] * (b - a) * (1 + 1e-6) + 1e-9
            assert span * (np.sqrt(u) + np.sqrt(v)) / 2 == pytest.approx(b - a, abs=1e-9)
        for stop in stops:  # never so fast that it could not stop there
            passed = (S[:-1] < edges[stop] - 1e-9) & (S[1:] > edges[stop] + 1e-9)
            assert not passed.any()
        i = min(np.searchsorted(T, tick - 1e-12), len(T) - 1)
        s, x = float(S[i]), float(X[i])
    while s < edges[-1] - 1e-9:  # pushed, it gets to the end
        cells, S, X, T = drive(edges, squares, brakes, ceiling, s, x, 1.0, 0.05)
        i = min(np.searchsorted(T, 0.05 - 1e-12), len(T) - 1)
        assert S[i] > s
        s, x = float(S[i]), float(X[i])


# ------------------------------------------- speeds from which stops end in time, against stops driven from everywh


def stop_from(start, square, cell, edges, brakes):
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
        speeds, body, *_ = stopping_speeds(sizes, brakes, times, harmless, caps, ends)
        assert (speeds <= caps).all()
        bounded += (body >= 0).sum()
        edges = np.concatenate([[0.0], np.cumsum(sizes)])
        squares = np.minimum(np.append(speeds, 0.0), np.append(0.0, speeds)) ** 2  # grid points keep both cells' bounds
        for _ in range(100):
            j, share = rng.integers(n), rng.uniform()
            most = squares[j] + share * (squares[j + 1] - squares[j])
            square = most * rng.choice([1.0, 1.0, rng.uniform()])
            if square <= 1e-9:
                continue
            for k, time, entry in stop_from(edges[j] + share * sizes[j], square * (1 - 1e-9), j, edges, brakes):
                late = time > times[k] + 1e-9
                assert not (late & (entry > harmless[k] + 1e-9)).any()
    assert bounded > 100


def test_stops_and_pushes_are_as_fast_as_their_bounds():
    sizes, brakes = np.full(2000, 1e-3), np.full(2000, 4.0)
    times, nothing = np.full((2000, 1), 0.25), np.zeros((2000, 1))
    speeds, *_ = stopping_speeds(sizes, brakes, times, nothing, np.full(2000, 9.0), np.full(2000, 1999))
    np.testing.assert_allclose(speeds[:1500], 1.0, rtol=1e-3)  # stands after 0.25 s at 4 rad/s²
    assert (speeds[1999] <= np.sqrt(2 * 4.0 * 1e-3) * (1 + 1e-12)).all()
    edges, squares, brakes = np.linspace(0.0, 1.0, 51), np.full(50, 1.0), np.full(50, 2.0)
    ceiling = ceilings(np.diff(edges), squares, brakes, np.zeros(0, dtype=np.intp))
    _, S, X, T = drive(edges, squares, brakes, ceiling, 0.0, 0.0, 1.0, 10.0)
    assert (S[-1], X.max()) == pytest.approx((1.0, 1.0))
    assert T[-1] == pytest.approx(1.5)  # 0.25 rad each to speed up and brake, 0.5 rad at 1 rad/s
