"""The cost of a path against closed forms, and its derivatives against finite differences."""

import numpy as np
import pytest

from safe_ompl import CollisionChecker, DangerField, InputError, Obstacle, Pose, Scene, Sphere
from safe_ompl.planning.simplification.cost import DangerDensity, ObstacleCost, PathCost, reference_danger
from safe_ompl.planning.simplification.costs import divided
from safe_ompl.planning.simplification.descent import ActiveSetCost


class Plane:
    """Stands for a robot of two joints that turn on and on."""

    n = 2
    continuous = np.zeros(2, dtype=bool)

    def difference(self, start, end):
        return end - start

    def unrolled(self, path):
        return path


class Density:
    """A density given by a function of configurations."""

    def __init__(self, value):
        self.value = value

    def values(self, Q):
        return self.value(Q)


SQUARES = Density(lambda Q: Q[:, 0] ** 2)
POINTS = np.array([[0.4, 0.2, 0.3], [-0.3, 0.5, 0.6], [0.1, -0.6, 0.4]])


def test_the_cost_of_a_known_path():
    path = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])  # ∫₀² (1 + x²) dx, then 1 · (1 + 4)
    assert PathCost(Plane(), [SQUARES]).of(path) == pytest.approx(2 + 8 / 3 + 5, rel=1e-3)
    assert PathCost(Plane(), []).of(path) == pytest.approx(3.0)


@pytest.mark.parametrize("name", ["panda", "gripper", "kinova"])  # the last one has joints that wrap
def test_kernels_know_the_costs_of_edges(robot_named, rng, name):
    robot = robot_named(name)
    density = DangerDensity(DangerField(robot, POINTS, aggregate="softmax", sharpness=0.5), 10.0)
    path = robot.unrolled(rng.uniform(robot.lower, robot.upper, (5, robot.n)) / 2)
    terms, cost = density.terms(), PathCost(robot, [density], 0.1)
    wanted, edges = np.eye(5, k=-1, dtype=bool), [(0, 3), (0, 4), (1, 2)]
    wanted[tuple(zip(*edges, strict=True))] = True
    found, samples = terms.edge_costs(path, wanted, robot.continuous)
    assert 2 * len(edges) <= samples <= 4 * len(edges)
    assert [*zip(*np.nonzero(np.isfinite(found)), strict=True)] == edges, "none leads back"
    for edge in edges:
        assert found[edge] == pytest.approx(cost.of(path[[*edge]]), rel=0.3)


BALL = Obstacle("ball", Sphere(0.2), Pose((0.5, 0.3, 0.4)))


@pytest.mark.parametrize("name", ["panda", "gripper"])  # joints of the latter mimic each other
def test_the_model_of_a_cost_with_obstacles(robot_named, rng, name):
    robot = robot_named(name)
    field = DangerField(robot, POINTS, aggregate="softmax", sharpness=0.5)
    obstacles = ObstacleCost(CollisionChecker(robot, Scene((BALL,))), 0.4)
    path = rng.uniform(robot.lower, robot.upper, (5, robot.n)) / 3
    cost = ActiveSetCost(DangerDensity(field, 10.0), obstacles, path)
    cost.anchor(path)
    found = cost.model(path)
    fine = divided(path, 0.002)  # the trapezoidal rule on many samples
    assert found.value - found.near == pytest.approx(cost.of(fine), rel=0.02)
    assert found.near > 0
    for k, i in ((0, 0), (1, 1), (2, robot.n - 1), (4, 1)):
        step = np.zeros_like(path)
        step[k, i] = 1e-5
        rise = cost.model(path + step).value - cost.model(path - step).value
        assert found.gradient[k, i] == pytest.approx(rise / 2e-5, rel=1e-4, abs=1e-4)
    straight = cost.model(divided(path[[0, 1]], 0.1))
    np.testing.assert_allclose(straight.blocks, straight.blocks.transpose(0, 2, 1), rtol=1e-12)
    assert (np.linalg.eigvalsh(straight.blocks) > 0).all()


def test_the_weight_is_in_the_scale_of_robot_and_scene(ur5):
    checker = CollisionChecker(ur5, Scene())
    near, far = (DangerField(ur5, scale * POINTS) for scale in (1.0, 3.0))
    assert reference_danger(near, checker) > reference_danger(far, checker)
    for field in (near, far):
        density = DangerDensity(field, reference_danger(field, checker), weight=5.0)
        samples = np.random.default_rng(1).uniform(ur5.lower, ur5.upper, (400, 6))
        assert np.median(density.values(samples)) == pytest.approx(5.0, rel=0.5)


def test_nothing_is_near_in_an_empty_scene(panda):
    density, Q = ObstacleCost(CollisionChecker(panda, Scene()), 0.05), np.zeros((3, 7))
    assert not density.values(Q).any()
    assert not len(density.near(Q).rows)


@pytest.mark.parametrize(("options", "message"), [({"weight": -1.0}, "weight"), ({"reference": 0.0}, "reference")])
@pytest.mark.parametrize("distance", [0.0, -0.1, np.inf, np.nan])
def test_bad_options(panda, options, message, distance):
    with pytest.raises(InputError, match=message):
        DangerDensity(DangerField(panda, POINTS), **{"reference": 10.0, **options})
    with pytest.raises(InputError, match="clearance"):
        ObstacleCost(CollisionChecker(panda, Scene()), distance)
