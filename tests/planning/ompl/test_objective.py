"""Danger as OMPL's objective, and any objective as the cost that planners read."""

from functools import partial
from itertools import count, pairwise

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import DangerField, DangerObjective, InputError, Pose, Scenario, Scene, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import ScratchState, StateBridge, StateCost, joint_space
from safe_ompl.scene import find_scenario


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


@pytest.fixture(scope="module", params=["ur5", "kinova"])
def setting(request, robot_named, points):
    robot = robot_named(request.param)
    si = ob.SpaceInformation(joint_space(robot))
    return si, DangerField(robot, points), StateBridge(si.getStateSpace())


def test_cost_of_a_state_is_its_danger(setting, rng):
    si, field, bridge = setting
    objective, scratch = DangerObjective(si, field), ScratchState(bridge)
    for q in rng.uniform(bridge.lower, bridge.upper, (5, bridge.n)):
        assert objective.stateCost(scratch.set(q)).value() == pytest.approx(field.value(q))


@pytest.mark.parametrize("tolerance", [0.01, 0.001])
def test_cost_of_a_motion_is_the_integral_of_the_danger(setting, rng, tolerance):
    si, field, bridge = setting
    objective = DangerObjective(si, field, tolerance=tolerance)
    first, second = ScratchState(bridge), ScratchState(bridge)
    for q1, q2 in rng.uniform(bridge.lower, bridge.upper, (5, 2, bridge.n)):
        delta = bridge.difference(q1, q2)
        t = np.linspace(0, 1, 2001)
        exact = np.trapezoid(field.values(q1 + t[:, None] * delta), t) * np.linalg.norm(delta)
        cost = objective.motionCost(first.set(q1), second.set(q2)).value()
        assert cost == pytest.approx(exact, rel=tolerance)
        assert objective.motionCost(second.set(q2), first.set(q1)).value() == cost
    assert objective.motionCost(first.set(q1), second.set(q1)).value() == 0


def test_a_motion_that_is_asked_for_again_costs_no_evaluation_until_the_points_move(setting, rng):
    si, _, bridge = setting
    robot = setting[1].robot
    ball = {"name": "ball", "sphere": {"radius": 0.1}, "position": [0.6, 0.2, 0.5], "weight": 1}
    scene = Scene.from_mapping({"obstacles": [ball]})
    field = DangerField.of_scene(robot, scene)
    objective = DangerObjective(si, field)
    first, second = ScratchState(bridge), ScratchState(bridge)
    ends = [scratch.set(q) for scratch, q in zip((first, second), rng.uniform(-1, 1, (2, bridge.n)), strict=True)]
    cost = objective.motionCost(*ends).value()
    before = field.counts.field_configurations
    assert objective.motionCost(*reversed(ends)).value() == cost
    assert field.counts.field_configurations == before
    field.move(scene.moved({"ball": Pose([0.6, 0.2, 0.8])}))
    moved = objective.motionCost(*ends).value()
    assert moved != cost
    assert moved == DangerObjective(si, field).motionCost(*ends).value()


def test_danger_points_that_depend_on_the_configuration_are_integrated_too(setting, points, rng):
    si, field, bridge = setting
    objective = DangerObjective(si, DangerField(field.robot, lambda q: points))
    first, second = ScratchState(bridge), ScratchState(bridge)
    ends = [scratch.set(q) for scratch, q in zip((first, second), rng.uniform(-1, 1, (2, bridge.n)), strict=True)]
    expected = DangerObjective(si, field).motionCost(*ends).value()
    assert objective.motionCost(*ends).value() == pytest.approx(expected, rel=0.01)


def test_ompl_sums_it_over_a_path(setting, rng):
    si, field, bridge = setting
    objective, scratch = DangerObjective(si, field), ScratchState(bridge)
    path, corners = og.PathGeometric(si), rng.uniform(bridge.lower, bridge.upper, (3, bridge.n))
    for q in corners:
        path.append(scratch.set(q))
    first, second = ScratchState(bridge), ScratchState(bridge)
    expected = sum(objective.motionCost(first.set(q1), second.set(q2)).value() for q1, q2 in pairwise(corners))
    assert path.cost(objective).value() == pytest.approx(expected)


