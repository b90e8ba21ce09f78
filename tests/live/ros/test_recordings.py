"""Joints from recordings of ROS 2 that other programs wrote, in all forms that there are."""

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from safe_ompl.apps import main
from safe_ompl.common import InputError
from safe_ompl.live.ros import messages, read_joint_log

TYPES = get_typestore(Stores.ROS2_JAZZY)
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
        kind_of = "trajectory_msgs/msg/JointTrajectoryPoint"
        parts = {name: filled(kind_of, content.get(name, {})) for name in ("reference", "feedback", "error")}
        header = filled("std_msgs/msg/Header", content["header"])
        return TYPES.types[kind](header=header, joint_names=list(content["joint_names"]), **parts)
    return TYPES.deserialize_cdr(messages.encoded(kind, content), kind)


def asked(t):
    return np.array([np.sin(t), 0.5 * t])


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_the_tube_of_a_controllers_state(tmp_path, capsys, plugin):
    rows = []
    for t in np.arange(0, 2, 0.02):
        state = {"header": messages.header(round(1e9 * (100 + t))), "joint_names": JOINTS}
        state |= {"reference": {"positions": asked(t)}, "feedback": {"positions": asked(t) - [0.01, 0.002]}}
        rows.append(("/controller/state", STATE, t, state))
    folder = write_bag(tmp_path / "bag", rows, plugin)
    commanded, measured = read_joint_log(folder)
    (file,) = [file for file in folder.iterdir() if file.suffix in (".mcap", ".db3")]
    np.testing.assert_array_equal(read_joint_log(file)[0].knots, commanded.knots)
    assert commanded.joint_names == measured.joint_names == JOINTS
    np.testing.assert_allclose(commanded.at(np.array([1.0])) - measured.at(np.array([1.0])), [[0.01, 0.002]], atol=1e-9)
    assert main(["tube", str(folder)]) == 0
    assert "--tube shoulder=0.0151,elbow=0.003" in capsys.readouterr().out


def test_commands_replace_each_other_from_where_they_begin(tmp_path):
    rows = []
    for k in range(10):  # each command is a ramp of 0.25 s, and the next one comes after 0.1 s
        points = 0.1 * k + np.array([0.0, 0.1, 0.25])
        rows_of = [asked(t) + (9.0 if i == 2 and k < 9 else 0.0) for i, t in enumerate(points)]
        content = messages.joint_trajectory(JOINTS, 50 + points, positions=rows_of)
        rows.append(("/command", messages.JOINT_TRAJECTORY, points[0], content))
    for t in np.arange(0, 1, 0.02):
        for names, q in ((("gripper", "elbow", "shoulder"), [0.0, *asked(t)[::-1]]), (["wheel"], [t])):
            state = messages.joint_state(round(1e9 * (50 + t)), names, q, [])
            rows.append(("/joint_states", messages.JOINT_STATE, t, state))
    commanded, measured = read_joint_log(write_bag(tmp_path / "bag", rows))
    times = [*0.1 * np.arange(11), 1.15]
    np.testing.assert_allclose(commanded.times, times, atol=1e-6)
    np.testing.assert_allclose(commanded.knots, [asked(t) for t in times], atol=1e-6)
    np.testing.assert_allclose(measured.at(np.array([0.5])), [asked(0.5)], atol=1e-4)


COMMANDED, MEASURED = ("/c", 0.0, JOINTS, [0, 1]), ("/m", 0.0, JOINTS, [0, 1])


@pytest.mark.parametrize(
    ("rows", "topics", "message"),
    [
        ([], (None, None), "has no topic of trajectory_msgs"),
        ([COMMANDED], (None, None), "has no topic of trajectory_msgs"),
        ([COMMANDED], ("/x", None), "--commanded-topic: unknown topic '/x'"),
        ([COMMANDED, MEASURED], ("/c", "/m"), "samples of shoulder, elbow at two or more times, got 1"),
        ([COMMANDED, ("/m", 0.0, ["elbow"], [0])], ("/c", "/m"), "shoulder missing at 0.000 s|at two or more times"),
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
