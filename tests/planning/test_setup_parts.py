"""The parts of SafeSetup, each alone: wiring, problem, and a run."""

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import DangerLimit, SafeSetup, make_planner
from safe_ompl.collision import CollisionChecker, Separation
from safe_ompl.common import CollisionError, InputError, UnknownNameError
from safe_ompl.paths import Constraints
from safe_ompl.planning.ompl import WorkspaceGoal, joint_space
from safe_ompl.planning.optimise import stopping
from safe_ompl.planning.planners import termination
from safe_ompl.planning.problem import Problem, Wiring
from safe_ompl.planning.run import PlanningRun
from safe_ompl.planning.safe_setup import simplification_time

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
IN_BALL = START * [0, 1, 1, 1, 1, 1]


class Plain(og.SimpleSetup):
    """OMPL's setup, of a class of Python's."""


@pytest.fixture
def plain(ur5):
    return Plain(joint_space(ur5))


@pytest.fixture
def wiring(plain, ur5, scene):
    return Wiring(plain.getSpaceInformation(), CollisionChecker(ur5, scene))


@pytest.fixture
def problem(plain, wiring):
    return Problem(plain, wiring)


# ---------------------------------------------------------------------------------------------------------- wiring


def test_what_cannot_be_put_in_place_leaves_both_plugins(wiring):
    motion, before = wiring.validator.motion, wiring.constraints
    with pytest.raises(UnknownNameError, match="nobody"):
        wiring.put(Constraints(Separation(speeds={"nobody": 1.0}, time=1.0)))
    assert wiring.constraints is before
    assert wiring.validator.motion is motion


# --------------------------------------------------------------------------------------------------------- problem


def test_a_problem_that_is_refused_leaves_the_last_one(plain, problem):
    problem.set_configurations(START, GOAL)
    goal = plain.getGoal()
    with pytest.raises(CollisionError, match="start is in collision"):
        problem.set_configurations(IN_BALL, START)
    assert plain.getGoal() is goal
    np.testing.assert_array_equal(problem.goals, [GOAL])


def test_of_a_place_and_configurations_a_planner_gets_what_it_plans_to(plain, wiring, problem):
    si, robot = plain.getSpaceInformation(), wiring.checker.robot
    problem.set_configurations(START, GOAL)
    states = plain.getGoal()
    problem.set_place(WorkspaceGoal(si, robot, robot.tip_pose(GOAL).translation, seed=0))
    problem.choose_goal(make_planner("SafeRRTConnect", si), 1)
    assert plain.getGoal() is states
    problem.choose_place(make_planner("SafeJTRRT", si))
    assert plain.getGoal() is problem.place


# -------------------------------------------------------------------------------------------------- paths made better


def test_a_simplifier_is_kept_as_long_as_the_checker(ur5, scene):
    setup = SafeSetup(ur5, scene)
    setup.setSimplification(clearance=0.02)
    first = setup.simplifier
    assert setup.simplifier is first
    setup.setMinClearance(0.01)
    assert setup.simplifier.motion is setup.motion_prover is not first.motion
    assert setup.simplifier.cost is first.cost
    setup.setScene(scene.without(scene.names[-1]))
    other = setup.simplifier
    assert other.cost is not first.cost
    assert other.obstacle_cost.distance == 0.02
    with pytest.raises(InputError, match="without danger"):
        SafeSetup(ur5, scene, danger=None).simplifier  # noqa: B018


def test_a_run_keeps_to_the_limit_of_its_planner(ur5, scene):
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(START, GOAL)
    planner = make_planner("SafeRRTConnect", setup.getSpaceInformation(), {"max_danger": 1e3})
    run = PlanningRun(setup, *setup.prepare(planner, 3), 3)
    before = setup.getConstraints()
    with run.under_own_limit():
        (limit,) = setup.motion_prover.limits
        assert (type(limit), limit.limit) == (DangerLimit, 1e3)
        assert setup.getConstraints() is before, "states are the planner's to check"
    assert setup.motion_prover.limits == ()
    result = run.validated(run.planned(20.0), begin=0.0)
    np.testing.assert_array_equal(result.path, setup.plan(seed=3, parameters={"max_danger": 1e3}).path)


# ----------------------------------------------------------------------------------------------------- limits of time


def test_limits_of_time(ticks):
    assert (simplification_time(True), simplification_time(False), simplification_time(0.5)) == (0.0, None, 0.5)
    with pytest.raises(InputError, match="simplify must be a positive number of seconds, got 0"):
        simplification_time(0)
    over = termination(0.01)
    assert [over() for _ in range(12)].index(True) == 9, "the first look was when it was made"
    assert not any(stopping(0.0)() for _ in range(3))
    assert stopping(ob.PlannerTerminationCondition(lambda: True))()
