"""The planners as printed, against literal transcriptions of the pseudocode: the same seed, the same path."""

from itertools import pairwise

import numpy as np
import pytest
from oracles.pinocchio_points import keypoint_jacobians
from plane import APPROXIMATE, EXACT, GOAL, START, HotSpot, PlaneProblem, wall_with_a_gap

from safe_ompl import Scenario, make_planner
from safe_ompl.collision import Bubble
from safe_ompl.collision.bubbles import diamond_meetings, reach_along
from safe_ompl.danger.link_field import vectors
from safe_ompl.geometry import DISTANCE_ERROR
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import StateCost
from safe_ompl.robot import ScratchState, StateBridge


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


class OnArm:
    """What transcriptions for an arm need."""

    def __init__(self, setup, alpha, seed=0):
        self.robot, self.checker, self.field, self.alpha = setup.robot, setup.checker, setup.field, alpha
        self.si = setup.getSpaceInformation()
        bridge = StateBridge(self.si.getStateSpace())
        self.states = ScratchState(bridge), ScratchState(bridge)
        self.rng = np.random.default_rng(seed)

    def random_config(self, *shape):
        return self.robot.lower + (self.robot.upper - self.robot.lower) * self.rng.random((*shape, self.robot.n))

    def is_free(self, start, end):
        one, other = self.states
        return self.si.checkMotion(one.set(start), other.set(end))


def ends_of(scenario, setup):
    return scenario.start_configuration(setup.robot), scenario.goal_configurations(setup.robot)[0]


# ------------------------------------------------------------------------------------------------- SAFE_RRT-CONNECT

RANGE = 0.25


class RRTConnect:
    """SAFE_RRT-CONNECT of the paper (§4.4) line by line; EXTEND and CONNECT are those of Kuffner and LaValle (2000)."""

    def __init__(self, task, alpha, seed):
        self.si, self.state = task.si, task.state
        self.cdf, self.alpha = HotSpot(task.si), alpha
        self.rng = np.random.default_rng(seed)
        self.rounds = 0

    def plan(self, q_s, q_g):
        Q1, Q2 = [(np.array(q_s), None)], [(np.array(q_g), None)]
        from_start = True
        while True:
            self.rounds += 1
            q_rand = -1.0 + 2.0 * self.rng.random(2)
            outcome, new = self.extend(Q1, self.argmin(Q1, q_rand), q_rand, from_start)
            if outcome != "Trapped":
                q_new = Q1[new][0]
                outcome, met = self.connect(Q2, self.argmin(Q2, q_new), q_new, not from_start)
                if outcome == "Reached":
                    return joined(Q1, new, Q2, met, from_start)
            Q1, Q2, from_start = Q2, Q1, not from_start

    def argmin(self, Q, target):
        rho = np.array([np.linalg.norm(target - q) for q, _ in Q])
        return int(np.argmin(rho + self.alpha * self.cdf.values(np.array([q for q, _ in Q]))))

    def extend(self, Q, old, target, from_start):
        q_old = Q[old][0]
        way = target - q_old
        reached = np.linalg.norm(way) <= RANGE
        q_new = target if reached else q_old + RANGE * way / np.linalg.norm(way)
        ends = (q_old, q_new) if from_start else (q_new, q_old)
        if not self.si.checkMotion(*map(self.state, ends)):
            return "Trapped", old
        Q.append((q_new, old))
        return "Reached" if reached else "Advanced", len(Q) - 1

    def connect(self, Q, node, target, from_start):
        outcome = "Advanced"
        while outcome == "Advanced":
            outcome, node = self.extend(Q, node, target, from_start)
        return outcome, node


