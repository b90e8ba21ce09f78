"""Messages as arrays in the world: frames, stamps, key points, poses and clouds."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from safe_ompl import InputError, Pose, Robot
from safe_ompl.live import find_skeleton
from safe_ompl.live.ros import lookup_of
from safe_ompl.live.ros.messages import FramePlaces, cloud_of, people_of_markers, pose_of, stamp_of
from safe_ompl.live.ros.sightings import CloudView, Sightings
from safe_ompl.live.simulation import ALL_KEYPOINTS

TURNED = Pose.from_rpy((1.0, 0.0, 2.0), (0.0, 0.0, np.pi / 2))


@pytest.fixture(scope="module")
def frames():
    return FramePlaces(Robot.from_example("panda"), {"camera": TURNED})


def message(**fields):
    """Return a message as readers have it, with attributes."""

    def part(value):
        if isinstance(value, dict):
            return SimpleNamespace(**{key: part(each) for key, each in value.items()})
        return [part(each) for each in value] if isinstance(value, list) else value

    return part(fields)


def header(frame="camera", sec=7, nanosec=500_000_000):
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def point(x, y, z):
    return {"x": x, "y": y, "z": z}


def marker(text="", number=0, frame="camera", place=(1.0, 0.0, 0.0), action=0, **stamp):
    pose = {"position": point(*place)}
    return {"header": header(frame, **stamp), "ns": "anna", "id": number, "text": text, "action": action, "pose": pose}


def test_frames_are_the_world_fixed_links_and_those_of_the_scenario(frames):
    for name, place in (("world", Pose()), ("panda_link0", Pose()), ("/camera", TURNED)):
        assert frames.place(message(frame_id=name)).isApprox(place.se3)
    for name, said in (("", "frame_id: is empty"), ("panda_link1", "unknown frame 'panda_link1'; did you ")):
        with pytest.raises(InputError, match=said):
            frames.place(message(frame_id=name))


def test_other_frames_are_looked_up_with_tf2_at_the_stamp(monkeypatch):
    """With a stand-in of tf2_ros: a camera that is turned about the base of the robot, from 7 s on."""
    place = {"translation": point(1.0, 0.0, 2.0), "rotation": {**point(0.0, 0.0, np.sqrt(0.5)), "w": np.sqrt(0.5)}}

    class Buffer:
        def __init__(self, node):
            assert node == "node"

        def can_transform(self, target, frame, time):
            return (target, frame) == ("panda_link0", "hand_camera") and time.seconds >= 7

        def lookup_transform(self, target, frame, time):
            assert self.can_transform(target, frame, time)
            return message(transform=place)

    def time(seconds, nanoseconds):
        return SimpleNamespace(seconds=seconds + 1e-9 * nanoseconds)

    tf2 = SimpleNamespace(Buffer=Buffer, TransformListener=lambda buffer, node: object())
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    assert lookup_of("node") is None
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2)
    monkeypatch.setitem(sys.modules, "rclpy.time", SimpleNamespace(Time=time))
    frames = FramePlaces(Robot.from_example("panda"), {}, lookup_of("node"))
    assert frames.place(message(**header("/hand_camera"))).isApprox(TURNED.se3)
    for late in (header("hand_camera", sec=6), header("camera")):
        with pytest.raises(InputError, match="unknown frame"):
            frames.place(message(**late))


def test_a_stamp_is_needed():
    assert stamp_of(message(**header())) == 7.5
    with pytest.raises(InputError, match="stamp: is missing"):
        stamp_of(message(**header(sec=0, nanosec=0)))


def test_markers_by_name_or_number(frames):
    given = message(markers=[marker(action=3), marker("left_wrist"), marker("pelvis"), marker("head", sec=6)])
    time, people = people_of_markers(given, ALL_KEYPOINTS, frames)
    assert time == 6.5  # the oldest
    k = ALL_KEYPOINTS.points.index("left_wrist")
    np.testing.assert_allclose(people["anna"][k], [1.0, 1.0, 2.0])
    assert np.isfinite(people["anna"]).all(axis=1).sum() == 2
    coco = find_skeleton("coco17")
    _, people = people_of_markers(message(markers=[marker(number=16)]), coco, frames)
    assert np.flatnonzero(np.isfinite(people["anna"]).all(axis=1)).tolist() == [16]
    assert people_of_markers(message(markers=[marker(action=3)]), coco, frames) == (7.5, {})


@pytest.mark.parametrize(
    ("markers", "said"),
    [
        ([], "markers: has no markers, and so no time"),
        ([marker("tail")], "anna: unknown key point of coco17 'tail'"),
        ([marker(number=17)], "anna: id: coco17 has 17 key points, got 17"),
        ([marker(frame="tracker")], "frame_id: unknown frame 'tracker'"),
        ([marker(place=(np.inf, 0, 0))], "key point: must be finite, or all NaN"),
        ([marker(place=(np.nan, 0, 0))], "key point: must be finite, or all NaN"),
    ],
)
def test_markers_that_cannot_be_used(frames, markers, said):
    with pytest.raises(InputError, match=said):
        people_of_markers(message(markers=markers), find_skeleton("coco17"), frames)


def test_an_object(frames):
    pose = {"position": point(1.0, 0.0, 0.0), "orientation": {**point(0.0, 0.0, 0.0), "w": 1.0}}
    _, place = pose_of(message(header=header(), pose=pose), frames)
    np.testing.assert_allclose(place.position, [1.0, 1.0, 2.0])
    with pytest.raises(InputError, match="quaternion"):
        pose_of(message(header=header(), pose={**pose, "orientation": {**point(0.0, 0.0, 0.0), "w": 0.0}}), frames)


def test_a_cloud(frames):
    points = np.array([[1, 0, 0], [np.nan, 0, 0], [2, 0, 0]], dtype="<f4")
    fields = [{"name": axis, "offset": 4 * k, "datatype": 7} for k, axis in enumerate("xyz")]
    sizes = {"height": 1, "width": 3, "point_step": 12, "row_step": 36, "is_bigendian": False}
    given = message(header=header(), fields=fields, data=points.tobytes(), **sizes)
    time, found = cloud_of(given, 0.02, frames)
    np.testing.assert_allclose(found, [[1.0, 1.0, 2.0], [1.0, 2.0, 2.0]])
    assert time == 7.5
    assert len(cloud_of(message(header=header(), **{**sizes, "width": 0}), 0.02, frames)[1]) == 0


# ----------------------------------------------------------------------------------------------------- sightings


def test_the_replanner_is_told_of_the_oldest_of_the_newest():
    seen = Sightings(("anna", "bert"), lost_after=0.5, clock_error=0.01)
    assert seen.due(1.0) is None
    seen.add("anna", 1.01, 1.0, "a")
    seen.add("bert", 0.81, 1.0, "b")
    assert seen.due(1.0) == (pytest.approx(0.8), {"anna": "a", "bert": "b"})
    assert seen.due(1.0) is None  # nothing new
    seen.add("anna", 0.9, 1.0, "older")
    seen.add("anna", 1.11, 1.1, "c")
    assert seen.due(1.1) is None  # of bert there is nothing new
    assert seen.due(1.4) == (pytest.approx(1.1), {"anna": "c"})  # bert is lost
    seen.add("bert", 1.06, 1.4, "d")
    assert seen.due(1.4) is None  # older than what was told already
    seen.add("bert", 1.21, 1.4, "e")
    seen.add("anna", 1.31, 1.4, "f")
    assert seen.due(1.4) == (pytest.approx(1.2), {"anna": "f", "bert": "e"})
    with pytest.raises(InputError, match=r"stamp: 'anna' was measured 1.000 s in the future"):
        seen.add("anna", 2.4, 1.4, "g")
    assert Sightings((), 0.5, 0.0).due(3.0) == (3.0, {})


def test_new_points_of_a_cloud():
    grid = np.stack(np.meshgrid(*[np.arange(0, 0.2, 0.02)] * 3), axis=-1).reshape(-1, 3)
    before = CloudView(grid, 0.02)
    assert CloudView(grid + 0.01, 0.02).news(before) == 0
    assert CloudView(np.concatenate([grid, [[1.0, 1.0, 1.0]] * 10]), 0.02).news(before) == 0
    assert CloudView(np.concatenate([grid, [[1.0, 1.0, 1.0]] * 11]), 0.02).news(before) == 11
    assert CloudView(grid, 0.02).news(None) == len(grid)  # where the path was proven nothing was known
    assert CloudView(np.zeros((0, 3)), 0.02).obstacle() is None
