"""The field of links against quadrature, its gradients against differences, and the laws of a potential."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from oracles.differences import slopes
from scipy.integrate import quad

from safe_ompl.danger import static
from safe_ompl.danger.link_field import (
    WEIGHTINGS,
    columns,
    field,
    segment_bounds,
    segment_distances,
    segment_fields,
    vectors,
)
from safe_ompl.danger.static import MAXIMUM, MEAN, DangerPointTable, PointDanger, SkeletonTable
from safe_ompl.robot.kinematics import JOINT, KEY_POINT, JointTable, KeyPointTable

ONE = np.array([[0, 1]])
ARM = np.array([[1, 2], [2, 3], [5, 6], [3, 5], [3, 7]])  # a branch, and key points 0 and 4 on no segment
K = 8

repeatable = settings(derandomize=True, deadline=None, max_examples=40)
coordinates = st.floats(-2, 2).map(lambda x: round(x, 3))  # to the millimetre: often the same place twice
places = arrays(np.float64, (3,), elements=coordinates)
skeletons = arrays(np.float64, (1, K, 3), elements=coordinates)


def gliding(places):
    """Return a table of key points (K, 3), each of which three joints move along the axes of the world."""
    joints = np.zeros(3 * len(places), JOINT)
    joints["rotation"], joints["axis"], joints["slides"] = np.eye(3), np.tile(np.eye(3), (len(places), 1)), 1
    joints["parent"] = [3 * k + x for k in range(len(places)) for x in range(3)]
    joints["parent"][::3] = 0
    keys = np.zeros(len(places), KEY_POINT)
    keys["joint"] = 3 * np.arange(1, len(places) + 1)
    joints["translation"][::3] = places
    return KeyPointTable(keys, JointTable(joints))


def point_danger(places, links, points, point_weights, by_length, kind):
    """Return the danger of key points (K, 3) that joints move along the axes of the world."""
    skeleton = SkeletonTable(gliding(places), links, by_length)
    return PointDanger(skeleton, DangerPointTable(columns(points), point_weights), kind, 1.0)


def keypoint_gradient(keypoints, links, points, weights, weighting="unit"):
    """Return the gradient (B, K, 3) of Σ_m w_m CDF(p_m) by the key points."""
    where = np.zeros((1, 3 * keypoints.shape[1]))
    each = [
        point_danger(places, links, points, len(points) * some, weighting == "length", MEAN)
        .values_and_gradients(where)[1]
        .reshape(places.shape)
        for places, some in zip(keypoints, weights, strict=True)
    ]
    return np.array(each)


def space_gradient(keypoints, links, points, weighting="unit"):
    return static.space_gradients(keypoints, links, columns(points), weighting == "length")


def arm(rng, configurations=1):
    return rng.normal(scale=0.5, size=(configurations, K, 3))


def link(a, b, p):
    """Field of the segment a → b at p."""
    return float(field(np.array([[a, b]], dtype=float), ONE, np.array([p], dtype=float))[0, 0])


def quadrature(a, b, p):
    """∫₀¹ dt/‖p − a − t(b − a)‖, eq. (4), as (1/ℓ) ∫ dx/√(h² + x²) about the exact foot of p."""
    a, b, p = ([Fraction(float(x)) for x in point] for point in (a, b, p))
    u, axis = ([x - y for x, y in zip(end, a, strict=True)] for end in (p, b))
    square = sum(x * x for x in axis)
    if not square:
        return 1 / math.sqrt(sum(x * x for x in u))
    foot = sum(x * y for x, y in zip(u, axis, strict=True)) / square
    height = math.sqrt(sum((x - foot * y) ** 2 for x, y in zip(u, axis, strict=True)))
    length = math.sqrt(square)
    start, end = float(-foot) * length, float(1 - foot) * length
    steps = 10.0 ** np.arange(-20, 8)
    cuts = [start, *(x for x in (*-steps[::-1], 0.0, *steps) if start < x < end), end]
    parts = (quad(lambda x: 1 / math.hypot(height, x), x0, x1, epsabs=0, epsrel=1e-11)[0] for x0, x1 in pairwise(cuts))
    return math.fsum(parts) / length


# ---------------------------------------------------------------------------------------------------- values

A, B = [0.1, 0.2, 0.3], [0.5, 0.2, 0.3]


HARD_PLACES = [
    pytest.param(A, B, [-0.4, 0.2, 0.3], id="on the axis, behind"),
    pytest.param(A, B, [0.5 + 1e-6, 0.2, 0.3], id="on the axis, 1e-6 before the end"),
    pytest.param(A, B, [0.5 + 1e-9, 0.2, 0.3], id="on the axis, 1e-9 before the end"),
    pytest.param(A, B, [-0.4, 0.2 + 1e-9, 0.3], id="beside the axis, behind"),
    pytest.param(A, B, [0.23, 0.2 + 1e-3, 0.3], id="1e-3 beside the link"),
    pytest.param(A, B, [0.23, 0.2 + 1e-6, 0.3], id="1e-6 beside the link"),
    pytest.param(A, B, [0.23, 0.2, 0.3 - 1e-9], id="1e-9 beside the link"),
    pytest.param(A, B, [0.1 - 1e-6, 0.2 + 1e-6, 0.3], id="1e-6 off the end"),
    pytest.param(A, B, [0.1 + 1e-9, 0.2 + 1e-6, 0.3], id="1e-6 beside the end"),
    pytest.param(A, B, [60.0, -30.0, 20.0], id="far"),
    pytest.param(A, B, [6e5, -3e5, 2e5], id="very far"),
    pytest.param(A, [0.1 + 1e-4, 0.2, 0.3], [1.0, 0.5, 0.3], id="short link"),
    pytest.param(A, [0.1, 0.2, 0.3 + 1e-12], [1.0, 0.5, 0.3], id="tiny link"),
    pytest.param(A, A, [1.0, 0.5, 0.3], id="no length"),
    pytest.param(A, [1000.1, 0.2, 0.3], [500.0, 0.2, 0.4], id="long link"),
]


@pytest.mark.parametrize(("a", "b", "p"), HARD_PLACES)
def test_closed_form_where_the_textbook_forms_fail(a, b, p):
    assert link(a, b, p) == pytest.approx(quadrature(a, b, p), rel=1e-9)


@repeatable
@given(st.integers(0, 10**6), st.sampled_from([1e-9, 1e-6, 1e-3, 1.0]))
def test_closed_form_in_general_position_and_close_to_a_tilted_link(seed, away):
    a, b, offset = np.random.default_rng(seed).normal(size=(3, 3))
    across = np.cross(b - a, offset)
    p = a + 0.3 * (b - a) + away * across / np.linalg.norm(across)
    assert link(a, b, p) == pytest.approx(quadrature(a, b, p), rel=1e-9 if away > 1e-9 else 1e-6)


def test_infinite_on_the_segment_which_spares_other_points(rng):
    keypoints, points = arm(rng, 3), rng.normal(size=(300, 3))  # more than a block
    alone = np.concatenate([field(keypoints, ARM, p[None]) for p in points], axis=1)
    for k, t in ((2, 0.0), (64, 0.25), (127, 0.7), (299, 1.0)):
        points[k] = keypoints[1, 2] + t * (keypoints[1, 3] - keypoints[1, 2])
    points[4] = np.nan
    mixed = field(keypoints, ARM, points)
    assert (mixed[1, [2, 64, 127, 299]] == np.inf).all()
    assert np.isnan(mixed[:, 4]).all()
    others = np.setdiff1d(np.arange(300), [2, 4, 64, 127, 299])
    np.testing.assert_allclose(mixed[:, others], alone[:, others], rtol=1e-13)
    assert link(A, A, A) == np.inf


def test_length_weighting_is_the_integral_over_arc_length(rng):
    keypoints, points = arm(rng, 4), rng.normal(size=(6, 3))
    lengths = np.linalg.norm(np.diff(keypoints[:, ARM], axis=2), axis=-1)
    arc = segment_fields(keypoints, ARM, points, "length")
    np.testing.assert_allclose(arc, segment_fields(keypoints, ARM, points) * lengths, rtol=1e-13)
    np.testing.assert_allclose(field(keypoints, ARM, points, "length"), arc.sum(axis=1), rtol=1e-13)


def test_nothing_in_nothing_out(rng):
    keypoints, points = arm(rng, 2), rng.normal(size=(3, 3))
    assert field(keypoints[:0], ARM, points).shape == (0, 3)
    assert field(keypoints, ARM, points[:0]).shape == (2, 0)
    assert vectors(keypoints, ARM, points[:0]).shape == (2, 0, 3)


# ------------------------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_gradients_against_slopes(rng, weighting):
    keypoints, points, weights = arm(rng), rng.normal(size=(5, 3)), rng.uniform(size=(1, 5))
    for p, slope in zip(points, space_gradient(keypoints, ARM, points, weighting)[0], strict=True):
        expected = slopes(lambda x: field(keypoints, ARM, x[None], weighting)[0, 0], p)
        np.testing.assert_allclose(slope, expected, rtol=1e-7, atol=1e-8)
    gradient = keypoint_gradient(keypoints, ARM, points, weights, weighting)
    expected = slopes(lambda k: (weights * field(k, ARM, points, weighting)).sum(), keypoints)
    np.testing.assert_allclose(gradient, expected, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("length", [3.0, 0.3, 0.1, 0.01, 1e-4])
def test_keypoint_gradient_of_links_of_any_length(weighting, length):
    keypoints = np.array([[[0.2, 0, 0], [0.2 + 0.6 * length, 0.8 * length, 0]]])
    points, one = np.array([[0.5, 0.7, 0.9]]), np.ones((1, 1))
    gradient = keypoint_gradient(keypoints, ONE, points, one, weighting)
    step = min(1e-5, 1e-3 * length)
    expected = slopes(lambda k: field(k, ONE, points, weighting)[0, 0], keypoints, step)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-8)


RAY = np.array([0.5, 0.7, 0.9]) - A
KNOWN = [  # the slope of a point's field, and that of a wire's, which is 2 asinh(0.5/h)
    (A, A, A + RAY, -RAY / np.linalg.norm(RAY) ** 3),
    *(([-0.5, 0, 0], [0.5, 0, 0], [0, h, 0], [0, -1 / (h * math.hypot(h, 0.5)), 0]) for h in (1e-2, 1e-4, 1e-6)),
]


@pytest.mark.parametrize(("a", "b", "p", "slope"), KNOWN)
def test_gradients_of_a_point_and_of_a_wire(a, b, p, slope):
    keypoints, p = np.array([[a, b]], dtype=float), np.array([p], dtype=float)
    np.testing.assert_allclose(space_gradient(keypoints, ONE, p)[0, 0], slope, rtol=1e-9)
    shares = keypoint_gradient(keypoints, ONE, p, np.ones((1, 1)))[0] @ slope
    np.testing.assert_allclose(shares, np.full(2, -0.5 * np.dot(slope, slope)), rtol=1e-9)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_gradient_is_zero_on_a_segment(weighting):
    keypoints = np.array([[A, B, [0.5, 0.9, 0.3]]])
    links = np.array([[0, 1], [1, 2]])
    points = np.array([A, B, [0.3, 0.2, 0.3], [1.0, 1.0, 1.0]])
    gradient = space_gradient(keypoints, links, points, weighting)[0]
    assert not gradient[:3].any()
    assert gradient[3].any()
    pulls = keypoint_gradient(keypoints, links, points, np.ones((1, 4)), weighting)
    free = keypoint_gradient(keypoints, links, points[3:], np.ones((1, 1)), weighting)
    np.testing.assert_allclose(pulls, free, rtol=1e-12)
    assert np.isfinite(vectors(keypoints, links, points, weighting)[0, 3]).all()


def test_vectors_have_the_length_of_the_field_and_point_to_the_robot(rng):
    keypoints, points = arm(rng), 5 * rng.normal(size=(20, 3))
    found = vectors(keypoints, ARM, points)[0]
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), field(keypoints, ARM, points)[0], rtol=1e-13)
    far = np.linalg.norm(points, axis=1) > 5
    assert far.any()
    assert (np.einsum("mi,mi->m", found, -points)[far] > 0).all()


# ------------------------------------------------------------------------------------------------------ laws


@repeatable
@given(skeletons, places, arrays(np.float64, (1, K, 3), elements=st.floats(-1, 1)), st.floats(0, 0.5))
@example(np.zeros((1, K, 3)), np.zeros(3), np.zeros((1, K, 3)), 0.0)
def test_bound_holds_after_any_motion_of_the_ends(keypoints, p, motion, size):
    motion = motion * size
    displacement = np.linalg.norm(motion, axis=-1)[0, ARM].max(axis=1)[:, None]
    fields = segment_fields(keypoints, ARM, p[None])
    distances = segment_distances(keypoints, ARM, p[None])
    bound = segment_bounds(fields, distances, displacement)
    assert (segment_fields(keypoints + motion, ARM, p[None]) <= bound * (1 + 1e-9)).all()
    assert (bound[np.broadcast_to(displacement, bound.shape) >= distances] == np.inf).all()


def test_segment_distances_against_dense_samples(rng):
    keypoints, points = arm(rng, 2), rng.normal(size=(5, 3))
    t = np.linspace(0, 1, 2001)[:, None]
    for i, j, m in np.ndindex(2, len(ARM), 5):
        a, b = keypoints[i, ARM[j]]
        dense = np.linalg.norm(a + t * (b - a) - points[m], axis=1).min()
        assert segment_distances(keypoints, ARM, points)[i, j, m] == pytest.approx(dense, abs=1e-3)
    assert segment_distances(np.array([[A, A]]), ONE, np.array([B]))[0, 0, 0] == pytest.approx(0.4)


# ------------------------------------------------------------------------------------------- in single precision


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([1e-3, 1.0, 30.0]),
    away=st.sampled_from([0.0, 10.0, 1000.0]),
    weighting=st.sampled_from(WEIGHTINGS),
)
def test_no_field_exceeds_its_bound_in_single_precision(seed, scale, away, weighting):
    """All points that reach a level are found, as those are left out whose bound in single precision is below it.

    They lie anywhere, and as near to the links, to their ends and to the lines beyond them as rounding can tell.
    """
    rng = np.random.default_rng(seed)
    places = scale * rng.normal(size=(5, 3)) + away
    places[4] = places[3] + rng.choice([0.0, 1e-9, 1e-4]) * rng.normal(size=3)
    links = np.array([[0, 1], [1, 2], [2, 3], [3, 4]])
    on = [places[a] + t * (places[b] - places[a]) for a, b in links for t in (-0.5, 0.0, 0.3, 0.999, 1.0, 2.0)]
    beside = np.array(on)[:, None] + 10.0 ** rng.uniform(-12, 0, (20, 1)) * rng.normal(size=(20, 3))
    points = np.vstack([scale * rng.normal(size=(50, 3)) + away, on, beside.reshape(-1, 3)])
    exact = field(places[None], links, points, weighting)[0]
    danger = point_danger(places, links, points, np.ones(len(points)), weighting == "length", MAXIMUM)
    for level in np.sort(exact[np.isfinite(exact)])[::20] * (1 - 1e-12):
        found = danger.high(np.zeros((1, 15)), 0.0, level)
        assert (found[exact >= level * (1 + 1e-11)] > 0).all()
