"""Robots from models that the user has already."""

import pickle

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.errors import InputError
from safe_ompl.robot.fingerprint import robot_hash
from safe_ompl.robot.joints.coupling import Mimic
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene


@pytest.fixture
def models(data_folder):
    urdf = str(data_folder / "gripper_arm.urdf")
    model = pin.buildModelFromUrdf(urdf)
    return model, pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION)


def test_the_same_as_from_the_urdf(models, data_folder):
    follows = {"grip_mirror": Mimic("grip", 1.5, 0.001)}
    robot = Robot.from_models(*models, tip="hand", mimics=follows)
    assert robot_hash(robot) == robot_hash(Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="hand"))
    assert robot.name == "gripper_arm"
    mimicking = Robot.from_models(*models, tip="finger_1", mimics=follows)
    from_urdf = Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="finger_1")
    assert robot_hash(mimicking) == robot_hash(from_urdf)


def test_pairs_that_are_given_are_those_that_are_checked(models):
    model, geometry = models
    names = [part.name for part in geometry.geometryObjects]
    for a, b in (("base_0", "lower_0"), ("lower_0", "hand_0"), ("upper_0", "hand_0")):
        geometry.addCollisionPair(pin.CollisionPair(names.index(a), names.index(b)))
    robot = Robot.from_models(model, geometry, tip="hand")
    assert set(CollisionChecker(robot, Scene()).pair_names) == {("base", "lower"), ("upper", "hand")}


def test_models_are_copied(models):
    model, geometry = models
    robot = Robot.from_models(model, geometry, tip="hand")
    before = robot_hash(robot)
    geometry.geometryObjects[1].geometry.halfSide[:] = 2.0
    geometry.addGeometryObject(pin.GeometryObject("tool_0", 1, pin.SE3.Identity(), coal.Sphere(0.3)))
    model.jointPlacements[1] = pin.SE3.Random()
    assert robot_hash(robot) == before
    assert robot_hash(robot.with_limits({"elbow": (-2.5, 2.5)})) == before


def test_meshes_become_hulls_and_travel(data_folder):
    urdf = str(data_folder / "twin_arm.urdf")
    model = pin.buildModelFromUrdf(urdf)
    robot = Robot.from_models(
        model,
        pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION, package_dirs=[str(data_folder)]),
        base=(0.0, 0.0, 1.0),
    )
    assert not any(isinstance(b.geometry, coal.BVHModelBase) for b in robot.collision_model.geometryObjects)
    other = pickle.loads(pickle.dumps(robot))
    assert robot_hash(other) == robot_hash(robot)
    q = np.zeros(robot.n)
    np.testing.assert_array_equal(other.keypoints(q), robot.keypoints(q))
    assert len(robot.visual_model.geometryObjects) == len(robot.collision_model.geometryObjects)


def test_other_things_than_models(models):
    model, geometry = models
    with pytest.raises(InputError, match=r"model must be a pin\.Model, not str"):
        Robot.from_models("robot.urdf", geometry)
    with pytest.raises(InputError, match=r"geometry must be a pin\.GeometryModel, not Model"):
        Robot.from_models(model, model)
