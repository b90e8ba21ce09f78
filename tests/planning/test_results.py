"""Results: what counts as solved, where paths begin and end, what is said, and how long all took."""

import math
import sys
from types import ModuleType
from xml.etree import ElementTree

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from safe_ompl import InputError, Obstacle, PlanningError, Pose, SafeRRTConnect, Scene, Sphere, certificate, verify
from safe_ompl.planning import PlanResult, SafeSetup, plan
from safe_ompl.planning.ompl import ScratchState, StateBridge

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
ASIDE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])


@pytest.fixture
def setup(ur5):
    scene = Scene((Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),))
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(START, GOAL)
    return setup


class Fixed(ob.Planner):
    """Returns a path that it was given, and calls it what it was told."""

    def __init__(self, setup, path, approximate=False):
        super().__init__(setup.getSpaceInformation(), "Fixed")
        self._scratch = ScratchState(StateBridge(setup.getStateSpace()))
        self._points, self._approximate = np.array(path), approximate

    def solve(self, ptc):
        solution = og.PathGeometric(self.getSpaceInformation())
        for q in self._points:
            solution.append(self._scratch.set(q))
        self.getProblemDefinition().addSolutionPath(solution, self._approximate, 0.1, self.getName())
        outcome = ob.PlannerStatus.APPROXIMATE_SOLUTION if self._approximate else ob.PlannerStatus.EXACT_SOLUTION
        return ob.PlannerStatus(outcome)

    def clear(self):
        pass


def test_an_approximate_solution_is_none(setup):
    short = [START, START + ASIDE]
    for options in ({}, {"simplify": True}):
        result = setup.plan(Fixed(setup, short, approximate=True), **options)
        assert not result
        assert result.status == "Approximate solution"
        assert result.path is None
        assert result.report is None
        np.testing.assert_array_equal(setup.solution(), short)
    setup.simplifySolution()
    assert not setup.haveExactSolutionPath()


def test_a_path_must_end_in_the_goal(setup):
    with pytest.raises(PlanningError, match=r"Fixed returned a path that ends 1\.6 rad away from the goal"):
        setup.plan(Fixed(setup, [START, START + ASIDE]))


def test_a_path_must_begin_at_a_start(setup):
    setup.setConfigurations(START, START + 2 * ASIDE)
    with pytest.raises(PlanningError, match=r"begins 0\.1 rad away from every start"):
        setup.plan(Fixed(setup, [START + ASIDE, START + 2 * ASIDE]))
    assert setup.plan(Fixed(setup, [START, START + 2 * ASIDE]))


def test_a_path_must_end_at_the_place(setup):
    setup = SafeSetup(setup.robot, setup.scene)
    setup.setStartConfiguration(START)
    setup.setWorkspaceGoal(setup.robot.tip_pose(START + ASIDE).translation + np.array([0.0, 0.0, 0.03]))
    with pytest.raises(PlanningError, match=r"ends 0\.03 m away from the goal"):
        setup.plan(Fixed(setup, [START, START + ASIDE]))


# -------------------------------------------------------------------------------------------------- what is said


def test_five_lines(setup):
    lines = str(setup.plan(seed=0, time=20.0, simplify=True)).splitlines()
    assert len(lines) == 5
    assert lines[0] == "Exact solution: SafeRRTConnect, seed 0"
    assert lines[1].startswith("planned in ")
    assert "simplified in" in lines[1]
    assert " rad, danger mean " in lines[2]
    assert lines[3].startswith("clearance ")
    assert lines[3].endswith("from ball")
    assert lines[4] == "certified: collision"


def test_what_limits_are_proven(setup):
    setup.setMaxDanger(1e3)
    setup.setMinClearance(0.01)
    setup.setMovingObstacles({"ball": 0.01}, 1.0)
    result = setup.plan(seed=0, time=20.0)
    assert str(result.report.validation) == "certified: collision, min clearance, max danger, moving obstacles"


def test_links_without_collision_geometry_are_named(setup, monkeypatch):
    monkeypatch.setattr(setup.robot, "links_without_collision", ("cover",))
    result = setup.plan(seed=0, time=20.0)
    assert result.report.links_without_collision == ("cover",)
    assert result.as_dict()["links_without_collision"] == ["cover"]
    assert str(result).endswith("no collision geometry: cover")


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


def test_simplification_keeps_to_the_time_limit(setup, monkeypatch):
    given = []
    monkeypatch.setattr(setup, "simplifySolution", lambda time: given.append(time))
    setup.plan(seed=0, time=20.0, simplify=True)
    setup.plan(seed=0, time=20.0, simplify=30.0)
    setup.plan(seed=0, time=20.0, simplify=0.25)
    assert 0 < given[0] < 20
    assert 0 < given[1] < 20
    assert given[2] == 0.25


# ------------------------------------------------------------------------------------------------------- solve, plan


@pytest.mark.parametrize("time", [math.inf, 1e10, np.float32(20.0), 20])
def test_long_times(setup, time):
    assert setup.solve(time)
    assert setup.haveExactSolutionPath()


def test_solve_without_a_planner_takes_ours(setup):
    assert setup.solve(20.0)
    assert setup.getPlanner().getName() == "SafeRRTConnect"


def test_a_scenario_by_name():
    result = plan("planar3", time=20.0)
    assert isinstance(result, PlanResult)
    assert result


def test_planners_that_are_none(setup, ur5):
    other = SafeSetup(ur5, setup.scene)
    foreign = SafeRRTConnect(other.getSpaceInformation())
    for wrong, message in [
        (None, "planner must be a name of planner_names"),
        (SafeRRTConnect, r"SafeRRTConnect is a class: give a planner, SafeRRTConnect\(setup"),
        (og.RRTConnect, "RRTConnect is a class"),
        (foreign, "SafeRRTConnect is a planner of another setup"),
    ]:
        with pytest.raises(InputError, match=message):
            setup.plan(wrong)


def test_a_solution_before_there_is_one(setup):
    with pytest.raises(InputError, match="there is no solution: call solve or plan first"):
        setup.solution()


def test_danger_that_is_no_mapping(setup):
    with pytest.raises(InputError, match="danger must be a mapping of options, or None for none, got True"):
        SafeSetup(setup.robot, setup.scene, danger=True)


def test_goals_that_hang_are_refused(setup):
    goal = ob.GoalLazySamples(setup.getSpaceInformation(), lambda goal, state: False, False, 0.1)
    setup.setGoal(goal)
    with pytest.raises(InputError, match="GoalLazySamples waits for itself for ever"):
        setup.solve(1.0)


STRAIGHT = [START, GOAL]
SHOWN = {
    "result": (lambda setup, result: result, "Exact solution", True),
    "report": (lambda setup, result: result.report, "certified", True),
    "trajectory": (lambda setup, result: result.timed(), "duration", True),
    "proof": (lambda setup, result: setup.check(result.path), "proven", True),
    "no proof": (lambda setup, result: setup.check(STRAIGHT), "&#x27;ball&#x27;", True),
    "repair": (lambda setup, result: setup.repair(STRAIGHT), "repaired", True),
    "verified": (
        lambda setup, result: verify(certificate(result.path, setup.robot, setup.scene)),
        "not claimed",
        False,
    ),
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
    assert ("SafeRRTConnect: 0 % of 1 s" in lines) == notebook
    assert (len(lines) > 3) == notebook
    assert "\n" not in "".join(lines)
