"""The planners as printed, against literal transcriptions of the pseudocode: the same seed, the same path."""

from itertools import pairwise

import numpy as np
import pytest
from oracles.pinocchio_points import keypoint_jacobians

from safe_ompl import Scenario
from safe_ompl.collision import Bubble
from safe_ompl.collision.bubbles import diamond_meetings, reach_along
from safe_ompl.danger.link_field import vectors
from safe_ompl.geometry import DISTANCE_ERROR
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners import needs_place
from safe_ompl.robot import ScratchState


def branch(rows, node):
    """Return the configurations from the root to a node of rows (q, …, parent)."""
    found = []
    while node is not None:
        found.append(rows[node][0])
        node = rows[node][-1]
    return found[::-1]


def joined(tree, node, other, met, from_start):
    """Return the path through where two trees meet, which is in both."""
    branches = branch(tree, node), branch(other, met)
    there, back = branches if from_start else branches[::-1]
    return np.array([*there, *back[-2::-1]])


class Literal:
    """What transcriptions share: a robot, its danger, random configurations, and the parameters of the planner."""

    alpha = 0.0

    def __init__(self, setup, seed, **parameters):
        self.robot, self.checker, self.field = setup.robot, setup.checker, setup.field
        self.si = setup.getSpaceInformation()
        self.states = ScratchState(setup.bridge), ScratchState(setup.bridge)
        self.rng = np.random.default_rng(seed)
        vars(self).update(parameters)

    def random_config(self, *shape):
        return self.robot.lower + (self.robot.upper - self.robot.lower) * self.rng.random((*shape, self.robot.n))

    def is_free(self, start, end):
        one, other = self.states
        return self.si.checkMotion(one.set(start), other.set(end))

    def argmin(self, Q, target):
        """Return the node of rows (q, parent) with the least ρ + α·CDF."""
        return int(np.argmin([np.linalg.norm(target - q) + self.alpha * self.field.value(q) for q, _ in Q]))

    def towards(self, q_old, target):
        way = target - q_old
        return q_old + way * min(1.0, self.range / np.linalg.norm(way))


class RRTConnect(Literal):
    """SAFE_RRT-CONNECT of the paper (§4.4) line by line; EXTEND and CONNECT are those of Kuffner and LaValle (2000)."""

    def plan(self, q_s, q_g):
        Q1, Q2 = [(q_s, None)], [(q_g, None)]
        self.rounds, from_start = 0, True
        while True:
            self.rounds += 1
            q_rand = self.random_config()
            outcome, new = self.extend(Q1, self.argmin(Q1, q_rand), q_rand, from_start)
            if outcome != "Trapped":
                q_new = Q1[new][0]
                outcome, met = self.connect(Q2, self.argmin(Q2, q_new), q_new, not from_start)
                if outcome == "Reached":
                    return joined(Q1, new, Q2, met, from_start)
            Q1, Q2, from_start = Q2, Q1, not from_start

    def extend(self, Q, old, target, from_start):
        q_old, q_new = Q[old][0], self.towards(Q[old][0], target)
        if not self.is_free(*((q_old, q_new) if from_start else (q_new, q_old))):
            return "Trapped", old
        Q.append((q_new, old))
        return "Reached" if np.linalg.norm(target - q_old) <= self.range else "Advanced", len(Q) - 1

    def connect(self, Q, node, target, from_start):
        outcome = "Advanced"
        while outcome == "Advanced":
            outcome, node = self.extend(Q, node, target, from_start)
        return outcome, node


class PRM(Literal):
    """The procedure SAFE_PRM_PLANNER of the paper (§4.2), line by line."""

    def plan(self, q_s, q_g):
        N = self.samples
        self.Q = np.vstack([self.random_config(N), q_s, q_g])
        self.ends = self.robot.keypoints_batch(self.Q)[:, self.robot.segments[:, 1]]
        Closed1, Closed2 = {}, {}
        Open1, Open2 = [(N, 0.0, None)], [(N + 1, 0.0, None)]
        from_start, q_current_goal = True, N + 1
        while Open1 and Open2:
            best = np.argmin([self.f(x, g, q_current_goal) for x, g, _ in Open1])
            q_new, g_new, parent = Open1[best]
            Open1 = [offer for offer in Open1 if offer[0] != q_new]
            Closed1[q_new] = self.Q[q_new], parent
            if q_new in Closed2:  # CONNECTED
                return joined(Closed1, q_new, Closed2, q_new, from_start)
            for x in self.neighbors_of(q_new, Closed1, from_start):
                Open1.append((x, g_new + np.abs(self.Q[x] - self.Q[q_new]).sum(), q_new))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            from_start, q_current_goal = not from_start, q_new
        return None

    def f(self, x, g, goal):
        q = self.Q[x]
        return g + np.abs(q - self.Q[goal]).sum() + self.alpha * self.field.value(q)

    def neighbors_of(self, q_new, closed, from_start):
        rest = [x for x in range(len(self.Q)) if x not in closed]
        D = {x: ((self.ends[x] - self.ends[q_new]) ** 2).sum() for x in rest}  # eq. (11)
        edges = ((x, (q_new, x) if from_start else (x, q_new)) for x in sorted(rest, key=D.get)[: self.neighbors])
        return [x for x, (start, end) in edges if self.is_free(self.Q[start], self.Q[end])]


