"""Places and regions of the tip: what planners get to sample, in which order, and what happens if there is nothing."""

import re
import signal
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from ball import IN_BALL, SCENE, START
from ompl import geometric as og

from safe_ompl import GoalRegion, InputError, PlanningError, Pose, RegionGoal, SafeSetup, Scene, WorkspaceGoal
from safe_ompl.robot import Robot, target_pose, tip_reach

POSITION = [0.35, -0.45, 0.35]
ROTATION = pin.rpy.rpyToMatrix(3.0, 0.2, -0.4)
FAR = [1.1, 0.0, 0.5]  # out of reach, but not provably so
SHELF = GoalRegion(Pose((0.4, -0.4, 0.35)), x=(-0.1, 0.1), y=(-0.1, 0.1), z=(0.0, 0.1))
RING = GoalRegion(  # about a pole, the hand downwards but for 0.3 rad
    Pose.from_rpy((0.45, -0.35, 0.3), (np.pi, 0.0, 0.0)), radius=(0.08, 0.12), roll=(-0.3, 0.3), pitch=(-0.3, 0.3)
)
REGIONS = [pytest.param(SHELF, id="shelf"), pytest.param(RING, id="ring")]


@pytest.fixture
def setup(ur5):
    setup = SafeSetup(ur5, SCENE)
    setup.setStartConfiguration(START)
    return setup


def goal_for(setup, position=POSITION, rotation=None, *, seed=0, **options):
    si = setup.getSpaceInformation()
    options = {"field": setup.field, "seed": seed, **options}
    if isinstance(position, GoalRegion):
        return RegionGoal(si, setup.robot, position, **options)
    return WorkspaceGoal(si, setup.robot, target_pose(setup.robot, position, rotation), **options)


def draw(setup, goal, number=1):
    """Return the next configurations that the goal hands out."""
    state, drawn = setup.getStateSpace().allocState(), []
    for _ in range(number):
        goal.sampleGoal(state)
        assert goal.distanceGoal(state) <= 0.05 * goal.tolerance
        drawn.append(state[0 : setup.robot.n])
    return np.array(drawn)


# ------------------------------------------------------------------------------------------------------------- goals


@pytest.mark.parametrize(("place", "rotation"), [(POSITION, None), (POSITION, ROTATION), (SHELF, None), (RING, None)])
def test_the_solutions_are_valid_and_at_the_place_or_all_over_the_region(setup, place, rotation):
    region = isinstance(place, GoalRegion)
    drawn = draw(setup, goal_for(setup, place, rotation, tolerance=0.01 if region else 0.005), 12)
    assert all(setup.robot.within_limits(q, 0.0).all() and not setup.checker.in_collision(q) for q in drawn)
    tips = [setup.robot.tip_pose(q) for q in drawn]
    if region:
        assert np.ptp([tip.translation for tip in tips], axis=0)[:2].min() > 0.05
        assert max(place.distance(tip) for tip in tips) < 1e-4
        return
    for tip in tips:
        assert np.linalg.norm(tip.translation - POSITION) < 5e-4
        assert rotation is None or np.linalg.norm(pin.log3(rotation.T @ tip.rotation)) < 2e-3


@pytest.mark.parametrize("goal", [POSITION, *REGIONS])
def test_the_distance_is_the_tips(setup, goal, rng):
    goal = goal_for(setup, goal)
    state = setup.getStateSpace().allocState()
    for q in rng.uniform(-2, 2, (10, setup.robot.n)):
        state[0 : setup.robot.n] = q.tolist()
        tip = setup.robot.tip_pose(q)
        region = isinstance(goal, RegionGoal)
        expected = goal.region.distance(tip) if region else np.linalg.norm(tip.translation - POSITION)
        assert goal.distanceGoal(state) == pytest.approx(expected)
        assert goal.isSatisfied(state) == (goal.distanceGoal(state) < goal.tolerance)
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


@pytest.mark.parametrize("place", [POSITION, *REGIONS])
def test_the_same_seed_gives_the_same_solutions(setup, place):
    first = draw(setup, goal_for(setup, place, seed=3), 5)
    goal = goal_for(setup, place, seed=4)
    assert not np.array_equal(draw(setup, goal, 5), first)
    goal.setSeed(3)
    np.testing.assert_array_equal(draw(setup, goal, 5), first)
    assert goal.getSeed() == 3


def test_solutions_of_continuous_joints(kinova, rng):
    setup = SafeSetup(kinova, Scene(()), danger=None)
    q = kinova.lower + (kinova.upper - kinova.lower) * rng.random(kinova.n)
    tip = kinova.tip_pose(q)
    goal = goal_for(setup, tip.translation, tip.rotation)
    state = setup.getStateSpace().allocState()
    goal.sampleGoal(state)
    assert goal.distanceGoal(state) < 1e-3
    assert setup.getSpaceInformation().satisfiesBounds(state)


