"""SafeSetup and plan: from a problem to a validated path, and clear words about problems that make no sense."""

import dataclasses
import logging
import re

import numpy as np
import pinocchio as pin
import pytest
from ball import BALL, GOAL, IN_BALL, SCENE, START, setup_for
from ompl import base as ob, geometric as og

from safe_ompl import CollisionError, DangerObjective, InputError, MotionProver, Scenario, Scene, check, time_path
from safe_ompl.certificates import certificate, verify
from safe_ompl.planning import SafeSetup, plan, setup_scenario
from safe_ompl.planning.planners import SafeRRTConnect, make_planner
from safe_ompl.robot import START_TOLERANCE, RobotSpec, ScratchState, StateBridge
from safe_ompl.scene.scenario import Goal
from safe_ompl.tasks import ToolPath, tool_motion


@pytest.fixture
def setup(ur5):
    return setup_for(ur5, SCENE)


# -------------------------------------------------------------------------------------------------------- the result


def test_a_solved_problem(setup, ur5):
    planner = SafeRRTConnect(setup.getSpaceInformation(), "Mine", range=0.5)
    result = setup.plan(planner, time=10.0, seed=3)
    assert result.solved
    assert result.status == "Exact solution"
    assert (result.planner, result.seed, result.joint_names) == ("Mine", 3, ur5.joint_names)
    np.testing.assert_allclose(result.path[[0, -1]], [START, GOAL])
    assert result.certified
    assert result.report.length == pytest.approx(np.linalg.norm(np.diff(result.path, axis=0), axis=1).sum())
    assert planner.getSeed() == 3
    counts = result.counts
    assert counts.nodes == planner.counts.nodes >= len(result.path) - 2
    assert counts.bound_queries > counts.margin_queries
    assert counts.field_configurations > 0
    assert counts.distance_queries == 0, "the report's own work is not planning"


def test_a_goal_that_is_the_start(setup):
    setup.setConfigurations(START, START)
    np.testing.assert_allclose(setup.plan(time=5.0).path[[0, -1]], [START, START])
    with pytest.raises(InputError, match="SORRTstar never ends"):
        setup.plan("SORRTstar", time=0.1)


def test_as_an_ompl_setup(setup):
    assert isinstance(setup.getOptimizationObjective(), DangerObjective)
    setup.setPlanner(SafeRRTConnect(setup.getSpaceInformation()))
    assert setup.solve(10.0).getStatus() == ob.PlannerStatus.EXACT_SOLUTION
    assert setup.getSolutionPath().check()
    own = SafeRRTConnect(setup.getSpaceInformation())  # a planner may be run on its own
    own.setProblemDefinition(setup.getProblemDefinition())
    setup.getProblemDefinition().clearSolutionPaths()
    assert own.solve(10.0)
    setup.simplifySolution(0.5)
    assert setup.is_free(setup.solution())
    setup.counts.reset()
    assert f"{setup}".startswith("SafeSetup(Robot('ur5'")
    assert setup.counts.collision_queries == 0, "OMPL's own words would ask thousands"


def test_danger_is_optional_and_has_options(ur5, setup):
    plain = setup_for(ur5, SCENE, danger=None)
    assert (plain.field, plain.getOptimizationObjective()) == (None, None)
    result = plain.plan(time=10.0)
    assert result.report.danger is None
    assert result.counts.field_configurations == 0
    assert SafeSetup(ur5, SCENE.without("ball")).field.value(START) == 0.0
    mean = SafeSetup(ur5, SCENE, danger={"aggregate": "mean", "spacing": 0.2})
    assert mean.field.aggregate == "mean"
    assert len(mean.field.points) < len(setup.field.points)
    for bad, message in (
        ({"aggregate": "median"}, "median"),
        ({"agregate": "mean"}, "agregate"),
        (True, "danger must be a mapping of options, or None for no danger field, got True"),
    ):
        with pytest.raises(InputError, match=message):
            SafeSetup(ur5, SCENE, danger=bad)


# ----------------------------------------------------------------------------------------------------------- bad input


BAD_CONFIGURATIONS = [
    (START * [1, np.nan, 1, 1, 1, 1], "configuration: must be finite"),
    (np.add(START, [0, 0, 2.3, 0, 0, 0]), r": joint 'elbow_joint' = 3.5 is outside its limits \[-3.14159, 3.14159\]"),
    (IN_BALL, r" is in collision: '.*_link' touches 'ball'"),
    ([0.0, -1.6, 3.0, 0.0, 0.0, 0.0], r" is in collision: '\w+_link' touches '\w+_link'"),
    ("home", "configuration: .*unknown group state 'home'"),
    *((shape, "configuration: must") for shape in (START[:5], [], None, [START[:3], START[3:]], [[START]])),
]


