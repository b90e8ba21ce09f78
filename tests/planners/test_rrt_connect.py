"""SafeRRTConnect in OMPL: what it solves, what it says otherwise, and that it keeps the promises of its life cycle."""

import subprocess
import sys
from itertools import pairwise
from time import perf_counter

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og
from ompl import tools as ot

from safe_ompl.errors import InputError
from safe_ompl.models.danger import DangerField
from safe_ompl.models.scenario import Scenario, find_scenario
from safe_ompl.planners.rrt_connect import SafeRRTConnect
from safe_ompl.plugins.objective import DangerObjective
from safe_ompl.setup import SafeSetup, setup_scenario

EXACT = ob.PlannerStatus.EXACT_SOLUTION
START, GOAL = (-0.8, 0.0), (0.8, 0.0)


# ------------------------------------------------------------------------------------------------ a point in a plane


class Walls(ob.StateValidityChecker):
    """Forbids what a function of (x, y) forbids; remembers what it was asked."""

    def __init__(self, si, forbidden):
        super().__init__(si)
        self.forbidden = forbidden
        self.asked = []

    def isValid(self, state):
        x, y = state[0:2]
        self.asked.append((x, y))
        return not self.forbidden(x, y)


class HotSpot(ob.OptimizationObjective):
    """A cost with a peak in the middle of the plane."""

    def stateCost(self, state):
        return ob.Cost(float(self.values(np.array([state[0:2]]))[0]))

    def motionCost(self, start, end):
        return ob.Cost(0.0)

    def values(self, Q):
        return np.exp(-4 * (Q**2).sum(axis=1))


class SlopedHotSpot(HotSpot):
    """The same, with gradients."""

    def values_and_gradients(self, Q):
        values = self.values(Q)
        return values, -8 * Q * values[:, None]


def nowhere(x, y):
    return False


def wall_with_a_gap(x, y):
    return abs(x) < 0.1 and not 0.55 < y < 0.75


def walled_in(x, y):
    return 0.1 < max(abs(x - GOAL[0]), abs(y - GOAL[1])) < 0.15


class Problem:
    """A point in the plane with plain OMPL parts and one planner."""

    def __init__(
        self, forbidden=nowhere, objective=None, starts=(START,), goals=(GOAL,), seed=0, **parameters
    ):
        space = ob.RealVectorStateSpace(2)
        space.setBounds(-1, 1)
        self.si = ob.SpaceInformation(space)
        self.walls = Walls(self.si, forbidden)
        self.si.setStateValidityChecker(self.walls)
        self.si.setStateValidityCheckingResolution(0.005)
        self.si.setup()
        self.problem = ob.ProblemDefinition(self.si)
        for start in starts:
            self.problem.addStartState(self.state(start))
        region = ob.GoalStates(self.si)
        for goal in goals:
            region.addState(self.state(goal))
        self.problem.setGoal(region)
        if objective is not None:
            self.problem.setOptimizationObjective(objective(self.si))
        self.planner = SafeRRTConnect(self.si, **parameters)
        self.planner.setSeed(seed)
        self.planner.setProblemDefinition(self.problem)
        self.planner.setup()
        self.walls.asked.clear()

    def state(self, point):
        state = self.si.getStateSpace().allocState()
        state[0:2] = list(point)
        return state

    def solve(self, time=5.0):
        return self.planner.solve(time).getStatus()

    @property
    def path(self):
        path = self.problem.getSolutionPath()
        return np.array([path.getState(k)[0:2] for k in range(path.getStateCount())])


def dense(path):
    return np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(path)])


def test_nothing_in_the_way():
    task = Problem()
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])
    assert np.linalg.norm(np.diff(task.path, axis=0), axis=1).max() <= task.planner.getRange() + 1e-9
    assert task.planner.counts.nodes > 0


@pytest.mark.parametrize("alpha", [0.0, 1.0])
@pytest.mark.parametrize("objective", [None, HotSpot, SlopedHotSpot])
def test_a_wall_with_a_gap(objective, alpha):
    task = Problem(wall_with_a_gap, objective, alpha=alpha)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])
    # The motion validator of this problem samples every 0.014; nothing else can slip through.
    inside = [point for point in dense(task.path) if wall_with_a_gap(*point)]
    assert all(min(abs(abs(x) - 0.1), abs(y - 0.55), abs(y - 0.75)) < 0.02 for x, y in inside)


