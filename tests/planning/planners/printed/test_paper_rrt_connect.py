"""The planners as printed, against literal transcriptions of the pseudocode: the same seed, the same path."""

import numpy as np
import pytest
from plane import EXACT, GOAL, START, TIMEOUT, HotSpot, PlaneProblem, wall_with_a_gap

from safe_ompl import make_planner
from safe_ompl.planning.ompl import StateCost

RANGE = 0.25


class Transcription:
    """SAFE_RRT-CONNECT of the paper (§4.4) line by line; EXTEND and CONNECT are those of Kuffner and LaValle (2000)."""

    def __init__(self, task, alpha, seed):
        self.si, self.state = task.si, task.state
        self.cdf, self.alpha = HotSpot(task.si), alpha
        self.rng = np.random.default_rng(seed)

    def rrt_connect(self, q_s, q_g):
        Q1, Q2 = [(np.array(q_s), None)], [(np.array(q_g), None)]
        from_start = True
        while True:
            q_rand = self.random_config()
            old = self.argmin(Q1, q_rand)
            outcome, new = self.extend(Q1, old, q_rand, from_start)
            if outcome != "Trapped":
                q_new = Q1[new][0]
                old_bar = self.argmin(Q2, q_new)
                outcome, met = self.connect(Q2, old_bar, q_new, not from_start)
                if outcome == "Reached":
                    branches = self.branch(Q1, new), self.branch(Q2, met)
                    first, second = branches if from_start else branches[::-1]
                    return np.array([*first, *second[-2::-1]])
            Q1, Q2, from_start = Q2, Q1, not from_start

    def random_config(self):
        return -1.0 + 2.0 * self.rng.random(2)

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

    def branch(self, Q, node):
        rows = []
        while node is not None:
            rows.append(Q[node][0])
            node = Q[node][1]
        return rows[::-1]


def task_of(name, seed, forbidden=wall_with_a_gap, **parameters):
    return PlaneProblem(
        lambda si: make_planner(name, si, {"range": RANGE, **parameters}), forbidden, HotSpot, seed=seed
    )


def goal_in_a_pocket(x, y):
    """Forbid a thick wall around the goal, but for an opening that looks away from the start."""
    across = max(abs(x - GOAL[0]), abs(y - GOAL[1]))
    return 0.06 < across < 0.15 and (x < GOAL[0] or abs(y) > 0.03)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("alpha", [0.0, 0.5, 3.0])
def test_safe_rrt_connect_is_the_papers(seed, alpha):
    task = task_of("PaperSafeRRTConnect", seed, alpha=alpha)
    assert task.solve() == EXACT
    expected = Transcription(task, alpha, seed).rrt_connect(START, GOAL)
    np.testing.assert_allclose(task.path, expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_rrt_connect_is_kuffners(seed):
    task = task_of("PaperRRTConnect", seed)
    assert task.solve() == EXACT
    np.testing.assert_allclose(task.path, Transcription(task, 0.0, seed).rrt_connect(START, GOAL), atol=1e-12)


@pytest.mark.parametrize("seed", [10, 11])
def test_trees_take_turns_also_where_one_hardly_grows(seed):
    task = task_of("PaperRRTConnect", seed, goal_in_a_pocket)
    assert task.solve() == EXACT
    assert len(task.planner.plannerGraph().configurations) > 200
    np.testing.assert_allclose(task.path, Transcription(task, 0.0, seed).rrt_connect(START, GOAL), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_k_iterations_and_no_more(seed):
    literal, rounds = Transcription(task_of("PaperRRTConnect", seed), 0.0, seed), []
    draw = literal.random_config
    literal.random_config = lambda: rounds.append(1) or draw()
    literal.rrt_connect(START, GOAL)
    assert task_of("PaperRRTConnect", seed, iterations=len(rounds)).solve() == EXACT
    assert task_of("PaperRRTConnect", seed, iterations=len(rounds) - 1).solve() == TIMEOUT


def test_alpha_makes_a_difference():
    plain, safe = (task_of("PaperSafeRRTConnect", 1, alpha=alpha) for alpha in (0.0, 3.0))
    assert plain.solve() == safe.solve() == EXACT
    assert plain.path.shape != safe.path.shape or (plain.path != safe.path).any()


def test_the_scale_of_danger_is_not_measured(monkeypatch):
    def measured(self, si):
        raise AssertionError("α is taken as it is")

    monkeypatch.setattr(StateCost, "slope", measured)
    task = task_of("PaperSafeRRTConnect", 0, alpha=2.0)
    assert task.solve() == EXACT
    assert task.planner.getAlpha() == 2.0
