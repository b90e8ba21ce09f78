"""The best path: what it takes, and what it takes back."""

import numpy as np

from safe_ompl.paths.descent import BestPath

GIVEN, FIRST, SECOND = np.zeros((2, 3)), np.ones((2, 3)), 2 * np.ones((2, 3))


def best_path(told):
    best = BestPath(GIVEN, lambda path, cost: told.append(cost))
    best.ceiling = 10.0
    return best


def test_paths_are_taken_while_j_is_not_above_that_of_the_given_one():
    told = []
    best = best_path(told)
    assert not best.take(FIRST, 11.0)
    assert best.path is GIVEN
    assert best.take(FIRST, 9.0)
    assert not best.take(SECOND, np.nan)
    assert best.path is FIRST
    assert best.take(SECOND, 9.5)
    assert told == [9.0, 9.5]


def test_a_path_that_turns_out_to_be_dearer_than_the_given_one_is_taken_back():
    best = best_path([])
    best.take(FIRST, 9.0)
    assert best.confirm(9.0)
    best.take(SECOND, 8.0)
    assert not best.is_confirmed
    assert not best.confirm(10.5)
    assert best.path is FIRST