def test_a_goal_that_cannot_be_reached_takes_its_time_and_no_more():
    task = Problem(walled_in)
    begin = perf_counter()
    assert task.solve(0.3) == ob.PlannerStatus.TIMEOUT
    assert 0.3 <= perf_counter() - begin < 6.0
    assert not task.problem.hasSolution()


def test_small_steps_heed_the_time_limit():
    task = Problem(range=1e-5)
    begin = perf_counter()
    assert task.solve(0.2) == ob.PlannerStatus.TIMEOUT
    assert perf_counter() - begin < 6.0


@pytest.mark.parametrize("start", [(0.0, 0.0), (-1.5, 0.0), (np.nan, 0.0)])
def test_a_start_that_is_not_valid(start):
    task = Problem(wall_with_a_gap, starts=[start])
    if np.isnan(start[0]):
        task.walls.forbidden = lambda x, y: np.isnan(x)
    assert task.solve() == ob.PlannerStatus.INVALID_START


@pytest.mark.parametrize("goal", [(0.0, 0.0), (1.5, 0.0)])
def test_a_goal_that_is_not_valid_wastes_no_time(goal):
    task = Problem(wall_with_a_gap, goals=[goal])
    begin = perf_counter()
    assert task.solve(5.0) == ob.PlannerStatus.INVALID_GOAL
    assert perf_counter() - begin < 6.0


def test_several_starts_and_goals_of_which_some_will_do():
    task = Problem(
        wall_with_a_gap, starts=[(0.0, 0.0), START, (-0.8, -0.5)], goals=[(0.0, 0.1), (0.8, -0.3), GOAL]
    )
    assert task.solve() == EXACT
    assert tuple(task.path[0]) in {START, (-0.8, -0.5)}
    assert tuple(task.path[-1]) in {(0.8, -0.3), GOAL}


def test_every_goal_can_be_the_one():
    def walled(x, y):
        return walled_in(x, y)  # around GOAL

    task = Problem(walled, goals=[GOAL, (0.0, 0.8)])
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[-1], (0.0, 0.8))


def test_a_goal_region_without_end():
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

    task = Problem(wall_with_a_gap)
    task.problem.setGoal(Right(task.si))
    assert task.solve() == EXACT
    assert task.path[-1][0] == 0.8


def test_goals_that_cannot_be_sampled():
    class Right(ob.GoalRegion):
        def distanceGoal(self, state):
            return max(0.0, 0.7 - state[0])

    task = Problem()
    task.problem.setGoal(Right(task.si))
    assert task.solve() == ob.PlannerStatus.UNRECOGNIZED_GOAL_TYPE


# ---------------------------------------------------------------------------------------------------------- promises


@pytest.mark.parametrize("objective", [None, HotSpot, SlopedHotSpot])
def test_the_same_seed_gives_the_same_path(objective):
    first, second, other = (Problem(wall_with_a_gap, objective, seed=seed) for seed in (3, 3, 4))
    assert first.solve() == second.solve() == other.solve() == EXACT
    np.testing.assert_array_equal(first.path, second.path)
    assert first.walls.asked == second.walls.asked
    assert first.path.shape != other.path.shape or (first.path != other.path).any()


@pytest.mark.parametrize("objective", [HotSpot, SlopedHotSpot])
def test_alpha_zero_is_the_classical_planner_step_by_step(objective):
    indifferent, classical = Problem(wall_with_a_gap, objective, alpha=0.0), Problem(wall_with_a_gap)
    assert indifferent.solve() == classical.solve() == EXACT
    assert indifferent.walls.asked == classical.walls.asked
    np.testing.assert_array_equal(indifferent.path, classical.path)
    anxious = Problem(wall_with_a_gap, objective, alpha=1.0)
    anxious.solve()
    assert anxious.walls.asked != classical.walls.asked


def test_danger_is_kept_away_from():
    def peak(seed, alpha):
        task = Problem(objective=SlopedHotSpot, seed=seed, alpha=alpha, range=0.1)
        assert task.solve() == EXACT
        return HotSpot(task.si).values(dense(task.path)).max()

    classical, safe = ([peak(seed, alpha) for seed in range(10)] for alpha in (0.0, 1.0))
    assert np.mean(safe) < 0.9 * np.mean(classical)


def test_the_scale_of_an_objective_does_not_matter():
    class Scaled(SlopedHotSpot):
        def values(self, Q):
            return 1024 * super().values(Q)

    usual, scaled = Problem(wall_with_a_gap, SlopedHotSpot), Problem(wall_with_a_gap, Scaled)
    assert usual.solve() == scaled.solve() == EXACT
    np.testing.assert_allclose(usual.path, scaled.path, atol=1e-9)