def task_of(name, seed, forbidden=wall_with_a_gap, **parameters):
    return PlaneProblem(
        lambda si: make_planner(name, si, {"range": RANGE, **parameters}), forbidden, HotSpot, seed=seed
    )


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("alpha", [None, 0.0, 0.5, 3.0])
def test_rrt_connect_is_the_papers_and_without_danger_kuffners(monkeypatch, seed, alpha):
    monkeypatch.setattr(StateCost, "slope", None)  # α is taken as it is
    name, given = ("PaperRRTConnect", {}) if alpha is None else ("PaperSafeRRTConnect", {"alpha": alpha})
    task = task_of(name, seed, **given)
    assert task.solve() == EXACT
    literal = RRTConnect(task, alpha or 0.0, seed)
    np.testing.assert_allclose(task.path, literal.plan(START, GOAL), atol=1e-12)
    assert task_of(name, seed, iterations=literal.rounds, **given).solve() == EXACT
    assert task_of(name, seed, iterations=literal.rounds - 1, **given).solve() == APPROXIMATE


# ------------------------------------------------------------------------------------------------- SAFE_PRM_PLANNER

N, K = 120, 8


class PRM(OnArm):
    """The procedure SAFE_PRM_PLANNER of the paper (§4.2), line by line."""

    def plan(self, q_s, q_g):
        self.samples = np.vstack([self.random_config(N), q_s, q_g])
        self.ends = self.robot.keypoints_batch(self.samples)[:, self.robot.segments[:, 1]]
        Closed1, Closed2 = {}, {}
        Open1, Open2 = [(N, 0.0, None)], [(N + 1, 0.0, None)]
        from_start, q_current_goal = True, N + 1
        while Open1 and Open2:
            best = np.argmin([self.f(x, g, q_current_goal) for x, g, _ in Open1])
            q_new, g_new, parent = Open1[best]
            Open1 = [offer for offer in Open1 if offer[0] != q_new]
            Closed1[q_new] = self.samples[q_new], parent
            if q_new in Closed2:  # CONNECTED
                return joined(Closed1, q_new, Closed2, q_new, from_start)
            for x in self.neighbors(q_new, Closed1, from_start):
                Open1.append((x, g_new + np.abs(self.samples[x] - self.samples[q_new]).sum(), q_new))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            from_start, q_current_goal = not from_start, q_new
        return None

    def f(self, x, g, goal):
        q = self.samples[x]
        danger = self.alpha * self.field.value(q) if self.alpha else 0.0
        return g + np.abs(q - self.samples[goal]).sum() + danger

    def neighbors(self, q_new, closed, from_start):
        rest = [x for x in range(len(self.samples)) if x not in closed]
        D = {x: ((self.ends[x] - self.ends[q_new]) ** 2).sum() for x in rest}  # eq. (11)
        edges = ((x, (q_new, x) if from_start else (x, q_new)) for x in sorted(rest, key=D.get)[:K])
        return [x for x, (start, end) in edges if self.is_free(self.samples[start], self.samples[end])]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("alpha", [0.0, 0.1, 1.0])
def test_prm_is_the_papers(planar3, scenario, seed, alpha):
    name, given = ("PaperSafePRM", {"alpha": alpha}) if alpha else ("PaperPRM", {})
    result = planar3.plan(name, time=20.0, seed=seed, parameters={"samples": N, "neighbors": K, **given})
    np.testing.assert_allclose(result.path, PRM(planar3, alpha, seed).plan(*ends_of(scenario, planar3)), atol=1e-12)
    assert (result.counts.field_configurations > 0) == (alpha > 0)


def test_too_few_samples_end_in_failure_only_as_printed(planar3):
    few = {"samples": 1, "neighbors": 1}
    assert planar3.plan("PaperPRM", time=20.0, seed=0, parameters=few).path is None
    assert planar3.plan("ClassicPRM", time=20.0, seed=0, parameters=few)


# ------------------------------------------------------------------------------------------------------- SAFE_JT-RRT

STEP, REACH, D_THRESHOLD = 0.1, 0.5, 0.01


