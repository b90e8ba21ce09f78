"""The tree: nodes, branches, selection by distance and cost; and which of two trees grows next."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ompl import base as ob
from plane import TIMEOUT, PlaneProblem, SlopedHotSpot, walled_in

from safe_ompl import make_planner
from safe_ompl.planning.ompl import StateBridge, StateCost
from safe_ompl.planning.planners.parts import kernels
from safe_ompl.planning.planners.parts.tree import NearestNode, Tree, TreeSchedule


class Height(ob.OptimizationObjective):
    """Cost of a state: its second coordinate squared; counts what it is asked."""

    def __init__(self, si):
        super().__init__(si)
        self.batches = []

    def stateCost(self, state):
        return ob.Cost(state[1] ** 2)

    def motionCost(self, start, end):
        return ob.Cost(0.0)

    def values(self, Q):
        self.batches.append(len(Q))
        return Q[:, 1] ** 2

    def values_and_gradients(self, Q):
        self.batches.append(len(Q))
        return Q[:, 1] ** 2, np.stack([0 * Q[:, 0], 2 * Q[:, 1]], axis=1)


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


def test_a_branch_runs_from_the_root_to_the_node(tree):
    np.testing.assert_array_equal(tree.branch(2), [[0, 0], [1, 0], [2, 3]])
    np.testing.assert_array_equal(tree.branch(0), [[0, 0]])
    other_root = tree.add(np.array([5.0, 5.0]))
    np.testing.assert_array_equal(tree.branch(tree.add(np.array([6.0, 5.0]), other_root)), [[5, 5], [6, 5]])


def test_a_node_is_a_copy(tree):
    q = np.array([4.0, 4.0])
    node = tree.add(q, 0)
    q[:] = 0
    np.testing.assert_array_equal(tree.configurations[node], [4, 4])


def test_the_best_node_without_danger_is_the_nearest(tree, height):
    assert tree.best(np.array([2.0, 2.0]), 0.0) == 2
    assert tree.best(np.array([0.4, 0.0]), 0.0) == 0
    assert height.batches == [], "costs are not even looked at"


def test_the_best_node_with_danger_weighs_both(tree):
    q = np.array([2.0, 2.0])  # at distances √8, √5 and 1; costs 0, 0, 9
    assert tree.best(q, 0.1) == 2  # 1 + 0.9 < √5
    assert tree.best(q, 0.2) == 1  # 1 + 1.8 > √5


def test_costs_are_evaluated_once_and_in_batches(tree, height):
    np.testing.assert_array_equal(tree.costs, [0, 0, 9])
    np.testing.assert_array_equal(tree.costs, [0, 0, 9])
    tree.add(np.array([0.0, 2.0]), 0)
    tree.add(np.array([0.0, 4.0]), 0)
    np.testing.assert_array_equal(tree.costs, [0, 0, 9, 4, 16])
    assert height.batches == [3, 2]


def test_a_gradient_brings_the_cost_along(tree, height):
    np.testing.assert_array_equal(tree.gradient(2), [0, 6])
    np.testing.assert_array_equal(tree.gradient(2), [0, 6])
    np.testing.assert_array_equal(tree.costs, [0, 0, 9])
    assert height.batches == [1, 2]


def test_growth_keeps_everything(bridge, height, rng):
    tree = Tree(bridge, StateCost(height, bridge))
    nodes = rng.uniform(-10, 10, (1000, 2))
    for k, q in enumerate(nodes):
        assert tree.add(q, k - 1) == k
        if k % 50 == 49:
            np.testing.assert_allclose(tree.costs, nodes[: k + 1, 1] ** 2)
    np.testing.assert_array_equal(tree.configurations, nodes)
    np.testing.assert_array_equal(tree.branch(999), nodes)
    q = np.array([1.0, -2.0])
    assert tree.best(q, 0.0) == np.linalg.norm(nodes - q, axis=1).argmin()
    assert tree.best(q, 0.05) == (np.linalg.norm(nodes - q, axis=1) + 0.05 * nodes[:, 1] ** 2).argmin()


def test_distances_wrap():
    bridge = StateBridge(ob.SO2StateSpace())
    tree = Tree(bridge, StateCost(None, bridge))
    tree.add(np.array([0.0]))
    tree.add(np.array([-3.0]))
    np.testing.assert_allclose(tree.distances(np.array([3.0])), [3.0, 2 * np.pi - 6.0])
    assert tree.best(np.array([3.0]), 0.0) == 1


# ------------------------------------------------------------------------------------------ whose turn it is


@pytest.fixture
def schedule():
    return TreeSchedule()


def pair(bridge, *counts):
    """Return two trees with so many nodes."""
    trees = [Tree(bridge, StateCost(None, bridge)) for _ in counts]
    for tree, count in zip(trees, counts, strict=True):
        for _ in range(count):
            tree.add(np.zeros(2))
    return trees


def order(schedule, first, second, count):
    """Return whose the next turns are, as a word of digits: 1 for the tree that has the first of them."""
    tree, other, digits = first, second, ""
    for _ in range(count):
        digits += "1" if tree is first else "2"
        if not schedule.grows_again(tree, other):
            tree, other = other, tree
    return digits


@pytest.mark.parametrize("counts", [(1, 1), (3, 64), (64, 3), (100, 100)])
def test_small_trees_and_equal_ones_alternate(bridge, schedule, counts):
    assert order(schedule, *pair(bridge, *counts), 8) == "12121212"


@pytest.mark.parametrize("counts", [(3, 65), (690, 700)])
def test_the_smaller_tree_has_eight_of_nine_turns(bridge, schedule, counts):
    smaller, larger = pair(bridge, *counts)
    assert order(schedule, smaller, larger, 18) == "111111112" * 2
    schedule.reset()
    assert order(schedule, larger, smaller, 18) == "122222222" * 2


def test_a_tree_that_has_caught_up_gives_way(bridge, schedule):
    smaller, larger = pair(bridge, 98, 100)
    assert schedule.grows_again(smaller, larger)
    for _ in range(2):
        smaller.add(np.zeros(2))
    assert not schedule.grows_again(smaller, larger)


@pytest.mark.parametrize("name", ["SafeRRTConnect", "ClassicRRTConnect", "PaperSafeRRTConnect"])
def test_the_tree_outside_grows_less_while_the_other_is_walled_in(name):
    task = PlaneProblem(lambda si: make_planner(name, si, {"range": 0.25, "iterations": 900}), walled_in, SlopedHotSpot)
    assert task.solve(60.0) == TIMEOUT
    outside = len(task.planner.plannerGraph().configurations)
    if name == "PaperSafeRRTConnect":  # whose trees alternate
        assert outside > 350
    else:
        assert 100 < outside < 200, "every second turn at first, then one of nine"


# ------------------------------------------------------------------------------------------------- the nearest node


def plainly(rows, q, wraps, alpha, costs):
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


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 8), alpha=st.sampled_from([0.0, 0.3, 5.0]))
def test_the_same_node_as_by_looking_at_all(seed, n, alpha):
    rng = np.random.default_rng(seed)
    rows, wraps, costs = nodes(rng, 1500, n), rng.random(n) < 0.4, rng.uniform(size=1500)
    search, size = NearestNode(wraps), 0
    while size < len(rows):
        size = min(len(rows), size + int(rng.integers(1, 300)))
        for q in rng.uniform(-3.5, 3.5, (5, n)):
            for weight in (alpha, 0.0):
                found = search.find(rows[:size], q, weight, costs[:size] if weight else np.empty(0))
                assert found == plainly(rows[:size], q, wraps, weight, costs[:size])


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_of_equal_ones_the_first(rng, alpha):
    rows = rng.integers(-2, 3, (1000, 3)).astype(float)
    costs = rng.integers(0, 3, 1000).astype(float)
    search = NearestNode(np.zeros(3, dtype=bool))
    for q in rng.integers(-2, 3, (50, 3)).astype(float):
        assert search.find(rows, q, alpha, costs) == plainly(rows, q, False, alpha, costs)


def test_places_that_wrap_are_near_across_the_seam():
    rows = np.linspace(-3.1, 3.0, 1000)[:, None].copy()
    search = NearestNode(np.array([True]))
    assert search.find(rows, np.array([3.1])) == 0  # 0.08 across the seam, 0.1 on this side
    assert search.find(rows, np.array([3.1 - 2 * np.pi])) == 0
    assert search.find(rows, np.array([3.02])) == 999


def test_nodes_without_a_finite_cost_come_last(rng):
    rows, costs = rng.normal(size=(1000, 2)), np.full(1000, np.inf)
    costs[[3, 700]] = 1.0, np.nan
    for number in (100, 1000):
        search = NearestNode(np.zeros(2, dtype=bool))
        assert search.find(rows[:number], rows[50], 0.5, costs[:number]) == 3
        assert search.find(rows[:number], rows[50], 0.5, np.full(number, np.inf)) == 0


@pytest.mark.parametrize("wraps", [False, True])
def test_many_nodes_in_pages_above_pages(rng, wraps):
    rows, costs = nodes(rng, 30_000, 3), rng.uniform(size=30_000)
    search = NearestNode(np.full(3, wraps))
    for number in (*range(500, 2000, 7), 5000, 30_000):
        q = rng.uniform(-3.5, 3.5, 3)
        assert search.find(rows[:number], q) == plainly(rows[:number], q, wraps, 0.0, costs[:number])
        assert search.find(rows[:number], q, 0.5, costs[:number]) == plainly(
            rows[:number], q, wraps, 0.5, costs[:number]
        )
    assert search._tree.used[kernels.DEPTH] > 2


def test_nodes_at_one_place_and_nodes_that_singles_cannot_tell_apart(rng):
    rows = np.repeat(rng.normal(size=(3, 2)), 1000, axis=0)
    rows[1000:2000] += 1e-12 * rng.normal(size=(1000, 2))
    search, costs = NearestNode(np.zeros(2, dtype=bool)), rng.integers(5, size=3000).astype(float)
    for q in (*rows[::250], *rng.normal(size=(20, 2))):
        for alpha in (0.0, 1e-13, 1.0):
            assert search.find(rows, q, alpha, costs) == plainly(rows, q, False, alpha, costs)


@pytest.mark.parametrize("scale", [1e-30, 1e-9, 1e6, 1e14, 1e30, 1e100])
def test_coordinates_and_costs_of_any_size(rng, scale):
    rows, costs = scale * (3.0 + nodes(rng, 1500, 3)), scale * rng.normal(size=1500)
    rows[:450] /= max(scale, 1.0)  # the first ones are in the tree before there are great ones
    search = NearestNode(np.zeros(3, dtype=bool))
    assert search.find(rows[:450], rows[7]) == 7
    for q in scale * (3.0 + rng.uniform(-3.5, 3.5, (50, 3))):
        for alpha in (0.0, 1.0):
            assert search.find(rows, q, alpha, costs) == plainly(rows, q, False, alpha, costs)


def test_costs_that_are_greater_than_singles_may_be(rng):
    rows, costs = rng.normal(size=(1000, 2)), 1e20 * rng.uniform(1, 2, 1000)
    search = NearestNode(np.zeros(2, dtype=bool))
    for q in rng.normal(size=(10, 2)):
        assert search.find(rows, q, 1.0, costs) == plainly(rows, q, False, 1.0, costs)