def test_a_second_solve_goes_on_and_clear_forgets():
    task = Problem(walled_in)
    task.solve(0.1)
    nodes = task.planner.counts.nodes
    assert nodes > 0
    task.walls.forbidden = nowhere
    assert task.solve() == EXACT
    assert task.planner.counts.nodes > nodes
    task.problem.clearSolutionPaths()
    assert task.solve() == EXACT, "again, from the trees that are there"
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])
    task.planner.clear()
    assert task.planner.counts.nodes == 0
    task.problem.clearSolutionPaths()
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])


def test_clear_keeps_the_parameters():
    task = Problem(alpha=0.25, range=0.3, nearest_fraction=0.5)
    task.planner.clear()
    assert (task.planner.getAlpha(), task.planner.getRange(), task.planner.getNearestFraction()) == (
        0.25,
        0.3,
        0.5,
    )


def test_another_problem_after_clear_query():
    task = Problem(wall_with_a_gap)
    assert task.solve() == EXACT
    other = ob.ProblemDefinition(task.si)
    other.addStartState(task.state((0.5, 0.5)))
    region = ob.GoalStates(task.si)
    region.addState(task.state((0.9, -0.9)))
    other.setGoal(region)
    task.planner.setProblemDefinition(other)
    task.planner.clearQuery()
    assert task.solve() == EXACT
    path = other.getSolutionPath()
    np.testing.assert_array_equal(list(path.getState(0)[0:2]), [0.5, 0.5])


def test_another_objective_is_noticed():
    task, classical = Problem(wall_with_a_gap), Problem(wall_with_a_gap)
    task.problem.setOptimizationObjective(HotSpot(task.si))
    assert task.solve() == classical.solve() == EXACT
    assert task.path.shape != classical.path.shape or (task.path != classical.path).any()


def test_without_a_problem():
    with pytest.raises(InputError, match="no problem definition"):
        SafeRRTConnect(Problem().si).solve(1.0)


def test_an_error_in_a_checker_reaches_the_caller():
    def broken(x, y):
        if x > -0.79:
            raise ZeroDivisionError("in the checker")
        return False

    task = Problem(starts=[(-0.8, 0.0)], goals=[(-0.8, 0.9)])
    task.walls.forbidden = broken
    with pytest.raises(ZeroDivisionError, match="in the checker"):
        task.solve()


# -------------------------------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("setter", "bad"),
    [
        ("setRange", [-0.1, np.nan, np.inf, "far", None]),
        ("setAlpha", [-1.0, np.nan, np.inf, "much", None]),
        ("setNearestFraction", [-0.1, 1.1, np.nan, "half", None]),
        ("setSlide", [-0.1, 1.1, np.nan, "some", None]),
        ("setSeed", [-1, 1.5, np.nan, np.inf, "seven", None, True]),
    ],
)
def test_setters_refuse_what_makes_no_sense(setter, bad):
    planner = SafeRRTConnect(Problem().si)
    for value in bad:
        with pytest.raises(InputError, match="must be"):
            getattr(planner, setter)(value)


def test_getters_give_back_what_was_set():
    planner = SafeRRTConnect(Problem().si, "Mine", range=0.2, alpha=2.0, nearest_fraction=0.3, slide=0.1)
    assert planner.getName() == "Mine"
    assert (planner.getRange(), planner.getAlpha(), planner.getNearestFraction()) == (0.2, 2.0, 0.3)
    assert planner.getSlide() == 0.1
    planner.setSeed(np.int64(7))
    assert planner.getSeed() == 7
    planner.setRange(0)
    assert 0 < planner.getRange() < np.hypot(2, 2)


# -------------------------------------------------------------------------------------------------------- other spaces


def test_a_circle_is_crossed_where_it_closes():
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
    planner = SafeRRTConnect(setup.getSpaceInformation())
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


def test_through_simple_setup_with_a_function_as_checker():
    space = ob.RealVectorStateSpace(2)
    space.setBounds(-1, 1)
    setup = og.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: not wall_with_a_gap(state[0], state[1]))
    setup.setOptimizationObjective(HotSpot(setup.getSpaceInformation()))
    start, goal = space.allocState(), space.allocState()
    start[0:2], goal[0:2] = list(START), list(GOAL)
    setup.setStartAndGoalStates(start, goal)
    setup.setPlanner(SafeRRTConnect(setup.getSpaceInformation()))
    assert setup.solve(5.0).getStatus() == EXACT
    assert setup.haveExactSolutionPath()
    assert setup.getSolutionPath().check()


