"""Descent on costs whose cheapest paths are known."""

import numpy as np
import pytest
from test_cost import Density, Plane

from safe_ompl.paths.cost import PathCost, factored, solved
from safe_ompl.paths.descent import Descent
from safe_ompl.paths.measures import Curve, divided

# In the half-plane with density 1/y cheapest paths are arcs of circles about points of the x axis, and the cost
# between two points is arcosh(1 + distance²/(2 y₁ y₂)) (Poincaré).
HYPERBOLIC = Density(lambda Q: 1 / Q[:, 1] - 1, lambda Q: np.stack([np.zeros(len(Q)), -1 / Q[:, 1] ** 2], axis=1))


def anywhere(Q):
    return Q


def descended(path, steps=60):
    descent = Descent(PathCost(Plane(), [HYPERBOLIC]), path, anywhere)
    values = [descent.value]
    for _ in range(steps):
        if not descent.step():
            break
        values.append(descent.value)
    return descent, values


def test_the_cheapest_path_of_the_half_plane():
    path = divided(np.array([[-2.0, 0.5], [2.0, 0.5]]), 0.2)
    descent, values = descended(path)
    best = np.arccosh(1 + 16 / (2 * 0.25))
    assert values[-1] == pytest.approx(best, rel=2e-3)
    assert values[12] - best < 0.05 * (values[0] - best), "few steps go most of the way"
    assert (np.diff(values) < 0).all()
    np.testing.assert_allclose(np.linalg.norm(descent.path, axis=1), np.hypot(2, 0.5), atol=0.05)
    np.testing.assert_array_equal(descent.path[[0, -1]], path[[0, -1]])


# ----------------------------------------------------------- cholesky's factor of a chain of blocks against numpy's


@pytest.mark.parametrize(("count", "n"), [(1, 3), (2, 1), (5, 3), (12, 7)])
def test_it_solves_what_the_whole_matrix_solves(rng, count, n):
    factor = rng.normal(size=(count, n, n))
    blocks = factor @ factor.transpose(0, 2, 1) + 8 * np.eye(n)
    beside = rng.normal(size=(count - 1, n, n))
    whole = np.zeros((count * n, count * n))
    for k in range(count):
        whole[k * n : (k + 1) * n, k * n : (k + 1) * n] = blocks[k]
    for k in range(count - 1):
        whole[k * n : (k + 1) * n, (k + 1) * n : (k + 2) * n] = beside[k]
        whole[(k + 1) * n : (k + 2) * n, k * n : (k + 1) * n] = beside[k].T
    whole += max(0.0, 1.0 - np.linalg.eigvalsh(whole).min()) * np.eye(count * n)
    blocks = np.array([whole[k * n : (k + 1) * n, k * n : (k + 1) * n] for k in range(count)])
    right = rng.normal(size=count * n)
    np.testing.assert_allclose(solved(factored(blocks, beside), right), np.linalg.solve(whole, right), atol=1e-10)


# ---------------------------------------------------------------------------------------------------- the best path


def test_configurations_by_arc_length(panda, rng):
    path = rng.uniform(-1, 1, (9, 7))
    path[4] = path[3]
    curve = Curve(panda, path)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(path[1:] - path[:-1], axis=1))])
    assert curve.length == pytest.approx(arc[-1], rel=1e-14)
    s = np.concatenate([rng.uniform(-0.5, 1.1 * arc[-1], 50), arc, [2.0 * arc[-1]]])
    expected = np.stack([np.interp(s, arc, column) for column in path.T], axis=1)
    np.testing.assert_allclose(curve.at(s), expected, rtol=0, atol=1e-13)
