"""`plan(cost="duration")`: paths that are driven in less time, simplified, optimised, or of OMPL's planners."""

from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import DangerObjective, DurationObjective, InputError, People, Scenario, UnknownNameError
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import MotionLimits, find_scenario
from safe_ompl.trajectories import duration_of


@pytest.fixture(scope="module")
def setup():
    scenario = Scenario.load(find_scenario("panda_shelf"))
    motion = MotionLimits(acceleration=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0))
    return setup_scenario(replace(scenario, motion=motion, people=People()))


def test_optimised_for_duration_a_path_is_driven_in_less_time(setup):
    safe = setup.plan(seed=0, simplify=True)
    fast = setup.plan(seed=0, optimise=3.0, cost="duration")
    assert fast.certified
    assert duration_of(setup.timer, fast.path, 400) < duration_of(setup.timer, safe.path, 400)
    costs = [improvement.cost for improvement in fast.improvements]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] == pytest.approx(fast.timed(setup.timer.limits, people=People()).duration)


def test_simplified_for_duration(setup):
    plain = setup.plan(seed=1)
    fast = setup.plan(seed=1, time=1.5, simplify=True, cost="duration")
    assert fast.certified
    np.testing.assert_allclose(fast.path[[0, -1]], plain.path[[0, -1]])
    assert duration_of(setup.timer, fast.path) <= duration_of(setup.timer, plain.path)


def test_planners_of_ompl_get_the_objective_and_give_it_back(setup, monkeypatch):
    set_to, plain = [], setup.setOptimizationObjective
    monkeypatch.setattr(
        setup, "setOptimizationObjective", lambda objective: (set_to.append(objective), plain(objective))
    )
    result = setup.plan("RRTstar", seed=0, time=0.5, cost="duration")
    assert result.path is not None
    assert isinstance(set_to[0], DurationObjective)
    assert isinstance(setup.getOptimizationObjective(), DangerObjective)


def test_what_is_no_cost_or_lacks_limits_is_refused(setup):
    with pytest.raises(UnknownNameError, match="unknown cost 'beauty'"):
        setup.plan(cost="beauty")
    setup.setMotionLimits(MotionLimits(velocity={"nobody": 1.0}))
    with pytest.raises(InputError, match="nobody"):
        setup.plan(cost="duration")
