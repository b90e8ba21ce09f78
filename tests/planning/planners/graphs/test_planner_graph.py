"""What planners have built, as OMPL's planner data and as GraphML."""

from itertools import pairwise

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import SafeRRTConnect, Scenario, make_planner, planner_data, planner_names
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners import is_ours
from safe_ompl.planning.planners.parts.tree import two_trees
from safe_ompl.scene import find_scenario

OURS = [name for name in planner_names() if is_ours(name)]


@pytest.fixture(scope="module")
def setup():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


def graph_of(setup, name):
    """Plan, whether or not that succeeds in time."""
    result = setup.plan(name, time=20.0, seed=1)
    return setup.getPlanner().plannerGraph(), result.path


@pytest.mark.parametrize("name", OURS)
def test_vertices_danger_edges_and_marks(setup, name):
    graph, path = graph_of(setup, name)
    assert len(graph.configurations) >= 2
    assert len(graph.costs) == len(graph.configurations)
    np.testing.assert_allclose(graph.costs, setup.field.values(graph.configurations), rtol=1e-12)
    if path is not None:
        np.testing.assert_array_equal(graph.configurations[graph.starts], path[:1])
        np.testing.assert_array_equal(graph.configurations[graph.goals], path[-1:])
    assert len(graph.edges)
    some = np.linspace(0, len(graph.edges) - 1, 50).astype(int)
    for (start, end), length in zip(graph.configurations[graph.edges[some]], graph.lengths[some], strict=True):
        assert setup.report([start, end]).certified
        assert length == pytest.approx(setup.report([start, end]).length)


@pytest.mark.parametrize("name", [name for name in OURS if "RRTConnect" in name])
def test_the_path_is_in_the_graph_of_a_tree(setup, name):
    graph, path = graph_of(setup, name)
    edges = {tuple(map(bytes, ends)) for ends in graph.configurations[graph.edges]}
    assert {(bytes(start), bytes(end)) for start, end in pairwise(path)} <= edges


@pytest.mark.parametrize("name", OURS)
def test_ompls_planner_data(setup, name):
    graph, _ = graph_of(setup, name)
    data = ob.PlannerData(setup.getSpaceInformation())
    for _ in range(2):  # filling it anew forgets what was there
        setup.getPlannerData(data)
    setup.getPlanner().clear()  # the data keeps its own copies
    assert (data.numVertices(), data.numEdges()) == (len(graph.configurations), len(graph.edges))
    assert {data.getStartIndex(k) for k in range(data.numStartVertices())} == {*graph.starts.tolist()}
    assert {data.getGoalIndex(k) for k in range(data.numGoalVertices())} == {*graph.goals.tolist()}
    for k, q in enumerate(graph.configurations):
        assert data.getVertex(k).getState()[0 : len(q)] == q.tolist()
    assert all(data.edgeExists(start, end) for start, end in graph.edges.tolist())
    assert data.printGraphML().count("<node") == len(graph.configurations)


def test_data_of_ompls_own_planners(setup):
    setup.plan("RRTConnect", time=5.0)
    data = ob.PlannerData(setup.getSpaceInformation())
    setup.getPlannerData(data)
    assert data.numVertices() > 2


@pytest.mark.parametrize("name", OURS)
def test_nothing_built_yet(setup, name):
    planner = make_planner(name, setup.getSpaceInformation())
    graph = planner.plannerGraph()
    assert (len(graph.configurations), len(graph.edges), len(graph.starts), len(graph.goals)) == (0, 0, 0, 0)
    data = ob.PlannerData(setup.getSpaceInformation())
    planner.fillPlannerData(data)
    assert data.numVertices() == 0


def test_two_trees_that_meet_share_a_vertex():
    there = np.array([[0.0], [1.0]]), np.array([-1, 0])
    back = np.array([[3.0], [2.0], [1.0]]), np.array([-1, 0, 1])
    vertices, edges, starts, goals = two_trees(there, back)
    np.testing.assert_array_equal(vertices, [[0.0], [1.0], [3.0], [2.0]])
    np.testing.assert_array_equal(edges, [[0, 1], [3, 2], [1, 3]])
    np.testing.assert_array_equal(starts, [0])
    np.testing.assert_array_equal(goals, [2])


def test_where_ompl_asks_in_vain_one_warning_says_so(setup, caplog):
    planner = SafeRRTConnect(setup.getSpaceInformation())
    plain = og.SimpleSetup(setup.getSpaceInformation())
    plain.setPlanner(planner)
    planner_data(planner)  # also before there is anything
    setup.setPlanner(planner)
    setup.getPlannerData(ob.PlannerData(setup.getSpaceInformation()))
    assert not caplog.records, "these fill it"
    for _ in range(2):
        data = ob.PlannerData(setup.getSpaceInformation())
        plain.getPlannerData(data)
        assert data.numVertices() == 0
    planner.getPlannerData(data)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "safe_ompl.planner_data(planner)" in caplog.text