class JTRRT(Literal):
    """SAFE_JT-RRT, EXTEND_TOWARDS_GOAL and EXTEND_RANDOMLY of the paper (§4.3), line by line, as they are read."""

    null_space_gain, danger_threshold = None, np.inf

    def plan(self, q_s, x_g):
        self.x_g = x_g
        self.Q, self.chosen = [(q_s, None)], set()
        while min(self.ws_distance(q) for q, _ in self.Q) >= 0.01:
            if self.rng.random() < self.goal_bias:
                self.extend_towards_goal()
            else:
                self.extend_randomly()
        return np.array(branch(self.Q, len(self.Q) - 1))

    def ws_distance(self, q):
        return np.linalg.norm(self.x_g - self.robot.tip_pose(q).translation)

    def extend_towards_goal(self):
        left = [k for k in range(len(self.Q)) if k not in self.chosen]
        if not left:
            return self.extend_randomly()
        old = min(left, key=lambda k: self.ws_distance(self.Q[k][0]) + self.alpha * self.field.value(self.Q[k][0]))
        while True:
            self.chosen.add(old)
            q_old = self.Q[old][0]
            q_new = np.clip(q_old + self.displacement(q_old), self.robot.lower, self.robot.upper)
            if self.ws_distance(q_new) > 0.995 * self.ws_distance(q_old):
                return None  # no progress
            if not (self.is_free(q_old, q_new) and self.field.value(q_new) < self.danger_threshold):
                return None
            self.Q.append((q_new, old))
            if self.ws_distance(q_new) < 0.01:
                return None
            old = len(self.Q) - 1

    def displacement(self, q):
        J, dx = self.robot.tip_jacobian(q)[:3], self.x_g - self.robot.tip_pose(q).translation
        if self.null_space_gain is None:  # the classical one
            dq = self.gain * J.T @ dx
        else:
            dq0, jacobians = np.zeros(self.robot.n), keypoint_jacobians(self.robot, q)
            for vector in vectors(self.robot.keypoints(q)[None], self.field.links, self.field.points)[0]:
                for _, end in self.robot.segments:
                    dq0 += self.null_space_gain * jacobians[end].T @ vector
            inverse = np.linalg.pinv(J)
            dq = self.gain * (inverse @ dx + (np.eye(self.robot.n) - inverse @ J) @ dq0)
        return dq * min(1.0, self.step / np.linalg.norm(dq))

    def extend_randomly(self):
        q_rand = self.random_config()
        old = self.argmin(self.Q, q_rand)
        q_new = self.towards(self.Q[old][0], q_rand)
        if self.is_free(self.Q[old][0], q_new):
            self.Q.append((q_new, old))


class BubblePlanner(Literal):
    """The procedure BUBBLE_PLANNER of the paper (§4.1) with eqs. (9) and (10), line by line."""

    def plan(self, q_s, q_g):
        Closed1, Closed2 = [], []  # entries: q, weights r_i/d_c, g, parent
        Open1, Open2 = [(q_s, 0.0, None, 0.0)], [(q_g, 0.0, None, 0.0)]  # entries: x, g, parent, CDF
        from_start, q_current_goal = True, q_g
        while True:
            q_new, g, parent, _ = Open1.pop(int(np.argmin(self.f(Open1, q_current_goal, Closed1))))
            Closed1.append((q_new, self.bubble(q_new), g, parent))
            if (path := self.intersect(Closed1, Closed2)) is not None:
                return path if from_start else path[::-1]
            for x in self.bubble_endpoints(q_new, Closed1[-1][1]):
                Open1.append((x, g + np.abs(x - q_new).sum(), len(Closed1) - 1, self.field.value(x)))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            from_start, q_current_goal = not from_start, q_new

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
        return np.array([*branch(Closed1, len(Closed1) - 1), meeting, *branch(Closed2, met)[::-1]])


