"""BUBBLE_PLANNER as printed, against a literal transcription: the same path."""

import numpy as np
import pytest

from safe_ompl.collision.checker import DISTANCE_ERROR
from safe_ompl.errors import InputError
from safe_ompl.maths.bubbles import diamond_meetings
from safe_ompl.planners.registry import make_planner
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.setup.safe_setup import setup_scenario


@pytest.fixture(scope="module", params=["planar2", "planar3"])
def scenario(request):
    return Scenario.load(find_scenario(request.param))


@pytest.fixture(scope="module")
def arm(scenario):
    return setup_scenario(scenario)


class Transcription:
    """The procedure BUBBLE_PLANNER of the paper (§4.1) with eqs. (9) and (10), line by line."""

    def __init__(self, setup, alpha, beta):
        self.robot, self.checker, self.field = setup.robot, setup.checker, setup.field
        self.alpha, self.beta = alpha, beta

    def plan(self, q_s, q_g, k_max=100_000):
        Closed1, Closed2 = [], []  # entries: q, weights r_i/d_c, g, parent
        Open1, Open2 = [(q_s, 0.0, None)], [(q_g, 0.0, None)]
        direction, q_current_goal = 1, q_g
        for _ in range(k_max):
            f = [self.f(x, g, q_current_goal, Closed1) for x, g, _ in Open1]
            q_new, g, parent = Open1.pop(int(np.argmin(f)))
            Closed1.append((q_new, self.bubble(q_new), g, parent))
            if (path := self.intersect(Closed1, Closed2)) is not None:
                return path if direction == 1 else path[::-1]
            for x in self.bubble_endpoints(q_new, Closed1[-1][1]):
                Open1.append((x, g + np.abs(x - q_new).sum(), len(Closed1) - 1))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            direction, q_current_goal = 3 - direction, q_new
        return None

    def f(self, x, g, goal, closed):
        danger = self.alpha * self.field.value(x) if self.alpha else 0.0
        diversity = min((np.linalg.norm(x - z) for z, *_ in closed), default=0.0)
        return g + np.abs(x - goal).sum() + danger - self.beta * diversity

    def bubble(self, q):
        """r_i/d_c: the cylinder about the axis of joint i that encloses all links, and the closest obstacle."""
        r = self.robot.displacement_radii_at(q).max(axis=0)
        return r / (self.checker.pair_distances(q).min() - DISTANCE_ERROR)

    def bubble_endpoints(self, q, weights):
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


def ends(scenario, robot):
    return scenario.start_configuration(robot), scenario.goal_configurations(robot)[0]


@pytest.mark.parametrize(("alpha", "beta"), [(0.1, 2.0), (0.3, 20.0)])
def test_the_safe_bubble_planner_is_the_papers(scenario, arm, alpha, beta):
    result = arm.plan("PaperSafeBubble", time=30.0, parameters={"alpha": alpha, "beta": beta})
    literal = Transcription(arm, alpha, beta)
    np.testing.assert_allclose(result.path, literal.plan(*ends(scenario, arm.robot)), atol=1e-9)


def test_the_bubble_planner_is_the_papers_without_danger(scenario, arm):
    result = arm.plan("PaperBubble", time=30.0, parameters={"beta": 20.0})
    expected = Transcription(arm, 0.0, 20.0).plan(*ends(scenario, arm.robot))
    np.testing.assert_allclose(result.path, expected, atol=1e-9)
    assert result.counts.field_configurations == 0


def test_k_max_ends_the_search(arm):
    result = arm.plan("PaperSafeBubble", time=30.0, parameters={"alpha": 0.1, "beta": 2.0, "iterations": 4})
    assert result.path is None
    assert result.counts.nodes == 4


@pytest.mark.parametrize(
    ("key", "value"), [("slide", 0.5), ("nearest_fraction", 0.3), ("guided", True), ("shape", "link")]
)
def test_what_is_ours_cannot_be_switched_on(arm, key, value):
    with pytest.raises(InputError, match=f"{key!r} of PaperSafeBubble is fixed"):
        make_planner("PaperSafeBubble", arm.getSpaceInformation(), {key: value})
