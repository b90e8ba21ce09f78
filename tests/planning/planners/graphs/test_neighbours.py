"""The nearest node: the same as by looking at all of them, with costs, ties and coordinates that wrap."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safe_ompl.planning.planners.parts.tree import NearestNode


def plainly(rows, q, wraps, alpha, costs):
    delta = rows - q
    delta = np.where(wraps, delta - 2 * np.pi * np.round(delta / (2 * np.pi)), delta)
    return int((np.sqrt((delta * delta).sum(axis=1)) + alpha * costs).argmin())


def nodes(rng, number, n):
    """Return nodes as planners make them: strings of steps, each from some node before."""
    rows = rng.uniform(-3, 3, (number, n))
    for k in range(1, number):
        if rng.random() < 0.8:
            rows[k] = rows[rng.integers(k)] + 0.1 * rng.normal(size=n)
    return rows


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 8), alpha=st.sampled_from([0.0, 0.3, 5.0]))
def test_the_same_node_as_by_looking_at_all(seed, n, alpha):
    rng = np.random.default_rng(seed)
    rows, wraps, costs = nodes(rng, 1500, n), rng.random(n) < 0.4, rng.uniform(size=1500)
    search, size = NearestNode(wraps), 0
    while size < len(rows):
        size = min(len(rows), size + int(rng.integers(1, 300)))
        for q in rng.uniform(-3.5, 3.5, (5, n)):
            for weight in (alpha, 0.0):
                found = search.find(rows[:size], q, weight, costs[:size] if weight else np.empty(0))
                assert found == plainly(rows[:size], q, wraps, weight, costs[:size])


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_of_equal_ones_the_first(rng, alpha):
    rows = rng.integers(-2, 3, (1000, 3)).astype(float)
    costs = rng.integers(0, 3, 1000).astype(float)
    search = NearestNode(np.zeros(3, dtype=bool))
    for q in rng.integers(-2, 3, (50, 3)).astype(float):
        assert search.find(rows, q, alpha, costs) == plainly(rows, q, False, alpha, costs)


def test_places_that_wrap_are_near_across_the_seam():
    rows = np.linspace(-3.1, 3.0, 1000)[:, None].copy()
    search = NearestNode(np.array([True]))
    assert search.find(rows, np.array([3.1])) == 0  # 0.08 across the seam, 0.1 on this side
    assert search.find(rows, np.array([3.1 - 2 * np.pi])) == 0
    assert search.find(rows, np.array([3.02])) == 999


def test_nodes_without_a_finite_cost_come_last(rng):
    rows, costs = rng.normal(size=(1000, 2)), np.full(1000, np.inf)
    costs[[3, 700]] = 1.0, np.nan
    for number in (100, 1000):
        search = NearestNode(np.zeros(2, dtype=bool))
        assert search.find(rows[:number], rows[50], 0.5, costs[:number]) == 3
        assert search.find(rows[:number], rows[50], 0.5, np.full(number, np.inf)) == 0
