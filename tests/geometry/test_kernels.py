"""The nearest point of a simplex against quadratic programming by brute force."""

from itertools import combinations

import numpy as np
import pytest

from safe_ompl.geometry.convex import direction_cell, extreme_vertices, nearest_point


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
        given = rng.normal((away, 0.0, 0.0), size=(corners, 3))
        point, kept = nearest_point(given)
        np.testing.assert_allclose(point, nearest(given), atol=1e-10)
        np.testing.assert_allclose(point, nearest(kept), atol=1e-10)
        assert all(any((row == corner).all() for corner in given) for row in kept)
        between.add(len(kept))
    assert len(between) > 1 or corners == 1


@pytest.mark.parametrize(
    ("simplex", "point"),
    [
        ([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], (0, 0, 0)),
        ([[0, 0, 1]] * 4, (0, 0, 1)),
        ([[-1, 0, 1], [0, 0, 1], [1, 0, 1], [2, 0, 1]], (0, 0, 1)),
        ([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], (0, 0, 1)),
    ],
)
def test_simplices_about_the_origin_and_flat_ones(simplex, point):
    np.testing.assert_allclose(nearest_point(np.array(simplex, dtype=float))[0], point, atol=1e-15)


# ---------------------------------------------------------------------------- lists of vertices that may be extreme


@pytest.mark.parametrize("grid", [1, 3, 4, 8])
@pytest.mark.parametrize("number", [1, 5, 200])
def test_the_extreme_vertex_is_in_the_list_of_its_cell(rng, number, grid):
    vertices = rng.normal(size=(number, 3)) * [0.5, 0.1, 0.02] + [0.3, 0.0, -0.1]
    starts, found = extreme_vertices(vertices, grid)
    assert len(starts) == 6 * grid**2 + 1
    on_borders = np.array(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3)).reshape(3, -1).T
    for direction in (*rng.normal(size=(1000, 3)), *on_borders):
        cell = direction_cell(*direction, grid)
        listed = found[starts[cell] : starts[cell + 1]]
        assert (vertices[listed] @ direction).max() >= (vertices @ direction).max() - 1e-15


def test_without_a_grid_there_is_one_cell():
    assert direction_cell(0.1, -0.2, 0.3, 0) == 0
    assert direction_cell(0.0, 0.0, 0.0, 4) == 0
