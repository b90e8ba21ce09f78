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


def distances(geometry, data):
    found = []
    for i, j in PAIRS:
        bodies = geometry.geometryObjects[int(i)], geometry.geometryObjects[int(j)]
        places = [coal.Transform3s(data.oMg[int(k)].rotation, data.oMg[int(k)].translation) for k in (i, j)]
        answer = coal.DistanceResult()
        coal.distance(
            bodies[0].geometry, places[0], bodies[1].geometry, places[1], coal.DistanceRequest(), answer
        )
        found.append(answer.min_distance)
    return np.array(found)


@pytest.mark.parametrize("seed", range(20))
def test_no_near_pair_is_missed(geometry, seed):
    data = geometry.createData()
    near = BroadPhase(geometry, data, PAIRS)
    near.margins[:] = 0.05
    pin.seed(seed)
    for k in range(BODIES):
        place = pin.SE3.Random()
        data.oMg[k] = pin.SE3(place.rotation, 0.5 * place.translation)
    found = near.found()
    assert set(np.flatnonzero(distances(geometry, data) <= 0.05)) <= set(found)
    assert len(found) < len(PAIRS)


def test_another_layout_of_places_is_noticed(geometry, monkeypatch):
    monkeypatch.setattr(broad_phase, "as_strided", lambda first, shape, _: as_strided(first, shape, (96, 0)))
    with pytest.raises(RuntimeError, match="another layout"):
        BroadPhase(geometry, geometry.createData(), PAIRS)


def test_looking_at_the_layout_changes_no_place(geometry):
    data = geometry.createData()
    data.oMg[BODIES - 1] = place = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.4, 0.5, 0.6]))
    BroadPhase(geometry, data, PAIRS)
    assert data.oMg[BODIES - 1] == place
