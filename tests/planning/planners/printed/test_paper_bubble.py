"""BUBBLE_PLANNER as printed, against a literal transcription: the same path."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from safe_ompl import Scenario, UnknownNameError, make_planner
from safe_ompl.collision import DISTANCE_ERROR, Bubble
from safe_ompl.collision.bubbles import diamond_meetings, reach_along
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario


@cache
def arm_of(name):
    return setup_scenario(Scenario.load(find_scenario(name)))


@pytest.fixture
def arm():
    return arm_of("planar2")


class Transcription:
    """The procedure BUBBLE_PLANNER of the paper (§4.1) with eqs. (9) and (10), line by line."""

    def __init__(self, setup, alpha, beta):
        self.robot, self.checker, self.field = setup.robot, setup.checker, setup.field
        self.alpha, self.beta = alpha, beta

    def plan(self, q_s, q_g, k_max=100_000):
        Closed1, Closed2 = [], []  # entries: q, weights r_i/d_c, g, parent
        Open1, Open2 = [(q_s, 0.0, None, 0.0)], [(q_g, 0.0, None, 0.0)]  # entries: x, g, parent, CDF
        direction, q_current_goal = 1, q_g
        for _ in range(k_max):
            q_new, g, parent, _ = Open1.pop(int(np.argmin(self.f(Open1, q_current_goal, Closed1))))
            Closed1.append((q_new, self.bubble(q_new), g, parent))
            if (path := self.intersect(Closed1, Closed2)) is not None:
                return path if direction == 1 else path[::-1]
            vertices = np.array(list(self.bubble_endpoints(q_new, Closed1[-1][1])))
            dangers = self.field.values(vertices) if self.alpha else np.zeros(len(vertices))
            for x, danger in zip(vertices, dangers, strict=True):
                Open1.append((x, g + np.abs(x - q_new).sum(), len(Closed1) - 1, danger))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            direction, q_current_goal = 3 - direction, q_new
        return None

    def f(self, opened, goal, closed):
        """F = g + h + α·CDF − β·min ‖x − z‖ over Closed(1), eq. (10)."""
        x, g, _, danger = map(np.array, zip(*opened, strict=True))
        diversity = 0.0
        if closed:
            z = np.array([entry[0] for entry in closed])
            diversity = np.linalg.norm(x[:, None] - z[None], axis=2).min(axis=1)
        return g + np.abs(x - goal).sum(axis=1) + self.alpha * danger - self.beta * diversity

    def bubble(self, q):
        """r_i/d_c: the cylinder about the axis of joint i that encloses all links, and the closest obstacle."""
        r = self.robot.bounds.displacement_radii_at(q).max(axis=0)
        return r / (self.checker.pair_distances(q).min() - DISTANCE_ERROR)

    def bubble_endpoints(self, q, weights):
        """Yield the vertices of the bubble, 0.99 of the way, within the joint limits."""
        for sign in (-1.0, 1.0):
            for i in range(self.robot.n):
                x = q.copy()
                x[i] = np.clip(q[i] + sign * 0.99 / weights[i], self.robot.lower[i], self.robot.upper[i])
                if abs(x[i] - q[i]) > 1e-9:
                    yield x

    def intersect(self, Closed1, Closed2):
        """Only the bubble closed last can be new to the other tree."""
        q, w, *_ = Closed1[-1]
        best, meeting, met = 0.99, None, None
        for k, (z, v, *_) in enumerate(Closed2):
            gaps, shares = diamond_meetings((w * np.abs(z - q))[None], (v * np.abs(z - q))[None])
            if gaps[0] < best:
                best, meeting, met = gaps[0], q + shares[0] * (z - q), k
        if meeting is None:
            return None
        branches = self.branch(Closed1, len(Closed1) - 1), self.branch(Closed2, met)
        return np.array([*branches[0], meeting, *branches[1][::-1]])

    def branch(self, closed, k):
        rows = []
        while k is not None:
            rows.append(closed[k][0])
            k = closed[k][3]
        return rows[::-1]


def expected_path(name, alpha, beta):
    scenario, setup = Scenario.load(find_scenario(name)), arm_of(name)
    ends = scenario.start_configuration(setup.robot), scenario.goal_configurations(setup.robot)[0]
    return Transcription(setup, alpha, beta).plan(*ends, k_max=400)


@pytest.mark.parametrize(
    ("name", "alpha", "beta"), [("planar2", 0.1, 20.0), ("planar2", 0.2, 20.0), ("planar3", 0.1, 20.0)]
)
def test_the_safe_bubble_planner_is_the_papers(name, alpha, beta):
    result = arm_of(name).plan("PaperSafeBubble", time=30.0, parameters={"alpha": alpha, "beta": beta})
    np.testing.assert_allclose(result.path, expected_path(name, alpha, beta), atol=1e-9)


@pytest.mark.parametrize("name", ["planar2", "planar3"])
def test_the_bubble_planner_is_the_papers_without_danger(name):
    result = arm_of(name).plan("PaperBubble", time=30.0, parameters={"beta": 20.0})
    np.testing.assert_allclose(result.path, expected_path(name, 0.0, 20.0), atol=1e-9)
    assert result.counts.field_configurations == 0


def test_consecutive_configurations_share_a_bubble():
    setup = arm_of("planar3")
    path = setup.plan("PaperBubble", time=20.0, parameters={"beta": 20.0}).path
    assert len(path) > 2
    for start, end in pairwise(path):
        reach = 0.0
        for q, motion in ((start, end - start), (end, start - end)):
            distances = setup.checker.pair_distances(q)
            reach = max(reach, reach_along(motion, setup.checker.pair_radii_at(q), distances))
        assert reach > 1


def test_cubes_within_the_papers_bubble_are_the_only_other_shape(arm):
    result = arm.plan("PaperSafeBubble", time=30.0, parameters={"shape": "paper_cube", "alpha": 0.1, "beta": 20.0})
    assert result
    assert result.report.certified


def test_k_max_ends_the_search(arm):
    result = arm.plan("PaperSafeBubble", time=30.0, parameters={"alpha": 0.1, "beta": 2.0, "iterations": 4})
    assert result.path is None
    assert result.counts.nodes == 4


def test_it_has_the_papers_shapes_only(arm):
    with pytest.raises(UnknownNameError, match="unknown shape 'link'; known: paper, paper_cube"):
        make_planner("PaperSafeBubble", arm.getSpaceInformation(), {"shape": "link"})


def test_the_cube_of_the_paper_lies_within_its_bubble(arm):
    checker, q = arm.checker, np.array([1.2, -0.5])
    diamond, cube = (Bubble.around(q, checker, shape) for shape in ("paper", "paper_cube"))
    reach = 1.0 / cube.weights
    assert reach[0] == reach[1]
    assert diamond.weights @ reach == pytest.approx(1.0)


def test_the_radii_of_the_paper_are_those_of_all_links(arm):
    q = np.array([1.2, -0.5])
    bubble, r = Bubble.around(q, arm.checker, "paper"), arm.robot.bounds.displacement_radii_at(q).max(axis=0)
    np.testing.assert_allclose(bubble.weights, r / (arm.checker.pair_distances(q).min() - DISTANCE_ERROR))
    assert (r >= arm.checker.pair_radii_at(q).max(axis=0)).all()
