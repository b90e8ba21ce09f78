"""Planners of OMPL's that hang or crash with callbacks in Python are refused, whichever way they come in."""

import _thread
import re
import threading
from time import sleep

import numpy as np
import pytest
from ompl import geometric as og
from plane import PlaneProblem

import safe_ompl
from safe_ompl import Benchmark, InputError, PlanningError, SafeSetup, Scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import FunctionPlanner
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


# ---------------------------------------------------------------------------------------------------- functions


def straight(robot, scene, start, goal):
    """Stand in for a planner that computes in single precision and does not see what it touches."""
    assert robot.n == len(start) == len(goal)
    assert "machine" in scene.names
    return np.array([start, start, goal], dtype=np.float32)


@pytest.mark.parametrize("options", [{}, {"simplify": True}, {"starts": 2}])
def test_a_function_plans_and_its_path_is_repaired_and_proven(setup, options, tmp_path):
    start, goal = setup.query.start, setup.query.goals[0]
    assert not setup.is_free([start, goal]), "it touches"
    result = setup.plan(straight, time=20.0, seed=1, **options)
    assert result.certified
    assert result.planner == "straight"
    np.testing.assert_allclose(result.path[[0, -1]], [start, goal], atol=1e-12)
    assert result.repaired.startswith("planned, by at most")
    assert f"path of straight: {result.repaired}; proven" in str(result)
    safe_ompl.save(result, tmp_path / "r.json")
    assert safe_ompl.load(tmp_path / "r.json").repaired == result.repaired
    again = setup.plan(lambda *asked: result.path, time=20.0)
    assert (again.repaired, again.certified) == ("unchanged", True)
    if not options:
        np.testing.assert_allclose(again.path, result.path, atol=1e-12)


def test_a_scenario_is_planned_by_a_function_under_all_its_limits(setup):
    refuses = SafeSetup(setup.robot, setup.scene, danger=None)
    refuses.setConfigurations(setup.query.start, setup.query.goals)
    before = refuses.plan(straight, time=20.0, seed=1)
    middle = before.path[len(before.path) // 2]
    refuses.setStateValidityChecker(lambda state: bool(np.linalg.norm(np.array(state[0:2]) - middle) > 0.1))
    result = refuses.plan(lambda *asked: before.path, time=20.0, seed=1)
    assert result.certified
    assert result.repaired == "planned anew, as the state validity checker refuses it"
    assert refuses.is_free(result.path)
    assert not refuses.is_free(before.path)
    assert safe_ompl.plan("planar2", planner=straight, time=20.0).certified


NO_PATHS = [
    (lambda start, goal: [start], InputError, "way points of <lambda> must be two or more, got 1"),
    (lambda start, goal: [start[:1], goal[:1]], InputError, "way points of <lambda>: must have shape"),
    (lambda start, goal: [start, np.full(2, np.nan), goal], InputError, "way points of <lambda>: must be finite"),
    (lambda start, goal: [start + 0.1, goal], PlanningError, "<lambda> returned a path that begins 0.1 rad away"),
    (lambda start, goal: [start, goal - 0.1], PlanningError, "<lambda> returned a path that ends 0.1 rad away"),
]


@pytest.mark.parametrize(("found", "error", "message"), NO_PATHS)
def test_what_is_no_path_of_a_function_is_refused(setup, found, error, message):
    with pytest.raises(error, match=re.escape(message)):
        setup.plan(lambda robot, scene, start, goal: found(start, goal), time=5.0)


def test_a_function_without_a_path_has_none(setup, caplog):
    assert not setup.plan(lambda *asked: None, time=5.0)

    def late(robot, scene, start, goal):
        sleep(0.03)
        return [start, goal]

    assert not setup.plan(late, time=0.02)
    assert "late: the path is not proven: nothing near it could be proven, and no way round was found" in caplog.text
    with pytest.raises(InputError, match="needs a CollisionFreeValidity"):
        PlaneProblem(lambda si: FunctionPlanner(si, straight)).solve()
    with pytest.raises(InputError, match="function must be a function of robot, scene, start and goal, got 3"):
        FunctionPlanner(setup.getSpaceInformation(), 3)
