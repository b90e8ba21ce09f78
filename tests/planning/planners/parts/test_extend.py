"""EXTEND: what is asked first of a candidate; and which nodes get a shorter step, and how long it is."""

from functools import partial

import numpy as np
import pytest
from plane import PlaneProblem, wall_with_a_gap

from safe_ompl import SafeRRTConnect, Scenario
from safe_ompl.common import Counts
from safe_ompl.planning.planners.parts.clearance import AdaptiveMargin
from safe_ompl.planning.planners.parts.extend import (
    Extension,
    SafeStep,
    ShortSteps,
    TangentialDescent,
    straight_extension,
)
from safe_ompl.planning.planners.parts.problem import AdaptiveThreshold, DangerWeight, FixedThreshold, PlanningProblem
from safe_ompl.planning.planners.parts.tree import Tree, Trees
from safe_ompl.scene import find_scenario


@pytest.fixture
def danger(plane):
    return DangerWeight(plane)


@pytest.fixture
def steps(plane, danger):
    return ShortSteps(plane.bridge, danger)


@pytest.fixture
def tree(plane):
    tree = Tree(plane.bridge, plane.cost)
    tree.add(np.array([-0.8, 0.0]))
    tree.add(np.zeros(2), 0)
    return tree


@pytest.mark.parametrize("dangerous", [0, 10])
def test_the_danger_of_blocked_steps_is_spared_where_danger_refuses_little(shelf, shelf_problem, dangerous):
    danger = DangerWeight(shelf_problem)
    descent, threshold = TangentialDescent(shelf_problem.bridge, danger), AdaptiveThreshold(danger)
    descent.share, threshold.rise, threshold.level = 0.8, 0.05, float("inf")
    nothing_free = FixedThreshold(shelf_problem, lambda start, end: False)
    nothing_free.level = 1.0
    margin = AdaptiveMargin(shelf_problem, danger)
    step = SafeStep(shelf_problem, danger, descent, threshold, margin, nothing_free)
    trees = Trees(shelf_problem.bridge, shelf_problem.cost, Counts())
    trees.add_start(Scenario.load(find_scenario("panda_shelf")).start_configuration(shelf.robot))
    trees.blocked, trees.dangerous = 10, dangerous
    trees.start.gradient(0)  # so that it is known
    assert danger.weight > 0
    before = shelf.counts.copy()
    outcome, _ = step.extend(trees, trees.start, 0, shelf_problem.bridge.upper, 0.5)
    assert outcome is Extension.TRAPPED
    evaluated = (shelf.counts - before).field_configurations
    assert (evaluated > 0) == (dangerous > 0)
    assert trees.blocked > 10


def test_a_straight_extension_advances_reaches_its_target_or_is_trapped():
    problem = PlanningProblem(PlaneProblem(SafeRRTConnect, wall_with_a_gap).si)
    trees = Trees(problem.bridge, problem.cost, Counts())
    trees.add_start(np.array([-0.8, 0.0]))
    extend = partial(straight_extension, problem, trees, trees.start)
    assert extend(0, np.array([0.8, 0.0]), 0.5) == (Extension.ADVANCED, 1)
    assert extend(1, np.array([-0.2, 0.1]), 0.5) == (Extension.REACHED, 2)
    assert extend(2, np.array([0.8, 0.1]), 0.5) == (Extension.TRAPPED, 2)
    np.testing.assert_allclose(trees.start.configurations, [(-0.8, 0.0), (-0.3, 0.0), (-0.2, 0.1)], atol=1e-12)
    assert trees.start.parents.tolist() == [-1, 0, 1]


# ------------------------------------------------------------------------------------------------ shorter steps


def test_a_node_gets_one_when_it_was_trapped_before(steps, tree):
    assert [steps.is_due(tree, node) for node in (0, 1, 0, 1)] == [False, False, True, True]


def test_at_once_while_danger_has_no_weight(steps, danger, tree):
    danger.scale = 0.0
    assert steps.is_due(tree, 0)


def test_never_where_they_are_off(steps, tree):
    steps.allowed = False
    assert not any(steps.is_due(tree, 0) for _ in range(3))


def test_they_lie_on_the_way(steps, tree):
    rng, target, q = np.random.default_rng(0), np.array([0.8, 0.6]), tree.configurations[0]
    rows = np.array([steps.nearer(q, target, 0.5, rng) for _ in range(200)]) - q
    lengths = np.linalg.norm(rows, axis=1)
    assert 0.05 * 0.5 <= lengths.min() < 0.03
    assert 0.4 < lengths.max() <= 0.5
    way = (target - q) / np.linalg.norm(target - q)
    np.testing.assert_allclose(rows, lengths[:, None] * way, atol=1e-12)


def test_no_way_no_step(steps, tree):
    q = tree.configurations[0]
    np.testing.assert_array_equal(steps.nearer(q, q, 0.5, np.random.default_rng(0)), q)
