"""Trees of configurations: nodes, costs, branches; two that meet; and the nearest node."""

from types import SimpleNamespace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from ompl import base as ob

from safe_ompl import InputError
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.growth import Tree
from safe_ompl.planning.planners.tree import TwoTrees
from safe_ompl.robot import StateBridge


class Height(ob.OptimizationObjective):
    """Cost of a state: its second coordinate squared; counts what it is asked."""

    def __init__(self, si):
        super().__init__(si)
        self.batches = []

    def values(self, Q):
        self.batches.append(len(Q))
        return Q[:, 1] ** 2

    def values_and_gradients(self, Q):
        return self.values(Q), np.stack([0 * Q[:, 0], 2 * Q[:, 1]], axis=1)


@pytest.fixture
def bridge():
    space = ob.RealVectorStateSpace(2)
    space.setBounds(-10, 10)
    return StateBridge(space)


@pytest.fixture
def height(bridge):
    return Height(ob.SpaceInformation(bridge.space))


@pytest.fixture
def tree(bridge, height):
    tree = Tree(bridge, StateCost(height, bridge))
    root = tree.add(np.array([0.0, 0.0]))
    middle = tree.add(np.array([1.0, 0.0]), root)
    tree.add(np.array([2.0, 3.0]), middle)
    return tree


def test_a_node_is_a_copy_and_a_branch_runs_from_its_root(tree):
    q = np.array([5.0, 5.0])
    other_root = tree.add(q)
    q[:] = 0
    np.testing.assert_array_equal(tree.branch(2), [[0, 0], [1, 0], [2, 3]])
    np.testing.assert_array_equal(tree.branch(0), [[0, 0]])
    np.testing.assert_array_equal(tree.branch(tree.add(np.array([6.0, 5.0]), other_root)), [[5, 5], [6, 5]])


def test_the_best_node_weighs_distance_and_danger(tree, height):
    q = np.array([2.0, 2.0])  # at distances √8, √5 and 1; costs 0, 0, 9
    assert tree.best(q, 0.0) == 2
    assert height.batches == [], "costs are not even looked at"
    assert tree.best(q, 0.1) == 2  # 1 + 0.9 < √5
    assert tree.best(q, 0.2) == 1  # 1 + 1.8 > √5


def test_what_leads_out_of_a_tree_is_refused(tree, bridge):
    for node in (-2, 3):
        for ask in (tree.gradient, tree.branch, lambda node: tree.add(np.zeros(2), node)):
            with pytest.raises(InputError, match=f"there is no node {node}: the tree has 3"):
                ask(node)
    with pytest.raises(InputError, match="a configuration must have 2 joints, got 3"):
        tree.best(np.zeros(3), 0.0)
    with pytest.raises(InputError, match="each must wrap or not"):
        Tree(SimpleNamespace(n=3, circular=bridge.circular, rotations=[]), StateCost(None, bridge))
    with pytest.raises(InputError, match="quaternions must be four of 2 coordinates"):
        Tree(SimpleNamespace(n=2, circular=bridge.circular, rotations=[0]), StateCost(None, bridge))


def test_arrays_that_were_handed_out_stay_as_they_are(tree):
    rows, costs = tree.configurations, tree.costs
    for _ in range(1000):
        tree.add(np.array([7.0, 7.0]), 2)
    np.testing.assert_array_equal(rows, [[0, 0], [1, 0], [2, 3]])
    np.testing.assert_array_equal(costs, [0, 0, 9])
    np.testing.assert_array_equal(tree.costs[-2:], [49, 49])


def test_two_trees_that_meet_share_a_vertex(bridge):
    trees = TwoTrees(*(Tree(bridge, StateCost(None, bridge)) for _ in range(2)))
    for tree, places in ((trees.start, (0.0, 1.0)), (trees.goal, (3.0, 2.0, 1.0))):
        for k, x in enumerate(places):
            tree.add(np.array([x, 0.0]), k - 1)
    vertices, edges, starts, goals = trees.graph()
    np.testing.assert_array_equal(vertices[:, 0], [0.0, 1.0, 3.0, 2.0])
    np.testing.assert_array_equal(edges, [[0, 1], [3, 2], [1, 3]])
    assert (starts.tolist(), goals.tolist()) == ([0], [2])


# ------------------------------------------------------------------------------------------------- the nearest node


class GivenCosts:
    """Costs of nodes in the order in which these were added."""

    def __init__(self, costs):
        self.left = costs

    def values(self, Q):
        now, self.left = np.split(self.left, [len(Q)])
        return now


def grown(rows, costs, wraps=None):
    """Return a tree of nodes with such costs."""
    n = rows.shape[1]
    tree = Tree(
        SimpleNamespace(n=n, circular=np.zeros(n, bool) if wraps is None else wraps, rotations=[]), GivenCosts(costs)
    )
    for q in rows:
        tree.add(q)
    return tree


def plainly(rows, q, wraps=False, alpha=0.0, costs=0.0):
    delta = rows - q
    delta = np.where(wraps, delta - 2 * np.pi * np.round(delta / (2 * np.pi)), delta)
    return int((np.sqrt((delta * delta).sum(axis=1)) + alpha * costs).argmin())


def nodes(rng, number, n):
    """Return nodes as planners make them: strings of steps, each from some node before."""
    rows = rng.uniform(-3, 3, (number, n))
    for k in range(1, number):
        if rng.random() < 0.8:
            rows[k] = rows[rng.integers(k)] + 0.1 * rng.normal(size=n)
    return rows


@settings(max_examples=12)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 8), alpha=st.sampled_from([0.0, 0.3, 5.0]))
def test_the_same_node_as_by_looking_at_all(seed, n, alpha):
    rng = np.random.default_rng(seed)
    rows, wraps, costs = nodes(rng, 1500, n), rng.random(n) < 0.4, rng.uniform(size=1500)
    tree, size = grown(rows[:0], costs, wraps), 0
    while size < len(rows):
        more = rows[size : size + int(rng.integers(1, 300))]
        for q in more:
            tree.add(q)
        size += len(more)
        for q in rng.uniform(-3.5, 3.5, (5, n)):
            for weight in (alpha, 0.0):
                assert tree.best(q, weight) == plainly(rows[:size], q, wraps, weight, costs[:size])


@pytest.mark.parametrize("alpha", [0.0, 1e-13, 1.0])
def test_of_equal_ones_the_first_also_where_all_are_at_one_place(rng, alpha):
    grid = rng.integers(-2, 3, (3000, 2)).astype(float)
    heaps = np.repeat(rng.normal(size=(3, 2)), 1000, axis=0)
    heaps[1000:2000] += 1e-16 * rng.normal(size=(1000, 2))
    spiral = np.geomspace(1e-12, 1.0, 3000)[:, None] * (1.0, -2.0)  # cells of one node beside cells of all others
    for rows in (grid, heaps, spiral):
        costs = rng.integers(5, size=3000).astype(float)
        tree = grown(rows, costs)
        for q in (*rows[::250], *rng.normal(size=(20, 2)), *rng.integers(-2, 3, (20, 2)).astype(float)):
            assert tree.best(q, alpha) == plainly(rows, q, False, alpha, costs)


def test_nodes_without_a_finite_cost_come_last(rng):
    rows, costs = rng.normal(size=(1000, 2)), np.full(1000, np.inf)
    costs[[3, 700]] = 1.0, np.nan
    for number in (100, 1000):
        for some, best in ((costs[:number], 3), (np.full(number, np.inf), 0)):
            assert grown(rows[:number], some).best(rows[50], 0.5) == best
