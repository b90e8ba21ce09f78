"""Danger points in groups: every point is in one, inside the ball and below the charge that the group says."""

import numpy as np
import pytest

from safe_ompl.danger import point_groups
from safe_ompl.danger.point_groups import PointGroups


@pytest.mark.parametrize("number", [1, 64, 65, 1024, 1025, 5000])
@pytest.mark.parametrize("flat", [1.0, 0.0])
def test_groups_hold_their_points(rng, number, flat):
    points, charges = rng.normal(size=(number, 3)) * [1.0, flat, flat], rng.choice([1.0, 2.0], number)
    groups = PointGroups.of(points, charges)
    given = np.column_stack([points, charges])
    kept = np.column_stack([groups.points.T, groups.charges])
    np.testing.assert_array_equal(np.sort(kept, axis=0), np.sort(given, axis=0))
    seen = []
    for block, (first, last) in enumerate(groups.spans[: groups.blocks]):
        for group in range(first, last):
            begin, end = groups.spans[group]
            seen += range(begin, end)
            for ball in (block, group):
                offsets = groups.points[:, begin:end] - groups.centres[:, [ball]]
                assert (np.linalg.norm(offsets, axis=0) <= groups.radii[ball]).all()
                assert (groups.charges[begin:end] <= groups.tops[ball]).all()
    assert seen == list(range(number))


def test_the_curve_goes_from_cell_to_cell_beside_it(monkeypatch):
    monkeypatch.setattr(point_groups, "_LEVELS", 3)
    cells = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), axis=-1).reshape(-1, 3)
    order = np.argsort(point_groups._places_on_curve(cells))
    assert (np.abs(np.diff(cells[order], axis=0)).sum(axis=1) == 1).all()


def test_groups_are_compact(rng):
    """A hundred groups of points in a cube are about as wide as a hundredth of the cube."""
    groups = PointGroups.of(rng.uniform(size=(6400, 3)), np.ones(6400))
    assert np.median(groups.radii[groups.blocks :]) < 0.25
