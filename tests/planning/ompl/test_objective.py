"""Danger as OMPL's objective, and any objective as the cost that planners read."""

import math
from functools import partial
from itertools import count

import numpy as np
import pytest
from ompl import base as ob, geometric as og
from plane import PlaneProblem, SlopedHotSpot

from safe_ompl import DangerField, DangerObjective, Pose, SafeRRTConnect, Scenario, Scene, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import FiniteCosts, StateCost
from safe_ompl.robot import ScratchState, StateBridge, joint_space


class Squares(ob.OptimizationObjective):
    """Anybody's objective: cost of a state x² + 3y², of a motion its length."""

    def stateCost(self, state):
        x, y = state[0:2]
        return ob.Cost(x**2 + 3 * y**2)

    def motionCost(self, start, end):
        return ob.Cost(self.getSpaceInformation().distance(start, end))


@pytest.fixture
def plane():
    space = ob.RealVectorStateSpace(2)
    space.setBounds(-1, 1)
    return ob.SpaceInformation(space)


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform(-1, 1, (20, 3)) + np.array([1.5, 0, 0.5])


class Setting:
    """A space, a danger field, and states of the space."""

    def __init__(self, robot, points):
        self.si = ob.SpaceInformation(joint_space(robot))
        self.field, self.bridge = DangerField(robot, points), StateBridge(self.si.getStateSpace())
        self.scratch = ScratchState(self.bridge), ScratchState(self.bridge)

    def states(self, ends):
        return [scratch.set(q) for scratch, q in zip(self.scratch, ends, strict=True)]

    def cost(self, ends, objective=None):
        return (objective or DangerObjective(self.si, self.field)).motionCost(*self.states(ends)).value()


@pytest.fixture(scope="module", params=["ur5", "kinova"])
def setting(request, robot_named, points):
    return Setting(robot_named(request.param), points)


def test_cost_of_a_state_is_its_danger_and_of_a_motion_the_integral(setting, points, rng):
    field, bridge = setting.field, setting.bridge
    objective = DangerObjective(setting.si, field)
    for ends in rng.uniform(bridge.lower, bridge.upper, (5, 2, bridge.n)):
        assert objective.stateCost(setting.states(ends)[0]).value() == pytest.approx(field.value(ends[0]))
        delta, t = bridge.difference(*ends), np.linspace(0, 1, 2001)
        exact = np.trapezoid(field.values(ends[0] + t[:, None] * delta), t) * np.linalg.norm(delta)
        cost = setting.cost(ends, objective)
        assert cost == pytest.approx(exact, rel=0.01)
        assert cost == setting.cost(ends[::-1], objective)
        assert cost >= objective.motionCostHeuristic(*setting.states(ends)).value()
    assert setting.cost([ends[0], ends[0]], objective) == 0
    path = og.PathGeometric(setting.si)
    for state in setting.states(ends):
        path.append(state)
    assert path.cost(objective).value() == pytest.approx(cost), "OMPL sums it over a path"


def test_a_motion_that_is_asked_for_again_costs_no_evaluation_until_the_points_move(setting, rng):
    ball = {"name": "ball", "sphere": {"radius": 0.1}, "position": [0.6, 0.2, 0.5], "weight": 1}
    scene = Scene.from_mapping({"obstacles": [ball]})
    field = DangerField.of_scene(setting.field.robot, scene)
    objective, ends = DangerObjective(setting.si, field), rng.uniform(-1, 1, (2, setting.bridge.n))
    cost = setting.cost(ends, objective)
    before = field.counts.field_configurations
    assert setting.cost(ends[::-1], objective) == cost
    assert field.counts.field_configurations == before
    field.move(scene.moved({"ball": Pose([0.6, 0.2, 0.8])}))
    assert cost != setting.cost(ends, objective) == setting.cost(ends, DangerObjective(setting.si, field))


def test_danger_is_read_in_batches_with_gradients(setting, rng):
    field, bridge = setting.field, setting.bridge
    cost = StateCost(DangerObjective(setting.si, field), bridge)
    batch = rng.uniform(bridge.lower, bridge.upper, (4, bridge.n))
    assert not cost.is_zero
    assert cost.has_gradients
    np.testing.assert_allclose(cost.values(batch), field.values(batch))
    value, gradient = cost.value_and_gradient(batch[2])
    assert value == pytest.approx(field.value(batch[2]))
    np.testing.assert_allclose(gradient, field.gradients(batch)[2])


def test_any_objective_is_read_state_by_state(plane, rng):
    cost = StateCost(Squares(plane), StateBridge(plane.getStateSpace()))
    batch = rng.uniform(-1, 1, (6, 2))
    assert not cost.is_zero
    assert not cost.has_gradients
    np.testing.assert_allclose(cost.values(batch), batch[:, 0] ** 2 + 3 * batch[:, 1] ** 2)
    plane.setStateValidityChecker(lambda state: True)
    drawn = 2 * np.random.default_rng(0).random((400, 2))[:50] - 1
    assert cost.slope(plane) == pytest.approx(np.median(np.hypot(2 * drawn[:, 0], 6 * drawn[:, 1])), rel=1e-6)


@pytest.mark.parametrize("length", [False, True])
def test_no_objective_and_path_length_cost_nothing(plane, rng, length):
    objective = ob.PathLengthOptimizationObjective(plane) if length else None
    cost = StateCost(objective, StateBridge(plane.getStateSpace()))
    batch = rng.uniform(-1, 1, (3, 2))
    assert cost.is_zero
    assert not cost.has_gradients
    np.testing.assert_array_equal(cost.values(batch), 0.0)
    assert cost.slope(plane) == 0.0


