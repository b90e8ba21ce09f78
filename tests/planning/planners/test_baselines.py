"""The transition-based baselines: the test itself, cheaper paths than an RRT's, and what they refuse."""

import numpy as np
import pytest
from plane import EXACT, GOAL, HotSpot, PlaneCost, PlaneProblem, dense, wall_with_a_gap

from safe_ompl import InputError, Scenario, UnknownNameError, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.baselines import HRRT, TransitionTest
from safe_ompl.scene import find_scenario


class Hill(PlaneCost):
    """A hill in the middle of the plane, between start and goal."""

    def values(self, Q):
        return 0.1 + 10 * np.exp(-8 * (Q**2).sum(axis=1))


class Slope(Hill):
    """The same, with gradients."""

    def values_and_gradients(self, Q):
        rises = self.values(Q)
        return rises, -16 * Q * (rises - 0.1)[:, None]


def crossing(name, objective=Slope, seed=0, **parameters):
    """Return the problem of crossing an empty plane past the hill."""

    def planner(si, **parameters):
        return make_planner(name, si, parameters)

    return PlaneProblem(
        planner, objective=objective, starts=[(-0.9, 0.0)], goals=[(0.9, 0.0)], seed=seed, **parameters
    )


def highest(name, objective, seed):
    """Plan, and return the highest cost on the way."""
    task = crossing(name, objective, seed, range=0.15)
    assert task.solve(10.0) == EXACT
    return float(objective(task.si).values(dense(task.path)).max())


def test_downhill_steps_are_always_accepted_and_steep_ones_hardly():
    test = TransitionTest(np.random.default_rng(0), scale=1.0)
    assert all(test.accepts(2.0, 1.0, 0.1) for _ in range(100))
    assert not test.accepts(1.0, 2.0, 0.1)


def test_it_warms_up_until_the_step_is_taken_and_cools_down_again():
    test = TransitionTest(np.random.default_rng(0), scale=1.0)
    tries = next(k for k in range(10_000) if test.accepts(1.0, 2.0, 0.1))
    assert tries > 50
    again = next(k for k in range(10_000) if test.accepts(1.0, 2.0, 0.1))
    assert 0 < again < tries


@pytest.mark.parametrize("name", ["TRRT", "BiTRRT", "GradienTRRT"])
def test_paths_go_round_the_hill_that_an_rrt_climbs(name):
    dear, cheap = (
        [highest(planner, Slope, seed) for seed in range(5)] for planner in ("ClassicRRTConnect", name)
    )
    assert np.median(cheap) < 0.5 * np.median(dear)


def test_without_gradients_gradientrrt_is_bitrrt():
    values = [highest(name, Hill, 3) for name in ("BiTRRT", "GradienTRRT")]
    assert values[0] == values[1]


@pytest.mark.parametrize(("name", "option"), [("TRRT", "alpha"), ("BiTRRT", "slide")])
def test_they_have_no_parameters_without_effect(name, option):
    with pytest.raises(UnknownNameError, match=option):
        crossing(name, **{option: 1.0})


def test_the_baselines_are_safer_than_a_classical_planner_on_an_arm():
    setup = setup_scenario(Scenario.load(find_scenario("planar3")))
    plans = {
        name: [setup.plan(name, time=20.0, seed=seed) for seed in range(5)]
        for name in ("ClassicRRTConnect", "BiTRRT", "GradienTRRT")
    }
    assert all(map(all, plans.values()))
    dangers = {name: np.median([r.report.danger.mean for r in results]) for name, results in plans.items()}
    assert dangers["BiTRRT"] < dangers["ClassicRRTConnect"]
    assert dangers["GradienTRRT"] < dangers["ClassicRRTConnect"]


# ------------------------------------------------------------------------------------------------------------- hrrt


def problem(*task, **parameters):
    return PlaneProblem(HRRT, *task, **parameters)


def test_quality_falls_from_the_optimal_cost_to_the_dearest():
    task = problem(wall_with_a_gap, HotSpot, range=0.2)
    assert task.solve(10.0) == EXACT
    planner, graph = task.planner, task.planner.plannerGraph()
    parents = {child: parent for parent, child in graph.edges.tolist()}
    goal = np.array(GOAL)
    values = HotSpot(task.si).values
    usual = (values(graph.configurations[:1]) + values(goal[None]))[0] / 2
    costs = []
    for node in range(len(graph.configurations)):
        end, cost = graph.configurations[node], 0.0
        while node in parents:
            a, b = graph.configurations[[parents[node], node]]
            danger = values(np.array([a, b])).mean()
            cost += np.linalg.norm(b - a) * (1.0 + danger / usual)
            node = parents[node]
        costs.append(cost + np.linalg.norm(end - goal))
    optimal, dearest = np.linalg.norm(graph.configurations[0] - goal), max(costs)
    expected = [1.0 - (cost - optimal) / (dearest - optimal) for cost in costs]
    np.testing.assert_allclose([planner.quality(k) for k in range(len(costs))], expected, atol=1e-9)
    assert planner.quality(0) == 1.0
    assert min(expected) == pytest.approx(0.0)


def test_a_floor_of_one_is_an_rrt_and_a_low_one_finds_cheaper_ways():
    def mean_cost(floor):
        costs = []
        for seed in range(12):
            task = problem(lambda x, y: False, Hill, range=0.15, seed=seed, floor=floor, danger_weight=3.0)
            assert task.solve(10.0) == EXACT
            points = dense(task.path)
            steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
            costs.append(float(steps @ Hill(task.si).values(points[1:])))
        return float(np.mean(costs))

    assert mean_cost(0.05) < 0.9 * mean_cost(1.0)


@pytest.mark.parametrize(("key", "value"), [("floor", 1.5), ("danger_weight", -1.0), ("goal_bias", -0.1)])
def test_bad_parameters_are_refused(key, value):
    with pytest.raises(InputError, match=key):
        problem(**{key: value})