TOO_FAR = r"out of reach: it is .* m from .* never more than 1.24 m from there"
NO_GOALS = [
    (lambda setup, panda: goal_for(setup, rotation=2 * np.eye(3)), "orthonormal"),
    (lambda setup, panda: goal_for(setup, tolerance=0.0), "tolerance: must be a positive length"),
    (lambda setup, panda: goal_for(setup, seed=-1), "seed: must be a whole number >= 0, got -1"),
    (lambda setup, panda: setup.setWorkspaceGoal([2.0, 0.0, 0.5]), TOO_FAR),
    (lambda setup, panda: setup.setWorkspaceGoal([0.4, 550.0, 0.3]), TOO_FAR),
    (lambda setup, panda: setup.setGoalRegion(GoalRegion(Pose((0.0, 0.0, -1.2)), x=(-0.1, 0.1))), TOO_FAR),
    (lambda setup, panda: setup.setGoalRegion(pin.SE3.Identity()), "region: must be a GoalRegion, got"),
    (lambda setup, panda: WorkspaceGoal(setup.getSpaceInformation(), panda, POSITION), "6 coordinates, but 'panda' 7"),
]


@pytest.mark.parametrize(("wrong", "message"), NO_GOALS)
def test_goals_that_make_no_sense(setup, panda, wrong, message):
    with pytest.raises(InputError, match=message):
        wrong(setup, panda)


# ---------------------------------------------------------------------------------------------------------- planners


REACHED = [
    *((name, ROTATION) for name in ("KPIECE1", "SafeRRTConnect", "RRTConnect")),
    ("RRT", None),
    *((name, SHELF) for name in ("SafeRRTConnect", "SafeJTRRT", "SafePRM", "BubblePlanner", "RRTConnect")),
    *((name, RING) for name in ("SafeRRTConnect", "SafeJTRRT")),
]


@pytest.mark.parametrize(("planner", "goal"), REACHED)
def test_planners_reach_the_place_or_the_region(setup, planner, goal):
    setup.setWorkspaceGoal(POSITION, None if isinstance(goal, GoalRegion) else goal)
    if isinstance(goal, GoalRegion):
        setup.setGoalRegion(goal)  # takes the place of the place
    result = setup.plan(planner, time=20.0, seed=1)
    assert result.certified
    assert setup.getGoal().target.distance(result.path[-1]) <= setup.getGoal().tolerance


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


@pytest.mark.parametrize("name", ["ur5", "kinova", "so101", "ur5 on wheels"])
def test_the_tip_never_leaves_its_reach(robot_named, name, rng):
    if name == "ur5 on wheels":
        arm = Robot.from_example("ur5", mobile_base=((-1.0, 2.0), (-0.5, 0.5)))
    else:
        arm = robot_named(name)
    centre, radius = tip_reach(arm)
    tips = [arm.tip_pose(q).translation for q in rng.uniform(arm.lower, arm.upper, (300, arm.n))]
    away = np.linalg.norm(np.array(tips) - centre, axis=1).max()
    assert 0.4 * radius < away <= radius + 1e-9


def test_planners_say_why_there_is_no_goal_configuration(setup, caplog):
    for place, rotation in ((FAR, np.eye(3)), ([0.5, 0.0, 0.55], None), (POSITION, None)):
        setup.setWorkspaceGoal(place, rotation)
        assert bool(setup.plan("SafeRRTConnect", time=0.3 if place != POSITION else 10.0)) is (place == POSITION)
    far, inside = [record.message for record in caplog.records if "inverse kinematics" in record.message]
    tries, off, turn = re.match(
        r"(\d+) searches .* found no valid .* within (\d+) mm and ([0-9.]+) deg of the goal at best; its reach", far
    ).groups()
    assert int(tries) >= 16
    centre, radius = tip_reach(setup.robot)
    assert 1e3 * (np.linalg.norm(FAR - centre) - radius) < float(off) < 500
    assert 0.0 <= float(turn) <= 180.0
    assert re.search(r"\d+ brought the tip .* all are refused; the last one is in collision: .* touches '\w+'", inside)


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
from safe_ompl import Obstacle, Pose, Robot, SafeSetup, Scene, Sphere

ball = Obstacle("ball", Sphere(0.1), Pose((0.5, 0.0, 0.8)), weight=1.0)
setup = SafeSetup(Robot.from_example("ur5"), Scene((ball,)))
setup.setStartConfiguration([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
for position in ([0.35, -0.45, 0.35], [1.1, 0.0, 0.5]):
    setup.setWorkspaceGoal(position)
    for planner in ("SafeRRTConnect", "SafeJTRRT", "RRTConnect", "RRT"):
        setup.plan(planner, time=0.2)
setup.setConfigurations([0.8, -1.6, 1.2, -1.2, -1.57, 0.0], [-0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
for planner in ("SafeRRTConnect", "SafePRM", "BubblePlanner"):
    assert setup.plan(planner)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert run.returncode == 0, run.stderr
    assert "leaked" not in run.stderr
