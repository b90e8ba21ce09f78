"""Pairs that a kernel finds near each other, against boxes and placements of Pinocchio's own."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.lib.stride_tricks import as_strided

from safe_ompl.collision import broad_phase
from safe_ompl.collision.broad_phase import BroadPhase

BODIES = 6


@pytest.fixture
def geometry():
    model = pin.GeometryModel()
    rng = np.random.default_rng(0)
    for k in range(BODIES):
        shape = coal.Box(*rng.uniform(0.1, 0.4, 3))
        model.addGeometryObject(pin.GeometryObject(f"box_{k}", 0, pin.SE3.Identity(), shape))
    return model


PAIRS = np.array([(i, j) for i in range(BODIES) for j in range(i)])


def test_another_layout_of_places_is_noticed(geometry, monkeypatch):
    monkeypatch.setattr(broad_phase, "as_strided", lambda first, shape, _: as_strided(first, shape, (96, 0)))
    with pytest.raises(RuntimeError, match="another layout"):
        BroadPhase(geometry, geometry.createData(), PAIRS)


def test_looking_at_the_layout_changes_no_place(geometry):
    data = geometry.createData()
    data.oMg[BODIES - 1] = place = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.4, 0.5, 0.6]))
    BroadPhase(geometry, data, PAIRS)
    assert data.oMg[BODIES - 1] == place
