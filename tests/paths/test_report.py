"""Reports on paths: validity, plain numbers, and when danger and clearance are computed."""

import json
import pickle
from itertools import pairwise

import numpy as np
import pytest
from crank import Field, balls, distance, report

from safe_ompl import CollisionChecker, DangerField, InputError, MotionProver, PathReport, Scene, Verdict
from safe_ompl.paths import PROFILE_POINTS

# ----------------------------------------------------------------------------------------------------------- validity


def test_a_free_path_is_certified(crank):
    found = report(crank, [[-1], [0], [1]], balls(0.7))
    assert found.certified
    assert found.refused is None


def test_a_path_through_an_obstacle_is_refused_with_edge_and_pair(crank):
    found = report(crank, [[-1], [-0.5], [0.5], [1]], balls(0.55))
    assert not found.certified
    edge, verdict = found.refused
    assert edge == 1
    assert verdict.verdict is Verdict.BLOCKED
    assert verdict.at == pytest.approx(0.5, abs=0.25)
    assert verdict.pair == ("ball", "ball0")
    assert found.clearance.min == pytest.approx(-0.05, abs=1e-4)


def test_a_path_outside_the_limits_is_refused_with_the_joint(crank):
    found = report(crank, [[0], [2.9], [3.1]])
    assert not found.certified
    assert found.refused[0] == 1
    assert found.refused[1].pair == ("turn", "its limits")


def test_the_validator_can_be_chosen(crank):
    scene = balls(0.4 - 2e-4)  # passes at 0.2 mm, inside the crank's reach
    checker = CollisionChecker(crank, scene)
    path = np.array([[-1.01], [1.0]])
    assert PathReport.of(path, checker, motion=MotionProver(checker, 1e-5)).certified
    assert not PathReport.of(path, checker, motion=MotionProver(checker, 0.05)).certified


def test_a_path_of_one_way_point(crank):
    found = report(crank, [[0.3]], balls(0.9), np.square)
    assert found.certified
    assert found.length == 0
    assert found.danger.mean == found.danger.max == pytest.approx(0.09)
    assert (found.danger.integral, found.danger.avoidable) == (0, 0)
    assert found.clearance.min == found.clearance.mean == pytest.approx(distance(0.3, 0.9), abs=1e-6)
    assert not report(crank, [[0.0]], balls(0.55)).certified


def test_repeated_way_points(crank):
    once = report(crank, [[0], [1], [2]], balls(0.9), np.square)
    twice = report(crank, [[0], [0], [1], [1], [2], [2]], balls(0.9), np.square)
    assert twice.certified
    assert twice.length == once.length
    assert twice.danger.integral == pytest.approx(once.danger.integral)
    assert twice.clearance == once.clearance


def test_continuous_joints_are_followed_the_short_way(kinova):
    rest = [2.9, 1.3, 3.0, 1.8, -3.0]
    found = report(kinova, [[3.0, *rest], [-3.0, *rest]])
    assert found.length == pytest.approx(2 * np.pi - 6)


def test_as_plain_numbers(crank):
    found = report(crank, [[-1], [1]], balls(0.9), np.square).as_dict()
    assert json.loads(json.dumps(found)) == found
    assert set(found) == {*("length", "danger", "clearance", "certified"), *("validation", "links_without_collision")}
    assert found["validation"] == {"proven": True, "claims": ["collision"], "checks": []}
    assert set(found["danger"]) == {"mean", "max", "max_bound", "integral", "avoidable", "profile"}
    assert set(found["clearance"]) == {"min", "mean", "length_below_50mm", "link", "obstacle", "at", "obstacles"}
    assert report(crank, [[-1], [1]]).as_dict()["danger"] is None


@pytest.mark.parametrize("path", [np.zeros((0, 1)), np.zeros((2, 2)), np.zeros(2), [[0.0], [np.nan]], [["a"], ["b"]]])
def test_what_is_no_path(crank, path):
    with pytest.raises(InputError, match="path"):
        PathReport.of(path, CollisionChecker(crank, Scene()))


# ------------------------------------------------------------------------------------------------- when it is computed


