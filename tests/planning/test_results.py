"""Results: what counts as solved, where paths begin and end, what is said, and how long all took."""

import json
import math
import re
import sys
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest
from ball import GOAL, IN_BALL, START, setup_for
from ompl import base as ob, geometric as og, util as ou

from safe_ompl import PlanningError, SafeSetup, Scene
from safe_ompl.robot import ScratchState, StateBridge

ASIDE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])


@pytest.fixture
def setup(ur5):
    return setup_for(ur5)


class Fixed(ob.Planner):
    """Returns a path that it was given, and calls it what it was told."""

    def __init__(self, setup, path, approximate=False):
        super().__init__(setup.getSpaceInformation(), "Fixed")
        self.path, self._approximate = og.PathGeometric(self.getSpaceInformation()), approximate
        for q in path:
            self.path.append(ScratchState(StateBridge(setup.getStateSpace())).set(q))

    def solve(self, ptc):
        self.getProblemDefinition().addSolutionPath(self.path, self._approximate, 0.1, self.getName())
        outcome = ob.PlannerStatus.APPROXIMATE_SOLUTION if self._approximate else ob.PlannerStatus.EXACT_SOLUTION
        return ob.PlannerStatus(outcome)

    def clear(self):
        pass


def test_an_approximate_solution_is_none(setup):
    short = [START, START + ASIDE]
    for options in ({}, {"simplify": True}):
        result = setup.plan(Fixed(setup, short, approximate=True), **options)
        assert (bool(result), result.status) == (False, "Approximate solution")
        assert (result.path, result.report, result.certified) == (None, None, False)
        assert [result.as_dict()[key] for key in ("solved", "path", "certified")] == [False, None, False]
        assert setup.haveSolutionPath()
        np.testing.assert_array_equal(setup.solution(), short)
    setup.simplifySolution(0.1)
    assert not setup.haveExactSolutionPath()


def test_a_path_is_from_a_start_to_the_goal(setup):
    with pytest.raises(PlanningError, match=r"Fixed returned a path that ends 1\.6 rad away from the goal"):
        setup.plan(Fixed(setup, [START, START + ASIDE]))
    with pytest.raises(PlanningError, match=r"not proven free: .*'ball'"):
        setup.plan(Fixed(setup, [START, IN_BALL, GOAL]))
    setup.setConfigurations(START, START + 2 * ASIDE)
    with pytest.raises(PlanningError, match=r"begins 0\.1 rad away from every start"):
        setup.plan(Fixed(setup, [START + ASIDE, START + 2 * ASIDE]))
    assert setup.plan(Fixed(setup, [START, START + 2 * ASIDE]))
    setup = SafeSetup(setup.robot, setup.scene)
    setup.setStartConfiguration(START)
    setup.setWorkspaceGoal(setup.robot.tip_pose(START + ASIDE).translation + np.array([0.0, 0.0, 0.03]))
    with pytest.raises(PlanningError, match=r"ends 0\.03 m away from the goal"):
        setup.plan(Fixed(setup, [START, START + ASIDE]))


def test_a_path_of_another_query_does_not_leave_the_setup(setup):
    planner, other = Fixed(setup, [START, START + ASIDE]), START + 2 * ASIDE
    setup.setConfigurations(START, START + ASIDE)
    setup.setPlanner(planner)
    assert setup.solve(1.0)
    near = START + 1e-4 * ASIDE
    end = START + ASIDE
    for start, goal, word in ((START, other, "ends"), (other, end, "begins"), (near, end, "begins")):
        setup.setConfigurations(start, goal)
        with pytest.raises(PlanningError, match=f"Fixed returned a path that {word}"):
            setup.solve(1.0)
        assert not setup.haveSolutionPath()
    setup.getProblemDefinition().addSolutionPath(planner.path, False, 0.0, "nobody")
    assert not setup.haveSolutionPath(), "nor is it taken from elsewhere"


# -------------------------------------------------------------------------------------------------- what is said


