"""The sense of clearance of all safe planners: what they keep from obstacles that nobody calls dangerous."""

import numpy as np
import pytest

from safe_ompl import InputError, Scenario, UnknownNameError, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.planners.parts.clearance import AdaptiveMargin, PenaltyMargin
from safe_ompl.scene import find_scenario

SAFE = ("SafeRRTConnect", "SafePRM", "SafeJTRRT", "BubblePlanner")
CLASSICAL = ("ClassicRRTConnect", "ClassicPRM", "ClassicJTRRT", "ClassicBubble")
AS_PRINTED = ("PaperSafeRRTConnect", "PaperSafePRM", "PaperSafeJTRRT", "PaperSafeBubble")
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
    seeds = 1 if name == "BubblePlanner" else 7
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
    planner = make_planner(name, shelf.getSpaceInformation(), {"clearance": LARGE})
    assert shelf.plan(planner, time=30.0, seed=0)
    assert not planner._margin.level


@pytest.mark.parametrize("name", AS_PRINTED)
def test_the_papers_forms_keep_none(shelf, name):
    with pytest.raises(UnknownNameError, match=f"unknown parameter of {name} 'clearance'"):
        make_planner(name, shelf.getSpaceInformation(), {"clearance": 0.05})


@pytest.mark.parametrize("name", SAFE)
def test_no_solution_is_lost_where_no_motion_keeps_it(shelf, name, monkeypatch):
    """The floor is nearer than the margin wherever the arm is, and the margin is not cut to what the ends keep."""
    monkeypatch.setattr(AdaptiveMargin, "_allowed_by", lambda self, ends: LARGE)
    monkeypatch.setattr(PenaltyMargin, "_allowed_by", lambda self, ends: LARGE)
    assert shelf.plan(name, time=60.0, seed=0)


def test_a_roadmap_asks_for_each_margin_of_an_edge_once(shelf, monkeypatch):
    planner = make_planner("SafePRM", shelf.getSpaceInformation(), {})
    assert shelf.plan(planner, time=30.0, seed=0)
    roadmap, local, asked = planner._roadmap, planner._local, []
    free = next(
        edge
        for edge, is_free in roadmap.edges.items()
        if is_free and 0 < roadmap.margins_of(*edge)[0] < roadmap.margins_of(*edge)[1] == np.inf
    )
    kept, _ = roadmap.margins_of(*free)
    is_free = planner._problem.motion_is_free
    monkeypatch.setattr(
        planner._problem, "motion_is_free", lambda *args: asked.append(args) or is_free(*args)
    )
    assert local.is_free(*free, kept)
    assert local.is_free(*free[::-1], kept / 2)
    assert not asked, "it is known"
    assert not local.is_free(*free, LARGE)
    assert not local.is_free(*free[::-1], 2 * LARGE)
    assert len(asked) == 1
    assert local.is_free(*free)
