"""SafePRM: the paper's search step by step, what is kept between queries, and the promises of its life cycle."""

from itertools import pairwise
from time import perf_counter, sleep

import numpy as np
import pytest
from ompl import base as ob
from ompl import geometric as og

from safe_ompl.errors import InputError
from safe_ompl.models.danger import DangerField
from safe_ompl.models.scene import Scene
from safe_ompl.planners import prm
from safe_ompl.planners.prm import SafePRM
from safe_ompl.planners.registry import make_planner
from safe_ompl.planners.roadmap import Graph, LinkMetric, Roadmap, SpaceMetric
from safe_ompl.plugins.objective import DangerObjective, StateCost
from safe_ompl.plugins.states import StateBridge
from safe_ompl.setup import SafeSetup

EXACT, TIMEOUT = ob.PlannerStatus.EXACT_SOLUTION, ob.PlannerStatus.TIMEOUT
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


class ForbiddenCorner(HotSpot):
    """Costs that are not finite on one side."""

    def values(self, Q):
        return np.where(Q[:, 1] > 0, np.inf, np.where(Q[:, 0] > 0, np.nan, 1.0 + Q[:, 0]))


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
        self.ask(starts, goals)
        if objective is not None:
            self.problem.setOptimizationObjective(objective(self.si))
        self.planner = SafePRM(self.si, **parameters)
        self.planner.setSeed(seed)
        self.planner.setProblemDefinition(self.problem)
        self.planner.setup()
        self.walls.asked.clear()

    def ask(self, starts, goals):
        self.problem.clearStartStates()
        for start in starts:
            self.problem.addStartState(self.state(start))
        region = ob.GoalStates(self.si)
        for goal in goals:
            region.addState(self.state(goal))
        self.problem.setGoal(region)

    def ask_again(self, starts=(START,), goals=(GOAL,)):
        self.problem.clearSolutionPaths()
        self.ask(starts, goals)
        self.planner.clearQuery()
        self.walls.asked.clear()

    def state(self, point):
        state = self.si.getStateSpace().allocState()
        state[0:2] = list(point)
        return state

    def solve(self, time=5.0):
        return self.planner.solve(time).getStatus()

    @property
    def roadmap(self):
        return self.planner._roadmap

    @property
    def path(self):
        path = self.problem.getSolutionPath()
        return np.array([path.getState(k)[0:2] for k in range(path.getStateCount())])


def dense(path):
    return np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in pairwise(path)])


@pytest.mark.parametrize("alpha", [0.0, 1.0])
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("objective", [None, HotSpot, SlopedHotSpot, ForbiddenCorner])
def test_a_wall_with_a_gap(objective, alpha):
    task = Problem(wall_with_a_gap, objective, alpha=alpha)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])
    # The motion validator of this problem samples every 0.014; nothing else can slip through.
    inside = [point for point in dense(task.path) if wall_with_a_gap(*point)]
    assert all(min(abs(abs(x) - 0.1), abs(y - 0.55), abs(y - 0.75)) < 0.02 for x, y in inside)
    assert task.planner.counts.nodes > 2


def test_samples_grow_until_they_suffice():
    def maze(x, y):
        return (abs(x + 0.2) < 0.05 and not 0.8 < y < 0.85) or (abs(x - 0.2) < 0.05 and not -0.85 < y < -0.8)

    task = Problem(maze, samples=3)
    assert task.solve() == EXACT
    assert len(task.roadmap) > 3 + 2
    assert task.path[:, 1].max() > 0.75
    assert task.path[:, 1].min() < -0.75


def test_a_goal_that_cannot_be_reached_takes_its_time_and_no_more():
    task = Problem(walled_in)
    begin = perf_counter()
    assert task.solve(0.3) == TIMEOUT
    assert 0.3 <= perf_counter() - begin < 6.0
    assert not task.problem.hasSolution()


def test_slow_checks_heed_the_time_limit():
    def slow(x, y):
        sleep(0.002)
        return x != START[0] and x != GOAL[0]

    task = Problem()
    task.walls.forbidden = slow
    begin = perf_counter()
    assert task.solve(0.2) == TIMEOUT
    assert perf_counter() - begin < 6.0


