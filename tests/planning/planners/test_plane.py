"""Planners on OMPL's own kinds of problems: any space of straight motions, checker, validator, objective, goal."""

import logging
from functools import partial
from math import cos, sin

import numpy as np
import pytest
from ompl import base as ob, geometric as og
from plane import (
    APPROXIMATE,
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
    nowhere,
    wall_with_a_gap,
    walled_in,
)

from safe_ompl import InputError, SafePRM, SafeRRTConnect, SafeSetup, Scene
from safe_ompl.planning.planners import seed_ompl
from safe_ompl.planning.planners.printed import PaperSafePRM, PaperSafeRRTConnect

KINDS = [SafeRRTConnect, SafePRM, PaperSafeRRTConnect, partial(PaperSafePRM, samples=200)]
ONE_MOTION = 300  # checks of the longest motion, and some


@pytest.fixture(params=[SafeRRTConnect, SafePRM])
def kind(request):
    """Return the class of a planner."""
    return request.param


@pytest.fixture
def problem(kind):
    """Return a function that poses a problem to a planner of this kind."""
    return partial(PlaneProblem, kind)


def state_at(space, values):
    state = space.allocState()
    space.copyFromReals(state, values)
    return state


def asked_in(space, is_free, ends, kind, resolution=0.01, objective=None, seed=0, **parameters):
    """Return OMPL's own setup for the way between two states, given as numbers, and a planner of a kind in it."""
    setup = og.SimpleSetup(space)
    si = setup.getSpaceInformation()
    setup.setStateValidityChecker(is_free)
    si.setStateValidityCheckingResolution(resolution)
    si.setup()
    setup.setStartAndGoalStates(*(state_at(space, values) for values in ends))
    if objective is not None:
        setup.setOptimizationObjective(objective(si))
    planner = kind(si, **parameters)
    planner.setSeed(seed)
    setup.setPlanner(planner)
    return setup, planner


class StateCosts(ob.OptimizationObjective):
    """A cost of states, asked state by state."""

    def __init__(self, si, cost):
        super().__init__(si)
        self._cost = cost

    def stateCost(self, state):
        return ob.Cost(self._cost(state))

    def motionCost(self, start, end):
        return ob.Cost(0.0)


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


def test_a_map_in_other_units_takes_as_many_steps(kind, ur5):
    found = {}
    for size in (1.0, 1000.0):
        space = ob.RealVectorStateSpace(2)
        space.setBounds(0, size)
        ends = [[share * size, 0.1 * size] for share in (0.1, 0.9)]
        setup, planner = asked_in(
            space, lambda state, s=size: bool(state[1] > 0.8 * s or not 0.4 < state[0] / s < 0.6), ends, kind
        )
        assert setup.solve(10.0).getStatus() == EXACT
        found[size] = planner.getRange() / size, planner.counts.nodes
    assert found[1.0] == (pytest.approx(0.075 * 2**0.5), found[1000.0][1]) == found[1000.0]
    # A joint that may turn by more than one turn counts as one that turns once.
    arm = kind(SafeSetup(ur5, Scene(())).getSpaceInformation())
    assert arm.getRange() == pytest.approx(0.075 * np.linalg.norm(np.minimum(ur5.upper - ur5.lower, 2 * np.pi)))


@pytest.mark.parametrize("kind", KINDS)
def test_the_nearest_path_in_reach_is_an_approximate_solution_and_comes_in_time(kind):
    task = PlaneProblem(kind, walled_in)
    for _ in range(2):
        stop = Stop(task.walls, 1000)
        assert task.solve(stop.condition) == APPROXIMATE
        if kind in (SafeRRTConnect, SafePRM):  # printed ones may give up before
            assert stop.checked_too_late <= ONE_MOTION
        assert task.problem.hasApproximateSolution()
        assert task.problem.getSolutionPath().check()
        np.testing.assert_array_equal(task.path[0], START)
        left = task.problem.getSolutionDifference()
        assert left == pytest.approx(np.linalg.norm(task.path[-1] - GOAL))
        assert 0.1 < left < 0.8
    task.walls.forbidden = nowhere
    task.planner.clear()
    assert task.solve() == EXACT
    assert not task.problem.hasApproximateSolution()
    np.testing.assert_array_equal(task.path[-1], GOAL)
    # Where nothing leads away from the start there is no path.
    stuck = PlaneProblem(kind, lambda x, y: (x, y) not in (START, GOAL))
    assert stuck.solve(Stop(stuck.walls, 500).condition) == TIMEOUT
    assert not stuck.problem.hasSolution()


