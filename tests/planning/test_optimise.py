"""SafeSetup and the command line simplify and optimise; the anytime optimiser keeps the best of what it finds."""

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import InputError, SafeSetup, Scenario, Simplifier
from safe_ompl.apps.benchmark import Campaign, summarize
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.run import optimise


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("ur5_handover")


@pytest.fixture(scope="module")
def setup(scenario):
    return setup_scenario(scenario)


# ----------------------------------------------------------------------------------------------------- simplification


def test_a_plan_simplified(scenario, setup):
    raw, simple = setup.plan(seed=1), setup.plan(seed=1, simplify=True)
    assert raw.simplification_time == 0 < simple.simplification_time
    assert simple.certified
    np.testing.assert_allclose(simple.path[[0, -1]], raw.path[[0, -1]])
    np.testing.assert_array_equal(simple.planned_path, raw.path)
    assert setup.simplifier.cost.of(simple.path) < setup.simplifier.cost.of(raw.path)
    assert simple.counts.bound_queries > raw.counts.bound_queries
    assert simple.counts.nodes == raw.counts.nodes
    campaign = Campaign(scenario, ("SafeRRTConnect", "RRTConnect"), runs=2, simplify=0.2)
    summaries = summarize(list(campaign.results(setup)))
    assert all((summary.metrics["simplification_time"] > 0).all() for summary in summaries)


def test_a_time_limit_is_kept(setup, monkeypatch):
    begin, looks = Simplifier.begin, []

    def watched(self, path, stop, *rest, **options):
        return begin(self, path, lambda: looks.append(stop()) or looks[-1], *rest, **options)

    monkeypatch.setattr(Simplifier, "begin", watched)
    setup.plan(seed=1, simplify=20.0)
    unlimited = len(looks)
    assert True not in looks
    looks.clear()
    setup.plan(seed=1, simplify=1e-6)
    assert looks.count(True) <= len(looks) < unlimited / 4
    assert looks[-1] is True


def test_simplify_solution_after_solve_as_in_ompl(setup):
    setup.clear()
    assert setup.solve(10.0)
    before = setup.solution()
    setup.simplifySolution()
    assert setup.haveExactSolutionPath()
    after = setup.solution()
    assert setup.simplifier.cost.of(after) < setup.simplifier.cost.of(before)
    assert setup.is_free(after)
    assert setup.getLastSimplificationTime() > 0
    setup.simplifySolution(ob.timedPlannerTerminationCondition(0.5))
    setup.simplifySolution(0.1)
    with pytest.raises(InputError, match="simplification"):
        setup.simplifySolution(-1)


def test_without_danger_paths_become_shorter_and_stay_proven(scenario, setup):
    robot, scene = setup.robot, setup.scene
    plain = SafeSetup(robot, scene, danger=None)
    plain.setConfigurations(scenario.start_configuration(robot), scenario.goal_configurations(robot))
    raw, simple = plain.plan("RRTConnect", seed=2), plain.plan("RRTConnect", seed=2, simplify=True)
    assert simple.certified
    assert simple.simplification_time > 0
    assert simple.report.length <= raw.report.length
    for call in (lambda: plain.simplifier, lambda: plain.plan(optimise=0.1)):
        with pytest.raises(InputError, match="danger field"):
            call()


# ------------------------------------------------------------------------------------------------------- optimisation


def test_an_optimised_plan(setup):
    result = setup.plan(optimise=0.8, seed=4)
    assert result.certified
    np.testing.assert_allclose(setup.solution(), result.path, err_msg="it is the solution of the setup, too")
    times, costs = zip(*((step.time, step.cost) for step in result.improvements), strict=True)
    assert list(times) == sorted(times)
    assert times[-1] <= result.planning_time + result.simplification_time
    assert (np.diff(costs) < 0).all()
    assert setup.simplifier.cost.of(result.path) == pytest.approx(costs[-1], rel=1e-6)
    assert costs[-1] <= setup.simplifier.cost.of(setup.plan(seed=4, simplify=True).path) * 1.02
    assert result.as_dict()["improvements"][-1] == {"time": times[-1], "cost": costs[-1]}


def test_the_best_of_several_starts_counts_and_is_refined(setup):
    paths = [setup.plan("RRTConnect", seed=seed).path for seed in range(4)]
    simplifier, asked = setup.simplifier, []
    simplified = [simplifier.simplify(path, lambda: False) for path in paths]
    alone = [simplifier.cost.of(path) for path in simplified]

    def search(start, seconds):
        asked.append(start)
        return paths[start] if start < len(paths) else None

    found = optimise(search, simplifier, 30.0, stop=lambda: len(asked) > 4)
    assert asked == [0, 1, 2, 3, 4]
    assert simplifier.cost.of(found.paths[-1]) <= min(alone) * (1 + 1e-6)
    assert found.first_path == found.times[0]
    asked.clear()
    found = optimise(lambda k, left: asked.append(k) or paths[0], simplifier, 60.0, stop=lambda: len(asked) > 9)
    assert len(found.paths[-1]) > len(simplified[0]), "where nothing better is found it is refined"


def test_interrupted_or_without_a_path(setup):
    path = setup.plan("RRTConnect", seed=0).path

    def search(start, seconds):
        if start:
            raise KeyboardInterrupt
        return path

    found = optimise(search, setup.simplifier, 30.0)
    assert setup.simplifier.cost.of(found.paths[-1]) < setup.simplifier.cost.of(path)
    found = optimise(lambda start, seconds: None, setup.simplifier, 0.05)
    assert (found.paths, found.first_path) == ([], None)
    assert found.settled(setup.simplifier) == (None, ())