@pytest.mark.parametrize("which", ["start", "goal"])
@pytest.mark.parametrize(("bad", "message"), BAD_CONFIGURATIONS)
def test_configurations_that_make_no_sense(setup, which, bad, message):
    with pytest.raises((InputError, CollisionError), match=rf"{which}( \d)?.*{message}"):
        setup.setConfigurations(*((bad, GOAL) if which == "start" else (START, bad)))
    np.testing.assert_array_equal(setup.query.goals, [GOAL])


BAD_ARGUMENTS = [
    *(("plan", {"time": time}, "time limit: must be a positive number") for time in (0, -1.0, np.nan, np.inf, "5")),
    *(("solve", {"time": time}, "time must be") for time in ("soon", -1.0, None, float("nan"))),
    *(("plan", {"seed": seed}, "seed: must be a whole number") for seed in (-1, 2**32, 1.5, "one", None, True)),
    *(("plan", {"ways": ways}, f'ways must be 1 or "all", got {ways!r}') for ways in (2, True, "both", None)),
    ("plan", {"ways": "all", "starts": 2}, "leave out starts"),
    ("plan", {"ways": "all", "optimise": 1.0}, "leave out optimise"),
    ("plan", {"starts": 0}, "starts"),
    ("plan", {"starts": 1.5}, "starts"),
    ("plan", {"starts": 2, "workers": 0}, "workers"),
    ("plan", {"planner": "RTT"}, "unknown planner 'RTT'; did you mean 'RRT'"),
    ("plan", {"planner": "RTT", "starts": 2}, "unknown planner 'RTT'; did you mean 'RRT'"),
    ("plan", {"parameters": {"alfa": 1.0}}, "unknown parameter of SafeRRTConnect 'alfa'; did you mean 'alpha'"),
    ("plan", {"planner": None}, "planner must be a name of planner_names"),
    ("plan", {"planner": SafeRRTConnect}, r"SafeRRTConnect is a class: give a planner, SafeRRTConnect\(setup"),
    ("plan", {"simplify": -1.0}, "simplify: must be a positive number of seconds"),
    ("plan", {"simplify": "long"}, "simplify"),
    ("plan", {"optimise": np.nan}, "time limit"),
    ("simplifySolution", {}, "there is no solution"),
    ("solution", {}, "there is no solution: call solve or plan first"),
    ("setSimplification", {"weight": -1.0}, "weight"),
    *(("setPlanner", {"planner": planner}, "planner") for planner in (3, None, "RRTConnect", og.RRTConnect)),
    ("setStateValidityChecker", {"checker": lambda state: None}, "must return a bool"),
    ("setStateValidityChecker", {"checker": 5}, "must be an ob.StateValidityChecker or a function of a state, got 5"),
    ("setStateValidityChecker", {"checker": bool, "resolution": 0.0}, "resolution: must be a positive distance"),
]


@pytest.mark.parametrize(("call", "options", "message"), BAD_ARGUMENTS)
def test_arguments_that_make_no_sense(setup, call, options, message):
    with pytest.raises(InputError, match=message):
        getattr(setup, call)(**options)


def planned_by_setup(robot, start):
    setup = SafeSetup(robot, SCENE)
    setup.setConfigurations(dict(zip(robot.joint_names, start, strict=True)), GOAL)
    path = setup.plan(time=10.0, simplify=False).path
    assert verify(certificate(path, robot, SCENE), robot, SCENE)
    return path


def planned_from_a_scenario(robot, start):
    goal = Goal(configurations=(tuple(GOAL.tolist()),))
    asked = Scenario("slightly", robot.spec, SCENE, tuple(start.tolist()), goal)
    return plan(asked, time=10.0, simplify=False).path


def planned_along_a_curve(robot, start):
    inside = np.minimum(np.maximum(start, robot.lower), robot.upper)
    tip, end = robot.tip_pose(inside), robot.tip_pose(np.add(inside, [0.0, 0.05, 0.05, 0.0, 0.0, 0.0]))
    found = tool_motion(ToolPath.line(tip, end), robot, Scene([]), start=start)
    return found.along.knots


@pytest.mark.parametrize("planned", [planned_by_setup, planned_from_a_scenario, planned_along_a_curve])
def test_a_start_slightly_outside_the_limits_begins_at_them(ur5, planned, caplog):
    """By up to 0.05 rad, with one warning; what is proven is of the start at the limit."""
    limit = np.nextafter(float(START[1]), 4.0)
    robot = ur5.with_limits({"shoulder_lift_joint": (limit, 3.0)})
    for away in (START_TOLERANCE - 1e-6, 1e-3):
        caplog.clear()
        start = np.where(np.arange(6) == 1, limit - away, START)
        with caplog.at_level(logging.WARNING):
            path = planned(robot, start)
        assert path[0, 1] == limit
        np.testing.assert_allclose(path[0], START, atol=1e-9)
        (said,) = [record.message for record in caplog.records if "clipped" in record.message]
        assert re.search(rf"start.*joint 'shoulder_lift_joint' = {start[1]:.4g}\d* is outside .* {limit:.4g}", said)
    with pytest.raises(InputError, match=r"start: joint 'shoulder_lift_joint' = .* is outside its limits"):
        planned(robot, np.where(np.arange(6) == 1, limit - START_TOLERANCE - 1e-6, START))
    with pytest.raises(InputError, match="start: joint 'shoulder_pan_joint' = 9 is outside its limits"):
        planned(robot, np.where(np.arange(6) == 0, 9.0, start))


