"""SafePRM: the paper's search step by step, and what is kept between queries."""

import numpy as np
import pytest
from ompl import base as ob
from plane import (
    EXACT,
    GOAL,
    START,
    TIMEOUT,
    HotSpot,
    PlaneProblem,
    SlopedHotSpot,
    Stop,
    nowhere,
    wall_with_a_gap,
    walled_in,
)

from safe_ompl import SafePRM, SafeSetup, Scene
from safe_ompl.planning.ompl import StateBridge, StateCost
from safe_ompl.planning.planners import prm
from safe_ompl.planning.planners.parts.problem import DangerWeight, PlanningProblem
from safe_ompl.planning.planners.parts.roadmap import (
    LinkMetric,
    LocalPlanner,
    Roadmap,
    Samples,
    SearchGraph,
    SpaceMetric,
    roadmap_metric,
)


class Watched(SafePRM):
    """Shows its milestones, those without an edge too."""

    @property
    def milestones(self):
        return self._roadmap.configurations


class Problem(PlaneProblem):
    def __init__(self, *task, **parameters):
        super().__init__(Watched, *task, **parameters)

    @property
    def milestones(self):
        return self.planner.milestones


def test_samples_grow_until_they_suffice():
    def maze(x, y):
        return (abs(x + 0.2) < 0.05 and not 0.8 < y < 0.85) or (abs(x - 0.2) < 0.05 and not -0.85 < y < -0.8)

    task = Problem(maze, samples=3)
    assert task.solve() == EXACT
    assert len(task.milestones) > 3 + 2
    assert task.path[:, 1].max() > 0.75
    assert task.path[:, 1].min() < -0.75


def test_checks_heed_the_termination_condition():
    task = Problem(lambda x, y: x not in (START[0], GOAL[0]))
    stop = Stop(task.walls, 100)
    assert task.solve(stop.condition) == TIMEOUT
    assert stop.checked_too_late <= 1


def test_memory_stays_bounded(monkeypatch):
    monkeypatch.setattr(prm, "_LARGEST_ROADMAP", 150)
    task = Problem(walled_in, samples=20)
    sizes = []

    def begun_anew():
        sizes.append(len(task.milestones))
        return bool((np.diff(sizes) < 0).sum() > 1)

    stop = ob.PlannerTerminationCondition(begun_anew)
    assert task.solve(stop) == TIMEOUT
    assert 120 < max(sizes) <= 150 * 1.25 + 1
    task.walls.forbidden = nowhere
    task.planner.clear()
    assert task.solve() == EXACT


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
@pytest.mark.parametrize("seed", range(3))
def test_the_search_is_the_papers_step_by_step(monkeypatch, objective, seed):
    order = []
    add_closed = SearchGraph.add_closed
    monkeypatch.setattr(
        SearchGraph, "add_closed", lambda self, offer: order.append(add_closed(self, offer)) or order[-1]
    )
    asked, check = {}, LocalPlanner.check
    monkeypatch.setattr(LocalPlanner, "check", lambda self, *edge: asked.setdefault(edge, check(self, *edge)))
    task = Problem(wall_with_a_gap, objective, seed=seed, neighbors=12, samples=200, slide=0.0)
    monkeypatch.setattr(LocalPlanner, "is_valid", lambda self, milestone: True)
    assert task.solve() == EXACT
    assert len(task.milestones) == 202, "the first samples suffice"

    Q, checked = task.milestones, {}
    problem = PlanningProblem(task.si)
    problem.take(objective and objective(task.si), None)
    danger = DangerWeight(problem)
    danger.alpha = task.planner.getAlpha()
    weight = danger.weight if objective else 0.0

    def is_free(i, j):
        checked[i, j] = problem.motion_is_free(Q[i], Q[j])
        return checked[i, j]

    def cost(q):
        return weight * HotSpot(task.si).values(q[None])[0] if weight else 0.0

    expected_order, expected_path = literal_search(Q, 0, 1, 12, cost, is_free)
    assert order == expected_order
    np.testing.assert_array_equal(task.path, Q[expected_path])
    assert len(asked) < 0.7 * len(checked), "though fewer edges were checked"
    assert all(checked[edge] == verdict for edge, verdict in asked.items() if edge in checked)


@pytest.mark.parametrize(("alpha", "way"), [(0.0, 0.2), (5.0, -0.5)])
def test_the_safer_of_two_ways_is_taken_if_danger_counts(monkeypatch, alpha, way):
    task = Problem(lambda x, y: abs(x) < 0.3 and abs(y) < 0.1, HotSpot, alpha=alpha, slide=0.0)
    ways = np.array([[0.0, 0.2], [0.0, -0.5]])  # the short way is the more dangerous one
    monkeypatch.setattr(Samples, "uniform", lambda self, count, rng: ways)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, [START, (0.0, way), GOAL])


# ------------------------------------------------------------------------------------------- what is kept, and what not


def test_the_same_query_again_costs_nothing():
    task = Problem(wall_with_a_gap, SlopedHotSpot)
    assert task.solve() == EXACT
    first, path, milestones = len(task.walls.asked), task.path, len(task.milestones)
    task.ask_again()
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, path)
    assert len(task.walls.asked) <= 10 < 0.02 * first, "the ends, once more"
    assert len(task.milestones) == milestones


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
    milestones = len(task.milestones)
    assert task.planner.counts.nodes > 0
    task.solve(0.1)
    assert len(task.milestones) > milestones
    task.walls.forbidden = nowhere
    task.planner.clear()
    assert task.planner.counts.nodes == len(task.milestones) == 0
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])


def test_another_objective_is_noticed():
    task = Problem(wall_with_a_gap)
    assert task.solve() == EXACT
    task.problem.setOptimizationObjective(HotSpot(task.si))
    assert task.solve() == EXACT
    graph = task.planner.plannerGraph()
    np.testing.assert_allclose(graph.costs, HotSpot(task.si).values(graph.configurations))


# -------------------------------------------------------------------------------------------------------------- metrics


@pytest.mark.parametrize("name", ["panda", "ur5", "twin_arm", "slider"])
def test_the_metric_of_the_link_ends_is_equation_11(robot_named, rng, name):
    robot = robot_named(name)
    Q = rng.uniform(robot.lower, robot.upper, (20, robot.n))
    metric = LinkMetric(robot)
    places = metric.places(Q)
    expected = [
        sum(np.linalg.norm(a - b) ** 2 for a, b in zip(robot.keypoints(q), robot.keypoints(Q[3]), strict=True))
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
    si = Problem().si
    assert isinstance(roadmap_metric(si, StateBridge(si.getStateSpace())), SpaceMetric)
    si = SafeSetup(ur5, clutter, danger=None).getSpaceInformation()
    assert isinstance(roadmap_metric(si, StateBridge(si.getStateSpace())), LinkMetric)
