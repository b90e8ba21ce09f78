"""Self pairs that are always in contact: sampled as long as undecided."""

import pinocchio as pin
import pytest

from safe_ompl.robot.collision import always_in_contact, sample_configurations


def every_pair(robot):
    geometry = robot.collision_model.copy()
    geometry.addAllCollisionPairs()
    return geometry


def count_all(model, geometry, samples):
    """Pairs in contact in over 95 % of the samples, all of them asked at all samples."""
    data, contacts, hits = model.createData(), pin.GeometryData(geometry), [0] * len(geometry.collisionPairs)
    for q in samples:
        pin.computeCollisions(model, data, geometry, contacts, q, False)
        hits = [n + result.isCollision() for n, result in zip(hits, contacts.collisionResults, strict=True)]
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    return [pair for pair, n in zip(pairs, hits, strict=True) if n > 0.95 * len(samples)]


@pytest.mark.parametrize("name", ["ur10", "so101", "twin_arm"])
def test_deciding_early_changes_no_decision(robot_named, name):
    robot = robot_named(name)
    geometry, samples = every_pair(robot), sample_configurations(robot.model)
    expected = count_all(robot.model, geometry, samples)
    assert expected, "the case is worth nothing without one"
    found = always_in_contact(robot.model, geometry, samples)
    assert [(pair.first, pair.second) for pair in found] == expected
