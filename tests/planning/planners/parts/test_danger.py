"""Danger in a planner's decisions: its decay, and the threshold that rises with the refusals."""

import numpy as np
import pytest

from safe_ompl.common import Counts
from safe_ompl.planning.planners.parts.problem import AdaptiveThreshold, DangerDecay, DangerWeight, FixedThreshold
from safe_ompl.planning.planners.parts.tree import Trees


@pytest.fixture
def danger(plane):
    return DangerWeight(plane)


def test_the_weight_is_relative_to_the_usual_slope(plane, danger):
    danger.alpha = 2.0
    assert danger.weight == 2.0 / plane.slope
    danger.scale = 0.5
    assert danger.weight == 1.0 / plane.slope
    danger.alpha = 0.0
    assert danger.weight == 0.0


def test_more_and_more_turns_ignore_danger(danger):
    decay, rng, scales = DangerDecay(danger), np.random.default_rng(1), []
    decay.half_life = 20
    for _ in range(200):
        decay.turn(rng)
        scales.append(danger.scale)
    assert set(scales) == {0.0, 1.0}
    assert np.mean(scales[:10]) > 0.8
    assert np.mean(scales[80:]) < 0.1
    decay.reset()
    assert danger.scale == 1.0


def test_danger_fades_to_half_and_to_next_to_nothing(danger):
    decay, scales = DangerDecay(danger), []
    decay.half_life = 20
    for _ in range(61):
        decay.fade()
        scales.append(danger.scale)
    assert scales[0] == 1.0
    assert scales[20] == pytest.approx(1 / 2)
    assert scales[60] == pytest.approx(1 / 82)


def test_without_half_life_it_never_decays(danger):
    decay = DangerDecay(danger)
    for _ in range(100):
        decay.fade()
    assert danger.scale == 1.0


def test_the_threshold_begins_with_the_danger_of_the_ends_and_rises_after_eight_refusals(plane, danger):
    threshold, trees = AdaptiveThreshold(danger), Trees(plane.bridge, plane.cost, Counts())
    trees.add_start(np.array([-0.8, 0.0]))
    trees.add_goal(np.array([0.5, 0.0]))
    forced = float(trees.goal.costs[0])
    assert threshold.tolerates(2 * forced, trees.start, 0, trees), "there is none"
    threshold.rise = 0.1
    assert threshold.tolerates(forced, trees.start, 0, trees)
    for _ in range(8):
        assert threshold.level == forced
        assert not threshold.tolerates(1.05 * forced, trees.start, 0, trees)
    assert threshold.level == pytest.approx(1.1 * forced)
    assert threshold.tolerates(1.05 * forced, trees.start, 0, trees)


def test_a_fixed_threshold_lets_a_motion_become_safer(plane):
    threshold = FixedThreshold(plane, lambda start, end: True)
    hot, warm, cold = np.array([0.1, 0.0]), np.array([0.3, 0.0]), np.array([0.9, 0.0])
    assert threshold.motion_is_free(cold, hot)
    threshold.level = float(plane.cost.values(warm[None])[0])
    assert not threshold.motion_is_free(cold, hot)
    assert threshold.motion_is_free(warm, cold)
    assert threshold.motion_is_free(hot, warm)
    assert not threshold.motion_is_free(warm, hot)
