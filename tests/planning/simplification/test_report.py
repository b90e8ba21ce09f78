"""Reports on paths: validity, plain numbers, when danger and clearance are computed, and these against closed forms."""

import json
import pickle
from itertools import pairwise

import numpy as np
import pytest
from crank import balls, distance, report

from safe_ompl import CollisionChecker, DangerField, InputError, MotionProver, PathReport, Scene, Verdict
from safe_ompl.planning.simplification import PROFILE_POINTS

# ----------------------------------------------------------------------------------------------------------- validity


def test_a_path_through_an_obstacle_is_refused_with_edge_and_pair(crank):
    found = report(crank, [[-1], [-0.5], [0.5], [1]], balls(0.55))
    assert not found.certified
    edge, verdict = found.refused
    assert (edge, verdict.verdict, verdict.pair) == (1, Verdict.BLOCKED, ("ball", "ball0"))
    assert verdict.at == pytest.approx(0.5, abs=0.25)
    assert found.clearance.min == pytest.approx(-0.05, abs=1e-4)
    text = repr(found)
    assert text.startswith("PathReport(2 rad, not proven free; edge 1 is blocked at ")
    assert text.endswith("'ball' and 'ball0')")
    free = report(crank, [[-1], [0], [1]], balls(0.7))
    assert (free.certified, free.refused) == (True, None)
    assert repr(free) == "PathReport(2 rad, certified: no collision)"


def test_a_path_outside_the_limits_is_refused_with_the_joint(crank):
    edge, verdict = report(crank, [[0], [2.9], [3.1]]).refused
    assert (edge, verdict.pair) == (1, ("turn", "its limits"))


def test_the_validator_can_be_chosen(crank):
    checker = CollisionChecker(crank, balls(0.4 - 2e-4))  # passes at 0.2 mm, inside the crank's reach
    for floor, certified in ((1e-5, True), (0.05, False)):
        found = PathReport.of([[-1.01], [1.0]], checker, motion=MotionProver(checker, floor))
        assert found.certified is certified


def test_way_points_alone_and_repeated(crank):
    found = report(crank, [[0.3]], balls(0.9), np.square)
    assert (found.certified, found.length) == (True, 0)
    assert found.danger.mean == found.danger.max == pytest.approx(0.09)
    assert (found.danger.integral, found.danger.avoidable) == (0, 0)
    assert found.clearance.min == found.clearance.mean == pytest.approx(distance(0.3, 0.9), abs=1e-6)
    assert not report(crank, [[0.0]], balls(0.55)).certified
    once, twice = (report(crank, [[q] for q in [0, 1, 2] for _ in range(k)], balls(0.9), np.square) for k in (1, 2))
    assert (twice.certified, twice.length, twice.clearance) == (True, once.length, once.clearance)
    assert twice.danger.integral == pytest.approx(once.danger.integral)


def test_continuous_joints_count_turns(kinova):
    rest = [2.9, 1.3, 3.0, 1.8, -3.0]
    assert report(kinova, [[3.0, *rest], [2 * np.pi - 3.0, *rest]]).length == pytest.approx(2 * np.pi - 6)
    with pytest.raises(InputError, match="path: joint 'j2s6s200_joint_1' turns by -6 rad after number 0"):
        report(kinova, [[3.0, *rest], [-3.0, *rest]])


def test_as_plain_numbers_here_and_in_another_process(crank):
    found = report(crank, [[-1], [1]], balls(0.9), np.square)
    told = found.as_dict()
    assert json.loads(json.dumps(told)) == told
    assert set(told) == {*("length", "danger", "clearance", "certified"), *("validation", "links_without_collision")}
    assert told["validation"] == {"proven": True, "claims": ["no collision"], "checks": []}
    assert set(told["danger"]) == {"mean", "max", "max_bound", "integral", "avoidable", "profile"}
    assert set(told["clearance"]) == {"min", "mean", "length_below_50mm", "link", "obstacle", "at", "obstacles"}
    restored = pickle.loads(pickle.dumps(found))
    assert restored.as_dict() == told
    assert (restored.refused, restored.time) == (found.refused, found.time)
    without = report(crank, [[-1], [1]])
    assert without.danger is without.as_dict()["danger"] is None


@pytest.mark.parametrize("path", [np.zeros((0, 1)), np.zeros((2, 2)), np.zeros(2), [[0.0], [np.nan]], [["a"], ["b"]]])
def test_what_is_no_path(crank, path):
    with pytest.raises(InputError, match="path"):
        PathReport.of(path, CollisionChecker(crank, Scene()))


# ------------------------------------------------------------------------------------------------------------ danger


def bumps(q):  # 6.85 at −2 and 2, 4 at −1, 3.5 at 1, and 6.5 between
    return np.interp(q, [-2, -1, 0, 1, 2], [6.85, 4.0, 6.5, 3.5, 6.85])


