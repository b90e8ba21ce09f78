"""WorkspaceGoal: what OMPL's planners and ours get to sample, in which order, and what happens if there is nothing."""

import re
import signal
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import Box, InputError, Obstacle, PlanningError, Pose, SafeSetup, Scene, Sphere, WorkspaceGoal
from safe_ompl.robot import Robot, place_of, tip_reach

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
POSITION = [0.35, -0.45, 0.35]
ROTATION = pin.rpy.rpyToMatrix(3.0, 0.2, -0.4)
IN_BALL = START * [0, 1, 1, 1, 1, 1]
FAR = [1.1, 0.0, 0.5]  # out of reach, but not provably so

EXACT = ob.PlannerStatus.EXACT_SOLUTION
TIMEOUT = ob.PlannerStatus.TIMEOUT


@pytest.fixture(scope="module")
def scene():
    return Scene(
        (
            Obstacle("ball", Sphere(0.12), Pose((0.5, 0.0, 0.55)), weight=1.0),
            Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1))),
        )
    )


@pytest.fixture
def setup(ur5, scene):
    setup = SafeSetup(ur5, scene)
    setup.setStartConfiguration(START)
    return setup


def goal_for(setup, position=POSITION, rotation=None, *, seed=0, **options):
    si = setup.getSpaceInformation()
    place = place_of(setup.robot, position, rotation)
    return WorkspaceGoal(si, setup.robot, place, field=setup.field, seed=seed, **options)


def draw(setup, goal, number=1):
    """Return the next configurations that the goal hands out."""
    space = setup.getStateSpace()
    state = space.allocState()
    drawn = []
    for _ in range(number):
        goal.sampleGoal(state)
        drawn.append(state[0 : setup.robot.n])
    return np.array(drawn)


# ------------------------------------------------------------------------------------------------------------- goals


@pytest.mark.parametrize("rotation", [None, ROTATION])
def test_the_solutions_are_valid_and_at_the_place(setup, rotation):
    goal = goal_for(setup, rotation=rotation, tolerance=0.005)
    for q in draw(setup, goal, 8):
        tip = setup.robot.tip_pose(q)
        assert np.linalg.norm(tip.translation - POSITION) < 5e-4
        assert rotation is None or np.linalg.norm(pin.log3(rotation.T @ tip.rotation)) < 2e-3
        assert setup.robot.within_limits(q, 0.0).all()
        assert not setup.checker.in_collision(q)


def test_the_distance_is_the_tips(setup):
    goal = goal_for(setup)
    state = setup.getStateSpace().allocState()
    state[0:6] = START.tolist()
    expected = np.linalg.norm(setup.robot.tip_pose(START).translation - POSITION)
    assert goal.distanceGoal(state) == pytest.approx(expected)
    assert not goal.isSatisfied(state)
    goal.sampleGoal(state)
    assert goal.isSatisfied(state)


def test_the_safest_comes_first(setup):
    goal = goal_for(setup)
    danger = setup.field.values(draw(setup, goal, 5))
    assert danger[0] == danger.min()
    assert (np.diff(danger) >= 0).all()


def test_one_solution_is_offered_at_first_and_more_to_those_who_ask(setup):
    goal = goal_for(setup)
    assert goal.maxSampleCount() == 1
    assert goal.maxSampleCount() == 1
    assert all(goal.couldSample() for _ in range(200))
    assert 5 < goal.maxSampleCount() < 50
    assert len(goal.solutions) == goal.maxSampleCount()
    apart = np.linalg.norm(goal.solutions[:, None] - goal.solutions, axis=2)
    assert apart[np.triu_indices(len(apart), 1)].min() > 0.05


def test_a_finite_set_of_solutions_begins_anew(setup):
    """A UR5 has eight configurations for a pose at most: after the last comes the first."""
    goal = goal_for(setup, rotation=ROTATION)
    drawn = draw(setup, goal, 300)
    different = np.unique(drawn.round(3), axis=0)
    assert len(different) == len(goal.solutions) <= 8
    assert (np.linalg.norm(drawn[1:] - drawn[0], axis=1) == 0).any()