def test_danger_is_read_in_batches_with_gradients(setting, rng):
    si, field, bridge = setting
    cost = StateCost(DangerObjective(si, field), bridge)
    batch = rng.uniform(bridge.lower, bridge.upper, (4, bridge.n))
    assert not cost.is_zero
    assert cost.has_gradients
    np.testing.assert_allclose(cost.values(batch), field.values(batch))
    gradients = field.gradients(batch)
    np.testing.assert_allclose(cost.gradient_norms(batch), np.linalg.norm(gradients, axis=1))
    value, gradient = cost.value_and_gradient(batch[2])
    assert value == pytest.approx(field.value(batch[2]))
    np.testing.assert_allclose(gradient, gradients[2])


def test_any_objective_is_read_state_by_state(plane, rng):
    cost = StateCost(Squares(plane), StateBridge(plane.getStateSpace()))
    batch = rng.uniform(-1, 1, (6, 2))
    assert not cost.is_zero
    assert not cost.has_gradients
    np.testing.assert_allclose(cost.values(batch), batch[:, 0] ** 2 + 3 * batch[:, 1] ** 2)
    exact = np.hypot(2 * batch[:, 0], 6 * batch[:, 1])
    np.testing.assert_allclose(cost.gradient_norms(batch), exact, rtol=1e-6)


@pytest.mark.parametrize("length", [False, True])
def test_no_objective_and_path_length_cost_nothing(plane, rng, length):
    objective = ob.PathLengthOptimizationObjective(plane) if length else None
    cost = StateCost(objective, StateBridge(plane.getStateSpace()))
    batch = rng.uniform(-1, 1, (3, 2))
    assert cost.is_zero
    assert not cost.has_gradients
    np.testing.assert_array_equal(cost.values(batch), 0.0)
    np.testing.assert_array_equal(cost.gradient_norms(batch), 0.0)


def test_no_configuration_is_less_dangerous_than_the_proven_minimum(setting, rng):
    _, field, bridge = setting
    dangers = field.values(rng.uniform(bridge.lower, bridge.upper, (3000, bridge.n)))
    assert 0.3 * dangers.min() < field.minimum <= dangers.min()


@pytest.mark.parametrize("options", [{"weighting": "length"}, {"aggregate": "mean"}, {"aggregate": "softmax"}])
def test_the_minimum_holds_for_other_fields_too(ur5, points, rng, options):
    field = DangerField(ur5, points, **options)
    assert 0 < field.minimum <= field.values(rng.uniform(ur5.lower, ur5.upper, (1000, 6))).min()


def test_the_minimum_holds_for_prismatic_joints(robot_named, points, rng):
    slider = robot_named("slider")
    field = DangerField(slider, points)
    assert 0 < field.minimum <= field.values(rng.uniform(slider.lower, slider.upper, (1000, slider.n))).min()


def test_the_heuristic_never_exceeds_the_cost_of_a_motion(setting, rng):
    si, field, bridge = setting
    objective = DangerObjective(si, field)
    first, second = ScratchState(bridge), ScratchState(bridge)
    for q1, q2 in rng.uniform(bridge.lower, bridge.upper, (20, 2, bridge.n)):
        ends = first.set(q1), second.set(q2)
        assert objective.motionCostHeuristic(*ends).value() <= objective.motionCost(*ends).value()


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), "fine"])
def test_the_tolerance_must_be_positive(setting, value):
    si, field, _ = setting
    with pytest.raises(InputError, match="tolerance"):
        DangerObjective(si, field, tolerance=value)


@pytest.mark.parametrize("planner", ["RRTstar", "InformedRRTstar", "SORRTstar", "BITstar"])
def test_optimising_planners_stop_when_asked(planner, ticks):
    setup = setup_scenario(Scenario.load(find_scenario("planar3")))
    setup.setOptimizationObjective(DangerObjective(setup.getSpaceInformation(), setup.field))
    result = setup.plan(planner, time=0.05, seed=2)
    assert 50 <= ticks.looks < 80
    assert result.status in ("Exact solution", "Approximate solution", "Timeout")
    assert not result or result.report.certified


@pytest.mark.parametrize("planner", ["PRM", "PRMstar", "AORRTC", "FMT", "BFMT"])
def test_planners_that_would_hang_or_crash_are_refused(setting, planner):
    with pytest.raises(InputError, match=f"OMPL's {planner} cannot be used"):
        make_planner(planner, setting[0])


@pytest.mark.parametrize("planner", ["RRTstar", "InformedRRTstar"])
def test_rrt_star_grows_the_same_tree_without_costs_that_it_does_not_need(planner):
    setup = setup_scenario(Scenario.load(find_scenario("planar2")))
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