SAMPLES = {"samples": 120, "neighbors": 8}
STEPS = {"range": 0.5, "step": 0.1, "goal_bias": 0.3}
POSTURE = {**STEPS, "gain": 0.2, "null_space_gain": 0.002}
CASES = {
    "Kuffner's": ("PaperRRTConnect", RRTConnect, {"range": 0.25}),
    **{f"α {a}": ("PaperSafeRRTConnect", RRTConnect, {"range": 0.25, "alpha": a}) for a in (0.0, 0.05, 0.3)},
    "PRM": ("PaperPRM", PRM, SAMPLES),
    **{f"PRM, α {a}": ("PaperSafePRM", PRM, {**SAMPLES, "alpha": a}) for a in (0.1, 1.0)},
    "Vande Weghe's": ("PaperJTRRT", JTRRT, {**STEPS, "gain": 0.3}),
    **{f"JT-RRT, α {a}": ("PaperSafeJTRRT", JTRRT, {**POSTURE, "alpha": a}) for a in (0.1, 2.0)},
    "JT-RRT, threshold": ("PaperSafeJTRRT", JTRRT, {**POSTURE, "alpha": 0.1, "danger_threshold": 6.4}),
    "bubbles": ("PaperBubble", BubblePlanner, {"beta": 20.0}),
    **{f"bubbles, α {a}": ("PaperSafeBubble", BubblePlanner, {"alpha": a, "beta": 20.0}) for a in (0.05, 0.1)},
}


def ends_of(scenario, robot, planner):
    """Return a start, and what a planner plans to: a configuration or a place of the tip."""
    goal = scenario.goal.position if needs_place(planner) else scenario.goal_configurations(robot)[0]
    return scenario.start_configuration(robot), np.array(goal)


@pytest.mark.parametrize(("name", "seed"), [("planar2", 1), ("planar3", 0)])
@pytest.mark.parametrize("case", CASES)
def test_planners_are_the_papers_and_without_danger_classical(monkeypatch, case, name, seed):
    monkeypatch.setattr(StateCost, "slope", None)  # α is taken as it is
    scenario, (planner, literal, parameters) = Scenario.load(name), CASES[case]
    setup = setup_scenario(scenario)
    result = setup.plan(planner, time=30.0, seed=seed, parameters=parameters)
    expected = literal(setup, seed, **parameters).plan(*ends_of(scenario, setup.robot, planner))
    np.testing.assert_allclose(result.path, expected, atol=1e-9)
    assert (result.counts.field_configurations > 0) == (parameters.get("alpha", 0.0) > 0)


def test_k_iterations_are_made_and_no_more(planar3, scenario):
    name, parameters = "PaperRRTConnect", {"range": 0.25}
    literal = RRTConnect(planar3, 0, **parameters)
    literal.plan(*ends_of(scenario, planar3.robot, name))
    for k, found in ((literal.rounds, True), (literal.rounds - 1, False)):
        assert bool(planar3.plan(name, time=30.0, seed=0, parameters={**parameters, "iterations": k})) is found
    few = planar3.plan("PaperSafeBubble", time=30.0, parameters={"alpha": 0.1, "beta": 2.0, "iterations": 4})
    assert (few.path, few.counts.nodes) == (None, 4)


def test_too_few_samples_end_in_failure_only_as_printed(planar3):
    few = {"samples": 1, "neighbors": 1}
    assert planar3.plan("PaperPRM", time=20.0, seed=0, parameters=few).path is None
    assert planar3.plan("ClassicPRM", time=20.0, seed=0, parameters=few)


def test_consecutive_configurations_share_a_bubble(planar3):
    path, checker = planar3.plan("PaperBubble", time=20.0, parameters={"beta": 20.0}).path, planar3.checker
    for start, end in pairwise(path):
        motions = (start, end - start), (end, start - end)
        assert max(reach_along(way, checker.pair_radii_at(q), checker.pair_distances(q)) for q, way in motions) > 1


def test_the_radii_of_the_papers_bubble_are_those_of_all_links():
    """Only an arm in space tells them from those of the pairs."""
    setup = setup_scenario(Scenario.load("panda_shelf"))
    checker, q = setup.checker, setup.query.start
    radii = checker.robot.bounds.displacement_radii_at(q).max(axis=0)
    expected = radii / (checker.pair_distances(q).min() - DISTANCE_ERROR)
    np.testing.assert_allclose(Bubble.around(q, checker, printed=True).weights, expected)
    assert (radii > checker.pair_radii_at(q).max(axis=0)).any()
