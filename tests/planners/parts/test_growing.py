"""EXTEND: what is asked first of a candidate, its danger or whether the step to it is free."""

import pytest

from safe_ompl.planners.parts.growing import Extension
from safe_ompl.planners.rrt_connect import SafeRRTConnect
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.setup.from_scenario import setup_scenario


@pytest.fixture(scope="module")
def shelf():
    return setup_scenario(Scenario.load(find_scenario("panda_shelf")))


@pytest.mark.parametrize("dangerous", [0, 10])
def test_the_danger_of_blocked_steps_is_spared_where_danger_refuses_little(shelf, dangerous):
    planner = SafeRRTConnect(shelf.getSpaceInformation(), patience=0)
    assert shelf.plan(planner, time=30.0, seed=0)
    trees, step = planner._trees, planner._step
    step._is_free = lambda start, end: False
    trees.blocked, trees.dangerous = 10, dangerous
    planner._threshold.level = float("inf")
    target = planner._bridge.upper
    trees.start.gradient(0)  # so that it is known
    assert len(trees.start.costs)
    before = shelf.counts.copy()
    outcome, _ = step.extend(trees, trees.start, 0, target, 0.5)
    assert outcome is Extension.TRAPPED
    evaluated = (shelf.counts - before).field_configurations
    assert (evaluated > 0) == (dangerous > 0)
    assert trees.blocked > 10
