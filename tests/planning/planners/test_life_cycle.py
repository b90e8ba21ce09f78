"""The life of planners and setups: solving again, clearing, other problems, threads, processes, and their ends."""

from __future__ import annotations

import gc
import multiprocessing
import pickle
import threading
import weakref

import numpy as np
import pytest
from ompl import base as ob
from ompl import util as ou

from safe_ompl import SafeSetup, Scenario, make_planner, planner_names
from safe_ompl.planning.planners import is_ours, needs_place
from safe_ompl.scene import find_scenario

OURS = [name for name in planner_names() if is_ours(name)]
SAFE = [name for name in OURS if not name.startswith("Classic")]
MOTION = np.array([0.4, 0.2, -0.15])  # short enough for every planner to find in no time


def load():
    return Scenario.load(find_scenario("planar3"))


def build(planner, scenario=None):
    scenario = scenario or load()
    setup = SafeSetup(scenario.build_robot(), scenario.scene)
    start = scenario.start_configuration(setup.robot)
    if needs_place(planner):
        setup.setStartConfiguration(start)
        setup.setWorkspaceGoal(setup.robot.tip_pose(start + MOTION).translation)
    else:
        setup.setConfigurations(start, start + MOTION)
    return setup


def solved(setup):
    assert setup.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    path = setup.solution()
    assert setup.report(path).certified
    return path


def with_planner(name, seed=0):
    setup = build(name)
    planner = make_planner(name, setup.getSpaceInformation())
    planner.setSeed(seed)
    setup.setPlanner(planner)
    return setup, planner


def rows(graph):
    return {q.tobytes() for q in graph.configurations}


def path_of(planner, seed, scenario=None):
    return build(planner, scenario).plan(planner, time=20.0, seed=seed).path


def send_path(pipe, planner, seed):
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    pipe.send(path_of(planner, seed))


# ------------------------------------------------------------------------------------------------ solving again


@pytest.mark.parametrize("name", OURS)
def test_solving_again_goes_on_with_what_there_is(name):
    setup, planner = with_planner(name)
    solved(setup)
    before = rows(planner.plannerGraph())
    solved(setup)
    assert before <= rows(planner.plannerGraph())


@pytest.mark.parametrize("name", OURS)
def test_clear_forgets(name):
    setup, planner = with_planner(name)
    solved(setup)
    setup.clear()
    assert not setup.haveSolutionPath()
    assert rows(planner.plannerGraph()) == set()
    assert planner.counts.nodes == 0
    solved(setup)


@pytest.mark.parametrize("name", OURS)
def test_after_clear_query_the_query_is_taken_again(name):
    setup, planner = with_planner(name)
    solved(setup)
    planner.clearQuery()
    setup.getProblemDefinition().clearSolutionPaths()
    solved(setup)


@pytest.mark.parametrize("name", OURS)
def test_another_problem(name):
    setup, _ = with_planner(name)
    solved(setup)
    start = load().start_configuration(setup.robot) + np.array([0.05, 0.05, 0.0])
    setup.clear()
    if needs_place(name):
        setup.setStartConfiguration(start)
    else:
        setup.setConfigurations(start, start + MOTION)
    path = solved(setup)
    np.testing.assert_array_equal(path[0], start)
    if not needs_place(name):
        np.testing.assert_array_equal(path[-1], start + MOTION)


# --------------------------------------------------------------------------------------------------------- ends


@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize("first", ["planner", "setup"])
def test_any_order_of_ends(name, first):
    setup, planner = with_planner(name)
    path = solved(setup)
    if first == "planner":
        del planner
        gc.collect()
        solved(setup)
        del setup
    else:
        del setup
        gc.collect()
        assert len(planner.plannerGraph().configurations)
        planner.clear()
        del planner
    gc.collect()
    assert len(path) >= 2


@pytest.mark.parametrize("name", OURS)
def test_a_planner_is_freed_as_soon_as_nobody_holds_it(name):
    planner = make_planner(name, build(name).getSpaceInformation())
    part = weakref.ref(planner.counts)
    gc.disable()
    try:
        del planner
        assert part() is None
    finally:
        gc.enable()


# ------------------------------------------------------------------------ the same seed, the same path, wherever


@pytest.mark.parametrize("name", OURS)
def test_in_any_order_and_in_two_setups_at_once(name):
    one, other = build(name), build(name)
    first = [setup.plan(name, time=20.0, seed=seed).path for setup, seed in ((one, 1), (other, 2), (one, 3))]
    again = [setup.plan(name, time=20.0, seed=seed).path for setup, seed in ((other, 3), (one, 2), (one, 1))]
    for path, same in zip(first, again[::-1], strict=True):
        np.testing.assert_array_equal(path, same)


@pytest.mark.parametrize("name", SAFE)
def test_in_threads(name):
    expected = [path_of(name, seed) for seed in (1, 2)]
    found: dict[int, np.ndarray] = {}

    def work(seed):
        found[seed] = path_of(name, seed)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    for seed, path in zip((1, 2), expected, strict=True):
        np.testing.assert_array_equal(found[seed], path)


@pytest.mark.parametrize("name", SAFE)
def test_in_a_process_that_is_forked(name):
    np.testing.assert_array_equal(path_in_process("fork", name), path_of(name, 4))


def test_in_a_process_that_is_spawned():
    np.testing.assert_array_equal(path_in_process("spawn", "SafePRM"), path_of("SafePRM", 4))


def path_in_process(method, name):
    context = multiprocessing.get_context(method)
    ours, theirs = context.Pipe()
    process = context.Process(target=send_path, args=(theirs, name, 4))
    process.start()
    theirs.close()
    path = ours.recv()
    process.join(60)
    assert process.exitcode == 0
    return path


@pytest.mark.parametrize("name", SAFE)
def test_from_a_problem_that_was_pickled(name):
    scenario = load()
    travelled = pickle.loads(pickle.dumps(scenario))
    np.testing.assert_array_equal(path_of(name, 5, travelled), path_of(name, 5, scenario))
    robot, scene = (pickle.loads(pickle.dumps(part)) for part in (scenario.build_robot(), scenario.scene))
    assert robot.joint_names == scenario.build_robot().joint_names
    assert scene == scenario.scene