def test_memory_stays_bounded(monkeypatch):
    monkeypatch.setattr(prm, "_LARGEST_ROADMAP", 300)
    task = Problem(walled_in, samples=20)
    largest = []
    begin_anew = task.planner._begin_anew
    monkeypatch.setattr(
        task.planner, "_begin_anew", lambda: (largest.append(len(task.roadmap)), begin_anew())
    )
    assert task.solve(0.5) == TIMEOUT
    assert len(largest) > 1
    assert max(largest) <= 300 * 1.25 + 1
    task.walls.forbidden = nowhere
    task.planner.clear()
    assert task.solve() == EXACT


@pytest.mark.parametrize(
    ("start", "goal", "status"),
    [
        ((0.0, 0.0), GOAL, ob.PlannerStatus.INVALID_START),
        (START, (0.0, 0.0), ob.PlannerStatus.INVALID_GOAL),
    ],
)
def test_ends_that_are_not_valid(start, goal, status):
    assert Problem(wall_with_a_gap, starts=[start], goals=[goal]).solve() == status


def test_several_starts_and_goals_of_which_some_will_do():
    def walled(x, y):
        return walled_in(x, y) or wall_with_a_gap(x, y)

    task = Problem(walled, starts=[(0.0, 0.0), START, (-0.8, -0.5)], goals=[GOAL, (0.0, 0.1), (0.8, -0.3)])
    assert task.solve() == EXACT
    assert tuple(task.path[0]) in {START, (-0.8, -0.5)}
    assert tuple(task.path[-1]) == (0.8, -0.3)


def test_a_start_that_is_a_goal():
    task = Problem(goals=[START])
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, [START])


# -------------------------------------------------------------------------------------------------- the paper's search


def literal_search(Q, start, goal, k, cost, is_free):
    """SAFE_PRM_PLANNER as it is printed: NEIGHBORS checks every edge. The best parent of a milestone in Open counts."""
    opened, closed = ({start: (0.0, None)}, {goal: (0.0, None)}), ({}, {})
    current_goal, order = goal, []
    forwards = True
    while opened[0] and opened[1]:
        f = {x: g + np.linalg.norm(Q[x] - Q[current_goal]) + cost(Q[x]) for x, (g, _) in opened[0].items()}
        new = min(f, key=f.get)
        closed[0][new] = opened[0].pop(new)
        order.append(new)
        if new in closed[1]:
            break
        rest = [x for x in range(len(Q)) if x not in closed[0]]
        for x in sorted(rest, key=lambda x: np.sum((Q[x] - Q[new]) ** 2))[:k]:
            edge = (new, x) if forwards else (x, new)
            if is_free(*edge):
                g = closed[0][new][0] + np.linalg.norm(Q[x] - Q[new])
                opened[0][x] = min(opened[0].get(x, (np.inf, None)), (g, new))
        opened, closed = opened[::-1], closed[::-1]
        forwards, current_goal = not forwards, new
    else:
        return order, None

    def branch(tree, x):
        return [] if x is None else [*branch(tree, tree[x][1]), x]

    first, second = closed if forwards else closed[::-1]
    return order, branch(first, new) + branch(second, new)[-2::-1]


@pytest.mark.parametrize("objective", [None, HotSpot])
@pytest.mark.parametrize("seed", range(6))
def test_the_search_is_the_papers_step_by_step(monkeypatch, objective, seed):
    order = []
    add_closed = Graph.add_closed
    monkeypatch.setattr(
        Graph, "add_closed", lambda self, offer: order.append(add_closed(self, offer)) or order[-1]
    )
    task = Problem(wall_with_a_gap, objective, seed=seed, neighbors=12, samples=200, slide=0.0)
    monkeypatch.setattr(task.planner, "_milestone_is_valid", lambda milestone: True)
    assert task.solve() == EXACT
    assert len(task.roadmap) == 202, "the first samples suffice"

    Q, checked = task.roadmap.configurations, {}

    def is_free(i, j):
        checked[i, j] = task.planner._motion_is_free(Q[i], Q[j])
        return checked[i, j]

    def cost(q):
        weight = task.planner.getAlpha() / task.planner._cost_scale if objective else 0.0
        return weight * HotSpot(task.si).values(q[None])[0] if weight else 0.0

    expected_order, expected_path = literal_search(Q, 0, 1, 12, cost, is_free)
    assert order == expected_order
    np.testing.assert_array_equal(task.path, Q[expected_path])
    assert len(task.roadmap.edges) < 0.7 * len(checked), "though fewer edges were checked"
    assert all(checked[edge] == verdict for edge, verdict in task.roadmap.edges.items() if edge in checked)


