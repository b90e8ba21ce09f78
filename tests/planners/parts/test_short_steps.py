"""Shorter steps: which nodes get one, and how long it is."""

import numpy as np
import pytest
from plane import PlaneProblem, SlopedHotSpot

from safe_ompl.planners.rrt_connect import SafeRRTConnect


@pytest.fixture
def planner():
    task = PlaneProblem(SafeRRTConnect, objective=SlopedHotSpot)
    task.planner._take_starts()
    return task.planner


def test_a_node_gets_one_when_it_was_trapped_before(planner):
    tree = planner._trees.start
    other = planner._trees.add(tree, np.zeros(2), 0)
    assert [planner._short_steps.help(tree, node) for node in (0, other, 0, other)] == [
        False,
        False,
        True,
        True,
    ]


def test_at_once_where_danger_is_not_heeded(planner):
    planner._danger.heed = 0.0
    assert planner._short_steps.help(planner._trees.start, 0)


def test_never_where_they_are_off(planner):
    planner.setShortSteps(False)
    assert not any(planner._short_steps.help(planner._trees.start, 0) for _ in range(3))


def test_they_lie_on_the_way(planner):
    rng, target = np.random.default_rng(0), np.array([0.8, 0.6])
    q = planner._trees.start.configurations[0]
    rows = np.array([planner._short_steps.nearer(q, target, 0.5, rng) for _ in range(200)]) - q
    lengths = np.linalg.norm(rows, axis=1)
    assert 0.05 * 0.5 <= lengths.min() < 0.03
    assert 0.4 < lengths.max() <= 0.5
    way = (target - q) / np.linalg.norm(target - q)
    np.testing.assert_allclose(rows, lengths[:, None] * way, atol=1e-12)


def test_no_way_no_step(planner):
    q = planner._trees.start.configurations[0]
    np.testing.assert_array_equal(planner._short_steps.nearer(q, q, 0.5, np.random.default_rng(0)), q)
