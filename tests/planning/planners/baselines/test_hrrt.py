"""HRRT: the quality of nodes as Urmson and Simmons define it, its floor, and cheaper paths than an RRT's."""

from itertools import pairwise

import numpy as np
import pytest
from plane import EXACT, TIMEOUT, HotSpot, PlaneCost, PlaneProblem, dense, wall_with_a_gap, walled_in

from safe_ompl import InputError
from safe_ompl.planning.planners.baselines import HRRT


class Hill(PlaneCost):
    """A hill in the middle of the plane, between start and goal."""

    def values(self, Q):
        return 0.1 + 10 * np.exp(-8 * (Q**2).sum(axis=1))


def problem(*task, **parameters):
    return PlaneProblem(HRRT, *task, **parameters)


@pytest.mark.parametrize("objective", [None, HotSpot])
def test_it_finds_the_gap(objective):
    task = problem(wall_with_a_gap, objective, range=0.2)
    assert task.solve(10.0) == EXACT
    assert all(task.si.isValid(task.state(q)) for q in dense(task.path))


def test_it_gives_up_when_time_is_up():
    assert problem(walled_in).solve(0.3) == TIMEOUT


def test_quality_falls_from_the_optimal_cost_to_the_dearest():
    task = problem(wall_with_a_gap, HotSpot, range=0.2)
    assert task.solve(10.0) == EXACT
    planner, tree = task.planner, task.planner._trees.start
    goal = planner._trees.goal.configurations[0]
    values = HotSpot(task.si).values
    usual = (values(tree.configurations[:1]) + values(goal[None]))[0] / 2
    costs = []
    for node in range(len(tree)):
        way, cost = tree.branch(node), 0.0
        for a, b in pairwise(way):
            danger = values(np.array([a, b])).mean()
            cost += np.linalg.norm(b - a) * (1.0 + danger / usual)
        costs.append(cost + np.linalg.norm(way[-1] - goal))
    optimal, dearest = np.linalg.norm(tree.configurations[0] - goal), max(costs)
    expected = [1.0 - (cost - optimal) / (dearest - optimal) for cost in costs]
    np.testing.assert_allclose([planner.quality(k) for k in range(len(tree))], expected, atol=1e-9)
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


def test_same_seed_same_path():
    first, again = (problem(wall_with_a_gap, HotSpot, seed=4) for _ in range(2))
    assert first.solve(10.0) == again.solve(10.0) == EXACT
    np.testing.assert_array_equal(first.path, again.path)


@pytest.mark.parametrize(("key", "value"), [("floor", 1.5), ("danger_weight", -1.0), ("goal_bias", -0.1)])
def test_bad_parameters_are_refused(key, value):
    with pytest.raises(InputError, match=key):
        problem(**{key: value})
