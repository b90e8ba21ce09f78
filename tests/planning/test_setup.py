"""SafeSetup and plan: from a problem to a validated path, and clear words about problems that make no sense."""

import json

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import Box, DangerObjective, Obstacle, Pose, SafeSetup, Scene
from safe_ompl.common import CollisionError, InputError, PlanningError, UnknownNameError
from safe_ompl.planning.planners import SafeRRTConnect, make_planner, planner_names

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
IN_BALL = START * [0, 1, 1, 1, 1, 1]


@pytest.fixture
def setup(ur5, scene):
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(START, GOAL)
    return setup


# -------------------------------------------------------------------------------------------------------- the result


def test_a_solved_problem(setup, ur5):
    result = setup.plan(time=10.0, seed=3)
    assert result
    assert result.solved
    assert result.status == "Exact solution"
    assert (result.planner, result.seed, result.joint_names) == ("SafeRRTConnect", 3, ur5.joint_names)
    np.testing.assert_allclose(result.path[[0, -1]], [START, GOAL])
    assert result.report.certified
    assert result.report.length == pytest.approx(np.linalg.norm(np.diff(result.path, axis=0), axis=1).sum())
    assert result.planning_time > 0
    counts = result.counts
    assert counts.nodes >= len(result.path) - 2
    assert counts.bound_queries > counts.margin_queries
    assert counts.field_configurations > 0
    assert counts.distance_queries == 0, "the report's own work is not planning"


def test_as_the_json_of_the_command_line(setup):
    found = setup.plan(time=10.0).as_dict()
    assert json.loads(json.dumps(found)) == found
    assert set(found) == {
        *(
            "planner",
            "seed",
            "status",
            "solved",
            "setup_time",
            "planning_time",
            "simplification_time",
            "report_time",
            "joint_names",
            "path",
        ),
        *("length", "danger", "clearance", "certified", "counts"),
        *("validation", "links_without_collision"),
    }
    assert set(found["counts"]) == {
        *("nodes", "collision_queries", "margin_queries", "bound_queries", "distance_queries"),
        *("field_configurations", "field_points"),
    }
    assert found["certified"] is True
    assert found["danger"]["avoidable"] >= 0


@pytest.mark.parametrize("name", ["RRTConnect", "ClassicRRTConnect"])
def test_other_planners_find_certified_paths(setup, name):
    result = setup.plan(name, time=10.0, seed=1)
    assert result.planner == name
    assert result.report.certified
    assert result.counts.nodes > 2


def test_a_planner_object(setup):
    planner = SafeRRTConnect(setup.getSpaceInformation(), "Mine", range=0.5)
    result = setup.plan(planner, time=10.0, seed=2)
    assert result.planner == "Mine"
    assert planner.getSeed() == 2
    assert result.counts.nodes == planner.counts.nodes


def test_parameters_reach_the_planner(setup):
    short, long = (setup.plan(time=10.0, parameters={"range": r, "alpha": 0.0}) for r in (0.1, 1.0))
    steps = [np.linalg.norm(np.diff(result.path, axis=0), axis=1).max() for result in (short, long)]
    assert steps[0] <= 0.1 + 1e-9 < steps[1]


def test_no_solution_in_time(crank):
    in_the_way = Scene((Obstacle("post", Box((0.1, 0.1, 0.1)), Pose((0.5, 0.0, 0.0))),))
    setup = SafeSetup(crank, in_the_way, danger=None)
    setup.setConfigurations([-1.0], [1.0])
    result = setup.plan(time=0.2)
    assert not result
    assert result.path is None
    assert result.report is None
    assert result.status == "Timeout"
    found = result.as_dict()
    assert (found["solved"], found["path"], found["certified"]) == (False, None, False)


def test_a_goal_that_is_the_start(setup):
    setup.setConfigurations(START, START)
    result = setup.plan(time=5.0)
    assert result
    np.testing.assert_allclose(result.path[[0, -1]], [START, START])


def test_a_path_that_nobody_checked_does_not_leave_the_package(setup):
    class Reckless(SafeRRTConnect):
        def _search(self, ptc):
            return np.array([START, IN_BALL, GOAL])

    with pytest.raises(PlanningError, match=r"Reckless returned a path that is not proven free: .*'ball'"):
        setup.plan(Reckless(setup.getSpaceInformation(), "Reckless"))


def test_continuous_joints_may_start_anywhere_on_the_circle(kinova):
    setup = SafeSetup(kinova, Scene(), danger=None)
    start = np.array([7.0, 2.9, 1.3, -9.0, 1.8, 4.0])
    goal = np.array([6.0, 2.9, 1.3, -9.0, 1.8, 4.0])
    setup.setConfigurations(start, goal)
    path = setup.plan(time=10.0).path
    np.testing.assert_allclose(kinova.difference(path[0], start), 0, atol=1e-9)
    np.testing.assert_allclose(kinova.difference(path[-1], goal), 0, atol=1e-9)


# --------------------------------------------------------------------------------------------------- OMPL's own doors


def test_it_is_a_simple_setup(setup, ur5):
    assert isinstance(setup.getOptimizationObjective(), DangerObjective)
    assert setup.getStateSpace().getDimension() == 6
    setup.setPlanner(SafeRRTConnect(setup.getSpaceInformation()))
    assert setup.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    assert setup.report(setup.solution()).certified
    assert setup.getSolutionPath().check()


