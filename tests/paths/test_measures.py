"""Danger and clearance along paths, against values computed by hand."""

from itertools import pairwise

import numpy as np
import pytest
from crank import balls, distance, report

from safe_ompl import CollisionChecker, DangerField, PathReport, Scene
from safe_ompl.paths import PROFILE_POINTS

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
