"""People and joints from recordings of ROS 2 that other programs wrote."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from safe_ompl.apps import main
from safe_ompl.apps.exchange import messages, read_joint_log, read_people
from safe_ompl.common import InputError
from safe_ompl.geometry import STANDING
from safe_ompl.people import find_skeleton

TYPES = get_typestore(Stores.ROS2_JAZZY)
COCO = find_skeleton("coco17")
JOINTS = ("shoulder", "elbow")
# As in control_msgs of ROS 2 Humble, but for parts of the message that are not looked at.
STATE = "control_msgs/msg/JointTrajectoryControllerState"
DEFINITION = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
"""
TYPES.register(get_types_from_msg(DEFINITION, STATE))


def write_bag(folder, rows, plugin=StoragePlugin.SQLITE3):
    """Write (topic, type, when recorded [s], content) with rosbags, which is how others write such a bag."""
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, kind, time, content in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            data = TYPES.serialize_cdr(filled(kind, content), kind)
            writer.write(connections[topic], round(1e9 * time), data)
    return folder


def filled(kind, content):
    if kind == STATE:
        parts = {
            name: filled("trajectory_msgs/msg/JointTrajectoryPoint", content.get(name, {}))
            for name in ("reference", "feedback", "error")
        }
        header = filled("std_msgs/msg/Header", content["header"])
        return TYPES.types[kind](header=header, joint_names=list(content["joint_names"]), **parts)
    return TYPES.deserialize_cdr(messages.encoded(kind, content), kind)


def markers(points, frame="camera", time=0.0):
    """Return key points without names, each with its number; NaN: there is no marker."""
    head = messages.header(round(1e9 * time), frame)
    seen = [(k, point) for k, point in enumerate(points) if not np.isnan(point).any()]
    return {"markers": [{"header": head, "ns": "anna", "id": k, "pose": messages.pose(point)} for k, point in seen]}


def walking(time):
    """17 key points of a person who walks along x at 1 m/s."""
    return np.linspace([0.0, 0.0, 0.0], [0.3, 0.4, 1.7], 17) + np.array([time, 0.0, 0.0])


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_people_of_a_bag_and_who_is_not_seen(tmp_path, plugin):
    hidden = walking(0.3)
    hidden[4] = np.nan
    times = (0.0, 0.1, 0.2, 0.3, 0.4, 0.9, 1.0, 1.1)
    rows = [("/a", messages.MARKERS, 5 + t, markers(hidden if t == 0.3 else walking(t))) for t in times]
    folder = write_bag(tmp_path / "bag", rows, plugin)
    found = read_people(folder, skeleton="coco17")
    assert found.skeleton == COCO
    assert found.rate == pytest.approx(10.0)
    seen = np.isfinite(found.frames).all(axis=2)
    assert not seen[3, 4]
    assert seen[3].sum() == 16
    assert not seen[5:9].any()  # half a second without a message
    known = [0, 1, 2, 4, 9, 10, 11]
    np.testing.assert_allclose(found.frames[known], [walking(0.1 * k) for k in known], atol=1e-9)
    (file,) = [file for file in folder.iterdir() if file.suffix in (".mcap", ".db3")]
    np.testing.assert_array_equal(read_people(file, skeleton="coco17").frames, found.frames)


def test_stamps_count_and_their_order_does_not(tmp_path):
    rows = [("/a", messages.MARKERS, 50.0, markers(walking(t), time=7 + t)) for t in (0.2, 0.0, 0.1, 0.1, 0.3)]
    found = read_people(write_bag(tmp_path / "bag", rows), skeleton="coco17")
    np.testing.assert_allclose(found.frames, [walking(t) for t in (0.0, 0.1, 0.2, 0.3)], atol=1e-7)


def test_people_by_name_with_named_key_points(tmp_path):
    body = {name: 1.75 * np.array(place) for name, place in STANDING.items()}
    rows = []
    for k in range(3):
        moved = {name: place + np.array([0.1 * k, 0.0, 0.0]) for name, place in reversed(body.items())}
        content = messages.people_markers(round(1e8 * k) + 1, {"anna": body, "bert": moved})
        rows.append(("/people", messages.MARKERS, k / 10, content))
    folder = write_bag(tmp_path / "bag", rows)
    found = read_people(folder, who="bert")
    assert found.skeleton.points == tuple(STANDING)
    np.testing.assert_allclose(found.frames[2], np.array(list(body.values())) + np.array([0.2, 0.0, 0.0]), atol=1e-6)
    for source, message in (
        ({}, "has the people anna, bert: say who with --clip"),
        ({"who": "carl"}, "unknown person 'carl'"),
        ({"topic": "/nobody"}, "--topic: unknown topic '/nobody'"),
        ({"who": "anna", "skeleton": "body25"}, "has 17 key points, body25 has 25"),
    ):
        with pytest.raises(InputError, match=message):
            read_people(folder, **source)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([(1.0, walking(0), {})], "must have messages at two times at least, got 1"),
        ([(1.0, walking(0), {"topic": "/b"})], "has /a, /b of .*say which with --topic"),
        ([(1.0, walking(0), {"frame": "map"})], "frame_id: must be one in all messages, got camera, map"),
        ([(1.0, walking(np.inf), {})], "key points: must be finite, or NaN"),
    ],
)
def test_recordings_of_people_that_are_none(tmp_path, rows, message):
    rows = [(1.1, walking(0.1), {}), *rows] if "two times" not in message else rows
    found = [(how.pop("topic", "/a"), messages.MARKERS, t, markers(points, **how)) for t, points, how in rows]
    with pytest.raises(InputError, match=message):
        read_people(write_bag(tmp_path / "bag", found), skeleton="coco17")
    joints = write_bag(tmp_path / "joints", [("/a", messages.JOINT_STATE, 1.0, {})])
    with pytest.raises(InputError, match="has no topic of visualization_msgs"):
        read_people(joints, skeleton="coco17")