BAD_ENDS = [
    ({"starts": [(0.0, 0.0)]}, ob.PlannerStatus.INVALID_START),
    ({"starts": [(-1.5, 0.0)]}, ob.PlannerStatus.INVALID_START),
    ({"starts": [(np.nan, 0.0)]}, ob.PlannerStatus.INVALID_START),
    ({"goals": [(0.0, 0.0)]}, ob.PlannerStatus.INVALID_GOAL),
    ({"goals": [(1.5, 0.0)]}, ob.PlannerStatus.INVALID_GOAL),
]


@pytest.mark.parametrize(("ends", "status"), BAD_ENDS)
def test_ends_that_are_not_valid_waste_no_time(problem, ends, status):
    task = problem(lambda x, y: np.isnan(x) or wall_with_a_gap(x, y), **ends)
    assert task.solve() == status
    assert len(task.walls.asked) <= 2, "start and goal"


@pytest.mark.parametrize("within_walls", [False, True])
def test_several_starts_and_goals_of_which_some_will_do(problem, within_walls):
    def forbidden(x, y):
        return wall_with_a_gap(x, y) or (within_walls and walled_in(x, y))  # those are around GOAL

    task = problem(forbidden, starts=[(0.0, 0.0), START, (-0.8, -0.5)], goals=[GOAL, (0.0, 0.1), (0.8, -0.3)])
    assert task.solve() == EXACT
    assert tuple(task.path[0]) in {START, (-0.8, -0.5)}
    assert tuple(task.path[-1]) in ({(0.8, -0.3)} if within_walls else {(0.8, -0.3), GOAL})


class Rare(ob.GoalSampleableRegion):
    """A region of which one in so many samples is valid; the first that is valid may be walled in."""

    def __init__(self, si, rarity, walled_in_first=False):
        super().__init__(si)
        self.rarity, self.walled_in_first, self.drawn = rarity, walled_in_first, 0

    def distanceGoal(self, state):
        return max(0.0, 0.7 - state[0])

    def sampleGoal(self, state):
        self.drawn += 1
        first = self.walled_in_first and self.drawn == self.rarity
        state[0:2] = [0.8, (0.0 if first else 0.5) if self.drawn % self.rarity == 0 else 2.0]

    def maxSampleCount(self):
        return 2**32 - 1


@pytest.mark.parametrize("kind", KINDS)
def test_goals_are_sampled_as_long_as_there_is_time(kind):
    task = PlaneProblem(kind)
    task.problem.setGoal(Rare(task.si, 500))
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[-1], (0.8, 0.5))
    never = Rare(task.si, 2**31)
    task.problem.setGoal(never)
    stop = Stop(task.walls, 1000)
    assert task.solve(stop.condition) == TIMEOUT
    assert never.drawn >= 990


def test_goals_are_sampled_in_turn_with_the_search(problem):
    task = problem(walled_in)
    rare = Rare(task.si, 200, walled_in_first=True)
    task.problem.setGoal(rare)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[-1], (0.8, 0.5))
    assert rare.drawn >= 400


@pytest.mark.parametrize("kind", KINDS)
def test_what_lies_outside_of_narrower_bounds_is_dropped(kind):
    task = PlaneProblem(kind, wall_with_a_gap)
    task.planner.setParameter("range", 0.3)
    assert task.solve() == EXACT
    task.problem.clearSolutionPaths()
    task.si.getStateSpace().setBounds(-0.9, 0.9)
    assert task.solve() == EXACT
    assert (np.abs(task.planner.plannerGraph().configurations) <= 0.9).all()
    assert task.planner.getRange() == 0.3


def test_what_cannot_be_planned_is_said(problem, kind):
    class Right(ob.GoalRegion):
        def distanceGoal(self, state):
            return max(0.0, 0.7 - state[0])

    task = problem()
    task.problem.setGoal(Right(task.si))
    assert task.solve() == ob.PlannerStatus.UNRECOGNIZED_GOAL_TYPE
    with pytest.raises(InputError, match="no problem definition"):
        kind(task.si).solve(1.0)


# ------------------------------------------------------------------------------------------------- seeds and danger


