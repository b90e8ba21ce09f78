"""Ticks as a log that Foxglove opens (MCAP), and read back.

A log has, for every tick, on

* ``/tick`` the tick itself, as in ``ticks.jsonl`` (JSON);
* ``/joint_states`` (sensor_msgs/JointState) where the robot is, and ``/command`` (trajectory_msgs/JointTrajectory) what
  it does from then on until it stands;
* ``/people`` (visualization_msgs/MarkerArray) key points: the namespace is the person, the text the key point;
* ``/diagnostics`` (diagnostic_msgs/DiagnosticArray) state, reason, distances and margins;
* ``/tf`` (tf2_msgs/TFMessage) and ``/scene/limbs`` (visualization_msgs/MarkerArray) what moves;

and once, on ``/scene/robot`` and ``/scene/obstacles`` (visualization_msgs/MarkerArray), the robot's bodies and what is
around it. An attachment, ``header.json``, is the header of the ticks. Messages of ROS are in its own encoding (CDR),
ticks are JSON. Times are those of the ticks, in nanoseconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from safe_ompl.apps.exchange import messages, scene_markers
from safe_ompl.apps.exchange.received import WORLD
from safe_ompl.common import InputError
from safe_ompl.geometry import Pose
from safe_ompl.io import check_header, strict_json
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.version import __version__
from safe_ompl.view import RobotBody

TICK, HEADER = "/tick", "header.json"
_TICK_SCHEMA = json.dumps({"title": "safe_ompl.Tick", "type": "object"})
_CHUNK = 1 << 20  # [bytes]
_TOPICS = {
    TICK: "safe_ompl.Tick",
    "/joint_states": messages.JOINT_STATE,
    "/command": messages.JOINT_TRAJECTORY,
    "/people": messages.MARKERS,
    "/diagnostics": messages.DIAGNOSTICS,
    "/tf": messages.TRANSFORMS,
    **{f"/scene/{what}": messages.MARKERS for what in ("robot", "obstacles", "limbs")},
}


class McapLog:
    """A log of ticks; it can be opened, cut short, once it is closed.

    Parameters
    ----------
    file : path-like
        Where it is written.
    header : mapping
        The header of the ticks, see `safe_ompl.io.ticks`.
    robot : Robot
        Drawn with the bodies that are checked for collisions.
    scene : Scene
        What is around it; obstacles that `header` has among its objects move.
    """

    def __init__(self, file: str | Path, header: Mapping[str, Any], robot: Robot, scene: Scene) -> None:
        self._header, self._name = header, robot.name
        self._stream = Path(file).open("wb")  # noqa: SIM115 (`close` closes it)
        self._writer = Writer(self._stream, chunk_size=_CHUNK)
        self._writer.start(library=f"safe-ompl {__version__}")
        carried = strict_json(header).encode()
        self._writer.add_attachment(0, 0, HEADER, "application/json", carried)
        self._channels = {topic: self._channel(topic, kind) for topic, kind in _TOPICS.items()}
        self._body = RobotBody(robot, coarse=True)
        self._parts = [part.name for part in robot.shared.collision_model.geometryObjects]
        self._scene: Scene | None = scene  # until it is written

    def _channel(self, topic: str, kind: str) -> int:
        encoding, form, text = "json", "jsonschema", _TICK_SCHEMA
        if topic != TICK:
            encoding, form, text = "cdr", "ros2msg", messages.definition(kind)
        schema = self._writer.register_schema(kind, form, text.encode())
        return int(self._writer.register_channel(topic, encoding, schema))

    def write(self, tick: Mapping[str, Any]) -> None:
        """Write all messages of a tick."""
        time, names = messages.nanoseconds(tick["time"]), self._header["joint_names"]
        if self._scene is not None:
            self._write_still(time, self._scene)
            self._scene = None
        stop, people = tick["stop"], tick["people"]
        self._add(TICK, time, tick)
        measured = messages.nanoseconds(tick.get("joints_measured", tick["time"]))
        self._add("/joint_states", time, messages.joint_state(measured, names, tick["q"], tick["qd"]))
        if stop["times"]:
            begin, after = stop["times"][0], np.asarray(stop["times"]) - stop["times"][0]
            rows = {"positions": stop["q"], "velocities": stop["qd"]}
            command = messages.joint_trajectory(messages.nanoseconds(begin), names, after.tolist(), **rows)
            self._add("/command", time, command)
        self._add("/people", time, messages.people_markers(time, WORLD, people))
        self._add("/diagnostics", time, messages.diagnostics(time, self._name, tick))
        self._add("/tf", time, scene_markers.transforms(time, self._places(tick)))
        self._add("/scene/limbs", time, scene_markers.limb_markers(time, people, self._header["people"]))

    def _places(self, tick: Mapping[str, Any]) -> dict[str, Any]:
        """Return where the parts of the robot and the objects that move are."""
        places = self._body.placements(np.array(tick["q"]))
        found = {scene_markers.body_frame(name): place for name, place in zip(self._parts, places, strict=False)}
        for name, place in tick["objects"].items():
            pose = Pose(tuple(place["position"]), tuple(place["quaternion_xyzw"]))
            found[scene_markers.obstacle_frame(name)] = pose.se3
        return found

    def _write_still(self, time: int, scene: Scene) -> None:
        """Write what the robot and what is around it look like."""
        moving = self._header["objects"]
        self._add("/scene/robot", time, scene_markers.robot_markers(time, self._body, self._parts))
        self._add("/scene/obstacles", time, scene_markers.obstacle_markers(time, scene, moving))

    def _add(self, topic: str, time: int, content: Mapping[str, Any]) -> None:
        data = strict_json(content).encode() if topic == TICK else messages.encoded(_TOPICS[topic], content)
        self._writer.add_message(self._channels[topic], time, data, time)

    def close(self) -> None:
        """Write what is left and the index, and close the file."""
        self._writer.finish()
        self._stream.close()


@contextmanager
def reading(file: str | Path) -> Iterator[None]:
    """Turn what readers raise of a broken file into one InputError that names it; only readers may be called inside."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(file)) from None
    except Exception as error:  # struct.error, KeyError, zstd's errors, …, of what is broken
        what = " ".join(str(error).split()) or type(error).__name__
        advice = "; `mcap recover` may save a part" if Path(file).suffix.lower() == ".mcap" else ""
        raise InputError(f"is broken, cut off, or no recording ({what}){advice}", str(file)) from None


def read_log(file: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the header and the ticks of a log.

    Raises
    ------
    InputError
        If it cannot be read, is broken, or holds no ticks.
    """
    with reading(file), Path(file).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        headers = [json.loads(part.data) for part in reader.iter_attachments() if part.name == HEADER]
        ticks = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=[TICK])]
    if not headers or not ticks:
        raise InputError(f"holds no ticks of safe-ompl (an attachment {HEADER}, a topic {TICK})", str(file))
    check_header(headers[0], file)
    return headers[0], ticks
