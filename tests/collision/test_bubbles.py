"""Bubbles: their shapes hold what they should, their ends lie on them, and INTERSECT agrees with a linear programme."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import linprog

from safe_ompl.collision import bubbles
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


def norm(shape, weights, motion):
    weighted = np.abs(weights * motion)
    return weighted.max(axis=-1) if shape is bubbles.inscribed_cube else weighted.sum(axis=-1)


@pytest.mark.parametrize("shape", [bubbles.common_diamond, bubbles.link_diamond, bubbles.inscribed_cube])
@given(data=radii_and_distances(), seed=st.integers(0, 99))
def test_every_shape_lies_within_the_bubble(shape, data, seed):
    radii, distances = data
    weights = shape(radii, distances)
    motions = np.random.default_rng(seed).normal(size=(200, radii.shape[1]))
    size = norm(shape, weights, motions)
    at_the_rim = motions[size > 0] / size[size > 0, None]
    assert (at_the_rim.__abs__() @ radii.T <= distances * (1 + 1e-9)).all()


@given(data=radii_and_distances())
def test_the_link_diamond_holds_the_papers_and_touches_the_bubble_on_every_axis(data):
    radii, distances = data
    link, paper = bubbles.link_diamond(radii, distances), bubbles.common_diamond(radii, distances)
    assert (link <= paper * (1 + 1e-12)).all()
    for axis, reach in zip(np.eye(len(link)), bubbles.extents(link), strict=True):
        assert bubbles.reach_along(axis, radii, distances) == pytest.approx(reach)


def test_the_cube_is_the_largest():
    radii, distances = np.array([[2.0, 1.0], [0.0, 4.0]]), np.array([0.3, 0.8])
    weights = bubbles.inscribed_cube(radii, distances)
    np.testing.assert_allclose(weights, 10.0)
    assert bubbles.reach_along(np.array([0.1, 0.1]), radii, distances) == pytest.approx(1.0)


def test_volume_gain_of_the_link_diamond_on_a_real_arm(ur5, clutter):
    """As many bubbles of the paper's kind fill one of ours: the median of these 40, and never less than one."""
    from safe_ompl.collision.checker import CollisionChecker

    checker, rng, gains = CollisionChecker(ur5, clutter), np.random.default_rng(1), []
    while len(gains) < 40:
        q = rng.uniform(ur5.lower, ur5.upper)
        distances = checker.pair_distances(q)
        if distances.min() > 0.01:
            radii = checker.pair_radii_at(q)
            paper, link = (f(radii, distances) for f in (bubbles.common_diamond, bubbles.link_diamond))
            gains.append(np.prod(np.minimum(1 / link, np.pi)) / np.prod(np.minimum(1 / paper, np.pi)))
    assert min(gains) >= 1 - 1e-9
    assert np.median(gains) == pytest.approx(25.5, rel=0.1)


def test_extents_and_axis_points():
    np.testing.assert_array_equal(bubbles.extents(np.array([2.0, 0.0])), [0.5, np.inf])
    points = bubbles.axis_points(np.zeros(2), np.array([0.5, np.inf]), np.array([-0.2, -3.0]), np.array([1.0, 3.0]))
    np.testing.assert_array_equal(points, [[-0.2, 0], [0, -3], [0.5, 0], [0, 3]])


def test_reach_without_anything_in_the_way():
    assert bubbles.reach_along(np.ones(2), np.zeros((0, 2)), np.zeros(0)) == np.inf
    assert bubbles.reach_along(np.zeros(2), np.ones((1, 2)), np.ones(1)) == np.inf


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


@given(gaps=weighted_gaps())
def test_diamonds_meet_where_the_linear_programme_says(gaps):
    u, v = gaps
    meetings = bubbles.diamond_meetings(u, v)
    s = meetings.shares[0]
    assert meetings.gaps[0] == pytest.approx(gap_by_linear_programme(u[0], v[0]), abs=1e-7)
    assert ((s >= 0) & (s <= 1)).all()
    assert max(u[0] @ s, v[0] @ (1 - s)) == pytest.approx(meetings.gaps[0], abs=1e-12)
    assert meetings.gaps[0] >= 1 or bubbles.diamonds_may_meet(u, v)[0]


@given(gaps=weighted_gaps())
def test_boxes_meet_where_every_coordinate_does(gaps):
    u, v = gaps
    gap, shares = bubbles.box_meetings(u, v)
    # Two intervals 1 apart with half-widths z/u and z/v touch where z/u + z/v = 1.
    touching = np.divide(u * v, u + v, out=np.zeros_like(u), where=u + v > 0)
    assert gap[0] == pytest.approx(touching.max(), abs=1e-12)
    assert gap[0] >= 1 or bubbles.boxes_may_meet(u, v)[0]
    assert max((u * shares).max(), (v * (1 - shares)).max()) == pytest.approx(gap[0], abs=1e-12)


def test_haltons_points_are_spread_evenly():
    np.testing.assert_allclose(halton_point(5, 2), [1 / 2 + 1 / 8, 2 / 3 + 1 / 9])
    points = np.array([halton_point(k, 3) for k in range(1, 501)])
    counts, _ = np.histogramdd(points, bins=2, range=[(0, 1)] * 3)
    assert counts.min() >= 55
    assert counts.max() <= 70
