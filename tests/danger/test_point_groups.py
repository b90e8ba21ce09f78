"""Danger points in groups: every point is in one, inside the ball and below the charge that the group says."""

import numpy as np
import pytest

from safe_ompl.danger.evaluation import PointGroups


@pytest.mark.parametrize("number", [1, 64, 65, 1024, 1025, 5000])
@pytest.mark.parametrize("flat", [1.0, 0.0])
def test_groups_hold_their_points(rng, number, flat):
    points, charges = rng.normal(size=(number, 3)) * [1.0, flat, flat], rng.choice([1.0, 2.0], number)
    groups = PointGroups.of(points, charges)
    places, kept, balls = groups.columns[0, :, :number], groups.charges[0], groups.balls
    centres = groups.columns[0, :, number:]
    given = np.column_stack([points, charges])
    np.testing.assert_array_equal(np.sort(np.column_stack([places.T, kept]), axis=0), np.sort(given, axis=0))
    seen = []
    blocks = balls["begin"][0]
    for block in range(blocks):
        held = balls[balls["begin"][block] : balls["end"][block]]
        begin, end = held["begin"][0], held["end"][-1]
        assert balls["number"][block] == held["number"].sum() == end - begin
        for group in range(balls["begin"][block], balls["end"][block]):
            first, last = balls["begin"][group], balls["end"][group]
            seen += range(first, last)
            for ball in (block, group):
                away = np.linalg.norm(places[:, first:last] - centres[:, [ball]], axis=0)
                assert (away <= balls["radius"][ball]).all()
                assert (kept[first:last] <= balls["heaviest"][ball]).all()
                assert (kept[first:last] >= balls["lightest"][ball]).all()
        for ball, (first, last) in ((block, (begin, end)), (balls["begin"][block], (begin, held["end"][0]))):
            np.testing.assert_allclose(
                np.average(places[:, first:last], axis=1, weights=kept[first:last]),
                centres[:, ball],
                atol=1e-12,
            )
            away = np.square(places[:, first:last] - centres[:, [ball]]).sum(axis=0)
            assert np.average(away, weights=kept[first:last]) == pytest.approx(balls["spread"][ball])
            assert balls["charge"][ball] == pytest.approx(kept[first:last].mean())
    assert seen == list(range(number))


def test_groups_are_compact(rng):
    """A hundred groups of points in a cube are about as wide as a hundredth of the cube."""
    groups = PointGroups.of(rng.uniform(size=(6400, 3)), np.ones(6400))
    assert np.median(groups.balls["radius"][groups.balls["begin"][0] :]) < 0.25
