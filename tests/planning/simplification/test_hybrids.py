"""Hybrids join parts of several paths, and are proven, no dearer, and as clear as the first path."""

from itertools import pairwise

import numpy as np
import pytest
from ball import never

from safe_ompl import Scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.simplification import hybrid


@pytest.fixture(scope="module")
def setup():
    return setup_scenario(Scenario.load("ur5_handover"))


def with_a_detour(path, begin):
    """Return a path (N, n) whose way points from one on, for a third of the path, are moved aside."""
    found, third = path.copy(), len(path) // 3
    found[begin : begin + third, 5] += 0.8
    return found


def test_a_hybrid_takes_the_good_part_of_each_path(setup):
    cost, path = setup.simplifier.cost, setup.plan(seed=1, simplify=True).path
    path = np.concatenate([np.linspace(a, b, 4)[:-1] for a, b in pairwise(path)] + [path[-1:]])
    paths = [with_a_detour(path, begin) for begin in (1, len(path) // 2)]
    assert all(setup.is_free(each) for each in paths)
    found = hybrid(setup.simplifier, paths, never)
    assert setup.is_free(found)
    assert cost.of(found) < 1.05 * cost.of(path) < 0.95 * min(map(cost.of, paths))
    np.testing.assert_array_equal(found[[0, -1]], path[[0, -1]])
    clear = [setup.report(each).clearance.min for each in (found, paths[0])]
    assert clear[0] >= clear[1] - 2e-4


def test_where_nothing_is_cheaper_or_time_is_up_the_first_path_stays(setup):
    path = setup.plan(seed=1, simplify=True).path
    dear = with_a_detour(path, 1)
    np.testing.assert_array_equal(hybrid(setup.simplifier, [path], lambda: True), path)
    np.testing.assert_array_equal(hybrid(setup.simplifier, [dear, path], lambda: True), dear)