class JTRRT(OnArm):
    """SAFE_JT-RRT, EXTEND_TOWARDS_GOAL and EXTEND_RANDOMLY of the paper (§4.3), line by line, as they are read."""

    def __init__(self, setup, alpha, seed, k1, k2, threshold, transpose):
        super().__init__(setup, alpha, seed)
        self.k1, self.k2, self.threshold, self.transpose = k1, k2, threshold, transpose

    def plan(self, q_s, x_g):
        self.x_g = x_g
        self.Q, self.chosen = [(q_s, None)], set()
        while min(self.ws_distance(q) for q, _ in self.Q) >= D_THRESHOLD:
            if self.rng.random() < 0.3:
                self.extend_towards_goal()
            else:
                self.extend_randomly()
        return np.array(branch(self.Q, len(self.Q) - 1))

    def ws_distance(self, q):
        return np.linalg.norm(self.x_g - self.robot.tip_pose(q).translation)

    def cdf(self, q):
        return self.field.value(q) if self.alpha or np.isfinite(self.threshold) else 0.0

    def extend_towards_goal(self):
        left = [k for k in range(len(self.Q)) if k not in self.chosen]
        if not left:
            return self.extend_randomly()
        old = min(left, key=lambda k: self.ws_distance(self.Q[k][0]) + self.alpha * self.cdf(self.Q[k][0]))
        while True:
            self.chosen.add(old)
            q_old = self.Q[old][0]
            q_new = np.clip(q_old + self.displacement(q_old), self.robot.lower, self.robot.upper)
            if self.ws_distance(q_new) > 0.995 * self.ws_distance(q_old):
                return None  # no progress
            if not (self.is_free(q_old, q_new) and self.cdf(q_new) < self.threshold):
                return None
            self.Q.append((q_new, old))
            if self.ws_distance(q_new) < D_THRESHOLD:
                return None
            old = len(self.Q) - 1

    def displacement(self, q):
        J, dx = self.robot.tip_jacobian(q)[:3], self.x_g - self.robot.tip_pose(q).translation
        if self.transpose:
            dq = self.k2 * J.T @ dx
        else:
            dq0, jacobians = np.zeros(self.robot.n), keypoint_jacobians(self.robot, q)
            for vector in vectors(self.robot.keypoints(q)[None], self.field.links, self.field.points)[0]:
                for _, end in self.robot.segments:
                    dq0 += self.k1 * jacobians[end].T @ vector
            inverse = np.linalg.pinv(J)
            dq = self.k2 * (inverse @ dx + (np.eye(self.robot.n) - inverse @ J) @ dq0)
        return dq * min(1.0, STEP / np.linalg.norm(dq))

    def extend_randomly(self):
        q_rand = self.random_config()
        old = int(np.argmin([np.linalg.norm(q - q_rand) + self.alpha * self.cdf(q) for q, _ in self.Q]))
        q_old = self.Q[old][0]
        way = q_rand - q_old
        q_new = q_old + way * min(1.0, REACH / np.linalg.norm(way))
        if self.is_free(q_old, q_new):
            self.Q.append((q_new, old))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("name", "alpha", "k1", "k2", "threshold"),
    [
        ("PaperSafeJTRRT", 0.1, 0.002, 0.2, np.inf),
        ("PaperSafeJTRRT", 0.5, 0.002, 0.2, np.inf),
        ("PaperSafeJTRRT", 0.1, 0.002, 0.2, 1.5),
        ("PaperJTRRT", 0.0, 0.0, 0.3, np.inf),
    ],
)
def test_jt_rrt_is_the_papers_and_without_danger_vande_weghes(planar3, scenario, seed, name, alpha, k1, k2, threshold):
    q_s, classical = scenario.start_configuration(planar3.robot), name == "PaperJTRRT"
    threshold *= planar3.field.value(q_s)
    given = {"range": REACH, "step": STEP, "goal_bias": 0.3, "gain": k2}
    if not classical:
        given |= {"alpha": alpha, "null_space_gain": k1}
    if np.isfinite(threshold):
        given["danger_threshold"] = threshold
    result = planar3.plan(name, time=20.0, seed=seed, parameters=given)
    literal = JTRRT(planar3, alpha, seed, k1, k2, threshold, classical)
    np.testing.assert_allclose(result.path, literal.plan(q_s, np.array(scenario.goal.position)), atol=1e-9)
    assert (result.counts.field_configurations == 0) == classical


