"""The sense of clearance of all safe planners: what they keep from obstacles that nobody calls dangerous."""

import numpy as np
import pytest

from safe_ompl import InputError, Scenario, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.parts.clearance import AdaptiveMargin, PenaltyMargin
from safe_ompl.planning.planners.parts.problem import PlanningProblem
from safe_ompl.planning.planners.parts.roadmap import LinkMetric, LocalPlanner, Roadmap
from safe_ompl.scene import find_scenario

SAFE = ("SafeRRTConnect", "SafePRM", "SafeJTRRT", "BubblePlanner")
CLASSICAL = ("ClassicRRTConnect", "ClassicPRM", "ClassicJTRRT", "ClassicBubble")
LARGE = 10.0  # [m]; no motion of an arm keeps so much from a floor


@pytest.fixture(scope="module")
def shelf():
    return setup_scenario(Scenario.load(find_scenario("panda_shelf")))


def least_clearance(setup, name, seeds, **parameters):
    results = [setup.plan(name, time=30.0, seed=seed, parameters=parameters) for seed in range(seeds)]
    assert all(results)
    return float(np.median([result.report.clearance.min for result in results]))


@pytest.mark.parametrize("name", SAFE)
def test_paths_keep_more_than_without_it(shelf, name):
    seeds = 1 if name == "BubblePlanner" else 5
    without, within = (least_clearance(shelf, name, seeds, clearance=c) for c in (0.0, 0.05))
    assert within > 0.03 > 0.0
    assert within > without


@pytest.mark.parametrize("name", SAFE)
def test_it_is_a_parameter_with_one_default(shelf, name):
    planner = make_planner(name, shelf.getSpaceInformation(), {})
    assert planner.getClearance() == 0.05
    planner.setClearance(0.02)
    assert planner.getClearance() == 0.02
    with pytest.raises(InputError, match="clearance"):
        planner.setClearance(-0.1)


@pytest.mark.parametrize("name", CLASSICAL)
def test_classical_planners_keep_none(shelf, name):
    paths = [shelf.plan(name, time=30.0, seed=0, parameters={"clearance": c}).path for c in (LARGE, 0.0)]
    np.testing.assert_array_equal(*paths)


@pytest.mark.parametrize("name", SAFE)
def test_no_solution_is_lost_where_no_motion_keeps_it(shelf, name, monkeypatch):
    """The floor is nearer than the margin wherever the arm is, and the margin is not cut to what the ends keep."""
    monkeypatch.setattr(AdaptiveMargin, "_allowed_by", lambda self, ends: LARGE)
    monkeypatch.setattr(PenaltyMargin, "_allowed_by", lambda self, ends: LARGE)
    assert shelf.plan(name, time=60.0, seed=0)


def test_a_roadmap_asks_for_each_margin_of_an_edge_once(shelf, monkeypatch):
    problem, asked = PlanningProblem(shelf.getSpaceInformation()), []
    roadmap = Roadmap(problem.bridge, problem.cost, LinkMetric(shelf.robot))
    start = np.array(shelf.problem.start)
    roadmap.add(np.array([start, start + 0.01]))
    is_free = problem.motion_is_free
    monkeypatch.setattr(problem, "motion_is_free", lambda *args: asked.append(args) or is_free(*args))
    local = LocalPlanner(problem, roadmap)
    assert local.is_free(0, 1, 1e-3)
    kept, _ = roadmap.margins_of(0, 1)
    assert kept >= 1e-3
    asked.clear()
    assert local.is_free(0, 1, kept)
    assert local.is_free(1, 0, kept / 2)
    assert not asked, "it is known"
    assert not local.is_free(0, 1, LARGE)
    assert not local.is_free(1, 0, 2 * LARGE)
    assert len(asked) == 1
    assert local.is_free(0, 1)