def test_in_words_and_as_the_json_of_the_command_line(setup, monkeypatch):
    monkeypatch.setattr(setup.robot, "links_without_collision", ("cover",))
    setup.setMaxDanger(1e3)
    setup.setMinClearance(0.01)
    setup.setMovingObstacles({"ball": 0.01}, 1.0)
    result = setup.plan(seed=0, time=20.0, simplify=True)
    lines = str(result).splitlines()
    assert len(lines) == 5
    assert lines[0] == "Exact solution: SafeRRTConnect, seed 0"
    assert lines[1].startswith("planned in ")
    assert "simplified in" in lines[1]
    assert " rad, danger mean " in lines[2]
    assert lines[3].startswith("clearance ")
    assert lines[3].endswith("from ball")
    claims = ["no collision", "min clearance", "max danger", "moving obstacles"]
    assert lines[4] == f"certified: {', '.join(claims)}; no collision geometry: cover"
    found = result.as_dict()
    assert json.loads(json.dumps(found)) == found
    assert set(found) == {
        *("planner", "seed", "status", "solved", "joint_names", "path", "planned_path", "moving_obstacles", "counts"),
        *("setup_time", "planning_time", "simplification_time", "report_time"),
        *("length", "danger", "clearance", "certified", "validation", "links_without_collision"),
    }
    assert set(found["counts"]) == {
        *("nodes", "collision_queries", "margin_queries", "bound_queries", "distance_queries"),
        *("field_configurations", "field_points"),
    }
    assert found["validation"]["claims"] == claims
    assert found["links_without_collision"] == ["cover"]


@pytest.mark.parametrize("options", [{}, {"simplify": True}, {"optimise": 0.5}])
def test_times_add_up(setup, ticks, options):
    result = setup.plan(seed=0, **{"time": 20.0, **options})
    elapsed = 1e-3 * (ticks.looks - 1)  # between the first look and the last
    parts = [getattr(result, f"{part}_time") for part in ("setup", "planning", "simplification", "validation")]
    assert min(parts) >= 0
    if "simplify" not in options:  # the clock of its own that this has is looked at, too
        assert sum(parts) == pytest.approx(elapsed, abs=2e-3)
    assert result.as_dict()["report_time"] > result.validation_time
    assert result.report.time > 0


@pytest.mark.parametrize("time", [math.inf, 1e10, np.float32(20.0), 20])
def test_long_times_and_our_planner_where_none_is_set(setup, time):
    assert setup.solve(time)
    assert setup.haveExactSolutionPath()
    assert setup.getPlanner().getName() == "SafeRRTConnect"


STRAIGHT = [START, GOAL]
SHOWN = {
    "result": (lambda setup, result: result, "Exact solution", True),
    "report": (lambda setup, result: result.report, "certified", True),
    "trajectory": (lambda setup, result: result.timed(), "duration", True),
    "no proof": (lambda setup, result: setup.check(STRAIGHT), "&#x27;ball&#x27;", True),
    "no path": (lambda setup, result: setup.plan(time=1e-6), "Timeout", False),
}


@pytest.mark.parametrize("plots", [True, False])
def test_notebooks_show_a_table_and_a_picture(setup, monkeypatch, plots):
    pytest.importorskip("matplotlib")
    result = setup.plan(seed=0, time=20.0)
    things = {name: make(setup, result) for name, (make, _, _) in SHOWN.items()}
    if not plots:
        monkeypatch.setitem(sys.modules, "matplotlib", None)
    for name, (_, words, drawn) in SHOWN.items():
        html = things[name]._repr_html_()
        tree = ElementTree.fromstring(html)  # well formed
        assert len(list(tree.iter("tr"))) == len(str(things[name]).splitlines()), name
        assert words in html, name
        assert ("data:image/png;base64,iVBOR" in html) == (drawn and plots), name


@pytest.mark.parametrize("level", ["LOG_DEBUG", "LOG_INFO", "LOG_ERROR"])
def test_ompl_is_quiet_unless_asked(ur5, level):
    ou.setLogLevel(getattr(ou.LogLevel, level))
    SafeSetup(ur5, Scene())
    wanted = "LOG_WARN" if level == "LOG_DEBUG" else level  # the first is OMPL's default
    assert ou.getLogLevel() == getattr(ou.LogLevel, wanted)


@pytest.mark.parametrize("notebook", [True, False])
def test_an_optimisation_in_a_notebook_says_how_far_it_is(setup, monkeypatch, capsys, notebook):
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    if notebook:
        monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    assert setup.plan(optimise=1.0)
    lines = capsys.readouterr().err.split("\r")  # each over the one before
    assert any(re.fullmatch(r"SafeRRTConnect: \d+ % of 1 s", line) for line in lines) == notebook
    assert (len(lines) > 3) == notebook
    assert "\n" not in "".join(lines)
