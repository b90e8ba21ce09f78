"""Which pairs of bodies and obstacles can come near: bounds by balls, and coal, against coal alone."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from oracles.coal_distances import coal_distance

from safe_ompl import Box, Capsule, Cylinder, Obstacle, PointCloud, Pose, Scene, Sphere
from safe_ompl.collision.geometry import SceneGeometry
from safe_ompl.collision.pairs import PairTable
from safe_ompl.geometry import DISTANCE_ERROR


def distance_of(reach, part):
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), reach.axis).matrix()
    cylinder = coal.Cylinder(reach.radius, 2 * reach.half_length)
    return coal_distance(cylinder, pin.SE3(turn, reach.center), part.geometry, part.placement)


@pytest.mark.parametrize("name", ["panda", "twin_arm"])
def test_pairs_that_can_come_near_are_those_that_coal_finds(robot_named, rng, name):
    robot = robot_named(name)
    shapes = [Box((0.1, 0.2, 0.3)), Sphere(0.1), Cylinder(0.1, 0.5), Capsule(0.05, 0.3)]
    shapes += [PointCloud(0.02, points=rng.normal(0, 0.1, (50, 3)).tolist())]
    places = [Pose.from_rpy(rng.uniform(-2.0, 2.0, 3), rng.uniform(-3, 3, 3)) for _ in range(8 * len(shapes))]
    scene = Scene([Obstacle(str(k), shapes[k % len(shapes)], place) for k, place in enumerate(places)])
    geometry = SceneGeometry(robot, scene, ())
    table = PairTable(robot, geometry)
    reaches = robot.bounds.body_reaches.values()
    expected = np.array([distance_of(reach, part) for reach in reaches for part in geometry.parts])
    for distance in (1e-5, 0.05, 0.4):
        clear = np.abs(expected - distance) > 2e-5
        near = np.isin(table.with_obstacle, table.within(distance - DISTANCE_ERROR))
        np.testing.assert_array_equal(near[clear], (expected < distance)[clear])
    assert 0 < (expected < 1e-5).sum() < expected.size, "both answers occur"


def test_what_may_be_anywhere_is_always_near(panda):
    scene = Scene([Obstacle("far", Sphere(0.1), Pose((50.0, 0.0, 0.0)))])
    table = PairTable(panda, SceneGeometry(panda, scene, ["far"]))
    assert np.isin(table.with_obstacle, table.within(0.0)).all()
