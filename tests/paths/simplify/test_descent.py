"""Descent on costs whose cheapest paths are known."""

import numpy as np
import pytest
from test_cost import Density, Plane

from safe_ompl.paths.simplify.cost import PathCost
from safe_ompl.paths.simplify.descent import BlockChain, Descent
from safe_ompl.paths.simplify.edges import divided, refined, with_way_points

# In the half-plane with density 1/y cheapest paths are arcs of circles about points of the x axis, and the cost
# between two points is arcosh(1 + distance²/(2 y₁ y₂)) (Poincaré).
HYPERBOLIC = Density(
    lambda Q: 1 / Q[:, 1] - 1, lambda Q: np.stack([np.zeros(len(Q)), -1 / Q[:, 1] ** 2], axis=1)
)


class Fixed:
    """Ends that stay."""

    def nearest(self, path):
        return path

    def tangent(self, path, change):
        change[-1] = 0.0
        return change


def descended(path, steps=60):
    descent = Descent(PathCost(Plane(), [HYPERBOLIC]), path, Fixed())
    values = [descent.value]
    for _ in range(steps):
        if not descent.step():
            break
        values.append(descent.value)
    return descent, values


def test_the_cheapest_path_of_the_half_plane():
    path = divided(np.array([[-2.0, 0.5], [2.0, 0.5]]), 0.2)
    descent, values = descended(path)
    assert values[-1] == pytest.approx(np.arccosh(1 + 16 / (2 * 0.25)), rel=2e-3)
    assert (np.diff(values) < 0).all()
    np.testing.assert_allclose(np.linalg.norm(descent.path, axis=1), np.hypot(2, 0.5), atol=0.05)
    np.testing.assert_array_equal(descent.path[[0, -1]], path[[0, -1]])


def test_few_steps_go_most_of_the_way():
    path = divided(np.array([[-2.0, 0.5], [2.0, 0.5]]), 0.2)
    best = np.arccosh(1 + 16 / (2 * 0.25))
    _, values = descended(path, steps=12)
    assert values[-1] - best < 0.05 * (values[0] - best)


def test_way_points_that_are_held_stay():
    path = divided(np.array([[-2.0, 0.5], [2.0, 0.5]]), 0.5)
    descent = Descent(PathCost(Plane(), [HYPERBOLIC]), path, Fixed())
    held = np.arange(len(path)) == 3
    descent.restart(path, held)
    for _ in range(5):
        descent.step()
    np.testing.assert_array_equal(descent.path[3], path[3])
    assert (descent.path[2] != path[2]).any()


def test_no_step_is_longer_than_allowed():
    path = divided(np.array([[-2.0, 0.5], [2.0, 0.5]]), 0.2)
    descent = Descent(PathCost(Plane(), [HYPERBOLIC]), path, Fixed())
    assert descent.step(0.03)
    assert np.abs(descent.path - path).max() <= 0.03 + 1e-12


def test_where_there_is_nothing_to_gain_no_step_is_taken():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    assert not Descent(PathCost(Plane(), []), path, Fixed()).step()


def test_block_chains_solve_what_the_whole_matrix_solves(rng):
    factor = rng.normal(size=(4, 3, 3))
    blocks = factor @ factor.transpose(0, 2, 1) + 8 * np.eye(3)
    beside = rng.normal(size=(3, 3, 3))
    whole = np.zeros((12, 12))
    for k in range(4):
        whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = blocks[k]
    for k in range(3):
        whole[3 * k : 3 * k + 3, 3 * k + 3 : 3 * k + 6] = beside[k]
        whole[3 * k + 3 : 3 * k + 6, 3 * k : 3 * k + 3] = beside[k].T
    right = rng.normal(size=(4, 3))
    found = BlockChain(blocks, beside, np.ones(4, dtype=bool)).solve(right)
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(whole, right.ravel()), atol=1e-12)


# ---------------------------------------------------------------------------------------------------------- division


def test_division_keeps_the_path_and_its_way_points():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.3]])
    found = divided(path, 0.4)
    np.testing.assert_allclose(found, [[0, 0], [1 / 3, 0], [2 / 3, 0], [1, 0], [1, 0.3]])
    assert all((found == q).all(axis=1).any() for q in path)


def test_segments_are_short_where_the_path_is_near_something():
    path = np.array([[0.0, 0.0], [0.4, 0.0], [0.8, 0.0], [1.2, 0.0]])
    found = refined(path, lambda Q: Q[:, 0] > 1.0)
    lengths = np.diff(found[:, 0])
    assert lengths[found[1:, 0] > 1.01].max() <= 0.12
    assert lengths[0] == 0.4
    np.testing.assert_array_equal(refined(path, lambda Q: Q[:, 0] > 5), path)


def test_way_points_at_given_places_unless_others_are_near():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    found = with_way_points(path, np.array([0.5, 0.995, 1.75]), 0.01)
    np.testing.assert_allclose(found, [[0, 0], [0.5, 0], [1, 0], [1, 0.75], [1, 1]])
    np.testing.assert_array_equal(with_way_points(path, np.zeros(0), 0.01), path)