def test_a_recorded_person_beside_the_robot(tmp_path, capsys):
    body = np.array(list(STANDING.values())) * 1.75
    rows = []
    for t in np.arange(0, 0.5, 0.1):
        anna = dict(zip(STANDING, body + np.array([0.5 * t, 0, 0]), strict=True))
        rows.append(("/people", messages.MARKERS, t, messages.people_markers(round(1e9 * t), {"anna": anna})))
    folder = write_bag(tmp_path / "bag", rows)
    words = ["live", "panda_shelf", "--people", str(folder), "--place", "0.9,0,0,3.1", "--seconds", "0.3"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    assert "contacts while moving 0" in " ".join(capsys.readouterr().out.split())
    assert main([*words, "--out", str(tmp_path / "out"), "--topic", "/persons"]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert error[-1].endswith("--topic: unknown topic '/persons'; known: /people")


# -------------------------------------------------------------------------------------------------------- joints


def asked(t):
    return np.array([np.sin(t), 0.5 * t])


def test_the_tube_of_a_controllers_state(tmp_path, capsys):
    rows = []
    for t in np.arange(0, 2, 0.01):
        state = {"header": messages.header(round(1e9 * (100 + t))), "joint_names": JOINTS}
        state |= {"reference": {"positions": asked(t)}, "feedback": {"positions": asked(t) - [0.01, 0.002]}}
        rows.append(("/controller/state", STATE, t, state))
    folder = write_bag(tmp_path / "bag", rows, StoragePlugin.MCAP)
    commanded, measured = read_joint_log(folder)
    assert commanded.joint_names == measured.joint_names == JOINTS
    np.testing.assert_allclose(commanded.at(np.array([1.0])) - measured.at(np.array([1.0])), [[0.01, 0.002]], atol=1e-9)
    assert main(["tube", str(folder)]) == 0
    assert "--tube shoulder=0.0151,elbow=0.003" in capsys.readouterr().out


def test_commands_replace_each_other_from_where_they_begin(tmp_path):
    rows = []
    for k in range(10):  # each command is a ramp of 0.2 s, and the next one comes after 0.1 s
        begin = 0.1 * k
        points = [begin, begin + 0.1, begin + 0.2]
        rows_of = [asked(t) + (9.0 if i == 2 and k < 9 else 0.0) for i, t in enumerate(points)]
        content = messages.joint_trajectory(round(1e9 * (50 + begin)), JOINTS, [0.0, 0.1, 0.2], positions=rows_of)
        rows.append(("/command", messages.JOINT_TRAJECTORY, begin, content))
    for t in np.arange(0, 1, 0.02):
        names = ("gripper", "elbow", "shoulder")
        q = [0.0, *asked(t)[::-1]]
        rows.append(
            ("/joint_states", messages.JOINT_STATE, t, messages.joint_state(round(1e9 * (50 + t)), names, q, []))
        )
        rows.append(
            ("/joint_states", messages.JOINT_STATE, t, messages.joint_state(round(1e9 * (50 + t)), ["wheel"], [t], []))
        )
    commanded, measured = read_joint_log(write_bag(tmp_path / "bag", rows))
    np.testing.assert_allclose(commanded.times, np.arange(12) * 0.1, atol=1e-6)
    np.testing.assert_allclose(commanded.knots, [asked(0.1 * k) for k in range(12)], atol=1e-6)
    np.testing.assert_allclose(measured.at(np.array([0.5])), [asked(0.5)], atol=1e-4)


COMMANDED, MEASURED = ("/c", 0.0, JOINTS, [0, 1]), ("/m", 0.0, JOINTS, [0, 1])


@pytest.mark.parametrize(
    ("rows", "topics", "message"),
    [
        ([], (None, None), "has no topic of trajectory_msgs"),
        ([COMMANDED], (None, None), "has no topic of trajectory_msgs"),
        ([COMMANDED], ("/x", None), "--commanded-topic: unknown topic '/x'"),
        ([COMMANDED, MEASURED], ("/c", "/m"), "samples of shoulder, elbow at two times at least, got 1"),
        ([COMMANDED, ("/m", 0.0, ["elbow"], [0])], ("/c", "/m"), "joints: shoulder missing at 0.000 s|two times"),
        ([("/c", 0.0, JOINTS, [0]), MEASURED], ("/c", "/m"), "/c: has 2 joints, but 1 positions"),
        ([COMMANDED, ("/c", 0.1, JOINTS, [0, np.nan]), MEASURED], ("/c", "/m"), "finite"),
    ],
)
def test_joints_that_cannot_be_read(tmp_path, rows, topics, message):
    given = [(topic, messages.JOINT_STATE, 1 + t, messages.joint_state(0, names, q, [])) for topic, t, names, q in rows]
    folder = write_bag(tmp_path / "bag", given or [("/joint_states", messages.JOINT_STATE, 0.0, {})])
    with pytest.raises(InputError, match=message):
        read_joint_log(folder, *topics)


def test_topics_are_for_recordings(tmp_path, capsys):
    (tmp_path / "log.csv").write_text("time,a_commanded,a_measured\n0,0,0\n1,1,1\n")
    assert main(["tube", str(tmp_path / "log.csv"), "--measured-topic", "/x"]) == 2
    assert "are for recordings, not for" in capsys.readouterr().err
    assert (
        main(["live", "panda_shelf", "--people", str(tmp_path / "log.csv"), "--topic", "/x", "--out", str(tmp_path)])
        == 2
    )
    assert "--topic: is for bags, not for" in capsys.readouterr().err
