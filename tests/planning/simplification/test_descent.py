"""Descent: what it ends at, and its linear algebra."""

import numpy as np
import pytest
from ball import never

from safe_ompl import DangerField
from safe_ompl.danger.static import MAXIMUM, DangerPointTable, PointDanger, SkeletonTable
from safe_ompl.planning.simplification.cost import DangerDensity
from safe_ompl.planning.simplification.costs import DangerTerms, Densities, PricedPath, Walk, divided, gauss_points
from safe_ompl.planning.simplification.descent import ActiveSetCost
from safe_ompl.planning.simplification.measures import Curve
from safe_ompl.robot import motion_limits
from safe_ompl.robot.kinematics import JOINT, KEY_POINT, JointTable, KeyPointTable


def descended(robot, field, path, steps=60):
    cost = ActiveSetCost(DangerDensity(field, 10.0), None, path)
    walk = Walk(*motion_limits(robot))
    walk.restart(cost.densities(), cost.model(path))
    values = [walk.cost]
    while len(values) <= steps and not walk.descend(never, 1, 0.4, 0.0):
        values.append(walk.cost)
    return walk, np.array(values), cost


def test_a_path_among_dangers_that_no_small_change_makes_cheaper(panda, rng):
    ends = np.array([[-1.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.7], [1.0, 0.6, 0.2, -1.5, 0.0, 2.2, 0.7]])
    path = divided(ends, 0.15)
    field = DangerField(panda, [[0.7, 0.0, 0.4], [0.5, 0.3, 0.8]], aggregate="softmax", sharpness=0.2)
    walk, values, cost = descended(panda, field, path)
    assert values[12] - values[-1] < 0.01 * (values[0] - values[-1]), "few steps go most of the way"
    assert (np.diff(values) < 0).all()
    assert values[-1] < 0.75 * values[0]
    best = walk.here.path
    assert cost.of(best) == pytest.approx(values[-1], rel=1e-3)
    np.testing.assert_array_equal(best[[0, -1]], path[[0, -1]])
    np.testing.assert_allclose(walk.here.danger, field.values(gauss_points(best)), rtol=1e-12)
    for _ in range(20):
        change = np.zeros_like(path)
        change[1:-1] = rng.normal(0.0, 0.01, change[1:-1].shape)
        assert cost.of(best + change) > 0.9995 * values[-1]


def test_without_danger_paths_become_straight(panda, rng):
    ends = rng.uniform(0.8 * panda.lower + 0.2 * panda.upper, 0.2 * panda.lower + 0.8 * panda.upper, (2, 7))
    path = divided(ends, 0.3)
    path[1:-1] += rng.normal(0.0, 0.1, path[1:-1].shape)
    _, values, _ = descended(panda, DangerField(panda, []), path)
    assert values[-1] == pytest.approx(np.linalg.norm(ends[1] - ends[0]), rel=1e-3)


# ----------------------------------------------------------- cholesky's factor of a chain of blocks against numpy's


@pytest.mark.parametrize(("count", "n"), [(2, 3), (3, 1), (5, 3), (12, 7)])
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
    held = rng.uniform(size=count) < 0.3
    keypoints = KeyPointTable(np.zeros(0, KEY_POINT), JointTable(np.zeros(n, JOINT)))
    skeleton = SkeletonTable(keypoints, np.zeros((0, 2), np.intp), False)
    danger = PointDanger(skeleton, DangerPointTable(np.zeros((3, 0)), np.zeros(0)), MAXIMUM, 1.0)
    terms = DangerTerms(danger, 1.0, np.eye(n), np.zeros(n))
    densities = Densities(terms, np.zeros(0, np.intp), np.zeros((0, 10)), np.zeros((0, 2)))
    walk = Walk(-np.ones(n), np.ones(n))
    at = PricedPath(np.zeros((count, n)), n)
    at.gradient[:], at.blocks, at.beside = right.reshape(count, n), blocks, beside
    walk.restart(densities, at, held)
    held[[0, -1]] = True
    right.reshape(count, n)[held] = 0.0
    whole[np.repeat(held, n)], whole[:, np.repeat(held, n)] = 0.0, 0.0
    whole[np.diag_indices(count * n)] += np.repeat(held, n)
    direction, slope, largest = walk.direction()
    np.testing.assert_allclose(direction.ravel(), -np.linalg.solve(whole, right), atol=1e-10)
    assert slope == pytest.approx(direction.ravel() @ right)
    assert largest == np.abs(direction).max()


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
