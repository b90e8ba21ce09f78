"""What SafeRRTConnect and SafePRM promise alike, shown where every step can be followed: a point in a plane."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from plane import (
    EXACT,
    GOAL,
    START,
    TIMEOUT,
    ForbiddenCorner,
    HotSpot,
    PlaneProblem,
    SlopedHotSpot,
    Stop,
    dense,
    wall_with_a_gap,
    walled_in,
)

from safe_ompl import DangerField, DangerObjective, InputError, SafePRM, SafeRRTConnect, SafeSetup

ONE_MOTION = 300  # checks of the longest motion, and some


@pytest.fixture(params=[SafeRRTConnect, SafePRM])
def kind(request):
    """Return the class of a planner."""
    return request.param


@pytest.fixture
def problem(kind):
    """Return a function that poses a problem to a planner of this kind."""
    return partial(PlaneProblem, kind)


# -------------------------------------------------------------------------------------------------- ways in the plane


@pytest.mark.parametrize("alpha", [0.0, 1.0])
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("objective", [None, HotSpot, SlopedHotSpot, ForbiddenCorner])
def test_a_wall_with_a_gap(problem, objective, alpha):
    task = problem(wall_with_a_gap, objective, alpha=alpha)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])
    # The motion validator of this problem samples every 0.014; nothing else can slip through.
    inside = [point for point in dense(task.path) if wall_with_a_gap(*point)]
    assert all(min(abs(abs(x) - 0.1), abs(y - 0.55), abs(y - 0.75)) < 0.02 for x, y in inside)
    assert task.planner.counts.nodes > 2


def test_a_goal_that_cannot_be_reached_takes_its_time_and_no_more(problem):
    task = problem(walled_in)
    stop = Stop(task.walls, 2000)
    assert task.solve(stop.condition) == TIMEOUT
    assert stop.checked_too_late <= ONE_MOTION
    assert not task.problem.hasSolution()


@pytest.mark.parametrize("start", [(0.0, 0.0), (-1.5, 0.0), (np.nan, 0.0)])
def test_a_start_that_is_not_valid(problem, start):
    task = problem(wall_with_a_gap, starts=[start])
    if np.isnan(start[0]):
        task.walls.forbidden = lambda x, y: np.isnan(x)
    assert task.solve() == ob.PlannerStatus.INVALID_START


@pytest.mark.parametrize("goal", [(0.0, 0.0), (1.5, 0.0)])
def test_a_goal_that_is_not_valid_wastes_no_time(problem, goal):
    task = problem(wall_with_a_gap, goals=[goal])
    assert task.solve(5.0) == ob.PlannerStatus.INVALID_GOAL
    assert len(task.walls.asked) <= 2, "start and goal"


@pytest.mark.parametrize("within_walls", [False, True])
def test_several_starts_and_goals_of_which_some_will_do(problem, within_walls):
    def forbidden(x, y):
        return wall_with_a_gap(x, y) or (within_walls and walled_in(x, y))  # those are around GOAL

    task = problem(forbidden, starts=[(0.0, 0.0), START, (-0.8, -0.5)], goals=[GOAL, (0.0, 0.1), (0.8, -0.3)])
    assert task.solve() == EXACT
    assert tuple(task.path[0]) in {START, (-0.8, -0.5)}
    assert tuple(task.path[-1]) in ({(0.8, -0.3)} if within_walls else {(0.8, -0.3), GOAL})


def test_every_goal_can_be_the_one(problem):
    task = problem(walled_in, goals=[GOAL, (0.0, 0.8)])
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[-1], (0.0, 0.8))


def test_a_goal_region_without_end(problem):
    class Right(ob.GoalSampleableRegion):
        def __init__(self, si):
            super().__init__(si)
            self.rng = np.random.default_rng(0)

        def distanceGoal(self, state):
            return max(0.0, 0.7 - state[0])

        def sampleGoal(self, state):
            state[0:2] = [0.8, self.rng.uniform(-0.9, 0.9)]

        def maxSampleCount(self):
            return 2**32 - 1

    task = problem(wall_with_a_gap)
    task.problem.setGoal(Right(task.si))
    assert task.solve() == EXACT
    assert task.path[-1][0] == 0.8


def test_goals_that_cannot_be_sampled(problem):
    class Right(ob.GoalRegion):
        def distanceGoal(self, state):
            return max(0.0, 0.7 - state[0])

    task = problem()
    task.problem.setGoal(Right(task.si))
    assert task.solve() == ob.PlannerStatus.UNRECOGNIZED_GOAL_TYPE


def test_without_a_problem(problem, kind):
    with pytest.raises(InputError, match="no problem definition"):
        kind(problem().si).solve(1.0)


def test_an_error_in_a_checker_reaches_the_caller(problem):
    def broken(x, y):
        if x > -0.79:
            raise ZeroDivisionError("in the checker")
        return False

    task = problem(starts=[(-0.8, 0.0)], goals=[(-0.8, 0.9)])
    task.walls.forbidden = broken
    with pytest.raises(ZeroDivisionError, match="in the checker"):
        task.solve()


# ------------------------------------------------------------------------------------------------- seeds and danger


@pytest.mark.parametrize("objective", [None, HotSpot, SlopedHotSpot])
def test_the_same_seed_gives_the_same_path(problem, objective):
    first, second, other = (problem(wall_with_a_gap, objective, seed=seed) for seed in (3, 3, 4))
    assert first.solve() == second.solve() == other.solve() == EXACT
    np.testing.assert_array_equal(first.path, second.path)
    assert first.walls.asked == second.walls.asked
    assert first.path.shape != other.path.shape or (first.path != other.path).any()


@pytest.mark.parametrize("objective", [HotSpot, SlopedHotSpot])
def test_alpha_zero_is_the_classical_planner_step_by_step(problem, objective):
    indifferent, classical = problem(wall_with_a_gap, objective, alpha=0.0), problem(wall_with_a_gap)
    assert indifferent.solve() == classical.solve() == EXACT
    assert indifferent.walls.asked == classical.walls.asked
    np.testing.assert_array_equal(indifferent.path, classical.path)
    anxious = problem(wall_with_a_gap, objective)
    anxious.solve()
    assert anxious.walls.asked != classical.walls.asked


def test_the_scale_of_an_objective_does_not_matter(problem):
    class Scaled(SlopedHotSpot):
        def values(self, Q):
            return 1024 * super().values(Q)

    usual, scaled = problem(wall_with_a_gap, SlopedHotSpot), problem(wall_with_a_gap, Scaled)
    assert usual.solve() == scaled.solve() == EXACT
    np.testing.assert_allclose(usual.path, scaled.path, atol=1e-9)


# --------------------------------------------------------------------------------------------------- beyond the plane


def test_a_circle_is_crossed_where_it_closes(kind):
    space = ob.CompoundStateSpace()
    height = ob.RealVectorStateSpace(1)
    height.setBounds(0, 1)
    space.addSubspace(ob.SO2StateSpace(), 1.0)
    space.addSubspace(height, 1.0)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: bool(abs(state[0].value) > 1.0))

    def state(angle, z):
        made = space.allocState()
        made[0].value, made[1][0] = angle, z
        return made

    setup.addStartState(state(2.5, 0.2))
    goal = ob.GoalStates(setup.getSpaceInformation())
    goal.addState(state(-2.5, 0.8))
    setup.setGoal(goal)
    planner = kind(setup.getSpaceInformation())
    planner.setSeed(0)
    setup.setPlanner(planner)
    assert setup.solve(5.0).getStatus() == EXACT
    path = setup.getSolutionPath()
    angles = np.array([path.getState(k)[0].value for k in range(path.getStateCount())])
    assert (np.abs(angles) <= np.pi).all()
    assert (np.abs(angles) > 1.0).all()
    assert (angles[0], angles[-1]) == (2.5, -2.5)
    assert (np.sign(angles[:-1]) != np.sign(angles[1:])).any()
    assert path.check()


def test_paths_of_a_robot_are_free_and_safer(kind, ur5, clutter, plain_check, rng):
    plain = plain_check(ur5, clutter)
    setup = SafeSetup(ur5, clutter, danger=None)
    points = rng.uniform(-0.5, 0.5, (10, 3)) + np.array([0.6, 0.0, 0.6])
    field = DangerField(ur5, points)
    setup.setOptimizationObjective(DangerObjective(setup.getSpaceInformation(), field))
    free = [q for q in rng.uniform(ur5.lower / 2, ur5.upper / 2, (60, 6)) if plain.nearest(q) > 0.01]
    safe = kind.__name__
    danger = {safe: [], safe.replace("Safe", "Classic"): []}
    for start, goal in zip(free[:6], free[6:12], strict=True):
        setup.setConfigurations(start, goal)
        for name, means in danger.items():
            result = setup.plan(name, time=5.0, seed=1)
            assert result
            assert result.report.certified
            np.testing.assert_allclose(result.path[[0, -1]], [start, goal])
            means.append(np.mean([field.value(q) for q in dense(result.path)[::20]]))
            for a, b in pairwise(result.path):
                assert plain.first_contact(a, b, 0.01) is None
    with_danger, without = map(np.mean, danger.values())
    assert with_danger < 0.9 * without