def test_the_same_seed_gives_the_same_solutions(setup):
    first = draw(setup, goal_for(setup, seed=3), 5)
    goal = goal_for(setup, seed=4)
    assert not np.array_equal(draw(setup, goal, 5), first)
    goal.setSeed(3)
    np.testing.assert_array_equal(draw(setup, goal, 5), first)
    assert goal.getSeed() == 3
    assert len(goal_for(setup, seed=None).solutions) == 0


def test_solutions_of_continuous_joints(kinova, rng):
    setup = SafeSetup(kinova, Scene(()), danger=None)
    q = kinova.lower + (kinova.upper - kinova.lower) * rng.random(kinova.n)
    tip = kinova.tip_pose(q)
    goal = goal_for(setup, tip.translation, tip.rotation)
    state = setup.getStateSpace().allocState()
    goal.sampleGoal(state)
    assert goal.distanceGoal(state) < 1e-3
    assert setup.getSpaceInformation().satisfiesBounds(state)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"position": [1, 2]}, "position of the tip"),
        ({"position": [1, 2, np.inf]}, "finite"),
        ({"rotation": 2 * np.eye(3)}, "orthonormal"),
        ({"tolerance": 0.0}, "tolerance must be a positive length"),
        ({"tolerance": np.nan}, "tolerance must be a positive length"),
        ({"seed": -1}, "seed must be a whole number >= 0, got -1"),
    ],
)
def test_goals_that_make_no_sense(setup, options, message):
    with pytest.raises(InputError, match=message):
        goal_for(setup, **options)


def test_a_space_of_another_robot_is_refused(setup, panda):
    with pytest.raises(InputError, match="6 coordinates, but 'panda' 7 joints"):
        WorkspaceGoal(setup.getSpaceInformation(), panda, POSITION)


def test_it_shows_itself(setup):
    assert repr(goal_for(setup)).startswith("WorkspaceGoal(Place('ur5', [0.35, -0.45, 0.35]), tolerance=0.01")


# ---------------------------------------------------------------------------------------------------------- planners


@pytest.mark.parametrize("rotation", [None, ROTATION])
@pytest.mark.parametrize("planner", ["SafeRRTConnect", "RRTConnect", "RRT", "KPIECE1", "BKPIECE1"])
def test_planners_reach_the_place(setup, planner, rotation):
    setup.setWorkspaceGoal(POSITION, rotation)
    result = setup.plan(planner, time=10.0, seed=1)
    assert result.status == "Exact solution"
    assert setup.getGoal().place.distance(result.path[-1]) < 0.01
    assert result.report.certified


def test_planners_get_more_goals_while_they_plan(setup):
    """The start is walled in, so that the search goes on until the time is up."""
    setup.setStateValidityChecker(lambda state: bool(abs(state[0] - START[0]) < 1e-9 or state[0] < 0.6))
    setup.setWorkspaceGoal(POSITION)
    assert not setup.plan("SafeRRTConnect", time=0.5)
    ours = len(setup.getGoal().solutions)
    assert not setup.plan("RRTConnect", time=0.5)
    assert ours > 3
    assert len(setup.getGoal().solutions) > 3


@pytest.mark.parametrize(
    ("planner", "status"),
    [("SafeRRTConnect", "Timeout"), ("RRTConnect", "Invalid goal"), ("RRT", "Approximate solution")],
)
def test_out_of_reach_planners_stop_in_time(setup, ticks, planner, status):
    """What OMPL's planners say then is theirs; none claims to be there."""
    setup.setWorkspaceGoal(FAR)
    result = setup.plan(planner, time=0.05)
    assert result.status == status
    assert not result
    assert ticks.looks < 80
    with pytest.raises(PlanningError, match="no valid configuration"):
        setup.getGoal().sampleGoal(setup.getStateSpace().allocState())


@pytest.mark.parametrize("position", [[2.0, 0.0, 0.5], [0.0, 0.0, -1.2], [0.4, 550.0, 0.3]])
def test_a_place_beyond_the_proven_reach_is_refused_at_once(setup, position):
    with pytest.raises(InputError, match=r"out of reach: it is .* m from .* never more than 1.24 m from there"):
        setup.setWorkspaceGoal(position)


