"""Scenes in which some obstacles are elsewhere."""

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, InputError, Obstacle, Person, PointCloud, Pose, Scene, UnknownNameError
from safe_ompl.geometry import STANDING

TURNED = Pose.from_rpy((1.0, -0.5, 0.2), (0.1, 0.2, 2.0))


@pytest.fixture
def scene():
    return Scene(
        (
            Obstacle("box", Box((0.1, 0.2, 0.3)), weight=0.5, color="#ff0000"),
            Obstacle("colleague", Person(1.8), TURNED),
            Obstacle("hand", Person(only=("right_hand", "right_forearm"))),
            Obstacle("cloud", PointCloud(0.02, points=np.eye(3)), TURNED),
        ),
        spacing=0.07,
    )


def test_all_but_the_places_is_shared(scene):
    moved = scene.moved({"box": TURNED})
    assert moved["box"] == Obstacle("box", Box((0.1, 0.2, 0.3)), TURNED, weight=0.5, color="#ff0000")
    assert moved.spacing == scene.spacing
    assert all(moved[name] is scene[name] for name in ("colleague", "hand", "cloud"))
    assert moved["box"].shape is scene["box"].shape
    assert scene["box"].pose == Pose(), "a scene is frozen"


@pytest.mark.parametrize("name", ["box", "colleague", "cloud"])
def test_any_obstacle_moves_to_a_pose_in_any_form(scene, name):
    place = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.array([0.1, 0.2, 0.3]))
    for form in (place, place.homogeneous, place.homogeneous.tolist(), Pose.of(place)):
        moved = scene.moved({name: form})[name]
        np.testing.assert_allclose(moved.pose.se3.homogeneous, place.homogeneous, atol=1e-12)
        assert moved.shape is scene[name].shape


def test_key_points_are_where_the_sensor_sees_them_in_the_world(scene):
    seen = {name: 1.8 * point + (0.3, -0.2, 0.1) for name, point in STANDING.items()}
    person = scene.moved({"colleague": seen})["colleague"]
    assert person.pose == TURNED
    for name in ("right_forearm", "left_thigh"):
        limb = next(limb for limb in person.shape.limbs() if limb.name == name)
        joints = {"right_forearm": ("right_elbow", "right_wrist"), "left_thigh": ("left_hip", "left_knee")}[name]
        for end, joint in zip((limb.start, limb.end), joints, strict=True):
            np.testing.assert_allclose(TURNED.se3.act(end), seen[joint], atol=1e-12)


def test_limbs_and_height_stay(scene):
    moved = scene.moved({"hand": {"right_wrist": (0.3, -0.2, 1.0), "right_hand": (0.4, -0.2, 1.0)}})["hand"]
    assert [limb.name for limb in moved.shape.limbs()] == ["right_forearm", "right_hand"]
    assert moved.shape.height == scene["hand"].shape.height


def test_points_of_a_cloud_are_given_in_the_world(scene):
    points = np.random.default_rng(0).normal(size=(50, 3))
    cloud = scene.moved({"cloud": points})["cloud"]
    np.testing.assert_allclose([TURNED.se3.act(p) for p in cloud.shape.centres], points, atol=1e-12)
    assert cloud.shape.radius == 0.02


def test_a_limb_whose_ends_meet_is_still_a_capsule(scene):
    seen = {name: 1.8 * point for name, point in STANDING.items()}
    seen["right_wrist"] = seen["right_elbow"]
    before, after = scene["colleague"], scene.moved({"colleague": seen})["colleague"]
    kinds = [[type(part.geometry) for part in person.shape.parts()] for person in (before, after)]
    assert kinds[0] == kinds[1]


@pytest.mark.parametrize(
    ("places", "why"),
    [
        ({"box": {"left_hand": (0, 0, 0)}}, "'box'.pose: must be a Pose"),
        ({"box": (1.0, 2.0, 3.0)}, "'box'.pose: must be a Pose"),
        ({"colleague": {"left_paw": (0, 0, 0)}}, "'colleague'.*left_paw"),
        ({"colleague": {"left_hand": (0, 0, np.nan)}}, "'colleague'.*left_hand"),
        ({"colleague": (1.0, 2.0, 3.0)}, "'colleague'.keypoints: must be"),
        ({"cloud": np.zeros((0, 3))}, "'cloud'.points: the point cloud is empty"),
        ({"cloud": np.zeros((5, 2))}, "'cloud'.points"),
        ({"cloud": [[0, 0, 0], [0]]}, "'cloud'.points"),
        ([("box", Pose())], "places: must be"),
    ],
)
def test_places_that_cannot_be_used(scene, places, why):
    with pytest.raises(InputError, match=why):
        scene.moved(places)


def test_unknown_names(scene):
    with pytest.raises(UnknownNameError, match="bx"):
        scene.moved({"bx": Pose()})