# --------------------------------------------------------------------------------------------------- BUBBLE_PLANNER


class BubblePlanner(OnArm):
    """The procedure BUBBLE_PLANNER of the paper (§4.1) with eqs. (9) and (10), line by line; β is 20."""

    def plan(self, q_s, q_g):
        Closed1, Closed2 = [], []  # entries: q, weights r_i/d_c, g, parent
        Open1, Open2 = [(q_s, 0.0, None, 0.0)], [(q_g, 0.0, None, 0.0)]  # entries: x, g, parent, CDF
        from_start, q_current_goal = True, q_g
        while True:
            q_new, g, parent, _ = Open1.pop(int(np.argmin(self.f(Open1, q_current_goal, Closed1))))
            Closed1.append((q_new, self.bubble(q_new), g, parent))
            if (path := self.intersect(Closed1, Closed2)) is not None:
                return path if from_start else path[::-1]
            vertices = np.array(list(self.bubble_endpoints(q_new, Closed1[-1][1])))
            dangers = self.field.values(vertices) if self.alpha else np.zeros(len(vertices))
            for x, danger in zip(vertices, dangers, strict=True):
                Open1.append((x, g + np.abs(x - q_new).sum(), len(Closed1) - 1, danger))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            from_start, q_current_goal = not from_start, q_new

    def f(self, opened, goal, closed):
        """F = g + h + α·CDF − β·min ‖x − z‖ over Closed(1), eq. (10)."""
        x, g, _, danger = map(np.array, zip(*opened, strict=True))
        diversity = 0.0
        if closed:
            z = np.array([entry[0] for entry in closed])
            diversity = np.linalg.norm(x[:, None] - z[None], axis=2).min(axis=1)
        return g + np.abs(x - goal).sum(axis=1) + self.alpha * danger - 20.0 * diversity

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


@pytest.mark.parametrize(
    ("name", "alpha"), [("planar2", 0.1), ("planar2", 0.2), ("planar3", 0.1), ("planar2", 0.0), ("planar3", 0.0)]
)
def test_the_bubble_planner_is_the_papers(name, alpha):
    scenario = Scenario.load(name)
    setup = setup_scenario(scenario)
    planner, given = ("PaperSafeBubble", {"alpha": alpha}) if alpha else ("PaperBubble", {})
    result = setup.plan(planner, time=30.0, parameters={**given, "beta": 20.0})
    expected = BubblePlanner(setup, alpha).plan(*ends_of(scenario, setup))
    np.testing.assert_allclose(result.path, expected, atol=1e-9)
    assert (result.counts.field_configurations > 0) == (alpha > 0)
    for start, end in pairwise(result.path):  # consecutive configurations share a bubble
        reach = 0.0
        for q, motion in ((start, end - start), (end, start - end)):
            reach = max(reach, reach_along(motion, setup.checker.pair_radii_at(q), setup.checker.pair_distances(q)))
        assert reach > 1


def test_k_max_ends_the_search(planar3):
    given = {"alpha": 0.1, "beta": 2.0, "iterations": 4}
    result = planar3.plan("PaperSafeBubble", time=30.0, parameters=given)
    assert result.path is None
    assert result.counts.nodes == 4


def test_the_radii_of_the_papers_bubble_are_those_of_all_links():
    """Only an arm in space tells them from those of the pairs."""
    setup = setup_scenario(Scenario.load("panda_shelf"))
    checker, q = setup.checker, setup.query.start
    radii = checker.robot.bounds.displacement_radii_at(q).max(axis=0)
    expected = radii / (checker.pair_distances(q).min() - DISTANCE_ERROR)
    np.testing.assert_allclose(Bubble.around(q, checker, printed=True).weights, expected)
    assert (radii > checker.pair_radii_at(q).max(axis=0)).any()
