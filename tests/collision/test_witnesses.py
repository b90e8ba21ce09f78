"""Witnesses of nearness: distances against coal's, gradients against finite differences."""

import numpy as np
import pytest
from oracles.pinocchio_points import body_points

from safe_ompl import CollisionChecker, InputError, Scene
from safe_ompl.collision import PairDistances
from safe_ompl.planning.simplification.cost import ObstacleCost

WITHIN = 0.15


@pytest.fixture(scope="module")
def near(panda, clutter):
    """Return a checker, and free configurations that are near something."""
    checker = CollisionChecker(panda, clutter)
    rng = np.random.default_rng(3)
    found = []
    while len(found) < 6:
        q = rng.uniform(panda.lower, panda.upper)
        if not checker.in_collision(q) and 0.01 < checker.clearance(q).distance < WITHIN - 0.01:
            found.append(q)
    return checker, np.array(found)


def distances_of(witnesses, Q):
    """Return distances (C,) and their gradients (C, n) by the witnesses."""
    points, normals, offsets = *np.split(witnesses.table[:, 3:9], 2, axis=1), witnesses.table[:, 9]
    joints = witnesses.carriers[witnesses.pairs]
    places, jacobians = body_points(witnesses.robot, Q, witnesses.rows, joints, points)
    return np.einsum("ci,ci->c", places, normals) - offsets, np.einsum("cin,ci->cn", jacobians, normals)


def test_the_nearest_witness_is_as_far_as_coal_says(near):
    checker, Q = near
    witnesses = PairDistances(checker, WITHIN).near(Q, WITHIN)
    distances, _ = distances_of(witnesses, Q)
    for row, q in enumerate(Q):
        assert distances[witnesses.rows == row].min() == pytest.approx(checker.clearance(q).distance, abs=1e-4)


def test_gradients_of_distances(near):
    checker, Q = near
    witnesses = PairDistances(checker, WITHIN).near(Q, WITHIN)
    _, gradients = distances_of(witnesses, Q)
    for i in range(Q.shape[1]):
        step = 1e-6 * np.eye(Q.shape[1])[i]
        rise = distances_of(witnesses, Q + step)[0] - distances_of(witnesses, Q - step)[0]
        np.testing.assert_allclose(gradients[:, i], rise / 2e-6, atol=1e-6)


def test_hinge_costs_are_those_of_the_distances(near):
    checker, Q = near
    witnesses = PairDistances(checker, WITHIN).near(Q, WITHIN)
    distances, slopes = distances_of(witnesses, Q)
    costs, gradients, bends = witnesses.hinge_costs(Q, np.array([[WITHIN, 2.0], [0.5 * WITHIN, 30.0]]))
    lacks = np.maximum(0.0, 1 - distances[:, None] / [WITHIN, 0.5 * WITHIN])
    assert (lacks[:, 1] > 0).any()
    assert (lacks[:, 1] == 0).any()
    terms = lacks**2 @ [2.0, 30.0]
    rates = -2 * lacks / [WITHIN, 0.5 * WITHIN] @ [2.0, 30.0]
    second = 2 * (lacks > 0) / np.square([WITHIN, 0.5 * WITHIN]) @ [2.0, 30.0]
    for row in range(len(Q)):
        of_row = witnesses.rows == row
        assert costs[row] == pytest.approx(terms[of_row].sum(), rel=1e-9)
        np.testing.assert_allclose(gradients[row], rates[of_row] @ slopes[of_row], atol=1e-8)
    np.testing.assert_allclose(bends, np.sqrt(second)[:, None] * slopes, atol=1e-8)


def test_nothing_is_near_in_an_empty_scene(panda):
    density, Q = ObstacleCost(CollisionChecker(panda, Scene()), 0.05), np.zeros((3, 7))
    assert not density.values(Q).any()
    assert not len(density.near(Q).rows)


@pytest.mark.parametrize("distance", [0.0, -0.1, np.inf, np.nan])
def test_bad_distances(panda, distance):
    with pytest.raises(InputError, match="clearance"):
        ObstacleCost(CollisionChecker(panda, Scene()), distance)