@pytest.mark.parametrize("objective", [HotSpot, SlopedHotSpot])
def test_alpha_zero_is_the_classical_planner_step_by_step(objective):
    indifferent, classical = Problem(wall_with_a_gap, objective, alpha=0.0), Problem(wall_with_a_gap)
    assert indifferent.solve() == classical.solve() == EXACT
    assert indifferent.walls.asked == classical.walls.asked
    np.testing.assert_array_equal(indifferent.path, classical.path)
    anxious = Problem(wall_with_a_gap, objective)
    anxious.solve()
    assert anxious.walls.asked != classical.walls.asked


@pytest.mark.parametrize(("alpha", "way"), [(0.0, 0.2), (5.0, -0.5)])
def test_the_safer_of_two_ways_is_taken_if_danger_counts(monkeypatch, alpha, way):
    task = Problem(lambda x, y: abs(x) < 0.3 and abs(y) < 0.1, HotSpot, alpha=alpha, slide=0.0)
    ways = np.array([[0.0, 0.2], [0.0, -0.5]])  # the short way is the more dangerous one
    monkeypatch.setattr(task.planner, "_uniform", lambda count: ways)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, [START, (0.0, way), GOAL])


def test_danger_is_kept_away_from():
    def peak(seed, **parameters):
        task = Problem(objective=SlopedHotSpot, seed=seed, **parameters)
        assert task.solve() == EXACT
        return HotSpot(task.si).values(dense(task.path)).max()

    seeds = range(10)
    classical, straight, safe = (
        np.mean([peak(seed, **parameters) for seed in seeds])
        for parameters in ({"alpha": 0.0}, {"slide": 0.0}, {})
    )
    assert safe < straight < 0.8 * classical


def test_the_scale_of_an_objective_does_not_matter():
    class Scaled(SlopedHotSpot):
        def values(self, Q):
            return 1024 * super().values(Q)

    usual, scaled = Problem(wall_with_a_gap, SlopedHotSpot), Problem(wall_with_a_gap, Scaled)
    assert usual.solve() == scaled.solve() == EXACT
    np.testing.assert_allclose(usual.path, scaled.path, atol=1e-9)


@pytest.mark.parametrize("objective", [None, HotSpot, SlopedHotSpot])
def test_the_same_seed_gives_the_same_path(objective):
    first, second, other = (Problem(wall_with_a_gap, objective, seed=seed) for seed in (3, 3, 4))
    assert first.solve() == second.solve() == other.solve() == EXACT
    np.testing.assert_array_equal(first.path, second.path)
    assert first.walls.asked == second.walls.asked
    assert first.path.shape != other.path.shape or (first.path != other.path).any()


# ------------------------------------------------------------------------------------------- what is kept, and what not


def test_the_same_query_again_costs_nothing():
    task = Problem(wall_with_a_gap, SlopedHotSpot)
    assert task.solve() == EXACT
    first, path, milestones = len(task.walls.asked), task.path, len(task.roadmap)
    task.ask_again()
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, path)
    assert len(task.walls.asked) <= 10 < 0.02 * first, "the ends, once more"
    assert len(task.roadmap) == milestones


def test_other_queries_use_what_is_known():
    rng = np.random.default_rng(0)
    ends = [(rng.uniform((-1, -1), (-0.2, 1)), rng.uniform((0.2, -1), (1, 1))) for _ in range(10)]

    def asked(forget):
        task, total = Problem(wall_with_a_gap), 0
        for start, goal in ends:
            if forget:
                task.planner.clear()
            task.ask_again([start], [goal])
            assert task.solve() == EXACT
            np.testing.assert_array_equal(task.path[[0, -1]], [start, goal])
            total += len(task.walls.asked)
        return total

    assert asked(forget=False) < 0.8 * asked(forget=True)


