"""Bubbles: diamonds hold what they should, their ends lie on them, and INTERSECT is what a linear programme says."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import linprog

from safe_ompl.collision import Bubble, bubbles
from safe_ompl.common import halton_point

SIZES = st.integers(1, 7)
POSITIVE = st.floats(0.01, 10.0)
WEIGHTS = st.one_of(st.just(0.0), POSITIVE)


@st.composite
def radii_and_distances(draw):
    pairs, joints = draw(st.integers(1, 6)), draw(SIZES)
    radii = draw(hnp.arrays(float, (pairs, joints), elements=WEIGHTS))
    return radii, draw(hnp.arrays(float, pairs, elements=POSITIVE))


@st.composite
def weighted_gaps(draw):
    joints = draw(SIZES)
    return tuple(draw(hnp.arrays(float, (1, joints), elements=WEIGHTS)) for _ in range(2))


@settings(max_examples=40)
@given(data=radii_and_distances(), seed=st.integers(0, 99))
def test_the_link_diamond_holds_the_papers_lies_within_the_bubble_and_touches_it_on_every_axis(data, seed):
    radii, distances = data
    link, paper = bubbles.link_diamond(radii, distances), bubbles.common_diamond(radii, distances)
    assert (link <= paper * (1 + 1e-12)).all()
    motions = np.random.default_rng(seed).normal(size=(200, radii.shape[1]))
    size = np.abs(link * motions).sum(axis=-1)
    at_the_rim = np.abs(motions[size > 0] / size[size > 0, None])
    assert (at_the_rim @ radii.T <= distances * (1 + 1e-9)).all()
    for axis, reach in zip(np.eye(len(link)), bubbles.extents(link), strict=True):
        assert bubbles.reach_along(axis, radii, distances) == pytest.approx(reach)


def test_vertices_are_within_the_limits_and_the_way_out_ends_at_the_rim():
    bubble = Bubble(np.zeros(2), np.array([2.0, 0.0]), np.array([[2.0, 0.0]]), np.ones(1))
    lower, upper = np.array([-0.2, -3.0]), np.array([1.0, 3.0])
    found = bubble.vertices(lower, upper, np.zeros(2, dtype=bool))
    np.testing.assert_allclose(found, [[-0.2, 0], [0, -3], [0.495, 0], [0, 3]])
    np.testing.assert_allclose(bubble.vertices(lower, upper, np.ones(2, dtype=bool))[1], [0, -3.1])
    np.testing.assert_allclose(bubble.exit(np.ones(2)), 0.495)
    np.testing.assert_allclose(bubble.exit(np.array([0.0, 9.0])), [0.0, 9.0])


def gap_by_linear_programme(u, v):
    """Min z: Σ u s ≤ z, Σ v (1 − s) ≤ z, 0 ≤ s ≤ 1."""
    n = len(u)
    solution = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=np.vstack([np.append(u, -1.0), np.append(-v, -1.0)]),
        b_ub=[0.0, -v.sum()],
        bounds=[(0, 1)] * n + [(0, None)],
    )
    return solution.fun


@settings(max_examples=40)
@given(gaps=weighted_gaps())
def test_diamonds_meet_where_the_linear_programme_says(gaps):
    u, v = gaps
    gap, (s,) = bubbles.diamond_meetings(u, v)
    assert gap[0] == pytest.approx(gap_by_linear_programme(u[0], v[0]), abs=1e-7)
    assert ((s >= 0) & (s <= 1)).all()
    assert max(u[0] @ s, v[0] @ (1 - s)) == pytest.approx(gap[0], abs=1e-12)
    assert gap[0] >= 1 or bubbles.diamonds_may_meet(u, v)[0]


def test_haltons_points_are_spread_evenly():
    np.testing.assert_allclose(halton_point(5, 2), [1 / 2 + 1 / 8, 2 / 3 + 1 / 9])
    counts, _ = np.histogramdd(np.array([halton_point(k, 3) for k in range(1, 501)]), bins=2, range=[(0, 1)] * 3)
    assert counts.min() >= 55
    assert counts.max() <= 70
