"""Pairs of boxes that may be near each other: none that is nearer than its margin is left out, few others are in."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl.geometry.kernels import near_boxes

NUMBER = 60


def near(places, boxes, pairs, margins):
    """Return which of the pairs the kernel takes for near."""
    rows = np.array([[*place.rotation.T.ravel(), *place.translation] for place in places])
    found = np.empty(len(pairs), dtype=np.intp)
    number = near_boxes(rows, boxes, pairs, margins, found)
    return set(found[:number].tolist())


@pytest.fixture
def placed(rng):
    """Boxes, off the origins of their frames, at random places; all their pairs, with margins."""
    places = [pin.SE3(pin.exp3(rng.normal(size=3) * 2), rng.uniform(-1.0, 1.0, 3)) for _ in range(NUMBER)]
    boxes = np.hstack([rng.normal(size=(NUMBER, 3)) * 0.1, rng.uniform(0.01, 0.4, (NUMBER, 3))])
    pairs = np.stack(np.triu_indices(NUMBER, 1), axis=1)
    return places, boxes, pairs, rng.uniform(0.0, 0.3, len(pairs))


def test_no_near_pair_is_left_out(placed):
    places, boxes, pairs, margins = placed
    distances = np.array([distance(places, boxes, a, b) for a, b in pairs])
    found, nearer = near(*placed), set(np.flatnonzero(distances < margins - 1e-6).tolist())
    assert 100 < len(nearer) < len(pairs) / 2
    assert nearer <= found
    assert len(found) < 1.1 * len(nearer)


def distance(places, boxes, a, b):
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    shapes = [coal.Box(*(2 * boxes[k, 3:])) for k in (a, b)]
    frames = [places[k] * pin.SE3(np.eye(3), boxes[k, :3]) for k in (a, b)]
    poses = [coal.Transform3s(frame.rotation, frame.translation) for frame in frames]
    return coal.distance(shapes[0], poses[0], shapes[1], poses[1], request, result)


@pytest.mark.parametrize("sides", [np.inf, np.nan])
def test_boxes_without_end_are_near_all(placed, sides):
    places, boxes, pairs, margins = placed
    boxes[0, 3:] = sides
    with_it = set(np.flatnonzero(pairs[:, 0] == 0).tolist())
    assert with_it <= near(places, boxes, pairs, margins)
