"""The nearest point of a simplex against quadratic programming by brute force."""

from itertools import combinations

import numpy as np
import pytest

from safe_ompl.geometry.kernels.convex import nearest_in_simplex


def nearest(corners):
    """Return the point of the hull of up to four corners that is nearest to the origin: the best of all its faces."""
    best = None
    for size in range(1, len(corners) + 1):
        for face in combinations(corners, size):
            face = np.array(face)
            edges = face[1:] - face[0]
            weights = np.linalg.lstsq(edges.T, -face[0], rcond=None)[0] if size > 1 else np.zeros(0)
            if (weights >= -1e-12).all() and weights.sum() <= 1 + 1e-12:
                point = face[0] + weights @ edges
                if best is None or point @ point < best @ best:
                    best = point
    return best


@pytest.mark.parametrize("corners", [1, 2, 3, 4])
@pytest.mark.parametrize("away", [0.0, 0.5, 2.0])
def test_the_nearest_point(rng, corners, away):
    between = set()
    for _ in range(300):
        simplex = rng.normal((away, 0.0, 0.0), size=(4, 3))
        given = simplex[:corners].copy()
        *point, kept = nearest_in_simplex(simplex, corners)
        np.testing.assert_allclose(point, nearest(given), atol=1e-10)
        np.testing.assert_allclose(point, nearest(simplex[:kept]), atol=1e-10)
        assert all(any((row == corner).all() for corner in given) for row in simplex[:kept])
        between.add(kept)
    assert len(between) > 1 or corners == 1


def test_the_origin_in_a_tetrahedron():
    simplex = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    assert nearest_in_simplex(simplex, 4) == (0.0, 0.0, 0.0, 4)


def test_flat_simplices():
    point = np.array([[0.0, 0.0, 1.0]])
    assert nearest_in_simplex(np.repeat(point, 4, axis=0), 4)[:3] == (0.0, 0.0, 1.0)
    line = np.array([[-1.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    np.testing.assert_allclose(nearest_in_simplex(line, 4)[:3], [0.0, 0.0, 1.0])
    square = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
    np.testing.assert_allclose(nearest_in_simplex(square, 4)[:3], [0.0, 0.0, 1.0], atol=1e-15)
