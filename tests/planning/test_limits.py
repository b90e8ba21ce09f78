"""Hard limits of whole paths: planners, setups, scenarios and the command line keep to them, or say why they cannot."""

import dataclasses
import json
import logging
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import CollisionError, InputError, SafeRRTConnect, Scenario, make_planner
from safe_ompl.apps import main
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.scene import find_scenario
from safe_ompl.scene.constraints import PathLimits

SAFE = ["SafeRRTConnect", "SafeJTRRT", "SafePRM", "BubblePlanner"]
LIMIT = 8.0  # planar3: paths without a limit reach 6.7 to 15, start and goal 4.3
CLEARANCE = 0.12  # [m] from the person; start and goal keep 0.6


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load(find_scenario("planar3"))


@pytest.fixture
def setup(scenario):
    return setup_scenario(scenario)


def densely(setup, path):
    t = np.linspace(0, 1, 200)[:, None]
    return np.concatenate([a + t * setup.robot.difference(a, b) for a, b in pairwise(path)])


def nearest_to_person(setup, path):
    of_person = [k for k, (_, name) in enumerate(setup.checker.distance_names) if name == "person"]
    return min(setup.checker.distances(q)[of_person].min() for q in densely(setup, path)[::10])


# ------------------------------------------------------------------------------------------------------ danger


@pytest.mark.parametrize("planner", SAFE)
def test_planners_keep_to_their_own_limit(setup, planner):
    result = setup.plan(planner, time=20.0, seed=1, parameters={"max_danger": LIMIT})
    assert result
    assert setup.field.values(densely(setup, result.path)).max() <= LIMIT


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "ClassicRRTConnect", "RRTConnect"])
def test_whoever_plans_keeps_to_the_limit_of_the_setup(setup, planner):
    setup.setMaxDanger(LIMIT)
    for seed in range(2):
        result = setup.plan(planner, time=20.0, seed=seed)
        assert result
        assert result.report.certified
        assert setup.field.values(densely(setup, result.path)).max() <= LIMIT


def test_simplified_paths_keep_to_limits(setup):
    for seed in range(2):
        result = setup.plan("SafeRRTConnect", time=20.0, seed=seed, parameters={"max_danger": LIMIT}, simplify=True)
        assert setup.field.values(densely(setup, result.path)).max() <= LIMIT
    setup.setMaxDanger(LIMIT)
    setup.setMinClearance(CLEARANCE)
    result = setup.plan("SafeRRTConnect", time=20.0, seed=0, simplify=True)
    assert setup.field.values(densely(setup, result.path)).max() <= LIMIT
    assert nearest_to_person(setup, result.path) > CLEARANCE - 1e-4


def test_optimised_paths_keep_to_limits(setup):
    result = setup.plan("SafeRRTConnect", optimise=0.5, seed=0, parameters={"max_danger": 1.25 * LIMIT})
    assert result
    assert setup.field.values(densely(setup, result.path)).max() <= 1.25 * LIMIT


def test_unlimited_paths_are_more_dangerous(setup):
    reports = [setup.plan("ClassicRRTConnect", time=20.0, seed=seed).report for seed in range(5)]
    assert max(report.danger.max for report in reports) > LIMIT


def test_a_start_above_the_limit_of_a_planner(setup, caplog):
    planner = make_planner("SafeRRTConnect", setup.getSpaceInformation(), {"max_danger": 4.0})
    assert planner.getMaxDanger() == 4.0
    planner.setProblemDefinition(setup.getProblemDefinition())
    setup.setup()
    planner.setup()
    with caplog.at_level(logging.WARNING):
        status = planner.solve(1.0)
    assert status == ob.PlannerStatus(ob.PlannerStatus.INVALID_START)
    danger = setup.field.value(setup.robot.lower * 0 + [1.25, -0.35, 0.2])
    assert f"SafeRRTConnect: start: danger {danger:.4g} is above the limit 4" in caplog.text


