"""Planners of OMPL's that hang or crash with callbacks in Python are refused, whichever way they come in."""

import _thread
import threading

import pytest
from ompl import geometric as og

from safe_ompl import Benchmark, InputError, Scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.registry import _REFUSED

WAYS = {
    "plan": lambda setup, kind: setup.plan(kind(setup.getSpaceInformation())),
    "optimise": lambda setup, kind: setup.plan(kind(setup.getSpaceInformation()), optimise=1.0),
    "setPlanner": lambda setup, kind: setup.setPlanner(kind(setup.getSpaceInformation())),
    "setPlannerAllocator": lambda setup, kind: (setup.setPlannerAllocator(kind), setup.solve(1.0)),
    "addPlanner": lambda setup, kind: Benchmark(setup).addPlanner(kind(setup.getSpaceInformation())),
    "addPlannerAllocator": lambda setup, kind: Benchmark(setup).addPlannerAllocator(kind),
}


@pytest.fixture
def setup():
    return setup_scenario(Scenario.load("planar2"))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", sorted(set(_REFUSED) - {"AORRTC"}))  # whose destruction alone ends the process
def test_planners_that_would_hang_or_crash_are_refused(setup, name, way):
    class Own(getattr(og, name)):
        pass

    for kind in (getattr(og, name), Own):
        with pytest.raises(InputError, match=f"OMPL's {name} cannot be used from Python"):
            WAYS[way](setup, kind)
    assert setup.plan(time=20.0), "the setup is as good as before"


@pytest.mark.parametrize("planner", [3, None, "RRTConnect", og.RRTConnect])
def test_what_is_no_planner_is_refused(setup, planner):
    with pytest.raises(InputError, match="planner"):
        setup.setPlanner(planner)


def test_other_planners_are_taken(setup):
    setup.setPlanner(og.RRTConnect(setup.getSpaceInformation()))
    assert setup.solve(20.0)
    setup = setup_scenario(Scenario.load("planar2"))
    setup.setPlannerAllocator(og.RRTConnect)
    assert setup.solve(20.0)
    assert setup.getPlanner().getName() == "RRTConnect"


@pytest.mark.parametrize("known", [True, False])
def test_an_objective_that_a_thread_of_ompls_own_asks_says_what_happens(setup, caplog, known):
    """PRM's thread, which Python does not know, waits for ever: all that can be done is to say so."""
    objective, over = setup.getOptimizationObjective(), threading.Event()
    state = setup.getStateSpace().allocState()

    def ask():
        objective.motionCostHeuristic(state, state)
        over.set()

    if known:
        threading.Thread(target=ask).start()
    else:
        _thread.start_new_thread(ask, ())
    assert over.wait(60.0)
    assert ("take SafePRM" in caplog.text) is not known
