"""The safest way round: `plan(ways="all")` joins several starts, compares ways, and says what the next best costs."""

import numpy as np
import pytest
from ball import never

import safe_ompl
from safe_ompl import Cylinder, Obstacle, Pose, SafeRRTConnect, Scenario, Scene, Simplifier, load, save
from safe_ompl.planning import SafeSetup, run, setup_scenario, ways
from safe_ompl.planning.simplification import simplifier

START, GOAL = (1.3, 0.3), (-1.3, 0.3)
SEEDS = range(0, 60, 10)  # the starts of two seeds are not the same


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


# -------------------------------------------------------------------------------------------- left or right of a pillar


def beside_a_pillar(robot):
    """Return a setup for an arm of two links that must fold to pass a pillar, its elbow on one side or the other."""
    pillar = Obstacle("pillar", Cylinder(0.05, 0.3), Pose((0.72, 0.0, 0.0)), weight=1.0)
    setup = SafeSetup(robot, Scene((pillar,)))
    setup.setConfigurations(START, GOAL)
    return setup


def on_one_side_of_it(robot):
    """Return two setups whose limits of the elbow leave one side only; the cheaper side first."""
    return [beside_a_pillar(robot.with_limits({"joint2": limits})) for limits in ((-0.7, 2.6), (-2.6, 0.7))]


def test_all_ways_find_the_cheaper_side_of_a_pillar_more_often_and_say_what_the_other_costs():
    robot = Scenario.load("planar2").build_robot()
    only = on_one_side_of_it(robot)
    cheap, dear = (
        [plan.report.danger.integral for plan in (setup.plan(seed=seed, simplify=True) for seed in SEEDS)]
        for setup in only
    )
    assert 1.1 * max(cheap) < min(dear)
    setup = beside_a_pillar(robot)
    one = [setup.plan(seed=seed, simplify=True).report.danger.integral for seed in SEEDS]
    results = [setup.plan(seed=seed, ways="all") for seed in SEEDS]
    assert all(result.certified for result in results)
    missed_by_one, missed = (
        sum(cost > 1.02 * max(cheap) for cost in costs) for costs in (one, [result.ways[0] for result in results])
    )
    # Chance leads one way to the other side; of all ways it does so if the first three starts take the same side.
    assert missed_by_one > missed
    assert missed <= 1
    both = [result.ways for result in results if len(result.ways) > 1]
    assert both
    assert all(costs[1] == pytest.approx(np.median(dear), rel=0.1) for costs in both)


@pytest.mark.parametrize(("saves", "joints"), [(True, 2), (False, 1)])
def test_paths_are_joined_once_more_where_that_saved_much(monkeypatch, saves, joints):
    robot = Scenario.load("planar2").build_robot()
    cheap, dear = (setup.plan(seed=0, simplify=True).path for setup in on_one_side_of_it(robot))
    setup, joined = beside_a_pillar(robot), []
    monkeypatch.setattr(ways, "hybrid", lambda *asked: joined.append(asked) or (cheap if saves else dear))
    ways.WaySearch(setup, setup.simplifier, 60.0, never).run(lambda start: dear)
    assert len(joined) == joints


def test_ways_to_a_place_of_the_tip_end_there():
    setup = beside_a_pillar(Scenario.load("planar2").build_robot())
    place = setup.robot.tip_pose(GOAL).translation
    setup.setWorkspaceGoal(place)
    result = setup.plan(seed=1, ways="all")
    assert result.certified
    assert np.linalg.norm(setup.robot.tip_pose(result.path[-1]).translation - place) <= 0.01
    assert result.ways[0] <= 1.05 * setup.plan(seed=1, simplify=True).report.danger.integral


# --------------------------------------------------------------------------------------------------- planners and goals


@pytest.mark.parametrize(
    "planner", ["SafeRRTConnect", "SafePRM", "SafeJTRRT", "BubblePlanner", "ClassicRRTConnect", "RRTConnect"]
)
def test_ways_with_other_planners(setup, planner):
    # The time suffices for any machine, as paths would depend on when it is over.
    one = setup.plan(planner, seed=2, simplify=True, time=60.0)
    result, again = (setup.plan(planner, seed=2, ways="all", time=60.0) for _ in range(2))
    assert result.certified
    assert result.ways[0] <= 1.05 * one.report.danger.integral
    np.testing.assert_array_equal(again.path, result.path)


def test_ways_without_danger_are_compared_by_length():
    scenario = Scenario.load("planar2")
    robot = scenario.build_robot()
    setup = SafeSetup(robot, scenario.scene, danger=None)
    setup.setConfigurations(scenario.start_configuration(robot), scenario.goal_configurations(robot))
    result = setup.plan(seed=1, ways="all")
    assert result.certified
    assert result.ways[0] == pytest.approx(result.report.length)
    assert result.report.length <= 1.05 * setup.plan(seed=1, simplify=True).report.length


def test_what_the_users_own_checker_refuses_is_not_returned(setup):
    refused = []

    def refuses(state):
        refused.append(abs(state[2]) > 1.5)
        return not refused[-1]

    try:
        setup.setStateValidityChecker(refuses)
        assert setup.plan(seed=1, ways="all", time=60.0).certified
        assert any(refused)
    finally:
        setup.setStateValidityChecker(None)


# ----------------------------------------------------------------------------------------------------- ends of a search


def test_no_start_begins_when_the_time_is_up(setup, monkeypatch):
    class Slow(SafeRRTConnect):
        """Lets a second pass with each start."""

        clock = 0.0

        def _search(self, ptc):
            Slow.clock += 1.0
            return super()._search(ptc)

    planner = Slow(setup.getSpaceInformation())
    for module in (run, simplifier):
        monkeypatch.setattr(module, "perf_counter", lambda: Slow.clock)
    begin, begun = Simplifier.begin, []
    monkeypatch.setattr(Simplifier, "begin", lambda *given, **options: begun.append(0) or begin(*given, **options))
    result = setup.plan(planner, seed=3, ways="all", time=1.5)
    assert (result.certified, Slow.clock, len(begun)) == (True, 2.0, 2)


def test_further_starts_take_longer_motions_and_no_more_queries_than_all_before(setup):
    ranges = []

    class Endless(SafeRRTConnect):
        """Asks without end with all seeds but the first."""

        def _search(self, ptc):
            ranges.append(self.range)
            if self.getSeed() == 3:
                return super()._search(ptc)
            while not ptc():
                setup.checker.in_collision(np.zeros(3))
            return None

    planner = Endless(setup.getSpaceInformation(), range=1.0)
    found, one = setup.plan(planner, seed=3, ways="all", time=20.0), setup.plan(planner, seed=3, simplify=True)
    assert found.certified
    np.testing.assert_array_equal(ranges, [1.0, *[2.0] * (len(ranges) - 2), 1.0])
    assert planner.range == 1.0
    assert one.counts.queries < found.counts.queries < 20 * one.counts.queries
