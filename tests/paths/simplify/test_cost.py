"""The cost of a path against closed forms, and its derivatives against finite differences."""

import numpy as np
import pytest

from safe_ompl import CollisionChecker, DangerField, InputError, Scene
from safe_ompl.paths.cost import DangerDensity, Expansion, PathCost, reference_danger


class Plane:
    """Stands for a robot of two joints that turn on and on."""

    n = 2

    def difference(self, start, end):
        return end - start


class Density:
    """A density given by a function of configurations, with its gradient."""

    def __init__(self, value, gradient):
        self.value, self.gradient = value, gradient

    def values(self, Q):
        return self.value(Q)

    def values_and_gradients(self, Q):
        return self.value(Q), self.gradient(Q)

    def expansion(self, Q):
        nowhere, nothing = np.zeros(0, dtype=np.intp), np.zeros((0, Q.shape[1]))
        return Expansion(self.value(Q), self.gradient(Q), nowhere, nothing)


SQUARES = Density(lambda Q: Q[:, 0] ** 2, lambda Q: np.stack([2 * Q[:, 0], 0 * Q[:, 0]], axis=1))
POINTS = np.array([[0.4, 0.2, 0.3], [-0.3, 0.5, 0.6], [0.1, -0.6, 0.4]])


def test_the_cost_of_a_known_path():
    path = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])  # ∫₀² (1 + x²) dx, then 1 · (1 + 4)
    assert PathCost(Plane(), [SQUARES]).of(path) == pytest.approx(2 + 8 / 3 + 5, rel=1e-3)
    assert PathCost(Plane(), []).of(path) == pytest.approx(3.0)
    cubic = Density(lambda Q: Q[:, 0] ** 3, lambda Q: np.stack([3 * Q[:, 0] ** 2, 0 * Q[:, 0]], axis=1))
    value, _ = PathCost(Plane(), [cubic]).value_and_gradient(np.array([[0.0, 0.0], [2.0, 0.0]]))
    assert value == pytest.approx(2 + 4, rel=1e-12), "Gauss points integrate cubic densities exactly"
    starts, ends = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[2.0, 0.0], [1.0, 3.0]])
    found = PathCost(Plane(), [SQUARES]).of_edges(starts, ends, np.array([200, 3]))
    np.testing.assert_allclose(found, [2 + 8 / 3, 3 * 2], rtol=1e-4)


def test_the_gradient_of_the_discretised_cost(panda, rng):
    field = DangerField(panda, POINTS, aggregate="softmax", sharpness=2.0)
    cost = PathCost(panda, [DangerDensity(field, 10.0)])
    path = rng.uniform(panda.lower, panda.upper, (4, 7))
    _, gradient = cost.value_and_gradient(path)
    for k, i in ((0, 0), (1, 3), (2, 5), (3, 1)):
        step = np.zeros_like(path)
        step[k, i] = 1e-5
        rise = cost.value_and_gradient(path + step)[0] - cost.value_and_gradient(path - step)[0]
        assert gradient[k, i] == pytest.approx(rise / 2e-5, rel=1e-5, abs=1e-5)


def test_the_weight_is_in_the_scale_of_robot_and_scene(ur5):
    checker = CollisionChecker(ur5, Scene())
    near, far = (DangerField(ur5, scale * POINTS) for scale in (1.0, 3.0))
    assert reference_danger(near, checker) > reference_danger(far, checker)
    for field in (near, far):
        density = DangerDensity(field, reference_danger(field, checker), weight=5.0)
        samples = np.random.default_rng(1).uniform(ur5.lower, ur5.upper, (400, 6))
        assert np.median(density.values(samples)) == pytest.approx(5.0, rel=0.5)


@pytest.mark.parametrize(("options", "message"), [({"weight": -1.0}, "weight"), ({"reference": 0.0}, "reference")])
def test_bad_options(panda, options, message):
    with pytest.raises(InputError, match=message):
        DangerDensity(DangerField(panda, POINTS), **{"reference": 10.0, **options})
