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


def test_of_meshes_the_corners_of_their_hulls_count(data_folder, tmp_path):
    wedge = (data_folder / "wedge.obj").read_text()
    shutil.copy(data_folder / "twin_arm.urdf", tmp_path)

    def fingerprint(text):
        (tmp_path / "wedge.obj").write_text(text)
        return robot_hash(Robot.from_urdf(tmp_path / "twin_arm.urdf"))

    assert fingerprint(wedge) == fingerprint(wedge[: wedge.rstrip().rindex("\n")]), "a face is missing, no corner"
    assert fingerprint(wedge) != fingerprint(wedge.replace("1.2", "1.21"))
