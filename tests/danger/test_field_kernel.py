"""The compiled field against NumPy's passes: in general position, on segments, on links without length."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from oracles import numpy_field
from pulled import keypoint_gradient

from safe_ompl.danger.link_field import (
    WEIGHTINGS,
    Segments,
    field,
    segment_distances,
    segment_fields,
    workspace_gradient,
)

PAIRS = np.array([[1, 2], [2, 3], [5, 6], [3, 5], [3, 7]])  # a branch, and key points 0 and 4 on no segment
TREE = Segments(PAIRS)
K = 8

coordinates = st.floats(-2, 2).map(lambda x: round(x, 3))  # to the millimetre: often the same place twice
skeletons = arrays(np.float64, (2, K, 3), elements=coordinates)
points = arrays(np.float64, (3, 3), elements=coordinates)
weightings = st.sampled_from(WEIGHTINGS)


def compared(keypoints, points, weights, weighting):
    """Return pairs of results, the package's and the oracle's."""
    scale = np.abs(numpy_field.keypoint_gradient(keypoints, PAIRS, points, weights, weighting)).max()
    slope = np.abs(numpy_field.space_gradient(keypoints, PAIRS, points, weighting)).max()
    options = {"weighting": weighting}
    return [
        (
            segment_fields(keypoints, TREE, points, **options),
            numpy_field.potentials(keypoints, PAIRS, points, weighting),
            0.0,
        ),
        (
            field(keypoints, TREE, points, **options),
            numpy_field.potentials(keypoints, PAIRS, points, weighting).sum(axis=1),
            0.0,
        ),
        (
            segment_distances(keypoints, TREE, points),
            numpy_field.distances(keypoints, PAIRS, points),
            1e-12,  # [m]
        ),
        (
            workspace_gradient(keypoints, TREE, points, **options),
            numpy_field.space_gradient(keypoints, PAIRS, points, weighting),
            1e-12 * slope,
        ),
        (
            keypoint_gradient(keypoints, TREE, points, weights, **options),
            numpy_field.keypoint_gradient(keypoints, PAIRS, points, weights, weighting),
            1e-12 * scale,
        ),
    ]


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("number", [1, 127, 128, 129, 300])  # about the block in which points are read
def test_the_same_in_general_position(weighting, number):
    rng = np.random.default_rng(number)
    keypoints, points = rng.normal(size=(3, K, 3)), rng.normal(size=(number, 3))
    weights = rng.normal(size=(3, number))
    for found, expected, absolute in compared(keypoints, points, weights, weighting):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=absolute)


@settings(max_examples=150)
@given(skeletons, points, weightings)
def test_the_same_anywhere(keypoints, points, weighting):
    for found, expected, absolute in compared(keypoints, points, np.ones((2, 3)), weighting):
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=absolute)


@settings(max_examples=100)
@given(skeletons, st.floats(0, 1), st.sampled_from([0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3]), weightings)
def test_the_same_on_a_segment_and_beside_it(keypoints, along, beside, weighting):
    a, b = keypoints[0, PAIRS[1]]
    place = a + along * (b - a) + beside * np.array([0.36, 0.48, 0.8])
    found, expected = (
        values[0].sum(axis=0)
        for values in (
            segment_fields(keypoints[:1], TREE, place[None], weighting=weighting),
            numpy_field.potentials(keypoints[:1], PAIRS, place[None], weighting),
        )
    )
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.parametrize("ratio", [1e-300, 1e-17, 1e-9, 1e-3, 0.4, 0.42, 1.0, 1e3, 2.0**20, 1e12])
def test_the_logarithm_is_that_of_the_library(ratio):
    """Straight before a link of length ℓ, at the distance x, θ = log(1 + ℓ/x)."""
    link, place = np.array([[[-ratio / 8, 0, 0], [0, 0, 0]]]), np.array([[0.125, 0, 0]])
    theta = field(link, Segments([[0, 1]]), place, weighting="length")[0, 0]
    assert theta == pytest.approx(np.log1p(ratio), rel=1e-15 if ratio < 1 else 1e-13)
