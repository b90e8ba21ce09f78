"""Reports on paths: validity, plain numbers, and when danger and clearance are computed."""

import json
import pickle

import numpy as np
import pytest
from crank import Field, balls, distance, report

from safe_ompl import CertifiedMotion, CollisionChecker, InputError, PathReport, Scene, Verdict
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
    assert PathReport.of(path, checker, motion=CertifiedMotion(checker, 1e-5)).certified
    assert not PathReport.of(path, checker, motion=CertifiedMotion(checker, 0.05)).certified


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
    assert set(found) == {
        *("length", "danger", "clearance", "certified"),
        *("validation", "links_without_collision"),
    }
    assert found["validation"] == {"proven": True, "claims": ["collision"], "checks": []}
    assert set(found["danger"]) == {"mean", "max", "max_bound", "integral", "avoidable", "profile"}
    assert set(found["clearance"]) == {
        "min",
        "mean",
        "length_below_50mm",
        "link",
        "obstacle",
        "at",
        "obstacles",
    }
    assert report(crank, [[-1], [1]]).as_dict()["danger"] is None


@pytest.mark.parametrize(
    "path", [np.zeros((0, 1)), np.zeros((2, 2)), np.zeros(2), [[0.0], [np.nan]], [["a"], ["b"]]]
)
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