def test_danger_and_clearance_wait_until_they_are_looked_at(crank):
    checker = CollisionChecker(crank, balls(0.9))
    found = PathReport.of(np.array([[-1.0], [1.0]]), checker, Field(np.square))
    assert found.certified
    assert checker.counts.distance_queries == 0
    assert found.time == 0
    least = found.clearance
    asked = checker.counts.distance_queries
    assert asked >= PROFILE_POINTS
    assert found.clearance is least
    assert checker.counts.distance_queries == asked, "computed once"
    assert found.time > 0


def test_what_is_computed_later_is_the_same(crank):
    checker = CollisionChecker(crank, balls(0.9))
    path = np.array([[-1.0], [1.0]])
    early, late = (PathReport.of(path, checker, Field(np.square)) for _ in range(2))
    before = early.as_dict()
    assert late.as_dict() == before


def test_a_report_in_another_process(crank):
    found = report(crank, [[-1], [1]], balls(0.55), np.square)
    restored = pickle.loads(pickle.dumps(found))
    assert restored.as_dict() == found.as_dict()
    assert restored.refused == found.refused
    assert restored.time == found.time > 0


def test_the_clearance_of_every_obstacle(crank):
    found = report(crank, [[-1], [1]], balls(0.9, 0.7, 2.0)).clearance
    assert found.obstacle == "ball1"
    assert found.obstacles == {
        "ball0": pytest.approx(0.3, abs=1e-3),
        "ball1": found.min,
        "ball2": pytest.approx(1.4, abs=1e-3),
    }


def test_in_one_line(crank):
    assert repr(report(crank, [[-1], [1]])) == "PathReport(2 rad, certified: collision)"
    text = repr(report(crank, [[-1], [1]], balls(0.55)))
    assert text.startswith("PathReport(2 rad, not proven free; edge 0 is blocked at 0.5")
    assert text.endswith("'ball' and 'ball0')")


# ------------------------------------------------ danger and clearance along paths, against values computed by hand


# ------------------------------------------------------------------------------------------------------------ danger


def test_danger_between_dangerous_ends(crank):
    found = report(crank, [[-1], [1]], function=np.square)
    assert found.length == pytest.approx(2)
    assert found.danger.max == pytest.approx(1)
    assert found.danger.integral == pytest.approx(2 / 3, abs=1e-3)
    assert found.danger.mean == pytest.approx(1 / 3, abs=1e-3)
    assert found.danger.avoidable == 0, "nothing on the way is worse than the ends"


def test_danger_on_the_way_is_avoidable(crank):
    found = report(crank, [[-1], [0.5], [1]], function=lambda q: 1.5 - q**2)
    assert found.danger.integral == pytest.approx(3 - 2 / 3, abs=1e-3)
    assert found.danger.avoidable == pytest.approx(2 - 2 / 3, abs=1e-3)
    assert found.danger.max == pytest.approx(1.5)


def test_only_what_exceeds_the_worse_end_is_avoidable(crank):
    found = report(crank, [[0], [2]], function=lambda q: 1 - np.abs(q - 1))  # ends: 0 and 0
    assert found.danger.avoidable == pytest.approx(1, abs=1e-3)
    found = report(crank, [[0.5], [2]], function=lambda q: 1 - np.abs(q - 1))  # ends: 0.5 and 0
    assert found.danger.avoidable == pytest.approx(0.25, abs=1e-3)


def test_a_rise_between_two_safer_places_is_avoidable_though_the_ends_are_worse(crank):
    def function(q):  # 6.85 at −2 and 2, 4 at −1, 3.5 at 1, and 6.5 between
        return np.interp(q, [-2, -1, 0, 1, 2], [6.85, 4.0, 6.5, 3.5, 6.85])

    found = report(crank, [[-2], [2]], function=function)
    top = 6.5 - 4.0  # a triangle above 4, the larger of the two minima beside it
    assert found.danger.avoidable == pytest.approx(top * (1 + top / 3) / 2, abs=5e-3)
    assert found.danger.max == pytest.approx(6.85)