@pytest.mark.parametrize("away", [1e-6, 0.04])
def test_a_goal_slightly_outside_the_limits_is_refused(ur5, away):
    setup = SafeSetup(ur5.with_limits({"elbow_joint": (-3.0, float(GOAL[2]) - away)}), SCENE)
    with pytest.raises(InputError, match="goal: joint 'elbow_joint' = "):
        setup.setConfigurations(START, GOAL)


def test_problems_without_start_or_goal_are_refused(ur5):
    setup = SafeSetup(ur5, SCENE)
    for call in (setup.setup, setup.solve, setup.plan):
        with pytest.raises(InputError, match="no goal is set"):
            call()
    setup.setWorkspaceGoal([0.4, 0.3, 0.4])
    with pytest.raises(InputError, match="no start is set"):
        setup.solve(0.1)
    setup.setStartConfiguration(START)
    setup.setGoal(ob.GoalLazySamples(setup.getSpaceInformation(), lambda goal, state: False, False, 0.1))
    with pytest.raises(InputError, match="GoalLazySamples deadlocks"):
        setup.solve(1.0)
    foreign = SafeRRTConnect(SafeSetup(ur5, SCENE).getSpaceInformation())
    with pytest.raises(InputError, match="SafeRRTConnect is a planner of another setup"):
        setup.plan(foreign)


WRONG_KINDS = [
    (lambda robot, scene: SafeSetup(robot, {}), "scene: must be a Scene, got {}"),
    (lambda robot, scene: SafeSetup("ur5", scene), "robot: must be a Robot, got 'ur5'"),
    (lambda robot, scene: SafeSetup(robot, scene).setConstraints([1]), "constraints: must be a Constraints"),
    (lambda robot, scene: check([START, GOAL], robot, scene, constraints=[1]), "constraints: must be a Con"),
    (lambda robot, scene: check([START, GOAL], robot, scene, limits=5.0), "limits: must be a RateLimits, got"),
    (lambda robot, scene: time_path([START, GOAL], robot, 5.0), "limits: must be a RateLimits, got 5.0"),
    (lambda robot, scene: time_path([START, GOAL], 5.0), "robot: must be a Robot, got 5.0"),
    (
        lambda robot, scene: SafeSetup(robot, scene).setStartConfiguration(np.degrees(START)),
        "start: joint 'shoulder_pan_joint' = 45.8366 is outside its limits [-3.14159, 3.14159]; "
        "degrees? 45.8366° are 0.8 rad",
    ),
    (
        lambda robot, scene: SafeSetup(robot, scene).setStartConfiguration(1000 * START),
        "start: joint 'shoulder_pan_joint' = 800 is outside its limits [-3.14159, 3.14159]",
    ),
]


@pytest.mark.parametrize(("wrong", "message"), WRONG_KINDS)
def test_what_is_of_the_wrong_kind(ur5, wrong, message):
    with pytest.raises(InputError) as caught:
        wrong(ur5, Scene(()))
    assert str(caught.value).startswith(message)
    assert ("degrees?" in str(caught.value)) == ("degrees?" in message)


# ------------------------------------------------------------------------------------------------------ forms of input


FORMS = [
    lambda robot, q: tuple(q),
    lambda robot, q: q.astype(np.float32),
    lambda robot, q: dict(zip(robot.joint_names, q, strict=True)),
    lambda robot, q: [np.float32(value) for value in q],
]


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_a_configuration(ur5, form):
    setup, start, goal = SafeSetup(ur5, BALL), form(ur5, START), form(ur5, GOAL)
    setup.setConfigurations(start, goal)
    np.testing.assert_allclose(setup.query.start, START, atol=1e-6)
    np.testing.assert_allclose(setup.bridge.read(setup.getGoal().getState(0)), GOAL, atol=1e-6)
    setup.setConfigurations(start, [goal, goal])
    assert setup.getGoal().getStateCount() == 2
    assert setup.plan(seed=np.int64(0), time=np.float32(20.0))


def test_one_warning_for_many_goals_in_collision(setup, caplog):
    with caplog.at_level(logging.WARNING):
        setup.setConfigurations(START, [IN_BALL] * 20 + [GOAL])
    (record,) = caplog.records
    assert record.getMessage().startswith("20 of 21 goals do not count: goal 0 is in collision: ")
    assert record.getMessage().endswith("; and 19 more")


