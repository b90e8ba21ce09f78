"""Robots from models that the user has already."""

import pickle
import shutil

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import CollisionChecker, InputError, Robot, Scene
from safe_ompl.robot import Mimic, robot_hash


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


def arm(shapes):
    """Return an arm of turning joints, one for each shape, as people write them by hand."""
    model, geometry, parent = pin.Model(), pin.GeometryModel(), 0
    limit = np.full(1, 2.0)
    for k, shape in enumerate(shapes):
        kind = pin.JointModelRZ() if k % 2 else pin.JointModelRY()
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4 * bool(k)]))
        parent = model.addJoint(parent, kind, place, f"joint{k}", limit, limit, -limit, limit)
        link = model.addBodyFrame(f"link{k}", parent, pin.SE3.Identity(), model.addJointFrame(parent))
        placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
        geometry.addGeometryObject(pin.GeometryObject(f"link{k}_0", parent, link, placement, shape))
    return model, geometry


def test_models_made_by_hand():
    shapes = [coal.Capsule(0.05, 0.2), coal.Box(0.1, 0.1, 0.2), coal.Sphere(0.1), coal.Cone(0.1, 0.2)]
    model, geometry = arm(shapes)
    robot = Robot.from_models(model, geometry)
    assert robot.tip == "link3"
    checker = CollisionChecker(robot, Scene())
    assert {("link0", "link1"), ("link0", "link2")} <= set(checker.pair_names)
    assert not checker.in_collision(np.zeros(robot.n))
    locked = Robot.from_models(model, geometry, locked={"joint1": 0.5}, tip="link3")
    q = np.array([0.3, -0.4, 0.2])
    expected = robot.tip_pose(np.insert(q, 1, 0.5))
    np.testing.assert_allclose(locked.tip_pose(q).homogeneous, expected.homogeneous, atol=1e-12)


def tool_on(joint):
    return pin.GeometryObject("tool_0", joint, pin.SE3.Identity(), coal.Sphere(0.1))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda _, bodies: bodies.addGeometryObject(tool_on(1)), "geometry 'tool_0' is on no link"),
        (lambda _, bodies: bodies.addGeometryObject(tool_on(7)), "there is no joint 7 in the model"),
        (lambda model, _: model.addJoint(2, pin.JointModelRX(), pin.SE3(), "wrist"), "call model.addJointFrame.3."),
        (lambda model, _: model.addBodyFrame("tool", 2, pin.SE3(), 0), "on another joint than the frame before it"),
    ],
)
def test_what_would_crash_pinocchio_is_named(spoil, message):
    model, geometry = arm([coal.Sphere(0.1), coal.Sphere(0.1)])
    for wrong, kind in (
        (("robot.urdf", geometry), "a pin.Model, not str"),
        ((model, model), "a pin.GeometryModel, not Model"),
        ((model, None), "a pin.GeometryModel, not NoneType"),
    ):
        with pytest.raises(InputError, match=f"must be {kind}"):
            Robot.from_models(*wrong)
    spoil(model, geometry)
    with pytest.raises(InputError, match=message):
        Robot.from_models(model, geometry)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        (coal.Plane(np.array([0.0, 0.0, 1.0]), 0.0), "a Plane cannot be part of a robot; these can: Box, "),
        (coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0), "a Halfspace cannot be part of a robot"),
        (coal.TriangleP(np.zeros(3), np.ones(3), np.eye(3)[0]), "a TriangleP cannot be part of a robot"),
        (coal.OcTree(0.05), "a OcTree cannot be part of a robot"),
        (coal.BVHModelOBBRSS(), "is a mesh without triangles"),
        (coal.Sphere(0.0), r"radius must be positive lengths \[m\], got \[0.0\]"),
        (coal.Box(np.nan, 1.0, 1.0), r"halfSide must be positive lengths \[m\], got \[nan, 0.5, 0.5\]"),
    ],
)
def test_shapes_that_are_not_supported_are_named(shape, message):
    with pytest.raises(InputError, match=f"geometry 'link1_0': {message}"):
        Robot.from_models(*arm([coal.Sphere(0.1), shape, coal.Sphere(0.1)]))


# ----------------------------------------------------------------------------------------------- what a robot hands out


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
