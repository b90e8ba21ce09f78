"""What every planner of the package promises, whatever its algorithm."""

import gc
import resource
import weakref
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
import pytest
from ompl import base as ob, geometric as og, util as ou
from planar import begun, build, solved

from safe_ompl import Cylinder, Obstacle, Pose, Robot, SafeSetup, Scene
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import SafeRRTConnect, is_ours, make_planner, needs_place, planner_data, planner_names
from safe_ompl.planning.planners.problem import Margin
from safe_ompl.planning.planners.roadmap import Roadmap
from safe_ompl.robot import OwnState

OURS = [name for name in planner_names() if is_ours(name)]
SAFE = [name for name in OURS if not name.startswith("Classic")]
LARGE = 10.0  # [m]; no motion of an arm keeps so much from a floor


def rows(planner):
    return {q.tobytes() for q in planner.plannerGraph().configurations}


def path_of(planner, seed):
    return build()[0].plan(planner, time=20.0, seed=seed).path


# ------------------------------------------------------------------------------------------------ paths and life


@pytest.mark.parametrize("planner", OURS)
def test_finds_a_proven_path_from_start_to_goal_the_same_for_the_same_seed(planar3, scenario, planner):
    result, _, again = (planar3.plan(planner, time=20.0, seed=seed) for seed in (5, 6, 5))
    assert result.report.certified
    np.testing.assert_array_equal(result.path, again.path)
    np.testing.assert_array_equal(result.path[0], scenario.start_configuration(planar3.robot))
    if needs_place(planner):
        tip = planar3.robot.tip_pose(result.path[-1]).translation
        assert np.linalg.norm(tip - scenario.goal.position) <= scenario.goal.tolerance
    else:
        np.testing.assert_array_equal(result.path[-1], scenario.goal_configurations(planar3.robot)[0])


@pytest.mark.parametrize("name", OURS)
def test_solving_again_goes_on_and_clearing_forgets(name):
    setup, _ = begun(name)
    planner = setup.getPlanner()
    before = rows(planner)
    solved(setup, name)
    assert before <= rows(planner)
    planner.clearQuery()
    setup.getProblemDefinition().clearSolutionPaths()
    solved(setup, name)
    setup.clear()
    assert not setup.haveSolutionPath()
    assert rows(planner) == set()
    assert planner.counts.nodes == 0
    solved(setup, name)


@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize("first", ["planner", "setup"])
def test_any_order_of_ends(name, first):
    setup, _ = begun(name)
    planner, path = setup.getPlanner(), setup.solution()
    if first == "planner":
        del planner
        gc.collect()
        solved(setup, name)
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
    planner = make_planner(name, build()[0].getSpaceInformation())
    part = weakref.ref(planner.counts)
    gc.disable()
    try:
        del planner
        assert part() is None
    finally:
        gc.enable()


# ------------------------------------------------------------------------ the same seed, the same path, wherever


def path_after(before, name, seed):
    """Return a path, after distances were asked for in a scenario, if one is named."""
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    if before:
        setup_scenario(before).checker.pair_distances([0.3, 0.2])
    return path_of(name, seed)


def in_process(method, *arguments):
    with ProcessPoolExecutor(1, get_context(method)) as pool:
        return pool.submit(path_after, *arguments).result()


@pytest.mark.parametrize("name", SAFE)
def test_in_threads_and_in_a_process_that_is_forked(name):
    with ThreadPoolExecutor(2) as pool:
        found = [*pool.map(partial(path_of, name), (1, 2))]
    np.testing.assert_array_equal(in_process("fork", "", name, 1), found[0])
    for seed, path in zip((1, 2), found, strict=True):
        np.testing.assert_array_equal(path, path_of(name, seed))


def test_in_a_process_that_is_spawned_whatever_was_asked_before():
    path = in_process("spawn", "planar2", "BubblePlanner", 4)
    np.testing.assert_array_equal(path, path_of("BubblePlanner", 4))


# ----------------------------------------------------------------------------------------- what cannot be solved