def test_forms_of_a_pose(setup):
    pose = setup.robot.tip_pose(GOAL)
    turn = pin.Quaternion(pose.rotation)
    for given in ((pose,), (pose.translation, pose.rotation), (pose.translation.tolist(), turn.coeffs().tolist())):
        setup.setWorkspaceGoal(*given)
        place = setup.getGoal().target
        np.testing.assert_allclose(place.position, pose.translation, atol=1e-6)
        np.testing.assert_allclose(place.rotation, pose.rotation, atol=1e-6)
    with pytest.raises(InputError, match=r"quaternion \(x, y, z, w\) must be of unit length"):
        setup.setWorkspaceGoal([0.4, 0.1, 0.5], [0, 0, 0, 2])
    with pytest.raises(InputError, match="the pose has one already"):
        setup.setWorkspaceGoal(pose, np.eye(3))


def test_a_wider_space_does_not_widen_the_limits(robot_named):
    """Beyond its stroke the carriage meets a wall that it never meets within: that pair is not looked at."""
    slider = robot_named("slider")
    joint = int(np.flatnonzero(slider.prismatic)[0])
    middle = 0.5 * (slider.lower + slider.upper)
    beyond = middle.copy()
    beyond[joint] = slider.upper[joint] + 1.0
    setup = SafeSetup(slider, Scene(), danger=None)
    space = setup.getStateSpace()
    for part in [space] if isinstance(space, ob.RealVectorStateSpace) else space.getSubspaces():
        if isinstance(part, ob.RealVectorStateSpace):
            bounds = ob.RealVectorBounds(part.getDimension())
            bounds.setLow(-10.0)
            bounds.setHigh(10.0)
            part.setBounds(bounds)
    si, bridge = setup.getSpaceInformation(), StateBridge(space)
    start, end = ScratchState(bridge).set(middle), ScratchState(bridge).set(beyond)
    assert space.satisfiesBounds(end)
    assert not si.isValid(end)
    assert not si.checkMotion(start, end)
    assert not MotionProver(setup.checker).is_free(middle, beyond)


# --------------------------------------------------------------------------------------------------- parts of a setup


def test_of_a_place_and_configurations_a_planner_gets_what_it_plans_to(setup):
    states = setup.getGoal()
    setup.setWorkspaceGoal(setup.robot.tip_pose(GOAL).translation)
    place = setup.getGoal()
    for planner, goal in (("SafeRRTConnect", states), ("SafeJTRRT", place), ("RRTConnect", states)):
        setup.prepare(planner, 1)
        assert setup.getGoal() is goal
    setup.setGoal(states)
    setup.query.choose_place(make_planner("SafeJTRRT", setup.getSpaceInformation()))
    assert setup.getGoal() is place


# ----------------------------------------------------------------------------------------------------- from a scenario


@pytest.fixture
def scenario():
    return Scenario(
        "ball",
        RobotSpec("ur5"),
        SCENE,
        tuple(START.tolist()),
        Goal((tuple(GOAL.tolist()),)),
        planners={"SafeRRTConnect": {"range": 0.2, "alpha": 0.0}},
    )


def test_a_scenario_in_one_call(scenario, tmp_path):
    result = plan(scenario, seed=4)
    assert result
    assert result.setup_time > 0
    assert plan(scenario, seed=4, simplify=True).report.length < result.report.length
    assert np.linalg.norm(np.diff(result.path, axis=0), axis=1).max() <= 0.2 + 1e-9, "its own parameters"
    file = tmp_path / "ball.yaml"
    scenario.save(file)
    np.testing.assert_array_equal(plan(file, seed=4).path, result.path)
    wide = plan(file, seed=4, parameters={"range": 1.0})
    assert np.linalg.norm(np.diff(wide.path, axis=0), axis=1).max() > 0.2


def test_a_scenario_whose_start_collides_names_file_and_pair(scenario, tmp_path):
    file = tmp_path / "bad.yaml"
    dataclasses.replace(scenario, start=tuple(IN_BALL.tolist())).save(file)
    with pytest.raises(InputError, match=r"bad.yaml: start is in collision: '.*_link' touches 'ball'"):
        plan(file)


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "RRTConnect", "SafeJTRRT"])
def test_a_scenario_may_name_a_place_alone(planner):
    scenario = Scenario.load("ur5_handover")
    place = dataclasses.replace(scenario.goal, configurations=())
    setup = setup_scenario(dataclasses.replace(scenario, goal=place))
    result = setup.plan(planner, time=10.0, seed=1)
    assert result
    tip = setup.robot.tip_pose(result.path[-1]).translation
    assert np.linalg.norm(tip - place.position) <= place.tolerance