FIELDS = [
    *((name, {}) for name in ("ur5", "kinova", "slider")),
    *(("ur5", options) for options in ({"weighting": "length"}, {"aggregate": "mean"}, {"aggregate": "softmax"})),
]


@pytest.mark.parametrize(("name", "options"), FIELDS)
def test_no_configuration_is_less_dangerous_than_the_proven_minimum(robot_named, points, rng, name, options):
    robot = robot_named(name)
    field = DangerField(robot, points, **options)
    dangers = field.values(rng.uniform(robot.lower, robot.upper, (1000, robot.n)))
    assert 0 < field.minimum <= dangers.min()
    assert options or name == "slider" or field.minimum > 0.3 * dangers.min()


@pytest.mark.parametrize("planner", ["RRTstar", "InformedRRTstar", "SORRTstar", "BITstar"])
def test_optimising_planners_stop_when_asked(planner, ticks):
    setup = setup_scenario(Scenario.load("planar3"))
    setup.setOptimizationObjective(DangerObjective(setup.getSpaceInformation(), setup.field))
    result = setup.plan(planner, time=0.05, seed=2)
    assert 50 <= ticks.looks < 80
    assert result.status in ("Exact solution", "Approximate solution", "Timeout")
    assert not result or result.report.certified


@pytest.mark.parametrize("planner", ["RRTstar", "InformedRRTstar"])
def test_rrt_star_grows_the_same_tree_without_costs_that_it_does_not_need(planner):
    setup = setup_scenario(Scenario.load("planar2"))
    objective, trees, asked = setup.getOptimizationObjective(), [], []
    for method in (setup.solve, partial(og.SimpleSetup.solve, setup)):  # the second one asks for all costs
        iterations = count()
        before = setup.counts.field_configurations
        setup.prepare(planner, 0)
        method(ob.PlannerTerminationCondition(lambda iterations=iterations: next(iterations) > 200))
        asked.append(setup.counts.field_configurations - before)
        tree = ob.PlannerData(setup.getSpaceInformation())
        setup.getPlanner().getPlannerData(tree)
        vertices = range(tree.numVertices())
        trees.append([(tree.getVertex(k).getState()[0:2], sorted(tree.getEdges(k))) for k in vertices])
    assert len(trees[0]) > 50
    assert trees[0] == trees[1]
    assert asked[0] < 0.7 * asked[1]
    ends = [ScratchState(StateBridge(setup.getStateSpace())) for _ in range(2)]
    far = [scratch.set(q) for scratch, q in zip(ends, (setup.robot.lower, setup.robot.upper), strict=True)]
    assert objective.motionCost(*far).value() < np.inf
    with objective.asked_by(setup.getPlanner()):
        assert objective.motionCost(*far).value() == np.inf
    assert objective.motionCost(*far).value() < np.inf


# ------------------------------------------------ the scale of danger: measured once, and only where it has weight


@pytest.fixture
def setup():
    return setup_scenario(Scenario.load("planar3"))


def prepared(setup, name, **parameters):
    planner = make_planner(name, setup.getSpaceInformation(), parameters)
    planner.setProblemDefinition(setup.getProblemDefinition())
    planner.setup()
    return planner


def test_alpha_that_is_set_later_finds_its_scale(setup):
    late, early = prepared(setup, "SafeRRTConnect", alpha=0.0), prepared(setup, "SafeRRTConnect", alpha=2.0)
    late.setAlpha(2.0)
    for planner in (late, early):
        planner.setSeed(1)
        setup.getProblemDefinition().clearSolutionPaths()
        assert planner.solve(20.0).asString() == "Exact solution"
    np.testing.assert_array_equal(late.plannerGraph().configurations, early.plannerGraph().configurations)


def test_with_a_checker_of_ones_own_it_is_measured_again_by_each_planner():
    task = PlaneProblem(SafeRRTConnect, objective=SlopedHotSpot)
    task.walls.forbidden = lambda x, y: x * x + y * y < 0.5
    task.planner.setup()
    assert len(task.walls.asked) > 50


class Peak(ob.OptimizationObjective):
    """The largest cost of a state on a path, NaN on the left; better is larger."""

    def stateCost(self, state):
        return ob.Cost(state[1] if state[0] > 0 else math.nan)

    def motionCost(self, start, end):
        return self.stateCost(end)

    def initialCost(self, state):
        return self.stateCost(state)

    def combineCosts(self, first, second):
        return ob.Cost(max(first.value(), second.value()))

    def isCostBetterThan(self, first, second):
        return first.value() > second.value()


@pytest.mark.parametrize(("first", "cost"), [(0.1, 0.9), (-0.1, math.inf)])
def test_infinity_stands_for_nan_and_all_else_is_as_the_users_objective_says(first, cost):
    space = ob.RealVectorStateSpace(2)
    si = ob.SpaceInformation(space)
    own = Peak(si)
    finite, path = FiniteCosts(own), og.PathGeometric(si)
    for x, y in ((0.1, 0.9), (0.2, 0.3), (first, 0.5)):
        state = space.allocState()
        state[0:2] = [x, y]
        path.append(state)
    assert path.cost(finite).value() == pytest.approx(cost)
    assert math.isnan(own.stateCost(state).value()) == math.isinf(cost)
    assert finite.isCostBetterThan(ob.Cost(3.0), ob.Cost(2.0))
    assert finite.isSymmetric() == own.isSymmetric()