@pytest.mark.parametrize("objective", [HotSpot, SlopedHotSpot])
def test_alpha_zero_is_the_classical_planner_step_by_step(problem, objective, caplog):
    indifferent = problem(wall_with_a_gap, objective, alpha=0.0)
    with caplog.at_level(logging.INFO):
        classical = problem(wall_with_a_gap)
    assert "danger is 0, because the problem has no danger objective" in caplog.text
    assert indifferent.solve() == classical.solve() == EXACT
    assert indifferent.walls.asked == classical.walls.asked
    np.testing.assert_array_equal(indifferent.path, classical.path)
    anxious = problem(wall_with_a_gap, objective)
    anxious.solve()
    assert anxious.walls.asked != classical.walls.asked
    # An objective that comes later is noticed.
    classical.problem.setOptimizationObjective(objective(classical.si))
    classical.problem.clearSolutionPaths()
    classical.planner.setSeed(0)
    assert classical.solve() == EXACT
    np.testing.assert_array_equal(classical.path, anxious.path)


def test_the_scale_of_an_objective_does_not_matter(problem):
    class Scaled(SlopedHotSpot):
        def values(self, Q):
            return 1024 * super().values(Q)

    usual, scaled = problem(wall_with_a_gap, SlopedHotSpot), problem(wall_with_a_gap, Scaled)
    assert usual.solve() == scaled.solve() == EXACT
    np.testing.assert_allclose(usual.path, scaled.path, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_without_a_seed_of_its_own_a_planner_follows_ompls(kind):
    def path(seed):
        seed_ompl(seed)  # calls `ou.RNG.setSeed`, which complains of a second seed
        task = PlaneProblem(kind, wall_with_a_gap)
        task.planner = kind(task.si)
        task.planner.setProblemDefinition(task.problem)
        assert task.solve() == EXACT
        return task.planner.getSeed(), task.path.tolist()

    assert path(3) == path(3)
    assert path(3)[0] != path(4)[0]
    assert kind(PlaneProblem(kind).si).getSeed() != kind(PlaneProblem(kind).si).getSeed()


class OnlyAbove(ob.ValidStateSampler):
    """Samples one line, and fails now and then."""

    def __init__(self, si):
        super().__init__(si)
        self.rng, self.asked = np.random.default_rng(0), 0

    def sample(self, state):
        self.asked += 1
        state[0:2] = [self.rng.uniform(-1, 1), 0.65]
        return self.asked % 3 != 0


@pytest.mark.parametrize("kind", [SafePRM, partial(PaperSafePRM, samples=100)])
def test_a_roadmap_asks_the_sampler_that_it_is_given(kind):
    task = PlaneProblem(kind, lambda x, y: abs(x) < 0.1 and not 0.64 < y < 0.66, neighbors=60)
    task.si.setValidStateSamplerAllocator(OnlyAbove)
    assert task.solve() == EXACT
    (through,) = {y for x, y in task.path[1:-1]}
    assert through == 0.65
    slow, samplers = PlaneProblem(kind, neighbors=60), list[OnlyAbove]()
    slow.si.setValidStateSamplerAllocator(lambda si: samplers.append(OnlyAbove(si)) or samplers[-1])
    slow.solve(ob.PlannerTerminationCondition(lambda: bool(samplers) and samplers[-1].asked >= 10))
    assert samplers[0].asked == 10, "it may take long"
    slow.si.clearValidStateSamplerAllocator()
    task.si.clearValidStateSamplerAllocator()


# --------------------------------------------------------------------------------------------------- other spaces


def within(space, most):
    """Return a space of positions, bounded by −most and most [m]."""
    bounds = ob.RealVectorBounds(space.getSubspace(0).getDimension())
    bounds.setLow(-most)
    bounds.setHigh(most)
    space.setBounds(bounds)
    return space


def circle_and_height():
    space, height = ob.CompoundStateSpace(), ob.RealVectorStateSpace(1)
    height.setBounds(0, 1)
    space.addSubspace(ob.SO2StateSpace(), 1.0)
    space.addSubspace(height, 1.0)
    return space


def bar_is_free(state):
    """Ask for a bar of 0.8 by 0.1 m, which fits through a gap in one direction, as in OMPL's demo RigidBodyPlanning."""
    c, s = cos(state.getYaw()), sin(state.getYaw())
    corners = [(x, y) for x in np.linspace(-0.4, 0.4, 9) for y in (-0.05, 0.05)]
    return all(abs(state.getX() + c * x - s * y) > 0.05 or abs(state.getY() + s * x + c * y) < 0.25 for x, y in corners)


def rod_is_free(state):
    """Ask for a rod of 0.6 m in SE(3), and a slot in a wall that it fits through flat."""
    r = state.rotation()
    axis = np.array([2 * (r.x * r.z + r.w * r.y), 2 * (r.y * r.z - r.w * r.x), 1 - 2 * (r.x**2 + r.y**2)])
    x, y, z = (np.linspace(-0.3, 0.3, 13)[:, None] * axis + [state.getX(), state.getY(), state.getZ()]).T
    return bool(((np.abs(x) > 0.05) | ((np.abs(y) < 0.4) & (np.abs(z) < 0.15))).all())


UPRIGHT = [0.0, 0.0, 0.0, 1.0]
SPACES = {  # a space, what is free in it, start, goal, and the resolution of the check
    "circle": (circle_and_height, lambda q: bool(abs(q[0].value) > 1.0), [2.5, 0.2], [-2.5, 0.8], 0.01),
    "bar": (lambda: within(ob.SE2StateSpace(), 2.0), bar_is_free, [-1.0, 0.0, 1.57], [1.0, 0.5, 1.57], 0.002),
    "rod": (
        lambda: within(ob.SE3StateSpace(), 1.0),
        rod_is_free,
        [-0.7, 0, 0.3, *UPRIGHT],
        [0.7, 0, 0.3, *UPRIGHT],
        0.01,
    ),
}


@pytest.mark.parametrize("name", SPACES)
def test_paths_in_any_space_of_positions_and_turns(kind, name):
    make, is_free, *ends, resolution = SPACES[name]
    space = make()
    objective = None if name == "circle" else partial(StateCosts, cost=lambda state: abs(state.getY()))
    setup, _ = asked_in(space, is_free, ends, kind, resolution, objective)
    assert setup.solve(30.0).getStatus() == EXACT
    assert setup.getSolutionPath().check()
    states = setup.getSolutionPath().getStates()
    assert all(space.satisfiesBounds(state) for state in states)
    for state, values in zip((states[0], states[-1]), ends, strict=True):
        assert space.distance(state, state_at(space, values)) < 1e-9
    if name == "circle":  # it is crossed where it closes
        angles = np.array([state[0].value for state in states])
        assert (np.abs(angles) > 1.0).all()
        assert (np.sign(angles[:-1]) != np.sign(angles[1:])).any()


def towards_the_sun(Q):
    """Return the cosine between the line of sight of a telescope, its z axis, and the sun at x, for `Q: (N, 4)`."""
    x, y, z, w = np.asarray(Q).T
    return 2 * (x * z + w * y)


def as_rows(*states):
    return [[q.x, q.y, q.z, q.w] for q in states]


def glare(state):
    return float(np.exp(3 * towards_the_sun(as_rows(state)))[0])


class Glare(StateCosts):
    """Grows as the sight nears the sun."""

    def __init__(self, si):
        super().__init__(si, glare)

    def values(self, Q):
        return np.exp(3 * towards_the_sun(Q))


class SlopedGlare(Glare):
    def values_and_gradients(self, Q):
        x, y, z, w = Q.T
        return self.values(Q), 6 * self.values(Q)[:, None] * np.stack([z, w, x, y], axis=1)


@pytest.mark.parametrize("objective", [Glare, SlopedGlare, partial(StateCosts, cost=glare)])
def test_a_telescope_turns_past_the_sun(kind, objective):
    def is_free(state):
        return bool(towards_the_sun(as_rows(state))[0] < cos(0.3))

    ends = [[0.0, sin(half), 0.0, cos(half)] for half in (np.pi / 4 - 0.4, np.pi / 4 + 0.4)]  # about y

    def mean_glare(alpha, seed):
        setup, _ = asked_in(ob.SO3StateSpace(), is_free, ends, kind, 0.005, objective, seed, alpha=alpha)
        assert setup.solve(30.0).getStatus() == EXACT
        path = setup.getSolutionPath()
        assert path.check()
        path.interpolate(60)
        return np.mean([glare(state) for state in path.getStates()])

    unaware, aware = (np.mean([mean_glare(alpha, seed) for seed in range(5)]) for alpha in (0.0, 5.0))
    assert aware < 0.6 * unaware
