"""Objects in the gripper: checked against scene and robot, in the skeleton, in hash, pickle and picture."""

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, CollisionChecker, InputError, Mesh, PointCloud, Pose, Scene, Sphere
from safe_ompl.robot import Attachment


@pytest.fixture
def holding(robot_named):
    """Return the Panda with a rod in its hand that sticks out by 0.38 m."""
    return robot_named("loaded")


def test_an_object_is_checked_against_all_links_but_those_rigidly_connected(panda, holding):
    pairs = {pair for pair in CollisionChecker(holding, Scene()).pair_names if "rod" in pair}
    assert pairs == {(f"panda_link{k}", "rod") for k in range(7)}
    assert not any("rod" in pair for pair in CollisionChecker(panda, Scene()).pair_names)
    assert len(holding.bounds.displacement_radii) == len(panda.bounds.displacement_radii) + 1


def test_it_goes_where_the_link_goes(panda, rng):
    pose = Pose.from_rpy((0.02, -0.01, 0.1), (0.3, -0.5, 0.7))
    robot = panda.with_attached("crate", Box((0.1, 0.1, 0.1)), "panda_hand_tcp", pose)
    body = robot.collision_model.geometryObjects[-1]
    data = robot.model.createData()
    for q in rng.uniform(robot.lower, robot.upper, (5, 7)):
        pin.forwardKinematics(robot.model, data, q)
        place = data.oMi[body.parentJoint] * body.placement
        np.testing.assert_allclose(place.homogeneous, (panda.tip_pose(q) * pose.se3).homogeneous, atol=1e-12)


def test_danger_reaches_to_its_far_end(panda, holding, rng):
    assert holding.segment_names == (*panda.segment_names[:-1], "rod", panda.segment_names[-1])
    base, end = holding.segments[holding.segment_names.index("rod")]
    for q in rng.uniform(panda.lower, panda.upper, (3, 7)):
        points, tip = holding.keypoints(q), panda.tip_pose(q)
        np.testing.assert_allclose(points[end], tip.translation + 0.38 * tip.rotation[:, 2], atol=1e-12)
        np.testing.assert_allclose(points[base], tip.translation, atol=1e-12)
        np.testing.assert_allclose(points[-1], tip.translation, atol=1e-12)


def test_meshes(panda, data_folder):
    mesh = Mesh(data_folder / "wedge.obj", (0.1, 0.1, 0.1))
    robot = panda.with_attached("wedge", mesh)
    assert len(robot.collision_model.geometryObjects) == len(panda.collision_model.geometryObjects) + 1
    item = Attachment("wedge", mesh, "panda_hand", Pose((0.0, 0.0, 0.1)), ("panda_link5",), True)
    written = item.to_mapping(data_folder)
    assert written["mesh"]["file"] == "wedge.obj"
    assert Attachment.from_mapping(written, data_folder) == item


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"link": "palm"}, "unknown link for 'rod' 'palm'; known: "),
        ({"touch_links": ["thumb"]}, "unknown link for 'rod' 'thumb'"),
        ({"name": "panda_hand"}, "a link or frame is called 'panda_hand': give another name"),
        ({"shape": (0.1, 0.1)}, "attached shape: must be one of Box, Sphere, Cylinder, Capsule, Mesh, not"),
        ({"shape": PointCloud(points=[[0, 0, 0]], radius=0.1)}, "attached shape: must be one of Box"),
        ({"pose": (1.0, 2.0)}, "pose.position: must be 3 numbers, got 2"),
        ({"pose": {"position": [0, 0, 0], "angle": 1}}, "pose.angle: unknown key"),
        ({"link": "panda_link0", "danger": True}, "has no danger: no joint of the skeleton is below"),
    ],
)
def test_bad_objects(panda, options, message):
    with pytest.raises(InputError, match=message):
        panda.with_attached(**{"name": "rod", "shape": Sphere(0.1), **options})


def test_links_that_it_may_touch(robot_named):
    robot = robot_named("gripper").with_attached(
        "bar", Box((0.03, 0.2, 0.03)), "hand", (0.06, 0.0, 0.0), touch_links=("finger_1", "finger_2")
    )
    pairs = {pair for pair in CollisionChecker(robot, Scene()).pair_names if "bar" in pair}
    assert pairs == {("base", "bar"), ("upper", "bar")}