@pytest.mark.parametrize("name", ["ur5", "panda", "kinova", "xarm7", "so101", "ur5 on wheels"])
def test_the_tip_never_leaves_its_reach(robot_named, name, rng):
    if name == "ur5 on wheels":
        arm = Robot.from_example("ur5", mobile_base=((-1.0, 2.0), (-0.5, 0.5)))
    else:
        arm = robot_named(name)
    if arm:
        centre, radius = tip_reach(arm)
        tips = [arm.tip_pose(q).translation for q in rng.uniform(arm.lower, arm.upper, (300, arm.n))]
        away = np.linalg.norm(np.array(tips) - centre, axis=1)
        assert away.max() <= radius + 1e-9
        assert away.max() > 0.4 * radius, "the bound says something"


def test_planners_say_how_near_the_tip_came(setup, caplog):
    setup.setWorkspaceGoal(FAR, np.eye(3))
    assert not setup.plan("SafeRRTConnect", time=0.3)
    (said,) = [record.message for record in caplog.records if "inverse kinematics" in record.message]
    tries, off, turn = re.match(
        r"(\d+) searches .* found no valid .* within (\d+) mm and ([0-9.]+) deg of the goal at best; its reach", said
    ).groups()
    assert int(tries) >= 16
    centre, radius = tip_reach(setup.robot)
    assert 1e3 * (np.linalg.norm(FAR - centre) - radius) < float(off) < 500
    assert 0.0 <= float(turn) <= 180.0


def test_planners_say_that_every_configuration_at_the_place_is_refused(setup, caplog):
    setup.setWorkspaceGoal([0.5, 0.0, 0.55])  # inside the ball
    assert not setup.plan("SafeRRTConnect", time=0.3)
    (said,) = [record.message for record in caplog.records if "inverse kinematics" in record.message]
    assert re.search(r"\d+ brought the tip .* all are refused; the last one is in collision: .* touches 'ball'", said)


def test_nothing_is_said_of_a_place_that_is_reached(setup, caplog):
    setup.setWorkspaceGoal(POSITION)
    assert setup.plan("SafeRRTConnect", time=10.0)
    assert not [record for record in caplog.records if "inverse kinematics" in record.message]


def test_an_invalid_start_is_reported_without_waiting_for_goals(setup, ticks):
    setup.setWorkspaceGoal(FAR)
    state = setup.getStateSpace().allocState()
    state[0:6] = IN_BALL.tolist()
    setup.clearStartStates()
    setup.addStartState(state)
    planner = og.RRTConnect(setup.getSpaceInformation())
    assert setup.plan(planner, time=5.0).status == "Invalid start"
    ticks.looks = 0
    assert setup.plan("SafeRRTConnect", time=5.0).status == "Invalid start"
    assert ticks.looks < 20


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "RRTConnect"])
def test_waiting_for_a_goal_can_be_interrupted(setup, ticks, planner):
    setup.setWorkspaceGoal(FAR)
    ticks.at[30] = lambda: signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        setup.plan(planner, time=10.0)
    assert not ticks.at
    assert ticks.looks == 30


def test_nothing_is_left_over_at_exit():
    """Goals, planners and setups let go of each other: nanobind would name what leaks."""
    program = """
from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.geometry.pose import Pose
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.geometry.basic import Sphere
from safe_ompl.planning.safe_setup import SafeSetup

ball = Obstacle("ball", Sphere(0.1), Pose((0.5, 0.0, 0.8)), weight=1.0)
setup = SafeSetup(Robot.from_example("ur5"), Scene((ball,)))
setup.setStartConfiguration([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
for position in ([0.35, -0.45, 0.35], [1.1, 0.0, 0.5]):
    setup.setWorkspaceGoal(position)
    for planner in ("SafeRRTConnect", "SafeJTRRT", "RRTConnect", "RRT"):
        setup.plan(planner, time=0.2)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    assert "leaked" not in run.stderr