def tent(q):
    return 1 - np.abs(q - 1)


TOP = 6.5 - 4.0  # a triangle above 4, the larger of the two minima beside it


AVOIDABLE = [
    ([-1, 1], np.square, 0.0),  # nothing on the way is worse than the ends
    ([-1, 0.5, 1], lambda q: 1.5 - q**2, 2 - 2 / 3),
    ([0, 2], tent, 1.0),
    ([0.5, 2], tent, 0.25),  # only what exceeds the worse end, 0.5
    ([-2, 2], bumps, TOP * (1 + TOP / 3) / 2),
    *((ends, lambda q: 1 + q**2, 0.0) for ends in ([-2, 1], [-1, 2], [0, 2], [-2, 0])),  # it falls and rises once
]


@pytest.mark.parametrize(("path", "function", "avoidable"), AVOIDABLE)
def test_danger_between_less_dangerous_places_is_avoidable(crank, path, function, avoidable):
    found = report(crank, [[q] for q in path], function=function)
    q = np.linspace(min(path), max(path), 20_001)
    integral = np.trapezoid(function(q), q)
    assert found.length == pytest.approx(q[-1] - q[0])
    assert found.danger.max == pytest.approx(function(q).max(), rel=6e-3)
    assert found.danger.integral == pytest.approx(integral, abs=5e-3)
    assert found.danger.mean == pytest.approx(integral / found.length, abs=5e-3)
    assert found.danger.avoidable == pytest.approx(avoidable, abs=5e-3 if avoidable else 1e-12)


def test_the_profile_runs_over_the_natural_parameter(crank):
    found = report(crank, [[0], [2], [1]], function=lambda q: q)  # 3 rad: up to 2, back to 1
    s = np.linspace(0, 3, PROFILE_POINTS)
    np.testing.assert_allclose(found.danger.profile, np.where(s < 2, s, 4 - s), atol=0.02)
    assert found.danger.mean == pytest.approx((2 + 1.5) / 3, abs=1e-3)


def test_the_peak_is_proven_where_it_can_be(ur5, rng):
    field, checker = DangerField(ur5, rng.uniform(-1, 1, (5, 3))), CollisionChecker(ur5, Scene())
    path = np.array([np.full(6, -0.3), np.full(6, 0.4), np.full(6, 0.9)])
    danger = PathReport.of(path, checker, field).danger
    np.testing.assert_allclose(danger.profile[[0, -1]], field.values(path[[0, -1]]))
    steps = np.linspace(0, 1, 500)[:, None]
    dense = field.values(np.concatenate([a + steps * (b - a) for a, b in pairwise(path)]))
    assert danger.profile.max() <= danger.max <= dense.max() * (1 + 1e-3)
    assert dense.max() <= danger.max_bound <= 1.06 * dense.max()
    outside = PathReport.of([np.zeros(6), np.full(6, 3.5)], checker, DangerField(ur5, [[2.0, 0.0, 0.0]]))
    assert outside.danger.max_bound is None


# --------------------------------------------------------------------------------------------------------- clearance


def test_clearance_has_a_witness(crank):
    found = report(crank, [[-1.0], [0.31]], balls(0.9, 0.7, 2.0)).clearance
    assert (found.link, found.obstacle, found.length_below_50mm) == ("ball", "ball1", 0)
    assert found.min == pytest.approx(0.1, abs=1e-5)
    assert found.at == pytest.approx(1 / 1.31, abs=1e-2)
    assert found.mean == pytest.approx(distance(np.linspace(-1, 0.31, 2000), 0.7).mean(), abs=1e-3)
    expected = {"ball0": pytest.approx(0.3, abs=1e-3), "ball1": found.min, "ball2": pytest.approx(1.4, abs=1e-3)}
    assert found.obstacles == expected


def test_the_least_clearance_is_found_between_the_samples(crank):
    q = np.linspace(-2.9, 2.83, 200_001)
    nearest = report(crank, [[-2.9], [2.83]], balls(0.601)).clearance
    assert nearest.min == pytest.approx(distance(q, 0.601).min(), abs=1e-6)
    assert nearest.at == pytest.approx(2.9 / 5.73, abs=1e-3)


def test_length_of_path_near_an_obstacle_or_without_any(crank):
    reach = np.arccos((0.25 + 0.61**2 - 0.15**2) / 0.61)  # distance 50 mm
    found = report(crank, [[-1], [1]], balls(0.61))
    assert found.clearance.length_below_50mm == pytest.approx(2 * reach, abs=0.03)
    clearance = report(crank, [[0], [1]]).clearance
    assert (clearance.min, clearance.mean) == (np.inf, np.inf)
    assert (clearance.link, clearance.obstacle, clearance.at) == (None, None, 0.0)
