"""SafeSetup and the command line simplify and optimise; the anytime optimiser keeps the best of what it finds."""

import json

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import InputError, SafeSetup, Scenario, Scene
from safe_ompl.apps import main
from safe_ompl.apps.benchmark import Campaign, summarize
from safe_ompl.paths import Simplifier
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.optimise import Optimisation, optimise
from safe_ompl.scene import find_scenario


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load(find_scenario("ur5_handover"))


@pytest.fixture(scope="module")
def setup(scenario):
    return setup_scenario(scenario)


# ----------------------------------------------------------------------------------------------------- simplification


def test_a_plan_simplified(setup):
    raw, simple = setup.plan(seed=1), setup.plan(seed=1, simplify=True)
    assert raw.simplification_time == 0
    assert simple.simplification_time > 0
    assert simple.report.certified
    np.testing.assert_allclose(simple.path[[0, -1]], raw.path[[0, -1]])
    assert setup.simplifier.cost.of(simple.path) < setup.simplifier.cost.of(raw.path)
    assert simple.counts.bound_queries > raw.counts.bound_queries
    assert simple.counts.nodes == raw.counts.nodes


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
    assert setup.report(after).certified
    assert setup.getLastSimplificationTime() > 0
    setup.simplifySolution(ob.timedPlannerTerminationCondition(0.5))
    setup.simplifySolution(0.1)


def test_without_danger_ompl_simplifies_and_the_path_stays_proven(scenario, setup):
    robot, scene = setup.robot, setup.scene
    plain = SafeSetup(robot, scene, danger=None)
    plain.setConfigurations(scenario.start_configuration(robot), scenario.goal_configurations(robot))
    raw, simple = plain.plan("RRTConnect", seed=2), plain.plan("RRTConnect", seed=2, simplify=True)
    assert simple.report.certified
    assert simple.simplification_time > 0
    assert simple.report.length <= raw.report.length
    with pytest.raises(InputError, match="danger field"):
        plain.simplifier  # noqa: B018
    with pytest.raises(InputError, match="danger field"):
        plain.plan(optimise=0.1)


def test_without_a_solution_there_is_nothing_to_simplify(setup):
    setup.clear()
    with pytest.raises(InputError, match="no solution"):
        setup.simplifySolution()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"simplify": -1.0}, "simplify"),
        ({"simplify": "long"}, "simplify"),
        ({"optimise": 0.0}, "time"),
        ({"optimise": np.nan}, "time"),
    ],
)
def test_bad_times(setup, options, message):
    with pytest.raises(InputError, match=message):
        setup.plan(**options)


def test_bad_options_of_the_simplifier(setup):
    with pytest.raises(InputError, match="weight"):
        setup.setSimplification(weight=-1.0)
    setup.plan(seed=1)
    with pytest.raises(InputError, match="simplification"):
        setup.simplifySolution(-1)


def test_a_campaign_simplifies_every_path(scenario, setup):
    campaign = Campaign(scenario, ("SafeRRTConnect", "RRTConnect"), runs=2, simplify=0.2)
    summaries = summarize(list(campaign.results(setup)))
    assert all((summary.metrics["simplification_time"] > 0).all() for summary in summaries)


# ------------------------------------------------------------------------------------------------------- optimisation


def test_an_optimised_plan(setup):
    result = setup.plan(optimise=0.8, seed=4)
    assert result
    np.testing.assert_allclose(setup.solution(), result.path, err_msg="it is the solution of the setup, too")
    assert result.report.certified
    times, costs = zip(*((step.time, step.cost) for step in result.improvements), strict=True)
    assert list(times) == sorted(times)
    assert times[-1] <= result.planning_time + result.simplification_time
    assert (np.diff(costs) < 0).all()
    assert setup.simplifier.cost.of(result.path) == pytest.approx(costs[-1], rel=1e-6)
    assert costs[-1] <= setup.simplifier.cost.of(setup.plan(seed=4, simplify=True).path) * 1.02
    told = result.as_dict()["improvements"]
    assert told[-1]["cost"] == costs[-1]
    assert set(told[0]) == {"time", "cost", "length", "danger_mean", "danger_max"}
    assert result.improvements[-1].length == pytest.approx(result.report.length)
    assert result.improvements[-1].danger_mean == pytest.approx(result.report.danger.mean, rel=0.01)


def test_the_best_of_several_starts_counts(setup):
    paths = [setup.plan("RRTConnect", seed=seed).path for seed in range(4)]
    simplifier = setup.simplifier
    alone = [simplifier.cost.of(simplifier.simplify(path, lambda: False)) for path in paths]
    asked = []

    def search(start, seconds):
        asked.append(start)
        return paths[start] if start < len(paths) else None

    found = optimise(search, simplifier, 30.0, stop=lambda: len(asked) > 4)
    assert asked == [0, 1, 2, 3, 4]
    assert simplifier.cost.of(found.paths[-1]) <= min(alone) * (1 + 1e-6)
    assert found.first_path == found.times[0]


def test_what_was_found_stands_when_interrupted(setup):
    path = setup.plan("RRTConnect", seed=0).path

    def search(start, seconds):
        if start:
            raise KeyboardInterrupt
        return path

    found = optimise(search, setup.simplifier, 30.0)
    assert setup.simplifier.cost.of(found.paths[-1]) < setup.simplifier.cost.of(path)


def test_a_planner_that_finds_nothing(setup):
    found = optimise(lambda start, seconds: None, setup.simplifier, 0.05)
    assert found.paths == []
    assert found.first_path is None
    assert found.settled(setup.simplifier) == (None, ())


def test_the_path_that_is_best_for_all_danger_points_is_returned(setup):
    paths = [setup.plan("RRTConnect", seed=seed).path for seed in range(2)]
    cheap, dear = sorted(paths, key=setup.simplifier.cost.of)
    best, improvements = Optimisation([0.1, 0.2], [cheap, dear]).settled(setup.simplifier)
    assert best is cheap
    assert [step.time for step in improvements] == [0.1]


def test_when_nothing_better_is_found_the_best_path_is_refined(setup):
    path, calls = setup.plan("RRTConnect", seed=0).path, []

    def search(start, seconds):
        calls.append(start)
        return path

    found = optimise(search, setup.simplifier, 60.0, stop=lambda: len(calls) > 9)
    assert len(found.paths[-1]) > len(setup.simplifier.simplify(path, lambda: False))


# --------------------------------------------------------------------------------------------------- the command line


def test_plan_simplified_on_the_command_line(capsys):
    assert main(["plan", "ur5_handover", "--simplify", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["simplification_time"] > 0
    assert main(["plan", "ur5_handover", "--simplify", "0.5"]) == 0
    assert "simplification" in capsys.readouterr().out


def test_plan_optimised_on_the_command_line(capsys, tmp_path):
    file = tmp_path / "result.json"
    assert main(["plan", "ur5_handover", "--optimise", "0.5", "--json", str(file)]) == 0
    assert "improvements" in capsys.readouterr().out
    told = json.loads(file.read_text())
    assert told["improvements"][-1]["cost"] < told["improvements"][0]["cost"]
    assert told["certified"]


def test_times_must_be_positive(capsys):
    assert main(["plan", "ur5_handover", "--simplify", "0"]) == 2
    assert "--simplify" in capsys.readouterr().err
    assert main(["plan", "ur5_handover", "--optimise", "never"]) == 2
    assert "--optimise" in capsys.readouterr().err


def test_an_empty_scene_has_no_danger_to_optimise(ur5):
    with pytest.raises(InputError):
        SafeSetup(ur5, Scene()).plan(optimise=0.1)