def test_printing_it_costs_no_queries(setup):
    setup.counts.reset()
    for text in (str(setup), repr(setup), f"{setup}"):
        assert text.startswith("SafeSetup(Robot('ur5'")
    assert setup.counts.collision_queries == 0


def test_danger_is_optional(ur5, scene):
    setup = SafeSetup(ur5, scene, danger=None)
    assert setup.field is None
    assert setup.getOptimizationObjective() is None
    setup.setConfigurations(START, GOAL)
    result = setup.plan(time=10.0)
    assert result.report.danger is None
    assert result.counts.field_configurations == 0


# ----------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("which", ["start", "goal"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({1: np.nan}, "configuration must be finite"),
        ({1: np.inf}, "configuration must be finite"),
        ({2: 3.5}, r": joint 'elbow_joint' = 3.5 is outside its limits \[-3.14159, 3.14159\]"),
    ],
)
def test_configurations_that_make_no_sense(setup, which, change, message):
    bad = START.copy()
    for joint, value in change.items():
        bad[joint] = value
    with pytest.raises(InputError, match=which + ".*" + message):
        setup.setConfigurations(*((bad, GOAL) if which == "start" else (START, bad)))


@pytest.mark.parametrize("bad", [START[:5], [], "home", None, [START[:3], START[3:]], [[START]]])
def test_configurations_of_the_wrong_shape(setup, bad):
    with pytest.raises(InputError, match="start configuration must"):
        setup.setConfigurations(bad, GOAL)
    with pytest.raises(InputError, match=r"goal( \d)? configuration must"):
        setup.setConfigurations(START, bad)


def test_a_start_in_collision_names_the_pair(setup):
    with pytest.raises(CollisionError, match=r"start is in collision: '.*_link' touches 'ball'"):
        setup.setConfigurations(IN_BALL, GOAL)
    folded = np.array([0.0, -1.6, 3.0, 0.0, 0.0, 0.0])
    with pytest.raises(CollisionError, match=r"goal is in collision: '\w+_link' touches '\w+_link'"):
        setup.setConfigurations(START, folded)


@pytest.mark.parametrize("time", [0, -1.0, np.nan, np.inf, "5", None])
def test_time_limits_that_cannot_be_met(setup, time):
    with pytest.raises(InputError, match="time limit must be a positive number of seconds"):
        setup.plan(time=time)


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5, "one", None, True])
def test_seeds_that_are_none(setup, seed):
    with pytest.raises(InputError, match="seed must be a whole number"):
        setup.plan(seed=seed)


def test_unknown_planner_and_parameter(setup):
    with pytest.raises(UnknownNameError, match="unknown planner 'RTT'; did you mean 'RRT'"):
        setup.plan("RTT")
    with pytest.raises(UnknownNameError, match=r"unknown parameter of SafeRRTConnect 'alfa'; did you mean 'alpha'"):
        setup.plan(parameters={"alfa": 1.0})
    with pytest.raises(InputError, match="alpha must be a finite number >= 0, got 'much'"):
        setup.plan(parameters={"alpha": "much"})
    with pytest.raises(InputError, match="parameter 'range' of RRTConnect: 'far' has the wrong type"):
        setup.plan("RRTConnect", parameters={"range": "far"})


def test_every_planner_name_makes_a_planner(setup):
    for name in planner_names():
        assert isinstance(make_planner(name, setup.getSpaceInformation()), ob.Planner)


def test_in_a_scene_in_which_nothing_is_dangerous_danger_is_zero(ur5, scene):
    setup = SafeSetup(ur5, scene.without("ball"))
    assert setup.field.value(np.zeros(6)) == 0.0


def test_options_of_the_danger(ur5, scene):
    mean = SafeSetup(ur5, scene, danger={"aggregate": "mean", "spacing": 0.2})
    assert mean.field.aggregate == "mean"
    assert len(mean.field.points) < len(SafeSetup(ur5, scene).field.points)
    with pytest.raises(InputError):
        SafeSetup(ur5, scene, danger={"aggregate": "median"})
    with pytest.raises(InputError, match="agregate"):
        SafeSetup(ur5, scene, danger={"agregate": "mean"})


def test_problems_without_start_or_goal_are_refused(ur5, scene):
    setup = SafeSetup(ur5, scene)
    for call in (setup.setup, setup.solve, setup.plan):
        with pytest.raises(InputError, match="no goal is set"):
            call()
    setup.setWorkspaceGoal([0.4, 0.3, 0.4])
    with pytest.raises(InputError, match="no start is set"):
        setup.solve(0.1)


def test_a_problem_on_which_ompl_hangs_is_refused(setup):
    setup.setConfigurations(START, START)
    with pytest.raises(InputError, match="SORRTstar never ends"):
        setup.plan("SORRTstar", time=0.1)


@pytest.mark.parametrize("time", ["soon", -1.0, None, float("nan")])
def test_solve_refuses_times_that_make_no_sense(setup, time):
    with pytest.raises(InputError, match="time must be"):
        setup.solve(time)


def test_a_solution_that_a_planner_found_on_its_own_is_simplified(setup):
    planner = SafeRRTConnect(setup.getSpaceInformation())
    planner.setProblemDefinition(setup.getProblemDefinition())
    assert planner.solve(10.0)
    setup.simplifySolution(0.5)
    assert setup.report(setup.solution()).certified
