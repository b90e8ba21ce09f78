"""The closed form against quadrature, the gradients against differences, and the laws of a potential."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pulled import keypoint_gradient
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from safe_ompl import InputError
from safe_ompl.danger.link_field import (
    WEIGHTINGS,
    Segments,
    field,
    segment_bounds,
    segment_distances,
    segment_fields,
    vector_field,
    workspace_gradient,
)

ONE = Segments([[0, 1]])
ARM = Segments([[1, 2], [2, 3], [5, 6], [3, 5], [3, 7]])  # a branch, and key points 0 and 4 on no segment
K = 8

repeatable = settings(derandomize=True, deadline=None, max_examples=60)

coordinates = st.floats(-2, 2).map(lambda x: round(x, 9))  # to the nanometre
places = arrays(np.float64, (3,), elements=coordinates)
skeletons = arrays(np.float64, (1, K, 3), elements=coordinates)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def arm(rng, configurations=1):
    return rng.normal(scale=0.5, size=(configurations, K, 3))


def link(a, b, p, **options):
    """Field of the segment a → b at p."""
    return float(field(np.array([[a, b]], dtype=float), ONE, np.array([p], dtype=float), **options)[0, 0])


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


def differences(function, x, step=1e-6):
    """Central differences of a scalar function of an array."""
    slopes = np.empty(x.shape)
    for index in np.ndindex(x.shape):
        h = np.zeros(x.shape)
        h[index] = step
        slopes[index] = (function(x + h) - function(x - h)) / (2 * step)
    return slopes


# ---------------------------------------------------------------------------------------------------- values


def test_closed_form_in_general_position(rng):
    for a, b, p in rng.normal(size=(30, 3, 3)):
        assert link(a, b, p) == pytest.approx(quadrature(a, b, p), rel=1e-11)


A, B = [0.1, 0.2, 0.3], [0.5, 0.2, 0.3]


@pytest.mark.parametrize(
    ("a", "b", "p"),
    [
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
    ],
)
def test_closed_form_where_the_textbook_forms_fail(a, b, p):
    assert link(a, b, p) == pytest.approx(quadrature(a, b, p), rel=1e-9)


def test_close_to_a_tilted_link(rng):
    for a, b, offset in rng.normal(size=(20, 3, 3)):
        across = np.cross(b - a, offset)
        p = a + 0.3 * (b - a) + 1e-6 * across / np.linalg.norm(across)
        assert link(a, b, p) == pytest.approx(quadrature(a, b, p), rel=1e-9)


def test_infinite_on_the_segment(rng):
    for a, b in rng.normal(size=(20, 2, 3)):
        for t in (0.0, 0.25, 0.7, 1.0):
            assert link(a, b, a + t * (b - a)) == np.inf
    assert link(A, A, A) == np.inf


def test_one_bad_point_spares_the_others(rng):
    keypoints, points = arm(rng, 3), rng.normal(size=(5, 3))
    alone = field(keypoints, ARM, points)
    points[2] = (keypoints[1, 2] + keypoints[1, 3]) / 2
    points[4] *= 1e5
    mixed = field(keypoints, ARM, points)
    assert mixed[1, 2] == np.inf
    assert np.isfinite(np.delete(mixed.ravel(), 7)).all()
    np.testing.assert_allclose(mixed[:, [0, 1, 3]], alone[:, [0, 1, 3]], rtol=1e-13)


def test_length_weighting_is_the_integral_over_arc_length(rng):
    keypoints, points = arm(rng, 4), rng.normal(size=(6, 3))
    unit = segment_fields(keypoints, ARM, points)
    lengths = np.linalg.norm(np.diff(keypoints[:, ARM.pairs], axis=2), axis=-1)
    arc = segment_fields(keypoints, ARM, points, weighting="length")
    np.testing.assert_allclose(arc, unit * lengths, rtol=1e-13)
    np.testing.assert_allclose(field(keypoints, ARM, points, weighting="length"), arc.sum(axis=1), rtol=1e-13)


# ------------------------------------------------------------------------------------------- batches, blocks


def test_batch_is_the_same_as_one_by_one(rng):
    keypoints, points, weights = arm(rng, 5), rng.normal(size=(7, 3)), rng.uniform(size=(5, 7))
    whole = field(keypoints, ARM, points), workspace_gradient(keypoints, ARM, points)
    pulls = keypoint_gradient(keypoints, ARM, points, weights)
    for i in range(5):
        one = keypoints[i : i + 1]
        np.testing.assert_allclose(field(one, ARM, points)[0], whole[0][i], rtol=1e-14)
        np.testing.assert_allclose(workspace_gradient(one, ARM, points)[0], whole[1][i], rtol=1e-13)
        np.testing.assert_allclose(keypoint_gradient(one, ARM, points, weights[i : i + 1])[0], pulls[i], rtol=1e-12)


def test_points_of_their_own_for_every_configuration(rng):
    keypoints, points, weights = arm(rng, 4), rng.normal(size=(4, 3, 3)), rng.uniform(size=(4, 3))
    points[2, 1] = keypoints[2, 3]
    for i in range(4):
        one = keypoints[i : i + 1]
        np.testing.assert_allclose(field(keypoints, ARM, points)[i], field(one, ARM, points[i])[0], rtol=1e-13)
        np.testing.assert_allclose(
            workspace_gradient(keypoints, ARM, points)[i], workspace_gradient(one, ARM, points[i])[0], rtol=1e-12
        )
        np.testing.assert_allclose(
            keypoint_gradient(keypoints, ARM, points, weights)[i],
            keypoint_gradient(one, ARM, points[i], weights[i : i + 1])[0],
            rtol=1e-12,
        )


def test_known_lengths_change_nothing(rng):
    keypoints, points = arm(rng), rng.normal(size=(6, 3))
    lengths = np.linalg.norm(np.diff(keypoints[0, ARM.pairs], axis=1)[:, 0], axis=-1)
    known = Segments(ARM.pairs, lengths)
    points[0] = keypoints[0, 1] + 1e-7
    for weighting in WEIGHTINGS:
        np.testing.assert_allclose(
            field(keypoints, known, points, weighting=weighting),
            field(keypoints, ARM, points, weighting=weighting),
            rtol=1e-12,
        )


def test_nothing_in_nothing_out(rng):
    keypoints, points = arm(rng, 2), rng.normal(size=(3, 3))
    assert field(keypoints[:0], ARM, points).shape == (0, 3)
    assert field(keypoints, ARM, points[:0]).shape == (2, 0)
    assert workspace_gradient(keypoints, ARM, points[:0]).shape == (2, 0, 3)
    assert not keypoint_gradient(keypoints, ARM, points[:0], np.empty((2, 0))).any()


def test_nan_stays_nan(rng):
    keypoints = arm(rng)
    assert np.isnan(field(keypoints, ARM, np.array([[np.nan, 0, 0], [1, 1, 1]]))).tolist() == [[True, False]]


# ------------------------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_workspace_gradient_against_differences(rng, weighting):
    keypoints, points = arm(rng), rng.normal(size=(8, 3))
    gradient = workspace_gradient(keypoints, ARM, points, weighting=weighting)[0]
    for p, slope in zip(points, gradient, strict=True):
        expected = differences(lambda x: field(keypoints, ARM, x[None], weighting=weighting)[0, 0], p)
        np.testing.assert_allclose(slope, expected, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_keypoint_gradient_against_differences(rng, weighting):
    keypoints, points, weights = arm(rng), rng.normal(size=(5, 3)), rng.uniform(size=(1, 5))
    gradient = keypoint_gradient(keypoints, ARM, points, weights, weighting=weighting)
    expected = differences(lambda k: (weights * field(k, ARM, points, weighting=weighting)).sum(), keypoints)
    np.testing.assert_allclose(gradient, expected, rtol=1e-7, atol=1e-8)
    assert not gradient[0, [0, 4]].any()


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("length", [3.0, 0.3, 0.1, 0.01, 1e-4])
def test_keypoint_gradient_of_links_of_any_length(weighting, length):
    keypoints = np.array([[[0.2, 0, 0], [0.2 + 0.6 * length, 0.8 * length, 0]]])
    points, one = np.array([[0.5, 0.7, 0.9]]), np.ones((1, 1))
    gradient = keypoint_gradient(keypoints, ONE, points, one, weighting=weighting)
    step = min(1e-5, 1e-3 * length)
    expected = differences(lambda k: field(k, ONE, points, weighting=weighting)[0, 0], keypoints, step)
    np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-8)


def test_gradient_of_a_link_without_length_is_that_of_a_charge():
    keypoints, p = np.array([[A, A]]), np.array([[0.5, 0.7, 0.9]])
    ray = p[0] - A
    expected = ray / np.linalg.norm(ray) ** 3
    np.testing.assert_allclose(workspace_gradient(keypoints, ONE, p)[0, 0], -expected, rtol=1e-14)
    shares = keypoint_gradient(keypoints, ONE, p, np.ones((1, 1)))[0]
    np.testing.assert_allclose(shares, [expected / 2, expected / 2], rtol=1e-14)


@pytest.mark.parametrize("height", [1e-2, 1e-4, 1e-6])
def test_gradient_beside_a_link_is_that_of_a_wire(height):
    keypoints, p = np.array([[[-0.5, 0, 0], [0.5, 0, 0]]]), np.array([[0, height, 0]])
    expected = -1 / (height * math.hypot(height, 0.5))  # derivative of 2 asinh(0.5/h)
    np.testing.assert_allclose(workspace_gradient(keypoints, ONE, p)[0, 0], [0, expected, 0], rtol=1e-9)
    shares = keypoint_gradient(keypoints, ONE, p, np.ones((1, 1)))[0]
    np.testing.assert_allclose(shares[:, 1], [-expected / 2, -expected / 2], rtol=1e-9)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_gradient_is_zero_on_a_segment(weighting):
    keypoints = np.array([[A, B, [0.5, 0.9, 0.3]]])
    segments = Segments([[0, 1], [1, 2]])
    points = np.array([A, B, [0.3, 0.2, 0.3], [1.0, 1.0, 1.0]])
    gradient = workspace_gradient(keypoints, segments, points, weighting=weighting)[0]
    assert not gradient[:3].any()
    assert gradient[3].any()
    pulls = keypoint_gradient(keypoints, segments, points, np.ones((1, 4)), weighting=weighting)
    free = keypoint_gradient(keypoints, segments, points[3:], np.ones((1, 1)), weighting=weighting)
    np.testing.assert_allclose(pulls, free, rtol=1e-12)


def test_vector_field_has_the_length_of_the_field_and_points_to_the_robot(rng):
    keypoints, points = arm(rng), 5 * rng.normal(size=(20, 3))
    values = field(keypoints, ARM, points)[0]
    vectors = vector_field(values, workspace_gradient(keypoints, ARM, points)[0])
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), values, rtol=1e-13)
    far = np.linalg.norm(points, axis=1) > 5
    assert far.any()
    assert (np.einsum("mi,mi->m", vectors, -points)[far] > 0).all()
    assert not vector_field(np.array([np.inf]), np.zeros((1, 3))).any()


# ------------------------------------------------------------------------------------------------------ laws


@repeatable
@given(skeletons, places, places, places)
def test_invariant_under_rigid_motion(keypoints, p, rotation, translation):
    turn = Rotation.from_rotvec(rotation)
    near = segment_distances(keypoints, ARM, p[None]).min()
    moved = turn.apply(keypoints[0])[None] + translation, ARM, turn.apply(p)[None] + translation
    if near > 1e-3:
        np.testing.assert_allclose(field(*moved), field(keypoints, ARM, p[None]), rtol=1e-10)
        np.testing.assert_allclose(
            workspace_gradient(*moved)[0],
            turn.apply(workspace_gradient(keypoints, ARM, p[None])[0]),
            rtol=1e-7,
            atol=1e-7,
        )


@repeatable
@given(skeletons, places)
def test_gradients_balance(keypoints, p):
    """Moving robot and point together changes nothing: Σ_k ∂/∂r_k + ∂/∂p = 0."""
    at_points = workspace_gradient(keypoints, ARM, p[None])[0, 0]
    at_keypoints = keypoint_gradient(keypoints, ARM, p[None], np.ones((1, 1)))[0]
    scale = max(1.0, np.abs(at_keypoints).max())
    np.testing.assert_allclose(at_keypoints.sum(axis=0), -at_points, atol=1e-9 * scale)


@repeatable
@given(skeletons, places, arrays(np.float64, (1, K, 3), elements=st.floats(-1, 1)), st.floats(0, 0.5))
def test_bound_holds_after_any_motion_of_the_ends(keypoints, p, motion, size):
    motion = motion * size
    displacement = np.linalg.norm(motion, axis=-1)[0, ARM.pairs].max(axis=1)[:, None]
    fields = segment_fields(keypoints, ARM, p[None])
    distances = segment_distances(keypoints, ARM, p[None])
    bound = segment_bounds(fields, distances, displacement)
    assert (segment_fields(keypoints + motion, ARM, p[None]) <= bound * (1 + 1e-9)).all()


def test_bound_at_contact_and_at_rest():
    fields, distances = np.array([5.0, 5.0, np.inf]), np.array([0.2, 0.2, 0.0])
    assert segment_bounds(fields, distances, np.array([0.0, 0.2, 0.0])).tolist() == [5.0, np.inf, np.inf]


def test_segment_distances_against_dense_samples(rng):
    keypoints, points = arm(rng, 2), rng.normal(size=(5, 3))
    t = np.linspace(0, 1, 2001)[:, None]
    for i, j, m in np.ndindex(2, len(ARM), 5):
        a, b = keypoints[i, ARM.pairs[j]]
        dense = np.linalg.norm(a + t * (b - a) - points[m], axis=1).min()
        assert segment_distances(keypoints, ARM, points)[i, j, m] == pytest.approx(dense, abs=1e-3)
    assert segment_distances(np.array([[A, A]]), ONE, np.array([B]))[0, 0, 0] == pytest.approx(0.4)


# ------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    "pairs", [[], np.empty((0, 2), dtype=int), [[0, 1, 2]], [0, 1], [[0.0, 1.0]], [[-1, 0]], [[0, 1], [1, 0], [0, 1]]]
)
def test_segments_refuse(pairs):
    with pytest.raises(InputError, match="segments"):
        Segments(pairs)


@pytest.mark.parametrize("lengths", [[1.0, 2.0], [-1.0], [np.nan], ["long"]])
def test_segments_refuse_lengths(lengths):
    with pytest.raises(InputError, match="lengths of segments"):
        Segments([[0, 1]], lengths)


def test_unknown_weighting(rng):
    keypoints, points = arm(rng), rng.normal(size=(2, 3))
    for function in (field, segment_fields, workspace_gradient):
        with pytest.raises(InputError, match="unknown weighting 'mass'; known: unit, length"):
            function(keypoints, ARM, points, weighting="mass")
    with pytest.raises(InputError, match="unknown weighting"):
        keypoint_gradient(keypoints, ARM, points, np.ones((1, 2)), weighting="mass")


def test_segments_read_like_their_constructor():
    segments = Segments([[0, 1], [1, 2]], [0.5, 0.25])
    assert repr(segments) == "Segments([[0, 1], [1, 2]], lengths=[0.5, 0.25])"
    assert repr(ONE) == "Segments([[0, 1]])"
    assert len(segments) == 2
