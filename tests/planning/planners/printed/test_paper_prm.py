"""SAFE_PRM_PLANNER as printed, against a literal transcription: the same seed, the same path."""

import numpy as np
import pytest

from safe_ompl import Scenario, make_planner
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import ScratchState, StateBridge
from safe_ompl.planning.planners.parts.roadmap import LocalPlanner
from safe_ompl.scene import find_scenario

N, K = 120, 8


@pytest.fixture(scope="module")
def arm():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


class Transcription:
    """The procedure SAFE_PRM_PLANNER of the paper (§4.2), line by line."""

    def __init__(self, setup, alpha, seed):
        self.robot, self.field, self.alpha = setup.robot, setup.field, alpha
        self.si = setup.getSpaceInformation()
        bridge = StateBridge(self.si.getStateSpace())
        self.states = ScratchState(bridge), ScratchState(bridge)
        self.rng = np.random.default_rng(seed)
        self.checks = 0

    def plan(self, q_s, q_g):
        self.samples = np.vstack([self.random_set(), q_s, q_g])
        self.ends = self.robot.keypoints_batch(self.samples)[:, self.robot.segments[:, 1]]
        Closed1, Closed2 = {}, {}
        Open1, Open2 = [(N, 0.0, None)], [(N + 1, 0.0, None)]
        from_start, q_current_goal = True, N + 1
        while Open1 and Open2:
            best = np.argmin([self.f(x, g, q_current_goal) for x, g, _ in Open1])
            q_new, g_new, parent = Open1[best]
            Open1 = [offer for offer in Open1 if offer[0] != q_new]
            Closed1[q_new] = parent
            if q_new in Closed2:  # CONNECTED
                first, second = (Closed1, Closed2) if from_start else (Closed2, Closed1)
                there, back = self.branch(first, q_new), self.branch(second, q_new)
                return self.samples[[*there, *back[-2::-1]]]
            for x in self.neighbors(q_new, Closed1, from_start):
                Open1.append((x, g_new + np.abs(self.samples[x] - self.samples[q_new]).sum(), q_new))
            Closed1, Closed2, Open1, Open2 = Closed2, Closed1, Open2, Open1
            from_start, q_current_goal = not from_start, q_new
        return None

    def random_set(self):
        lower, upper = self.robot.lower, self.robot.upper
        return lower + (upper - lower) * self.rng.random((N, self.robot.n))

    def f(self, x, g, goal):
        q = self.samples[x]
        danger = self.alpha * self.field.value(q) if self.alpha else 0.0
        return g + np.abs(q - self.samples[goal]).sum() + danger

    def neighbors(self, q_new, closed, from_start):
        rest = [x for x in range(len(self.samples)) if x not in closed]
        D = {x: ((self.ends[x] - self.ends[q_new]) ** 2).sum() for x in rest}  # eq. (11)
        nearest = sorted(rest, key=D.get)[:K]
        return [x for x in nearest if self.is_free(*((q_new, x) if from_start else (x, q_new)))]

    def is_free(self, start, end):
        self.checks += 1
        one, other = self.states
        return self.si.checkMotion(one.set(self.samples[start]), other.set(self.samples[end]))

    def branch(self, closed, x):
        rows = []
        while x is not None:
            rows.append(x)
            x = closed[x]
        return rows[::-1]


def planned(arm, name, seed, **parameters):
    return arm.plan(name, time=20.0, seed=seed, parameters={"samples": N, "neighbors": K, **parameters})


def ends_of(arm):
    scenario = Scenario.load(find_scenario("planar3"))
    return scenario.start_configuration(arm.robot), scenario.goal_configurations(arm.robot)[0]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("alpha", [0.1, 1.0])
def test_safe_prm_is_the_papers(arm, seed, alpha):
    literal = Transcription(arm, alpha, seed)
    expected, result = literal.plan(*ends_of(arm)), planned(arm, "PaperSafePRM", seed, alpha=alpha)
    assert expected is not None
    np.testing.assert_allclose(result.path, expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
def test_prm_is_the_papers_without_danger(arm, seed):
    result = planned(arm, "PaperPRM", seed)
    np.testing.assert_allclose(result.path, Transcription(arm, 0.0, seed).plan(*ends_of(arm)), atol=1e-12)
    assert result.counts.field_configurations == 0


def test_as_many_edges_are_checked_as_in_the_paper(arm, monkeypatch):
    planner, asked = make_planner("PaperPRM", arm.getSpaceInformation(), {"samples": N, "neighbors": K}), []
    check = LocalPlanner.check
    monkeypatch.setattr(LocalPlanner, "check", lambda self, *edge: asked.append(edge) or check(self, *edge))
    assert arm.plan(planner, time=20.0, seed=3)
    literal = Transcription(arm, 0.0, 3)
    literal.plan(*ends_of(arm))
    assert len(asked) == literal.checks


def test_too_few_samples_end_in_failure(arm):
    result = planned(arm, "PaperPRM", 0, samples=1, neighbors=1)
    assert result.path is None
    assert planned(arm, "ClassicPRM", 0, samples=1, neighbors=1)