def test_through_the_benchmark(ur5, clutter):
    setup = SafeSetup(ur5, clutter, danger=None)
    start, goal = np.array([0.0, -1.6, 1.2, -1.2, -1.57, 0.0]), np.array([1.2, -1.6, 1.2, -1.2, -1.57, 0.0])
    setup.setConfigurations(start, goal)
    benchmark = ot.Benchmark(setup, "ur5")
    benchmark.addPlannerAllocator(lambda si: SafeRRTConnect(si, "safe"))
    request = ot.Request(5.0, 4096.0, 4)
    request.displayProgress = request.saveConsoleOutput = False
    request.simplify = False
    benchmark.benchmark(request)
    runs = benchmark.getRecordedExperimentData().planners[0].runs
    assert len(runs) == 4
    assert all(run["correct solution BOOLEAN"] == "1" for run in runs)
    assert len({run["solution length REAL"] for run in runs}) > 1, "runs differ"


# -------------------------------------------------------------------------------------------------------- with a robot


def test_paths_of_a_robot_are_free(ur5, clutter, plain_check, rng):
    plain = plain_check(ur5, clutter)
    setup = SafeSetup(ur5, clutter, danger=None)
    points = rng.uniform(-0.5, 0.5, (10, 3)) + np.array([0.6, 0.0, 0.6])
    field = DangerField(ur5, points)
    setup.setOptimizationObjective(DangerObjective(setup.getSpaceInformation(), field))
    free = [q for q in rng.uniform(ur5.lower / 2, ur5.upper / 2, (60, 6)) if plain.nearest(q) > 0.01]
    solved = 0
    for start, goal in zip(free[:6], free[6:12], strict=True):
        setup.clear()
        setup.setConfigurations(start, goal)
        planner = SafeRRTConnect(setup.getSpaceInformation())
        planner.setSeed(1)
        setup.setPlanner(planner)
        if setup.solve(5.0).getStatus() == EXACT:
            solved += 1
            path = setup.solution()
            np.testing.assert_allclose(path[[0, -1]], [start, goal])
            for a, b in pairwise(path):
                assert plain.first_contact(a, b, 0.01) is None
    assert solved >= 5


SCRIPT = """
import numpy as np
from safe_ompl.models.robot import Robot
from safe_ompl.models.scene import Scene
from safe_ompl.models.obstacle import Obstacle
from safe_ompl.models.pose import Pose
from safe_ompl.models.shapes import Sphere
from safe_ompl.setup import SafeSetup

scene = Scene((Obstacle("ball", Sphere(0.1), Pose((0.5, 0.0, 0.6)), weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.8, -1.6, 1.2, -1.2, -1.57, 0.0], [-0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
for seed in (0, 0, 1):
    result = setup.plan(seed=seed)
    assert result, result.status
    print("PATH" + result.path.tobytes().hex())
"""


def test_a_process_ends_quietly_and_repeats_itself():
    paths = []
    for _ in range(2):
        run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=100)
        assert run.returncode == 0, run.stderr
        assert "leaked" not in run.stderr
        assert "rror" not in run.stderr
        paths.append([line for line in run.stdout.splitlines() if line.startswith("PATH")])
    first, again, other = paths[0]
    assert first == again
    assert first != other
    assert paths[0] == paths[1]


# -------------------------------------------------------------------------------------------- the adaptive threshold


def avoidable_danger(setup, seed, **options):
    planner = SafeRRTConnect(setup.getSpaceInformation(), **options)
    result = setup.plan(planner, time=20.0, seed=seed)
    assert result
    return result.report.danger.avoidable


def test_the_threshold_keeps_the_peak_of_the_danger_low():
    setup = setup_scenario(Scenario.load(find_scenario("panda_shelf")))
    with_it, without = (
        np.mean([avoidable_danger(setup, seed, threshold_rise=rise) for seed in range(5)])
        for rise in (0.05, 0.0)
    )
    assert with_it < 0.5 * without


def test_a_threshold_does_not_close_a_dangerous_passage():
    """Start and goal are harmless; the only gap lies in the middle of the hot spot."""

    def hot_gap(x, y):
        return abs(x) < 0.1 and abs(y) > 0.1

    problem = Problem(hot_gap, SlopedHotSpot, seed=1, threshold_rise=0.01)
    assert problem.solve() == EXACT
    assert problem.planner._threshold > 1.5 * np.exp(-4 * 0.8**2)
