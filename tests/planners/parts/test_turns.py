"""Turns of two trees: whose is the next one."""

import numpy as np
import pytest
from plane import TIMEOUT, PlaneProblem, SlopedHotSpot, walled_in

from safe_ompl.planners.parts.turns import Turns
from safe_ompl.planners.registry import make_planner
from safe_ompl.planners.rrt_connect import SafeRRTConnect


@pytest.fixture
def balanced():
    turns = Turns()
    turns.balanced = True
    return turns


def grown(*counts):
    """Return two trees with so many nodes."""
    trees = PlaneProblem(SafeRRTConnect).planner._trees
    for tree, count in zip((trees.start, trees.goal), counts, strict=True):
        for _ in range(count):
            tree.add(np.zeros(2))
    return trees.start, trees.goal


def order(turns, first, second, count):
    """Return whose the next turns are, as a word of digits: 1 for the tree that has the first of them."""
    tree, other, digits = first, second, ""
    for _ in range(count):
        digits += "1" if tree is first else "2"
        if not turns.again(tree, other):
            tree, other = other, tree
    return digits


def test_trees_alternate_unless_they_are_balanced():
    assert order(Turns(), *grown(3, 500), 8) == "12121212"


@pytest.mark.parametrize("counts", [(1, 1), (3, 64), (64, 3), (100, 100)])
def test_small_trees_and_equal_ones_alternate(balanced, counts):
    assert order(balanced, *grown(*counts), 8) == "12121212"


@pytest.mark.parametrize("counts", [(3, 65), (690, 700)])
def test_the_smaller_tree_has_eight_of_nine_turns(balanced, counts):
    smaller, larger = grown(*counts)
    assert order(balanced, smaller, larger, 18) == "111111112" * 2
    balanced.reset()
    assert order(balanced, larger, smaller, 18) == "122222222" * 2


def test_a_tree_that_has_caught_up_gives_way(balanced):
    smaller, larger = grown(98, 100)
    assert balanced.again(smaller, larger)
    for _ in range(2):
        smaller.add(np.zeros(2))
    assert not balanced.again(smaller, larger)


@pytest.mark.parametrize("name", ["SafeRRTConnect", "ClassicRRTConnect"])
def test_the_tree_outside_grows_less_while_the_other_is_walled_in(name):
    def outside(balanced):
        parameters = {"range": 0.25, "iterations": 900, "balanced": balanced}
        task = PlaneProblem(lambda si: make_planner(name, si, parameters), walled_in, SlopedHotSpot)
        assert task.solve(60.0) == TIMEOUT
        return len(task.planner._trees.start)

    assert outside(balanced=False) > 350
    assert 100 < outside(balanced=True) < 200, "every second turn at first, then one of nine"


def test_it_can_be_switched_off():
    planner = SafeRRTConnect(PlaneProblem(SafeRRTConnect).si)
    assert planner.getBalanced()
    planner.setBalanced(False)
    assert not planner.getBalanced()
