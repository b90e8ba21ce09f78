"""Logs for Foxglove: read back with mcap's own reader and compared with the ticks that were written beside them."""

import json
from collections import defaultdict
from itertools import pairwise

import numpy as np
import pytest

mcap_reader = pytest.importorskip("mcap.reader")
pytest.importorskip("rosbags")
from mcap.writer import Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

from safe_ompl import InputError, Obstacle, Pose, Scene, Shield, Sphere, Surroundings, Tracker  # noqa: E402
from safe_ompl.apps import main  # noqa: E402
from safe_ompl.apps.cli import output  # noqa: E402
from safe_ompl.drawing import read_recording  # noqa: E402
from safe_ompl.io import built_scene, read_ticks, strict_json  # noqa: E402
from safe_ompl.live import find_skeleton  # noqa: E402
from safe_ompl.live.ros import McapLog, messages, read_log  # noqa: E402

MARKERS = "visualization_msgs/msg/MarkerArray"
TOPICS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/command": "trajectory_msgs/msg/JointTrajectory",
    "/people": MARKERS,
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
LIVE = ["live", "panda_shelf", "--people", "random:2", "--movers", "1", "--seconds", "1"]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Folder with the ticks and the log of a drive beside two people and a ball."""
    folder = tmp_path_factory.mktemp("drive")
    assert main([*LIVE, "--out", str(folder), "--mcap", str(folder / "drive.mcap")]) == 0
    return folder


@pytest.fixture(scope="module")
def recorded(drive):
    """Header and ticks."""
    return read_ticks(drive / "ticks.jsonl")


@pytest.fixture(scope="module")
def log(drive, recorded):
    """By topic: messages (plain data or rosbags' objects), of which topics, types and times are right."""
    found, times, types, topics = defaultdict(list), defaultdict(list), get_typestore(Stores.EMPTY), {}
    with (drive / "drive.mcap").open("rb") as stream:
        reader = mcap_reader.make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.topic == "/tick":
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                content = json.loads(message.data)
            else:
                assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
                types.register(get_types_from_msg(schema.data.decode(), schema.name))
                content, topics[channel.topic] = types.deserialize_cdr(message.data, schema.name), schema.name
            found[channel.topic].append(content)
            times[channel.topic].append(message.log_time)
    assert topics == TOPICS
    wanted = [round(1e9 * tick["time"]) for tick in recorded[1]]
    begin = [round(1e9 * tick["stop"]["times"][0]) for tick in recorded[1]]
    for topic, at in times.items():
        assert at == wanted
        if topic != "/tick":
            assert [stamp(content) for content in found[topic]] == (begin if topic == "/command" else at)
    return found


def stamp(content):
    """Time that a message says [ns]."""
    many = getattr(content, "markers", None)
    inner = many[0] if many else content
    return inner.header.stamp.sec * 10**9 + inner.header.stamp.nanosec


def test_joints_commands_and_diagnostics_are_those_of_the_ticks(log, recorded):
    header, ticks = recorded
    assert log["/tick"] == ticks
    rows = zip(ticks, log["/joint_states"], log["/command"], log["/diagnostics"], strict=True)
    for tick, joints, command, diagnostics in rows:
        assert joints.name == command.joint_names == header["joint_names"]
        assert joints.position.tolist() == command.points[0].positions.tolist() == tick["q"]
        assert joints.velocity.tolist() == tick["qd"]
        assert [point.positions.tolist() for point in command.points] == tick["stop"]["q"]
        assert np.abs(command.points[-1].velocities).max() == 0.0  # it ends in a stop
        (status,) = diagnostics.status
        values = {item.key: item.value for item in status.values}
        assert values["state"] == tick["state"]
        assert float(values["distance"]) == pytest.approx(tick["distance"], rel=1e-5)
        assert status.message.startswith(tick["state"])
        assert (status.level == 0) == (tick["state"] in ("moving", "slowed", "done"))
    (alarm,) = messages.diagnostics(7, "panda", {**ticks[0], "obeyed": False})["status"]
    assert alarm["level"] == 2
    for tick, after in pairwise(ticks):  # the stop ends where the next tick begins at the soonest
        times = tick["stop"]["times"]
        assert times[0] == tick["time"] or tick is ticks[0]  # the first command holds a latency later
        assert (np.diff(times) > 0).all()
        assert times[-1] > after["time"] or not tick["state"] == after["state"] == "moving"


def test_people_are_markers_with_names(log, recorded):
    for tick, people in zip(recorded[1], log["/people"], strict=True):
        assert people.markers[0].action == 3  # deletes those of the tick before
        found = defaultdict(dict)
        for marker in people.markers[1:]:
            assert marker.header.frame_id == "world"
            place = marker.pose.position
            found[marker.ns][marker.text] = [place.x, place.y, place.z]
        for who, points in tick["people"].items():
            assert found[who] == {name: place for name, place in points.items() if None not in place}
        assert len(found["operator"]) == 17  # the pelvis is not seen


def test_obstacles_are_drawn_where_they_are(recorded):
    scene = built_scene(recorded[0]["scene"])
    drawn = messages.obstacle_markers(7, scene)["markers"][1:]
    assert {marker["ns"] for marker in drawn} == set(scene.names)
    for marker in drawn:
        vertices, faces = scene[marker["ns"]].shape.triangles(24)
        corners = np.array([list(point.values()) for point in marker["points"]])
        np.testing.assert_allclose(corners, vertices[faces].reshape(-1, 3), atol=1e-6)
        assert list(marker["pose"]["position"].values()) == list(scene[marker["ns"]].pose.position)


def test_it_is_read_back_also_cut_short_and_seen(drive, recorded, tmp_path):
    header, ticks = recorded
    assert read_log(drive / "drive.mcap") == recorded
    log = McapLog(tmp_path / "a.mcap", header)
    for tick in ticks[:3]:
        log.write(tick)
    log.close()
    assert read_log(tmp_path / "a.mcap")[1] == ticks[:3]
    pytest.importorskip("viser")
    assert main(["view", str(drive / "drive.mcap"), "--html", str(drive / "drive.html")]) == 0
    assert (drive / "drive.html").stat().st_size > 100_000


def test_a_shield_is_logged_and_read_back(panda, tmp_path):
    scene, anna = Scene((Obstacle("ball", Sphere(0.1)),)), Tracker(find_skeleton("coco17"))
    shield, file = Shield(panda, Surroundings(scene, {"anna": anna}, {"ball": 1.6})), tmp_path / "shield.mcap"
    seen = np.random.default_rng(0).uniform([1.7, -0.3, -0.3], [2.3, 0.3, 0.3], (17, 3))
    home = np.array([-1.0, 0.0, 0.0, -2.0, 0.0, 2.2, 0.785])
    shield.start(home)
    written, log = [], McapLog(file, shield.log_header())
    for k in range(12):
        shield.update({"anna": seen}, {"ball": Pose((2.0, 0.05 * k, 0.5))}, 0.05 * k)
        if k < 6:
            shield.propose(home + np.linspace(0, 0.2, 8)[:, None] * np.eye(7)[0] + 0.01 * k, rate=20.0)
        command = shield.command(0.05 * k + 0.02)
        written.append(shield.log_tick())
        log.write(written[-1])
        np.testing.assert_allclose(written[-1]["stop"]["q"][-1], command.at(np.inf).q)
        assert (written[-1]["follows"], written[-1]["state"]) == (command.follows, command.action.value)
    log.close()
    header, ticks = read_log(file)
    assert ticks == json.loads(strict_json(written))
    assert header["objects"] == {"ball": 1.6}
    assert ticks[5]["people"]["anna"]["left_wrist"] == seen[9].tolist()
    content = read_recording(file, read=read_log)
    np.testing.assert_array_equal(content.motions["live"].motion.knots[5], written[5]["q"])


BROKEN = [
    lambda data: data[: len(data) // 2],
    lambda data: data[:-1],
    lambda data: b"",
    lambda data: b"{}\n",
    lambda data: data[:9000] + bytes(200) + data[9200:],
    None,
]


@pytest.mark.parametrize("change", BROKEN)
def test_broken_files_are_refused_in_one_line(drive, tmp_path, capsys, change):
    file, message = tmp_path / "bad.mcap", "cannot be read (No such file or directory)"
    if change is not None:
        file.write_bytes(change((drive / "drive.mcap").read_bytes()))
        message = "is broken, cut off, or no recording"
    for words in (["view", str(file), "--html", str(tmp_path / "a.html")], ["tube", str(file)]):
        capsys.readouterr()
        assert main(words) == 2
        error = capsys.readouterr().err.strip()
        assert f"{file}: {message}" in error
        assert len(error.splitlines()) == 1


def test_other_logs_hold_no_ticks(tmp_path):
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    with pytest.raises(InputError, match=r"other.mcap: holds no ticks of safe-ompl"):
        read_log(tmp_path / "other.mcap")


def test_the_option_is_checked_first(tmp_path, capsys, monkeypatch):
    words = [*LIVE, "--out", str(tmp_path), "--mcap"]
    assert main([*words, "log.txt"]) == 2
    assert "--mcap: 'log.txt' must end in .mcap" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "no" / "log.mcap")]) == 2
    assert "--mcap: cannot write" in capsys.readouterr().err
    monkeypatch.setitem(output.EXTRAS, "mcap", ("no_such", "logs"))
    assert main([*words, "log.mcap"]) == 2
    assert "pip install 'safe-ompl[mcap]'" in capsys.readouterr().err
