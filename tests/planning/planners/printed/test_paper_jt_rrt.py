"""SAFE_JT-RRT as printed, against a literal transcription: the same seed, the same path."""

import numpy as np
import pytest

from safe_ompl import Scenario
from safe_ompl.danger.link_field import vectors
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import ScratchState, StateBridge
from safe_ompl.scene import find_scenario

RANGE, STEP, D_THRESHOLD = 0.5, 0.1, 0.01
PARAMETERS = {"range": RANGE, "step": STEP, "goal_bias": 0.3}


@pytest.fixture(scope="module")
def arm():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


class Transcription:
    """SAFE_JT-RRT, EXTEND_TOWARDS_GOAL and EXTEND_RANDOMLY of the paper (§4.3), line by line, as they are read."""

    def __init__(self, setup, seed, *, alpha, k1, k2, p_g, cdf_threshold=np.inf, transpose=False):
        self.robot, self.field, self.alpha = setup.robot, setup.field, alpha
        self.k1, self.k2, self.p_g = k1, k2, p_g
        self.cdf_threshold, self.transpose = cdf_threshold, transpose
        self.si = setup.getSpaceInformation()
        bridge = StateBridge(self.si.getStateSpace())
        self.states = ScratchState(bridge), ScratchState(bridge)
        self.rng = np.random.default_rng(seed)

    def plan(self, q_s, x_g):
        self.x_g = x_g
        self.Q, self.parents, self.chosen = [q_s], [None], set()
        while min(map(self.ws_distance, self.Q)) >= D_THRESHOLD:
            if self.rng.random() < self.p_g:
                self.extend_towards_goal()
            else:
                self.extend_randomly()
        node, rows = len(self.Q) - 1, []
        while node is not None:
            rows.append(self.Q[node])
            node = self.parents[node]
        return np.array(rows[::-1])

    def ws_distance(self, q):
        return np.linalg.norm(self.x_g - self.robot.tip_pose(q).translation)

    def cdf(self, q):
        return self.field.value(q) if self.alpha or np.isfinite(self.cdf_threshold) else 0.0

    def extend_towards_goal(self):
        left = [k for k in range(len(self.Q)) if k not in self.chosen]
        if not left:
            return self.extend_randomly()
        old = min(left, key=lambda k: self.ws_distance(self.Q[k]) + self.alpha * self.cdf(self.Q[k]))
        while True:
            self.chosen.add(old)
            q_old = self.Q[old]
            q_new = np.clip(q_old + self.displacement(q_old), self.robot.lower, self.robot.upper)
            if self.ws_distance(q_new) > 0.995 * self.ws_distance(q_old):
                return None  # no progress
            if not (self.is_free(q_old, q_new) and self.cdf(q_new) < self.cdf_threshold):
                return None
            self.add(q_new, old)
            if self.ws_distance(q_new) < D_THRESHOLD:
                return None
            old = len(self.Q) - 1

    def displacement(self, q):
        J, dx = self.robot.tip_jacobian(q)[:3], self.x_g - self.robot.tip_pose(q).translation
        if self.transpose:
            dq = self.k2 * J.T @ dx
        else:
            dq0 = np.zeros(self.robot.n)
            found = vectors(self.robot.keypoints(q)[None], self.robot.segments, self.field.points)[0]
            jacobians = self.robot.keypoint_jacobians(q)
            for vector in found:
                for _, end in self.robot.segments:
                    dq0 += self.k1 * jacobians[end].T @ vector
            inverse = np.linalg.pinv(J)
            dq = self.k2 * (inverse @ dx + (np.eye(self.robot.n) - inverse @ J) @ dq0)
        return dq * min(1.0, STEP / np.linalg.norm(dq))

    def extend_randomly(self):
        q_rand = self.robot.lower + (self.robot.upper - self.robot.lower) * self.rng.random(self.robot.n)
        scores = [np.linalg.norm(q - q_rand) + self.alpha * self.cdf(q) for q in self.Q]
        old = int(np.argmin(scores))
        way = q_rand - self.Q[old]
        q_new = self.Q[old] + way * min(1.0, RANGE / np.linalg.norm(way))
        if self.is_free(self.Q[old], q_new):
            self.add(q_new, old)

    def add(self, q, parent):
        self.Q.append(q)
        self.parents.append(parent)

    def is_free(self, start, end):
        one, other = self.states
        return self.si.checkMotion(one.set(start), other.set(end))


def problem(arm):
    scenario = Scenario.load(find_scenario("planar3"))
    return scenario.start_configuration(arm.robot), np.array(scenario.goal.position)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("alpha", [0.1, 0.5])
def test_safe_jt_rrt_is_the_papers(arm, seed, alpha):
    given = {**PARAMETERS, "alpha": alpha, "null_space_gain": 0.002, "gain": 0.2}
    result = arm.plan("PaperSafeJTRRT", time=20.0, seed=seed, parameters=given)
    literal = Transcription(arm, seed, alpha=alpha, k1=0.002, k2=0.2, p_g=0.3)
    np.testing.assert_allclose(result.path, literal.plan(*problem(arm)), atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_cdf_threshold_is_the_papers(arm, seed):
    q_s, x_g = problem(arm)
    threshold = 1.5 * arm.field.value(q_s)
    given = {**PARAMETERS, "alpha": 0.1, "null_space_gain": 0.002, "gain": 0.2, "danger_threshold": threshold}
    result = arm.plan("PaperSafeJTRRT", time=20.0, seed=seed, parameters=given)
    literal = Transcription(arm, seed, alpha=0.1, k1=0.002, k2=0.2, p_g=0.3, cdf_threshold=threshold)
    np.testing.assert_allclose(result.path, literal.plan(q_s, x_g), atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_jt_rrt_is_vande_weghes(arm, seed):
    result = arm.plan("PaperJTRRT", time=20.0, seed=seed, parameters={**PARAMETERS, "gain": 0.3})
    literal = Transcription(arm, seed, alpha=0.0, k1=0.0, k2=0.3, p_g=0.3, transpose=True)
    np.testing.assert_allclose(result.path, literal.plan(*problem(arm)), atol=1e-9)
    assert result.counts.field_configurations == 0


def test_the_null_space_motion_makes_a_difference(arm):
    paths = [
        arm.plan(
            "PaperSafeJTRRT",
            time=20.0,
            seed=1,
            parameters={**PARAMETERS, "alpha": 0.1, "gain": 0.2, "null_space_gain": k1},
        ).path
        for k1 in (0.0, 0.01)
    ]
    assert paths[0].shape != paths[1].shape or not np.allclose(*paths)
