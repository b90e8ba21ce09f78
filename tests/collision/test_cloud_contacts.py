"""A checker with a large cloud never misses what balls, one by one, would touch."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import CollisionChecker, Obstacle, PointCloud, Robot, Scene, certificate, verify

RADIUS = 0.02


@pytest.fixture(scope="module")
def scan() -> np.ndarray:
    """Return a patch of a wall and of a table, as a camera sees them."""
    rng = np.random.default_rng(2)
    wall = np.column_stack(
        [rng.normal(0.55, 0.002, 120), rng.uniform(-0.4, 0.4, 120), rng.uniform(0.2, 0.8, 120)]
    )
    table = np.column_stack(
        [rng.uniform(0.2, 0.8, 120), rng.uniform(-0.4, 0.4, 120), rng.normal(0.1, 0.002, 120)]
    )
    return np.concatenate([wall, table])


def nearest_ball(robot: Robot, points: np.ndarray, configurations: np.ndarray) -> np.ndarray:
    """Return the distance of the robot's moving bodies from the nearest ball at each configuration, pair by pair."""
    geometry = robot.collision_model.copy()
    geometry.removeAllCollisionPairs()
    bodies = [k for k, body in enumerate(geometry.geometryObjects) if body.parentJoint != 0]
    for k, ((_, shape, place),) in enumerate(
        Obstacle("p", PointCloud(RADIUS, points=[point])).geometries() for point in points
    ):
        number = geometry.addGeometryObject(pin.GeometryObject(f"ball{k}", 0, place, shape))
        for body in bodies:
            geometry.addCollisionPair(pin.CollisionPair(body, number))
    data, results = robot.model.createData(), pin.GeometryData(geometry)
    nearest = []
    for q in configurations:
        pin.computeDistances(robot.model, data, geometry, results, robot.pinocchio_configuration(q))
        nearest.append(min(result.min_distance for result in results.distanceResults))
    return np.array(nearest)


def test_contacts_and_distances_are_never_more_hopeful_than_the_balls(panda, scan) -> None:
    cloud = PointCloud(RADIUS, points=scan)
    checker = CollisionChecker(panda, Scene((Obstacle("scan", cloud),)))
    alone = CollisionChecker(panda, Scene())
    rng = np.random.default_rng(3)
    configurations = np.array(
        [q for q in rng.uniform(panda.lower, panda.upper, (60, panda.n)) if not alone.in_collision(q)]
    )
    nearest = nearest_ball(panda, scan, configurations)
    touching = np.array([checker.in_collision(q) for q in configurations])
    slack = 3**0.5 * cloud.cell_edge
    assert touching[nearest < 0].all()
    assert not touching[nearest > slack + 1e-4].any()
    assert 5 < (nearest < 0).sum() < len(nearest) - 5
    for q, distance in zip(configurations, nearest, strict=True):
        assert checker.clearance(q).distance <= max(distance, 0.0) + 1e-4


def test_a_certificate_beside_a_large_cloud_verifies(panda, scan) -> None:
    scene = Scene((Obstacle("scan", PointCloud(RADIUS, points=np.tile(scan, (20, 1)))),))
    path = [[-1.8, -0.9, 0.0, -2.4, 0.0, 1.8, 0.8], [-2.4, -0.7, 0.1, -2.2, 0.1, 1.9, 0.6]]
    assert verify(certificate(path, panda, scene), panda, scene).edges == 1