@pytest.mark.parametrize("planner", OURS)
def test_behind_a_wall_time_is_up_and_memory_stays_bounded(arm_between_walls, planner):
    setup = arm_between_walls
    if needs_place(planner):
        setup = SafeSetup(setup.robot, setup.scene, danger=None)
        setup.setStartConfiguration([0.0, 0.0])
        setup.setWorkspaceGoal(setup.robot.tip_pose(np.array([3.0, 0.0])).translation)
    setup.plan(planner, time=0.05)  # loads kernels
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    result = setup.plan(planner, time=0.25)
    assert not result
    assert (result.status, result.path) == ("Approximate solution", None)
    assert setup.is_free(setup.solution())
    if not needs_place(planner):
        left = np.linalg.norm(setup.solution()[-1] - [3.0, 0.0])
        assert setup.getProblemDefinition().getSolutionDifference() == pytest.approx(left)
        assert left < 3.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50 * 1024


# ------------------------------------------------------------------------------------------- what has been built


@pytest.mark.parametrize("name", OURS)
def test_the_graph_and_its_edges_also_as_ompls_data(planar3, name):
    path = planar3.plan(name, time=20.0, seed=1).path
    graph = planar3.getPlanner().plannerGraph()
    np.testing.assert_array_equal(graph.configurations[graph.starts], path[:1])
    np.testing.assert_array_equal(graph.configurations[graph.goals], path[-1:])
    some = np.linspace(0, len(graph.edges) - 1, 50).astype(int)
    assert all(planar3.is_free(ends) for ends in graph.configurations[graph.edges[some]])
    if "RRTConnect" in name:
        edges = {tuple(map(bytes, ends)) for ends in graph.configurations[graph.edges]}
        assert {(bytes(start), bytes(end)) for start, end in pairwise(path)} <= edges
    data = ob.PlannerData(planar3.getSpaceInformation())
    for _ in range(2):  # filling it anew forgets what was there
        planar3.getPlannerData(data)
    planar3.getPlanner().clear()  # the data keeps its own copies
    assert planner_data(planar3.getPlanner()).numVertices() == 0
    assert (data.numVertices(), data.numEdges()) == (len(graph.configurations), len(graph.edges))
    assert {data.getStartIndex(k) for k in range(data.numStartVertices())} == {*graph.starts.tolist()}
    assert {data.getGoalIndex(k) for k in range(data.numGoalVertices())} == {*graph.goals.tolist()}
    for k, q in enumerate(graph.configurations):
        assert data.getVertex(k).getState()[0 : len(q)] == q.tolist()
    assert all(data.edgeExists(start, end) for start, end in graph.edges.tolist())
    assert data.printGraphML().count("<node") == len(graph.configurations)


def test_states_for_ompls_data_are_used_again(planar3):
    planar3.plan("SafeRRTConnect", time=20.0, seed=1)
    unused = OwnState(planar3.bridge)._unused
    kept = []
    for _ in range(3):
        planar3.getPlannerData(ob.PlannerData(planar3.getSpaceInformation()))
        gc.collect()
        kept.append(len(unused))
    assert kept[0] == kept[1] == kept[2] >= len(planar3.getPlanner().plannerGraph().configurations)


def test_where_ompl_asks_in_vain_one_warning_says_so(planar3, caplog):
    planner = SafeRRTConnect(planar3.getSpaceInformation())
    plain = og.SimpleSetup(planar3.getSpaceInformation())
    own = og.RRTConnect(plain.getSpaceInformation())
    plain.setPlanner(own)
    assert planner_data(own).numVertices() == 0
    plain.setPlanner(planner)
    planner_data(planner)  # also before there is anything
    planar3.setPlanner(planner)
    planar3.getPlannerData(ob.PlannerData(planar3.getSpaceInformation()))
    assert not caplog.records, "these fill it"
    for _ in range(2):
        data = ob.PlannerData(planar3.getSpaceInformation())
        plain.getPlannerData(data)
        assert data.numVertices() == 0
    planner.getPlannerData(data)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "call safe_ompl.planner_data(planner), or take SafeSetup and safe_ompl.Benchmark" in caplog.text


# --------------------------------------------------------------------------- clearance of all obstacles, and danger


# Least clearance [m] of paths around a pillar, which start and goal are far from. SafePRM takes edges that keep less
# than the margin of 50 mm with a penalty, and SafeJTRRT lowers the margin after a few trapped steps.
LEAST = {"SafeRRTConnect": 0.045, "SafePRM": 0.03, "SafeJTRRT": 0.04, "BubblePlanner": 0.05}


