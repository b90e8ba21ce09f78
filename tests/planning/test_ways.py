"""The safest way round: `plan(ways="all")` joins several starts, compares ways, and says what the next best costs."""

import numpy as np
import pytest

import safe_ompl
from safe_ompl import InputError, Scenario, load, save
from safe_ompl.planning import setup_scenario


@pytest.fixture(scope="module")
def setup():
    return setup_scenario(Scenario.load("planar3"))


def test_all_ways_cost_no_more_than_one_and_follow_from_the_seed(setup, tmp_path):
    one, result = setup.plan(seed=3, simplify=True), setup.plan(seed=3, ways="all")
    objective = setup.getOptimizationObjective()
    assert result.certified
    assert result.ways == tuple(sorted(result.ways))
    assert result.ways[0] == setup.getSolutionPath().cost(objective).value()
    np.testing.assert_array_equal(setup.solution(), result.path)
    setup.set_solution(one.path)
    assert result.ways[0] <= 1.05 * setup.getSolutionPath().cost(objective).value()
    assert (result.seed, result.planner) == (one.seed, one.planner)
    again = safe_ompl.plan("planar3", seed=3, ways="all")
    np.testing.assert_array_equal(again.path, result.path)
    assert again.ways == result.ways
    assert f"found: cost {result.ways[0]:.2f}" in str(result).splitlines()[-1]
    save(result, tmp_path / "result.json")
    assert load(tmp_path / "result.json").ways == result.ways


def test_one_way_is_what_it_was(setup):
    plain, one = setup.plan(seed=5, simplify=True), setup.plan(seed=5, simplify=True, ways=1)
    np.testing.assert_array_equal(one.path, plain.path)
    assert one.ways == plain.ways == ()
    assert "found" not in str(one)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ways": 2}, 'ways must be 1 or "all", got 2'),
        ({"ways": True}, 'ways must be 1 or "all", got True'),
        ({"ways": "both"}, "got 'both'"),
        ({"ways": None}, "got None"),
        ({"ways": "all", "starts": 2}, "leave out starts"),
        ({"ways": "all", "optimise": 1.0}, "leave out optimise"),
    ],
)
def test_what_ways_may_be(setup, options, words):
    with pytest.raises(InputError, match=words):
        setup.plan(**options)
