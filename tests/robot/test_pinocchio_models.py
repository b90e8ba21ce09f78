"""What a robot hands out can be changed; the robot cannot."""

import shutil

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import CollisionChecker, Robot, Scene
from safe_ompl.robot import robot_hash


@pytest.fixture
def robot(data_folder):
    return Robot.from_urdf(data_folder / "twin_arm.urdf")


def spoil_bodies(robot):
    robot.collision_model.addGeometryObject(pin.GeometryObject("tool_0", 1, pin.SE3.Identity(), coal.Sphere(0.3)))


def spoil_pairs(robot):
    robot.collision_model.removeAllCollisionPairs()


def spoil_shape(robot):
    robot.collision_model.geometryObjects[0].geometry.halfSide[:] = 3.0


def spoil_placement(robot):
    robot.collision_model.geometryObjects[1].placement = pin.SE3.Random()


def spoil_model(robot):
    robot.model.jointPlacements[2] = pin.SE3.Random()


@pytest.mark.parametrize("spoil", [spoil_bodies, spoil_pairs, spoil_shape, spoil_placement, spoil_model])
def test_what_is_done_to_a_model_handed_out_changes_nothing(robot, spoil):
    q = (robot.lower + robot.upper) / 2
    before = robot_hash(robot), robot.bounds.displacement_radii.copy(), robot.keypoints(q)
    pairs = CollisionChecker(robot, Scene()).pair_names
    spoil(robot)
    assert robot_hash(robot) == before[0]
    np.testing.assert_array_equal(robot.bounds.displacement_radii, before[1])
    np.testing.assert_array_equal(robot.keypoints(q), before[2])
    checker = CollisionChecker(robot, Scene())
    assert checker.pair_names == pairs


def test_arrays_are_read_only(robot):
    own = ("lower", "upper", "continuous", "prismatic", "segments", "joint_keypoint_support")
    radii = ("displacement_radii", "joint_radii", "keypoint_radii", "joint_keypoint_radii", "arm_rates")
    arrays = [getattr(robot, name) for name in own] + [getattr(robot.bounds, name) for name in radii]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.fixture
def hash_with(data_folder, tmp_path):
    """Return a function from the lines of a mesh to the hash of a robot with such hands."""
    shutil.copy(data_folder / "twin_arm.urdf", tmp_path)

    def fingerprint(lines, *, hulls=False):
        (tmp_path / "wedge.obj").write_text("\n".join(lines))
        return robot_hash(Robot.from_urdf(tmp_path / "twin_arm.urdf", hulls=hulls))

    return fingerprint


@pytest.fixture
def wedge(data_folder):
    return (data_folder / "wedge.obj").read_text().splitlines()


def test_the_triangles_of_a_mesh_count(hash_with, wedge):
    usual = hash_with(wedge)
    assert hash_with(wedge[:-1]) != usual, "a face is missing, no vertex"
    *rest, last = wedge
    word, first, *others = last.split()
    assert hash_with([*rest, " ".join([word, *others, first])]) == usual, "the same triangle"
    assert hash_with([*rest, " ".join([word, first, *others[::-1]])]) != usual, "its other side"


def test_the_order_of_a_mesh_does_not_count(hash_with, wedge):
    faces = [line for line in wedge if line.startswith("f ")]
    assert hash_with([*(line for line in wedge if line not in faces), *faces[::-1]]) == hash_with(wedge)


def test_of_convex_hulls_the_vertices_count(hash_with, wedge):
    usual = hash_with(wedge, hulls=True)
    assert hash_with(wedge[:-1], hulls=True) == usual
    assert hash_with([line.replace("1.2", "1.21") for line in wedge], hulls=True) != usual