@pytest.mark.parametrize("weight", [0.0, 1.0, None])
@pytest.mark.parametrize(("name", "least"), LEAST.items())
def test_every_safe_planner_keeps_a_margin_with_danger_and_without(name, least, weight):
    setup = beside_a_pillar(weight)
    runs = [setup.plan(name, time=30.0, seed=seed) for seed in range(1 if name == "BubblePlanner" else 8)]
    assert min(run.report.clearance.min for run in runs) > least
    simplified = setup.plan(name, time=30.0, seed=0, simplify=True)
    assert simplified.report.clearance.min > runs[0].report.clearance.min - 1.1e-4
    assert simplified.report.length <= runs[0].report.length


def test_what_plans_classically_keeps_no_margin():
    setup = beside_a_pillar(0.0)
    for name in ("ClassicRRTConnect", "RRTConnect"):
        assert min(setup.plan(name, time=30.0, seed=seed).report.clearance.min for seed in range(8)) < 0.03


def beside_a_pillar(weight):
    """Return a setup of an arm that is to turn from one side of a pillar to the other; without danger if None."""
    pillar = Obstacle("pillar", Cylinder(0.06, 1.2), Pose((0.55, 0.0, 0.6)), weight=weight or 0.0)
    setup = SafeSetup(Robot.from_example("ur5"), Scene((pillar,)), danger=None if weight is None else {})
    start = np.array([-0.9, -1.2, 1.4, -1.7, -1.57, 0.0])
    goal = start + 2.0 * np.eye(6)[0]
    setup.setWorkspaceGoal(setup.robot.tip_pose(goal).translation)
    setup.setConfigurations(start, goal)
    return setup


@pytest.mark.parametrize("danger", [{}, None])
@pytest.mark.parametrize("name", SAFE)
def test_clearance_costs_no_solution_where_no_motion_keeps_it(shelf, name, danger, monkeypatch):
    """The floor is nearer than the margin wherever the arm is, and the margin is not cut to what the ends keep."""
    monkeypatch.setattr(Margin, "_allowed_by", lambda self, ends: LARGE)
    setup = SafeSetup(shelf.robot, shelf.scene, danger=danger)
    setup.setWorkspaceGoal(shelf.robot.tip_pose(shelf.query.goals[0]).translation)
    setup.setConfigurations(shelf.query.start, shelf.query.goals)
    margins, is_free = [LARGE], Roadmap.is_free
    monkeypatch.setattr(Roadmap, "is_free", lambda *asked: margins.append(asked[-1]) or is_free(*asked))
    result = setup.plan(name, time=60.0, seed=0)
    assert result
    assert result.counts.nodes < 2000
    assert set(margins) <= {LARGE, 0.3 * LARGE, 0.0}, "after two penalties an edge must only be free"


ONCE_LONGER = [
    *(("PRM", scenario) for scenario in ("panda_shelf", "paper_1", "paper_2", "ur5_handover", "xarm7_pillars")),
    *(("JTRRT", scenario) for scenario in ("paper_1", "paper_2", "ur5_handover", "xarm7_pillars")),
]


@pytest.mark.parametrize(("family", "scenario"), ONCE_LONGER)
def test_dangers_are_below_classical_ones_and_paths_hardly_longer(family, scenario):
    setup = setup_scenario(scenario)
    peaks, means, lengths = [], [], []
    for planner in (f"Safe{family}", f"Classic{family}"):
        reports = [setup.plan(planner, time=20.0, seed=seed).report for seed in range(5)]
        peaks.append(np.median([report.danger.max for report in reports]))
        means.append(np.mean([report.danger.mean for report in reports]))
        lengths.append(np.median([report.length for report in reports]))
    assert peaks[0] < peaks[1]
    assert means[0] < (0.7 if family == "JTRRT" and scenario == "ur5_handover" else 1.0) * means[1]
    assert lengths[0] < 1.3 * lengths[1]


@pytest.mark.parametrize("name", [name for name in OURS if name not in SAFE])
def test_classical_planners_look_at_neither_clearance_nor_danger(shelf, name):
    results = [shelf.plan(name, time=30.0, seed=0, parameters={"clearance": c}) for c in (LARGE, 0.0)]
    np.testing.assert_array_equal(*(result.path for result in results))
    assert all(result.counts.field_configurations == 0 for result in results)
