"""Distances of simplices against quadratic programming by brute force, and extreme vertices by lists."""

from itertools import combinations

import numpy as np
import pytest

from safe_ompl.geometry.convex import BODY, NODE, ShapeTable, extreme_vertices
from safe_ompl.geometry.surface_points import capsule_points


def hull(vertices, grid=0):
    """Return the table of two bodies: the hull of vertices (V, 3), and the origin."""
    bodies = np.zeros(2, BODY)
    bodies["rotation"] = np.eye(3)
    bodies["first_cell"], bodies["grid"] = (1, 0), (grid, 0)
    starts, listed = extreme_vertices(vertices, grid) if grid else ([0, len(vertices)], np.arange(len(vertices)))
    lists = np.concatenate([np.zeros((1, 3)), vertices[listed]])
    return ShapeTable(bodies, np.append(0, 1 + np.asarray(starts, dtype=np.intp)), lists, np.zeros(0, NODE))


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


FLAT = [
    [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]],
    [[0, 0, 1]] * 4,
    [[-1, 0, 1], [0, 0, 1], [1, 0, 1], [2, 0, 1]],
    [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
]


@pytest.mark.parametrize("corners", [1, 2, 3, 4])
@pytest.mark.parametrize("away", [0.0, 0.5, 2.0])
def test_bounds_of_the_distance_of_a_simplex(rng, corners, away):
    """Of any, of one about the origin, and of flat ones; along any axis to begin with."""
    np.testing.assert_allclose([nearest(simplex) for simplex in FLAT], [[0, 0, z] for z in (0, 1, 1, 1)], atol=1e-15)
    for simplex in (*np.array(FLAT, float), *rng.normal((away, 0.0, 0.0), size=(100, corners, 3))):
        distance = np.linalg.norm(nearest(simplex))
        for axis in (simplex[0], (0.3, 0.2, 1.0)):
            lower, upper = hull(simplex).distance_bounds(0, 1, axis, np.inf, -np.inf)
            assert lower <= distance + 1e-10
            if distance > 1e-10:
                assert lower >= 0.9 * distance
                assert distance - 1e-10 <= upper <= lower / 0.9 + 1e-10
            else:
                assert upper == -np.inf


# ---------------------------------------------------------------------------- lists of vertices that may be extreme


@pytest.mark.parametrize("grid", [1, 3, 4, 8])
@pytest.mark.parametrize("number", [1, 5, 200])
def test_the_extreme_vertex_is_in_the_list_of_its_cell(rng, number, grid):
    vertices = rng.normal(size=(number, 3)) * [0.5, 0.1, 0.02] + [0.3, 0.0, -0.1]
    table = hull(vertices, grid)
    on_borders = np.array(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3)).reshape(3, -1).T
    for direction in (*rng.normal(size=(300, 3)), *on_borders):
        assert table.support(0, direction) @ direction >= (vertices @ direction).max() - 1e-15


# ------------------------------------------------------------------------------------------------ points on surfaces


@pytest.mark.parametrize("tilt", [0.0, 1e-160, 1e-9, 1e-6, 2e-6, 1e-5, 1e-3, 1.0])
def test_points_of_a_capsule_that_points_down_are_on_it(tilt):
    start, axis, radius = np.array([0.1, 0.2, 1.3]), np.array([0.2 * tilt, -0.1 * tilt, -0.5]), 0.05
    points = capsule_points(start[None], (start + axis)[None], np.array([radius]), 0.02)
    along = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
    np.testing.assert_allclose(np.linalg.norm(points - start - along[:, None] * axis, axis=1), radius, atol=1e-13)