def test_the_way_back_is_checked_as_it_is_driven():
    task = Problem(wall_with_a_gap)
    assert task.solve() == EXACT
    there, first = task.path, len(task.walls.asked)
    task.ask_again([GOAL], [START])
    assert task.solve() == EXACT
    assert len(task.walls.asked) < 0.5 * first
    assert {tuple(q) for q in task.path} == {tuple(q) for q in there}


def test_an_edge_that_is_free_one_way_only_is_not_driven_the_other_way():
    class OneWay(ob.MotionValidator):
        def __init__(self, si):
            super().__init__(si)

        def checkMotion(self, start, end):
            return bool(end[0] > start[0])

    task = Problem()
    task.si.setMotionValidator(OneWay(task.si))
    assert task.solve() == EXACT
    task.ask_again([GOAL], [START])
    assert task.solve(0.3) == TIMEOUT


def test_a_second_solve_goes_on_and_clear_forgets():
    task = Problem(walled_in)
    task.solve(0.1)
    milestones = len(task.roadmap)
    assert task.planner.counts.nodes > 0
    task.solve(0.1)
    assert len(task.roadmap) > milestones
    task.walls.forbidden = nowhere
    task.planner.clear()
    assert task.planner.counts.nodes == len(task.roadmap) == 0
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])


def test_another_objective_is_noticed():
    task = Problem(wall_with_a_gap)
    assert task.solve() == EXACT
    task.problem.setOptimizationObjective(HotSpot(task.si))
    assert task.solve() == EXACT
    assert not np.isnan(task.roadmap._costs).all()


# ---------------------------------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("setter", "bad"),
    [
        ("setAlpha", [-1.0, np.nan, np.inf, "much", None]),
        ("setNeighbors", [0, -1, 2.5, True, "many", None]),
        ("setSamples", [0, -1, 2.5, True, "many", None]),
        ("setSlide", [-0.1, 1.1, np.nan, "some", None]),
    ],
)
def test_setters_refuse_what_makes_no_sense(setter, bad):
    planner = SafePRM(Problem().si)
    for value in bad:
        with pytest.raises(InputError, match="must be"):
            getattr(planner, setter)(value)


def test_getters_give_back_what_was_set():
    planner = SafePRM(Problem().si, "Mine", alpha=2.0, neighbors=7, samples=np.int64(30), slide=0.1)
    planner.clear()
    assert planner.getName() == "Mine"
    assert (planner.getAlpha(), planner.getNeighbors(), planner.getSamples()) == (2.0, 7, 30)
    assert planner.getSlide() == 0.1


def test_by_name():
    si = Problem().si
    assert make_planner("ClassicPRM", si, {"neighbors": 9}).getNeighbors() == 9
    assert make_planner("ClassicPRM", si).getAlpha() == 0
    assert make_planner("SafePRM", si).getAlpha() > 0


# -------------------------------------------------------------------------------------------------------------- metrics


@pytest.mark.parametrize("name", ["panda", "ur5", "twin_arm", "slider"])
def test_the_metric_of_the_link_ends_is_equation_11(robot_named, rng, name):
    robot = robot_named(name)
    Q = rng.uniform(robot.lower, robot.upper, (20, robot.n))
    metric = LinkMetric(robot)
    places = metric.places(Q)
    expected = [
        sum(
            np.linalg.norm(a - b) ** 2 for a, b in zip(robot.keypoints(q), robot.keypoints(Q[3]), strict=True)
        )
        for q in Q
    ]
    np.testing.assert_allclose(metric.distances(places, places[3]), expected, atol=1e-12)
    roadmap = Roadmap(*_space(robot), metric)
    roadmap.add(Q)
    roadmap.invalid[5] = True
    excluded = np.arange(20) < 2
    nearest = [k for k in np.argsort(expected, kind="stable") if k not in (0, 1, 5)]
    assert roadmap.nearest(3, excluded).tolist() == nearest


