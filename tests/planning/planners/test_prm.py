"""SafePRM: the paper's search step by step, and what is kept between queries."""

from functools import partial

import numpy as np
import pytest
from ompl import base as ob
from plane import EXACT, GOAL, START, TIMEOUT, HotSpot, PlaneProblem, SlopedHotSpot, nowhere, wall_with_a_gap, walled_in

from safe_ompl import SafePRM, SafeSetup, Scene
from safe_ompl.planning.planners import prm
from safe_ompl.planning.planners.problem import PlanningProblem
from safe_ompl.planning.planners.roadmap import Roadmap

Problem = partial(PlaneProblem, SafePRM)


def milestones(task):
    """Return the milestones, those without an edge too."""
    return task.planner._roadmap.configurations


def test_samples_grow_until_they_suffice():
    def maze(x, y):
        return (abs(x + 0.2) < 0.05 and not 0.8 < y < 0.85) or (abs(x - 0.2) < 0.05 and not -0.85 < y < -0.8)

    task = Problem(maze, samples=3)
    assert task.solve() == EXACT
    assert len(milestones(task)) > 3 + 2
    assert task.path[:, 1].max() > 0.75
    assert task.path[:, 1].min() < -0.75


def test_memory_stays_bounded_and_clear_forgets(monkeypatch):
    monkeypatch.setattr(prm, "_LARGEST_ROADMAP", 60)
    task = Problem(walled_in, samples=10)
    sizes = []

    def begun_anew():
        sizes.append(len(milestones(task)))
        return bool((np.diff(sizes) < 0).sum() > 1)

    assert task.solve(ob.PlannerTerminationCondition(begun_anew)) == TIMEOUT
    assert 48 < max(sizes) <= 60 * 1.25 + 1
    task.walls.forbidden = nowhere
    task.planner.clear()
    assert task.planner.counts.nodes == len(milestones(task)) == 0
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path[[0, -1]], [START, GOAL])


# -------------------------------------------------------------------------------------------------- the paper's search


@pytest.mark.parametrize(("alpha", "way"), [(0.0, 0.2), (5.0, -0.5)])
def test_the_safer_of_two_ways_is_taken_if_danger_counts(monkeypatch, alpha, way):
    task = Problem(lambda x, y: abs(x) < 0.3 and abs(y) < 0.1, HotSpot, alpha=alpha, slide=0.0)
    ways = np.array([[0.0, 0.2], [0.0, -0.5]])  # the short way is the more dangerous one
    monkeypatch.setattr(PlanningProblem, "random", lambda self, rng, *count: ways)
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, [START, (0.0, way), GOAL])


def test_with_danger_milestones_are_checked_when_they_leave_open(monkeypatch):
    blocked, free = [[-0.25, 0.05], [-0.25, -0.05]], [[0.0, 0.2], [0.0, 0.9], [0.0, -0.9]]
    monkeypatch.setattr(PlanningProblem, "random", lambda self, rng, *count: np.array(blocked + free))
    task = Problem(lambda x, y: abs(x) < 0.3 and abs(y) < 0.1, HotSpot, alpha=0.1, neighbors=1, slide=0.0)
    monkeypatch.setattr(task.planner, "_usual_danger", lambda: np.inf)
    assert task.solve() == EXACT
    # Both neighbours of the start are invalid, and the next nearest takes their place.
    np.testing.assert_array_equal(task.path, [START, free[0], GOAL])
    roadmap = task.planner._roadmap
    assert roadmap.invalid.sum() == len(blocked)
    assert not (roadmap.valid | roadmap.invalid)[-2:].any()


# ------------------------------------------------------------------------------------------- what is kept, and what not


def test_the_same_query_again_costs_nothing():
    task = Problem(wall_with_a_gap, SlopedHotSpot)
    assert task.solve() == EXACT
    first, path, number = len(task.walls.asked), task.path, len(milestones(task))
    task.ask_again()
    assert task.solve() == EXACT
    np.testing.assert_array_equal(task.path, path)
    assert len(task.walls.asked) <= 10 < 0.02 * first, "the ends, once more"
    assert len(milestones(task)) == number


def test_the_way_back_is_checked_as_it_is_driven():
    class OneWay(ob.MotionValidator):
        def __init__(self, si):
            super().__init__(si)

        def checkMotion(self, start, end):
            return bool(end[0] > start[0])

    task = Problem(wall_with_a_gap, alpha=0.0)
    assert task.solve() == EXACT
    there, first = task.path, len(task.walls.asked)
    task.ask_again([GOAL], [START])
    assert task.solve() == EXACT
    assert len(task.walls.asked) < 0.5 * first
    assert {tuple(q) for q in task.path} == {tuple(q) for q in there}
    task = Problem()
    task.si.setMotionValidator(OneWay(task.si))
    assert task.solve() == EXACT
    task.ask_again([GOAL], [START])
    assert task.solve(0.3) == TIMEOUT


def test_a_roadmap_asks_for_each_margin_of_an_edge_once(shelf, monkeypatch):
    problem, asked = PlanningProblem(shelf.getSpaceInformation()), []
    roadmap, start = Roadmap(problem), np.array(shelf.query.start)
    roadmap.add(np.array([start, start + 0.01]))
    is_free = problem.motion_is_free
    monkeypatch.setattr(problem, "motion_is_free", lambda *args: asked.append(args) or is_free(*args))
    assert roadmap.is_free(0, 1, 1e-3)
    kept, _ = roadmap.margins_of(0, 1)
    assert kept >= 1e-3
    asked.clear()
    assert roadmap.is_free(0, 1, kept)
    assert roadmap.is_free(1, 0, kept / 2)
    assert not asked, "it is known"
    assert not roadmap.is_free(0, 1, 10.0), "no motion of an arm keeps so much from a floor"
    assert not roadmap.is_free(1, 0, 20.0)
    assert len(asked) == 1
    assert roadmap.is_free(0, 1)


# -------------------------------------------------------------------------------------------------------------- metrics


@pytest.mark.parametrize("name", ["panda", "ur5", "twin_arm", "slider"])
def test_the_metric_of_the_link_ends_is_equation_11(robot_named, rng, name):
    robot = robot_named(name)
    Q = rng.uniform(robot.lower, robot.upper, (20, robot.n))
    points = [robot.keypoints(q) for q in Q]
    expected = [sum(np.linalg.norm(a - b) ** 2 for a, b in zip(row, points[3], strict=True)) for row in points]
    roadmap = Roadmap(PlanningProblem(SafeSetup(robot, Scene(), danger=None).getSpaceInformation()))
    roadmap.add(Q)
    roadmap.invalid[5] = True
    nearest = [k for k in np.argsort(expected, kind="stable") if k not in (0, 1, 5)]
    assert roadmap.nearest(3, np.arange(20) < 2).tolist() == nearest