def test_the_limit_of_a_plan_ends_with_it(setup):
    path = setup.plan("ClassicRRTConnect", time=20.0, seed=0).path
    limit = 0.95 * setup.field.values(densely(setup, path)).max()
    for options in ({"simplify": True}, {"optimise": 0.3}):
        setup.plan("SafeRRTConnect", time=20.0, seed=0, parameters={"max_danger": limit}, **options)
        assert setup.report(path).certified
    with pytest.raises(ZeroDivisionError):
        setup.plan(Interrupted(setup, limit), time=20.0, simplify=True)
    assert setup.report(path).certified
    setup.setMaxDanger(limit)
    setup.plan("SafeRRTConnect", time=20.0, seed=0, parameters={"max_danger": LIMIT}, simplify=True)
    assert not setup.report(path).certified, "that of the setup stays"


class Interrupted(SafeRRTConnect):
    """A planner with a limit of its own, and an error."""

    def __init__(self, setup, limit):
        super().__init__(setup.getSpaceInformation())
        self.setMaxDanger(limit)

    def _search(self, ptc):
        raise ZeroDivisionError


def test_a_limit_set_later_drops_the_trees(setup):
    planner = make_planner("SafeRRTConnect", setup.getSpaceInformation())
    assert setup.plan(planner, time=20.0, seed=0)
    planner.setMaxDanger(LIMIT)
    setup.getProblemDefinition().clearSolutionPaths()
    assert planner.solve(20.0) == ob.PlannerStatus(ob.PlannerStatus.EXACT_SOLUTION)
    assert setup.field.values(densely(setup, setup.solution())).max() <= LIMIT


def test_a_limit_needs_a_danger(scenario):
    setup = SafeSetup(scenario.build_robot(), scenario.scene, danger=None)
    with pytest.raises(InputError, match="max danger needs a danger field"):
        setup.setMaxDanger(9.0)
    setup.setConfigurations([1.25, -0.35, 0.2], [-1.2, 0.3, -0.25])
    with pytest.raises(InputError, match="SafeRRTConnect: max danger 9 needs a DangerObjective"):
        setup.plan("SafeRRTConnect", parameters={"max_danger": 9.0})


def test_without_a_danger_objective_a_planner_says_so_every_time(scenario):
    setup = SafeSetup(scenario.build_robot(), scenario.scene, danger=None)
    setup.setConfigurations([1.25, -0.35, 0.2], [-1.2, 0.3, -0.25])
    planner = make_planner("SafeRRTConnect", setup.getSpaceInformation(), {"max_danger": 9.0})
    setup.setPlanner(planner)
    for _ in range(3):
        with pytest.raises(InputError, match="max danger 9 needs a DangerObjective"):
            setup.solve(20.0)


def test_a_start_above_the_limit_of_the_setup(setup):
    with pytest.raises(CollisionError, match=r"start: danger 4\.277 is above the limit 4"):
        setup.setMaxDanger(4.0)
    assert setup.plan(time=20.0), "what was refused is not set"
    for bad in (-1.0, np.nan, "9"):
        with pytest.raises(InputError, match="max danger must be a finite number >= 0"):
            setup.setMaxDanger(bad)
    assert setup.plan(time=20.0)


@pytest.mark.parametrize("refused", [4.0, -1.0])
def test_a_limit_that_is_refused_leaves_the_one_before(setup, refused):
    dangerous = setup.plan("ClassicRRTConnect", time=20.0, seed=0).path
    assert setup.field.values(densely(setup, dangerous)).max() > LIMIT
    setup.setMaxDanger(LIMIT)
    with pytest.raises((InputError, CollisionError)):
        setup.setMaxDanger(refused)
    assert not setup.report(dangerous).certified
    with pytest.raises(CollisionError, match="above the limit 8"):
        setup.setConfigurations([1.25, -0.35, 0.2], [0.3, 0.9, -1.8])
    assert setup.plan(time=20.0).report.danger.max <= LIMIT


def test_a_goal_above_the_limit_of_the_setup(setup):
    setup.setMaxDanger(LIMIT)
    near = [0.3, 0.9, -1.8]
    with pytest.raises(CollisionError, match="goal"):
        setup.setConfigurations([1.25, -0.35, 0.2], near)
    setup.setConfigurations([1.25, -0.35, 0.2], [near, [-1.2, 0.3, -0.25]])
    assert setup.plan(time=20.0)


# --------------------------------------------------------------------------------------------------- clearance


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "RRTConnect"])
def test_paths_keep_their_distance(setup, planner):
    setup.setMinClearance(CLEARANCE)
    for seed in range(3):
        result = setup.plan(planner, time=20.0, seed=seed)
        assert result
        assert result.report.certified
        assert nearest_to_person(setup, result.path) > CLEARANCE - 1e-4


