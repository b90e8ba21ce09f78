"""The scale of danger: measured once for an objective and what is valid, and only where danger has weight."""

import numpy as np
import pytest
from plane import PlaneProblem, SlopedHotSpot

from safe_ompl import DangerField, SafeRRTConnect, Scenario, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario

SAFE = ["SafeRRTConnect", "SafePRM", "BubblePlanner"]


@pytest.fixture
def setup():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


@pytest.fixture
def batches(monkeypatch):
    """Return the sizes of the batches for which gradients of the danger are asked."""
    sizes = []
    original = DangerField.values_and_gradients

    def counted(self, Q):
        sizes.append(len(Q))
        return original(self, Q)

    monkeypatch.setattr(DangerField, "values_and_gradients", counted)
    return sizes


def prepared(setup, name, **parameters):
    planner = make_planner(name, setup.getSpaceInformation(), parameters)
    planner.setProblemDefinition(setup.getProblemDefinition())
    planner.setup()
    return planner


@pytest.mark.parametrize("name", SAFE)
def test_it_is_measured_once_for_all_planners(setup, batches, name):
    prepared(setup, name)
    assert max(batches) == 50
    batches.clear()
    for other in SAFE:
        prepared(setup, other)
    assert not batches


@pytest.mark.parametrize("name", ["ClassicRRTConnect", "ClassicPRM", "ClassicBubble"])
def test_a_classical_planner_needs_none(setup, batches, name):
    result = setup.plan(name, time=20.0)
    assert result
    assert result.counts.field_configurations == 0
    assert 50 not in batches


def test_alpha_that_is_set_later_finds_its_scale(setup):
    late, early = prepared(setup, "SafeRRTConnect", alpha=0.0), prepared(setup, "SafeRRTConnect", alpha=2.0)
    late.setAlpha(2.0)
    for planner in (late, early):
        planner.setSeed(1)
        setup.getProblemDefinition().clearSolutionPaths()
        assert planner.solve(20.0).asString() == "Exact solution"
    np.testing.assert_array_equal(late.plannerGraph().configurations, early.plannerGraph().configurations)


def test_another_distance_to_keep_has_a_scale_of_its_own(setup, batches):
    first = setup.plan("SafeRRTConnect", time=20.0, seed=1).path
    setup.setMinClearance(0.05)
    batches.clear()
    with_clearance = setup.plan("SafeRRTConnect", time=20.0, seed=1).path
    assert 50 in batches
    other = setup_scenario(Scenario.load(find_scenario("planar3")))
    other.setMinClearance(0.05)
    np.testing.assert_array_equal(other.plan("SafeRRTConnect", time=20.0, seed=1).path, with_clearance)
    batches.clear()
    prepared(setup, "SafePRM")
    assert not batches
    setup.setMinClearance(0.0)
    np.testing.assert_array_equal(setup.plan("SafeRRTConnect", time=20.0, seed=1).path, first)


def test_with_a_checker_of_ones_own_it_is_measured_again_by_each_planner():
    task = PlaneProblem(SafeRRTConnect, objective=SlopedHotSpot)
    task.walls.forbidden = lambda x, y: x * x + y * y < 0.5
    task.planner.setup()
    assert len(task.walls.asked) > 50
