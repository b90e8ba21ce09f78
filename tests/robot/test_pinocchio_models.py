"""What a robot hands out can be changed; the robot cannot."""

import shutil

import coal
import pinocchio as pin
import pytest

from safe_ompl import CollisionChecker, Robot, Scene
from safe_ompl.robot import robot_hash


@pytest.fixture
def robot(data_folder):
    return Robot.from_urdf(data_folder / "twin_arm.urdf")


def test_arrays_are_read_only(robot):
    own = ("lower", "upper", "continuous", "prismatic", "segments", "joint_keypoint_support")
    radii = ("displacement_radii", "joint_radii", "keypoint_radii", "joint_keypoint_radii", "arm_rates")
    arrays = [getattr(robot, name) for name in own] + [getattr(robot.bounds, name) for name in radii]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_what_is_done_to_models_handed_out_changes_nothing(robot):
    q = (robot.lower + robot.upper) / 2

    def state():
        numbers = *robot.bounds.displacement_radii.ravel(), *robot.keypoints(q).ravel()
        return robot_hash(robot), CollisionChecker(robot, Scene()).pair_names, numbers

    before, bodies = state(), robot.collision_model
    bodies.geometryObjects[0].geometry.halfSide[:] = 3.0
    bodies.geometryObjects[1].placement = pin.SE3.Random()
    bodies.addGeometryObject(pin.GeometryObject("tool_0", 1, pin.SE3.Identity(), coal.Sphere(0.3)))
    bodies.removeAllCollisionPairs()
    robot.model.jointPlacements[2] = pin.SE3.Random()
    assert state() == before


@pytest.fixture
def hash_with(data_folder, tmp_path):
    """Return a function from the lines of a mesh to the hash of a robot with such hands."""
    shutil.copy(data_folder / "twin_arm.urdf", tmp_path)

    def fingerprint(lines, *, hulls=False):
        (tmp_path / "wedge.obj").write_text("\n".join(lines))
        return robot_hash(Robot.from_urdf(tmp_path / "twin_arm.urdf", hulls=hulls))

    return fingerprint


def test_of_meshes_corners_and_triangles_count_and_of_hulls_the_corners(hash_with, data_folder):
    wedge = (data_folder / "wedge.obj").read_text().splitlines()
    (*rest, last), usual = wedge, hash_with(wedge)
    word, first, *others = last.split()
    assert hash_with(rest) != usual, "a face is missing, no vertex"
    assert hash_with([*rest, " ".join([word, *others, first])]) == usual, "the same triangle"
    assert hash_with([*rest, " ".join([word, first, *others[::-1]])]) != usual, "its other side"
    faces = [line for line in wedge if line.startswith("f ")]
    assert hash_with([*(line for line in wedge if line not in faces), *faces[::-1]]) == usual, "another order"
    hull = hash_with(wedge, hulls=True)
    assert hash_with(rest, hulls=True) == hull
    assert hash_with([line.replace("1.2", "1.21") for line in wedge], hulls=True) != hull