def test_without_it_paths_come_nearer(setup):
    paths = [setup.plan("ClassicRRTConnect", time=20.0, seed=seed).path for seed in range(5)]
    assert min(nearest_to_person(setup, path) for path in paths) < CLEARANCE


def test_a_start_that_is_too_near(setup):
    with pytest.raises(CollisionError, match=r"start is too near: '.*' keeps less than 700 mm from 'person'"):
        setup.setMinClearance(0.7)
    assert setup.getConstraints().separation.min_clearance is None
    assert setup.plan(time=20.0), "what was refused is not set"
    setup.setMinClearance(0.7, exempt=[(f"link{k}", "person") for k in (1, 2, 3)])
    assert setup.plan(time=20.0)


@pytest.mark.parametrize(
    ("refused", "error"),
    [
        ((0.7,), CollisionError),
        ((-1.0,), InputError),
        ((0.1, ["nobody"]), InputError),
        ((0.1, None, [("nose", "person")]), InputError),
    ],
)
def test_a_clearance_that_is_refused_leaves_the_one_before(setup, refused, error):
    setup.setMinClearance(CLEARANCE)
    before = setup.getConstraints().separation.min_clearance
    assert before.distance == CLEARANCE
    with pytest.raises(error):
        setup.setMinClearance(*refused)
    assert setup.getConstraints().separation.min_clearance == before
    assert nearest_to_person(setup, setup.plan(time=20.0).path) > CLEARANCE - 1e-4


# ----------------------------------------------------------------------------------- scenarios and command line


def test_scenarios_have_limits(scenario, tmp_path):
    limits = PathLimits(LIMIT, CLEARANCE, ("person", "bin"), (("link3", "bin"), ("link2", "bin")))
    limited = dataclasses.replace(scenario, limits=limits)
    limited.save(tmp_path / "limited.yaml")
    again = Scenario.load(tmp_path / "limited.yaml")
    assert again.limits == limits
    result = setup_scenario(dataclasses.replace(again, limits=PathLimits(LIMIT, CLEARANCE))).plan(time=20.0)
    assert result.report.danger.max <= LIMIT


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"max_danger": -1}, "limits.max_danger: must be a finite number >= 0, got -1"),
        ({"min_clearance": "far"}, "limits.min_clearance: must be a finite number >= 0"),
        ({"exempt": [["link1"]]}, "limits.exempt: must be pairs of a link and an obstacle"),
        ({"exempt": "link1"}, "limits.exempt"),
        ({"danger": 3}, "limits.*danger"),
    ],
)
def test_limits_are_checked(scenario, tmp_path, limits, message):
    scenario.save(tmp_path / "s.yaml")
    with (tmp_path / "s.yaml").open("a") as stream:
        stream.write(f"limits: {json.dumps(limits)}\n")
    with pytest.raises(InputError, match=message):
        Scenario.load(tmp_path / "s.yaml")


def test_limits_on_the_command_line(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    scenario = str(find_scenario("planar3").resolve())
    limits = ["--max-danger", str(LIMIT), "--min-clearance", "0.1"]
    assert main(["plan", scenario, *limits, "--certificate", "proof.json"]) == 0
    content = json.loads(Path("proof.json").read_text())
    assert content["danger"]["bound"] <= LIMIT
    assert content["clearance"] == {"distance": 0.1, "obstacles": ["person"], "exempt": []}
    capfd.readouterr()
    assert main(["verify", "proof.json"]) == 0
    assert "at least 100 mm from person" in capfd.readouterr().out
    assert main(["plan", scenario, "--max-danger", "3"]) == 2
    assert "is above the limit 3" in capfd.readouterr().err
    assert main(["plan", scenario, "--min-clearance", "-1"]) == 2
    assert "must be a positive number, not '-1'" in capfd.readouterr().err


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "RRTConnect"])
def test_paths_keep_what_a_person_may_walk(setup, planner):
    setup.setMovingObstacles({"person": 0.2}, 0.2)
    result = setup.plan(planner, time=20.0, seed=1, simplify=0.2)
    assert nearest_to_person(setup, result.path) > 0.04 - 1e-4