def test_danger_that_falls_and_rises_once_is_not_avoidable(crank):
    for ends in ([-2, 1], [-1, 2], [0, 2], [-2, 0]):
        found = report(crank, [[end] for end in ends], function=lambda q: 1 + q**2)
        assert found.danger.avoidable == pytest.approx(0, abs=1e-12)


def test_the_profile_runs_over_the_natural_parameter(crank):
    found = report(crank, [[0], [2], [1]], function=lambda q: q)  # 3 rad: up to 2, back to 1
    assert found.danger.profile.shape == (PROFILE_POINTS,)
    s = np.linspace(0, 3, PROFILE_POINTS)
    np.testing.assert_allclose(found.danger.profile, np.where(s < 2, s, 4 - s), atol=0.02)
    assert found.danger.mean == pytest.approx((2 + 1.5) / 3, abs=1e-3)


def test_the_danger_field_itself(ur5, rng):
    points = rng.uniform(-1, 1, (5, 3))
    field = DangerField(ur5, points)
    path = np.array([np.full(6, -0.3), np.full(6, 0.4)])
    found = PathReport.of(path, CollisionChecker(ur5, Scene()), field)
    assert found.danger.profile[0] == pytest.approx(field.value(path[0]))
    assert found.danger.profile[-1] == pytest.approx(field.value(path[1]))
    assert found.danger.max >= found.danger.profile.max()


def test_the_peak_is_proven(ur5, rng):
    field = DangerField(ur5, rng.uniform(-1, 1, (5, 3)))
    path = np.array([np.full(6, -0.3), np.full(6, 0.4), np.full(6, 0.9)])
    danger = PathReport.of(path, CollisionChecker(ur5, Scene()), field).danger
    steps = np.linspace(0, 1, 500)[:, None]
    dense = field.values(np.concatenate([a + steps * (b - a) for a, b in pairwise(path)]))
    assert danger.max <= dense.max() * (1 + 1e-3)
    assert dense.max() <= danger.max_bound <= 1.06 * dense.max()


def test_where_no_peak_is_proven(crank, ur5):
    assert report(crank, [[0], [1]], function=np.square).danger.max_bound is None, "moving danger points"
    field = DangerField(ur5, [[2.0, 0.0, 0.0]])
    outside = PathReport.of([np.zeros(6), np.full(6, 3.5)], CollisionChecker(ur5, Scene()), field)
    assert outside.danger.max_bound is None


def test_without_a_field_there_is_no_danger(crank):
    assert report(crank, [[0], [1]]).danger is None


# --------------------------------------------------------------------------------------------------------- clearance


def test_clearance_has_a_witness(crank):
    found = report(crank, [[-1.0], [0.31]], balls(0.9, 2.0))
    assert found.clearance.min == pytest.approx(0.3, abs=1e-5)
    assert (found.clearance.link, found.clearance.obstacle) == ("ball", "ball0")
    assert found.clearance.at == pytest.approx(1 / 1.31, abs=1e-2)
    assert found.clearance.length_below_50mm == 0
    q = np.linspace(-1, 0.31, 2000)
    assert found.clearance.mean == pytest.approx(distance(q, 0.9).mean(), abs=1e-3)


def test_the_least_clearance_is_found_between_the_samples(crank):
    q = np.linspace(-2.9, 2.83, 200_001)
    nearest = report(crank, [[-2.9], [2.83]], balls(0.601)).clearance
    assert nearest.min == pytest.approx(distance(q, 0.601).min(), abs=1e-6)
    assert nearest.at == pytest.approx(2.9 / 5.73, abs=1e-3)


def test_length_of_path_near_an_obstacle(crank):
    reach = np.arccos((0.25 + 0.61**2 - 0.15**2) / 0.61)  # distance 50 mm
    found = report(crank, [[-1], [1]], balls(0.61))
    assert found.clearance.length_below_50mm == pytest.approx(2 * reach, abs=0.03)


def test_nothing_to_keep_clear_of(crank):
    clearance = report(crank, [[0], [1]]).clearance
    assert (clearance.min, clearance.mean) == (np.inf, np.inf)
    assert (clearance.link, clearance.obstacle, clearance.at) == (None, None, 0.0)