def _space(robot):
    bridge = StateBridge(SafeSetup(robot, Scene(()), danger=None).getStateSpace())
    return bridge, StateCost(None, bridge)


def test_the_metric_of_the_space_wraps():
    metric = SpaceMetric(StateBridge(ob.SO2StateSpace()))
    places = metric.places(np.array([[3.0], [-3.0], [0.0]]))
    np.testing.assert_allclose(metric.distances(places, places[0]), [0.0, 2 * np.pi - 6, 3.0])


def test_which_metric_is_used(ur5, clutter):
    assert isinstance(Problem().roadmap._metric, SpaceMetric)
    assert isinstance(SafePRM(ob.SpaceInformation(ob.RealVectorStateSpace(2)))._roadmap._metric, SpaceMetric)
    setup = SafeSetup(ur5, clutter, danger=None)
    assert isinstance(SafePRM(setup.getSpaceInformation())._roadmap._metric, LinkMetric)


# ---------------------------------------------------------------------------------------------------- in OMPL's company


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
    planner = SafePRM(setup.getSpaceInformation(), samples=5)
    planner.setSeed(0)
    setup.setPlanner(planner)
    assert setup.solve(5.0).getStatus() == EXACT
    path = setup.getSolutionPath()
    angles = np.array([path.getState(k)[0].value for k in range(path.getStateCount())])
    assert (np.abs(angles) > 1.0).all()
    assert (np.sign(angles[:-1]) != np.sign(angles[1:])).any()
    assert path.check()


def test_an_error_in_a_checker_reaches_the_caller():
    task = Problem()

    def broken(x, y):
        if (x, y) not in (START, GOAL):
            raise ZeroDivisionError("in the checker")
        return False

    task.walls.forbidden = broken
    with pytest.raises(ZeroDivisionError, match="in the checker"):
        task.solve()


def test_paths_of_a_robot_are_free_and_safer(ur5, clutter, plain_check, rng):
    plain = plain_check(ur5, clutter)
    setup = SafeSetup(ur5, clutter, danger=None)
    points = rng.uniform(-0.5, 0.5, (10, 3)) + np.array([0.6, 0.0, 0.6])
    field = DangerField(ur5, points)
    setup.setOptimizationObjective(DangerObjective(setup.getSpaceInformation(), field))
    free = [q for q in rng.uniform(ur5.lower / 2, ur5.upper / 2, (60, 6)) if plain.nearest(q) > 0.01]
    danger = {"SafePRM": [], "ClassicPRM": []}
    for start, goal in zip(free[:6], free[6:12], strict=True):
        setup.setConfigurations(start, goal)
        for name, means in danger.items():
            result = setup.plan(name, time=5.0, seed=1)
            assert result
            assert result.report.certified
            np.testing.assert_allclose(result.path[[0, -1]], [start, goal])
            means.append(np.mean([field.value(q) for q in dense(result.path)[::20]]))
            for a, b in pairwise(result.path):
                assert plain.first_contact(a, b, 0.02) is None
    assert np.mean(danger["SafePRM"]) < 0.9 * np.mean(danger["ClassicPRM"])


def test_a_robots_second_query_costs_next_to_nothing(ur5, clutter):
    setup = SafeSetup(ur5, clutter, danger=None)
    start, goal = np.array([0.0, -1.6, 1.2, -1.2, -1.57, 0.0]), np.array([1.2, -1.6, 1.2, -1.2, -1.57, 0.0])
    planner = SafePRM(setup.getSpaceInformation())
    planner.setSeed(0)
    setup.setPlanner(planner)

    def queries():
        before = setup.counts.copy()
        assert setup.solve(5.0).getStatus() == EXACT
        work = setup.counts - before
        return work.collision_queries + work.margin_queries

    setup.setConfigurations(start, goal)
    first = queries()
    planner.clearQuery()
    setup.getProblemDefinition().clearSolutionPaths()
    assert queries() < 0.2 * first
    planner.clearQuery()
    setup.getProblemDefinition().clearSolutionPaths()
    setup.setConfigurations(goal, start)
    assert queries() < 0.7 * first
