"""The transition-based baselines: the test itself, cheaper paths than an RRT's, and what they refuse."""

import numpy as np
import pytest
from plane import EXACT, PlaneCost, PlaneProblem, dense

from safe_ompl import Scenario, UnknownNameError, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.baselines import TransitionTest
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
