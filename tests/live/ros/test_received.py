"""Messages as arrays in the world: frames, stamps, key points, poses and clouds."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from safe_ompl import InputError, Pose, Robot
from safe_ompl.live import find_skeleton
from safe_ompl.live.ros import lookup_of
from safe_ompl.live.ros.messages import FramePlaces, cloud_of, people_of_markers, pose_of, proposal_of
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


def posed(w=1.0, **head):
    """Return a pose with a quaternion (0, 0, 0, w)."""
    orientation = {**point(0.0, 0.0, 0.0), "w": w}
    return message(header=header(**head), pose={"position": point(1.0, 0.0, 0.0), "orientation": orientation})


def test_an_object(frames):
    time, place = pose_of(posed(), frames)
    assert time == 7.5
    np.testing.assert_allclose(place.position, [1.0, 1.0, 2.0])


def test_a_cloud(frames):
    points = np.array([[1, 0, 0], [np.nan, 0, 0], [2, 0, 0]], dtype="<f4")
    fields = [{"name": axis, "offset": 4 * k, "datatype": 7} for k, axis in enumerate("xyz")]
    sizes = {"height": 1, "width": 3, "point_step": 12, "row_step": 36, "is_bigendian": False}
    given = message(header=header(), fields=fields, data=points.tobytes(), **sizes)
    time, found = cloud_of(given, 0.02, frames)
    np.testing.assert_allclose(found, [[1.0, 1.0, 2.0], [1.0, 2.0, 2.0]])
    assert time == 7.5
    assert len(cloud_of(message(header=header(), **{**sizes, "width": 0}), 0.02, frames)[1]) == 0


def trajectory(*points, **stamp):
    """Return a trajectory of the Panda through points at times [s], with these fields."""
    rows = [{"time_from_start": {"sec": sec, "nanosec": 0}, **FIELDS, **fields} for sec, fields in points]
    return message(header=header(**stamp), joint_names=[f"panda_joint{k}" for k in range(7, 0, -1)], points=rows)


FIELDS = {"positions": [], "velocities": [], "accelerations": []}
ROW = [0.1 * k for k in range(7)]


def test_a_proposal_begins_with_its_first_point_or_is_a_velocity(panda):
    points = (1, {"positions": ROW}), (3, {"positions": ROW[::-1]})
    motion, start = proposal_of(trajectory(*points), panda)
    assert (start, motion.duration) == (8.5, 2.0)
    np.testing.assert_allclose(motion.knots, [ROW[::-1], ROW])
    assert proposal_of(trajectory(*points, sec=0, nanosec=0), panda)[1] is None
    velocity, start = proposal_of(trajectory((0, {"velocities": ROW})), panda)
    assert start is None
    np.testing.assert_array_equal(velocity, ROW[::-1])


def people_of(*markers):
    return lambda frames: people_of_markers(message(markers=list(markers)), find_skeleton("coco17"), frames)


UNUSABLE = [
    (people_of(), "markers: has no markers, and so no time"),
    (people_of(marker("tail")), "anna: unknown key point of coco17 'tail'"),
    (people_of(marker(number=17)), "anna: id: coco17 has 17 key points, got 17"),
    (people_of(marker(number=-1)), "anna: id: coco17 has 17 key points, got -1"),
    (people_of(marker(frame="tracker")), "frame_id: unknown frame 'tracker'"),
    (people_of(marker(place=(np.inf, 0, 0))), "key point: must be finite, or all NaN"),
    (people_of(marker(place=(np.nan, 0, 0))), "key point: must be finite, or all NaN"),
    (lambda frames: pose_of(posed(frame=""), frames), "frame_id: is empty"),
    (lambda frames: pose_of(posed(frame="panda_link1"), frames), "unknown frame 'panda_link1'; did you "),
    (lambda frames: pose_of(posed(sec=0, nanosec=0), frames), "stamp: is missing"),
    (lambda frames: pose_of(posed(w=0.0), frames), "quaternion"),
    (lambda frames: proposal_of(trajectory(), Robot.from_example("panda")), "points: has no points"),
]


@pytest.mark.parametrize(("read", "said"), UNUSABLE)
def test_messages_that_cannot_be_used(frames, read, said):
    with pytest.raises(InputError, match=said):
        read(frames)


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
