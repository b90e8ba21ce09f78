"""Logs and recordings: ticks as a log that Foxglove opens (MCAP), and joints from recordings of ROS 2.

A log has, for every tick, on

* ``/tick`` the tick itself, as in ``ticks.jsonl`` (JSON);
* ``/joint_states`` (sensor_msgs/JointState) the state of the robot, and ``/command`` (trajectory_msgs/JointTrajectory)
  the command until the robot stands;
* ``/people`` (visualization_msgs/MarkerArray) key points: the namespace is the person, the text the key point;
* ``/diagnostics`` (diagnostic_msgs/DiagnosticArray) state, reason, distances and margins.

An attachment, ``header.json``, is the header of the ticks. Messages of ROS are in its own encoding (CDR), ticks are
JSON. Times are those of the ticks, in nanoseconds.

Recordings of ROS 2 are MCAP, and rosbag2's folders and databases. Joints are `sensor_msgs/JointState`,
`trajectory_msgs/JointTrajectory`, of which each takes the place of the one before from its own beginning on, or
`control_msgs/JointTrajectoryControllerState`, which has both what was commanded and what was measured. The time of a
message is its stamp; without one, when it was recorded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from safe_ompl.common import FloatArray, InputError, UnknownNameError, documents as document
from safe_ompl.io import check_header, strict_json
from safe_ompl.live.ros import messages
from safe_ompl.motions import Motion
from safe_ompl.version import __version__

TICK, HEADER = "/tick", "header.json"
_TICK_SCHEMA = json.dumps({"title": "safe_ompl.Tick", "type": "object"})
_CHUNK = 1 << 20  # [bytes]
_CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
_TOPICS = {
    TICK: "safe_ompl.Tick",
    "/joint_states": messages.JOINT_STATE,
    "/command": messages.JOINT_TRAJECTORY,
    "/people": messages.MARKERS,
    "/diagnostics": messages.DIAGNOSTICS,
}


class McapLog:
    """A log of ticks with a header (`safe_ompl.io.ticks`). It can be read after an interruption, if it was closed."""

    def __init__(self, file: str | Path, header: Mapping[str, Any]) -> None:
        self._names, self._name = header["joint_names"], header["robot"]["name"]
        self._stream = Path(file).open("wb")  # noqa: SIM115 (`close` closes it)
        self._writer = Writer(self._stream, chunk_size=_CHUNK)
        self._writer.start(library=f"safe-ompl {__version__}")
        self._writer.add_attachment(0, 0, HEADER, "application/json", strict_json(header).encode())
        self._channels = {topic: self._channel(topic, kind) for topic, kind in _TOPICS.items()}

    def _channel(self, topic: str, kind: str) -> int:
        encoding, form, text = "json", "jsonschema", _TICK_SCHEMA
        if topic != TICK:
            encoding, form, text = "cdr", "ros2msg", messages.definition(kind)
        schema = self._writer.register_schema(kind, form, text.encode())
        return int(self._writer.register_channel(topic, encoding, schema))

    def write(self, tick: Mapping[str, Any]) -> None:
        """Write all messages of a tick."""
        time, names = messages.nanoseconds(tick["time"]), self._names
        stop, people = tick["stop"], tick["people"]
        self._add(TICK, time, tick)
        measured = messages.nanoseconds(tick.get("joints_measured", tick["time"]))
        self._add("/joint_states", time, messages.joint_state(measured, names, tick["q"], tick["qd"]))
        if stop["times"]:
            rows = {"positions": stop["q"], "velocities": stop["qd"]}
            self._add("/command", time, messages.joint_trajectory(names, stop["times"], **rows))
        self._add("/people", time, messages.people_markers(time, people))
        self._add("/diagnostics", time, messages.diagnostics(time, self._name, tick))

    def _add(self, topic: str, time: int, content: Mapping[str, Any]) -> None:
        data = strict_json(content).encode() if topic == TICK else messages.encoded(_TOPICS[topic], content)
        self._writer.add_message(self._channels[topic], time, data, time)

    def close(self) -> None:
        """Write the remaining data and the index, and close the file."""
        self._writer.finish()
        self._stream.close()


@contextmanager
def reading(file: str | Path) -> Iterator[None]:
    """Convert the exceptions of readers for a broken file to an InputError. Only readers may be called inside."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(file)) from None
    # A broken file raises struct.error, KeyError, zstd's errors and others.
    except Exception as error:
        what = " ".join(str(error).split()) or type(error).__name__
        advice = "; `mcap recover` may save a part" if Path(file).suffix.lower() == ".mcap" else ""
        raise InputError(f"is broken, cut off, or no recording ({what}){advice}", str(file)) from None


def read_log(file: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return header and ticks of a log. Raises InputError if the log cannot be read, is broken, or has no ticks."""
    with reading(file), Path(file).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        headers = [json.loads(part.data) for part in reader.iter_attachments() if part.name == HEADER]
        ticks = [json.loads(message.data) for _, _, message in reader.iter_messages(topics=[TICK])]
    if not headers or not ticks:
        raise InputError(f"holds no ticks of safe-ompl (an attachment {HEADER}, a topic {TICK})", str(file))
    check_header(headers[0], file)
    return headers[0], ticks


# ------------------------------------------------------------------------------------------------------- recordings


Rows = list[tuple[int, dict[str, float]]]  # [ns], values by name


class Bag:
    """A recording with the types of its `topics`. Raises InputError if it cannot be read or is broken."""

    def __init__(self, file: str | Path) -> None:
        self.file = str(file)
        with reading(file), _opened(Path(file)) as (topics, _):
            self.topics = topics

    def read(self, topic: str) -> list[tuple[int, Any]]:
        """Return all messages of a topic and their recording times [ns]. Raises InputError if a message is broken."""
        with reading(self.file), _opened(Path(self.file)) as (_, read):
            return list(read(topic))

    def topic(self, given: str | None, kinds: Collection[str], option: str) -> str:
        """Return the given topic, or the only topic of the types. Raises InputError if there is none or several."""
        fit = sorted(topic for topic, kind in self.topics.items() if kind in kinds)
        if given is None:
            if len(fit) != 1:
                known = ", ".join(fit) or "no topic"
                raise InputError(f"has {known} of {' or '.join(kinds)}: say which with {option}", self.file)
            return fit[0]
        if given not in self.topics:
            raise UnknownNameError("topic", given, self.topics, option)
        if given not in fit:
            raise InputError(f"{given!r} is {self.topics[given]}, not {' or '.join(kinds)}", option)
        return given


@contextmanager
def _opened(path: Path) -> Iterator[tuple[dict[str, str], Callable[[str], Iterator[tuple[int, Any]]]]]:
    """Yield the topics with their types, and a function that reads a topic."""
    if path.suffix.lower() != ".mcap" or path.is_dir():
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            yield {each.topic: each.msgtype for each in bag.connections}, partial(_bag_messages, bag)
        return
    # rosbags does not read logs that contain other messages as well.
    with path.open("rb") as stream:
        reader, types, topics = make_reader(stream, validate_crcs=True), get_typestore(Stores.EMPTY), {}
        summary = reader.get_summary()
        for channel in () if summary is None else summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is not None and (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg"):
                types.register(get_types_from_msg(schema.data.decode(), schema.name))
                topics[channel.topic] = schema.name

        def read(topic: str) -> Iterator[tuple[int, Any]]:
            for _, _, message in reader.iter_messages(topics=[topic]):
                yield message.log_time, types.deserialize_cdr(message.data, topics[topic])

        yield topics, read


def _bag_messages(bag: AnyReader, topic: str) -> Iterator[tuple[int, Any]]:
    chosen = [connection for connection in bag.connections if connection.topic == topic]
    for connection, time, data in bag.messages(chosen):
        yield time, bag.deserialize(data, connection.msgtype)


def _stamp(header: Any, recorded: int) -> int:
    time = header.stamp.sec * messages.SECOND + header.stamp.nanosec
    return time if time > 0 else recorded


def read_joint_log(
    file: str | Path, commanded: str | None = None, measured: str | None = None
) -> tuple[Motion, Motion]:
    """Return the commanded and the measured motion of a recording, interpolated linearly between samples.

    By default the topics are the only `JointTrajectoryControllerState`, if there is one, else the only
    `JointTrajectory` and the only `JointState`. Raises InputError if the recording cannot be read, or if a topic is
    missing or ambiguous.
    """
    bag = Bag(file)
    states = [topic for topic, kind in bag.topics.items() if kind == _CONTROLLER_STATE]
    if commanded is None and measured is None and len(states) == 1:
        commanded = measured = states[0]
    kinds = (messages.JOINT_TRAJECTORY, _CONTROLLER_STATE, messages.JOINT_STATE)
    topic = bag.topic(commanded, (messages.JOINT_TRAJECTORY,) if commanded is None else kinds, "--commanded-topic")
    asked = _rows(bag, topic, ("reference", "desired"))
    topic = bag.topic(measured, (messages.JOINT_STATE,) if measured is None else kinds[1:], "--measured-topic")
    found = _rows(bag, topic, ("feedback", "actual"))
    names = tuple(asked[0][1])
    begin = min(asked[0][0], found[0][0])
    with document.within(str(file), ": "):
        return tuple(_motion(rows, names, begin) for rows in (asked, found))  # type: ignore[return-value]


def _rows(bag: Bag, topic: str, keys: Sequence[str]) -> Rows:
    """Return the samples of a topic in the order of their times. `keys`: the fields of a controller's state to use."""
    kind = bag.topics[topic]
    rows: Rows = []
    found = [(_stamp(message.header, time), message) for time, message in bag.read(topic)]
    for time, message in sorted(found, key=lambda each: each[0]):
        if kind == messages.JOINT_TRAJECTORY:
            while rows and rows[-1][0] >= time:
                rows.pop()
            for point in message.points:
                after = point.time_from_start.sec * messages.SECOND + point.time_from_start.nanosec
                rows.append((time + after, _by_name(message.joint_names, point.positions, topic)))
        elif kind == _CONTROLLER_STATE:
            point = next(each for key in keys if (each := getattr(message, key, None)) is not None)
            rows.append((time, _by_name(message.joint_names, point.positions, topic)))
        else:
            rows.append((time, _by_name(message.name, message.position, topic)))
    if not rows:
        raise InputError("has no messages", f"{bag.file}: {topic}")
    return rows


def _by_name(names: Sequence[str], values: FloatArray, topic: str) -> dict[str, float]:
    if len(names) != len(values):
        raise InputError(f"has {len(names)} joints, but {len(values)} positions", topic)
    return dict(zip(names, values.tolist(), strict=True))


def _motion(rows: Rows, names: tuple[str, ...], begin: int) -> Motion:
    """Return the samples of the named joints as a motion. Samples without these joints are left out."""
    own = [(time, values) for time, values in rows if any(name in values for name in names)]
    for time, values in own:
        missing = [name for name in names if name not in values]
        if missing:
            at = (time - begin) / messages.SECOND
            raise InputError(f"{', '.join(missing)} missing at {at:.3f} s", "joints")
    # Of samples with equal times, the last one counts.
    last = dict(own)
    if len(last) < 2:
        raise InputError(f"must have samples of {', '.join(names)} at two or more times, got {len(last)}")
    times = (np.array(list(last)) - begin) / messages.SECOND
    table = [[values[name] for name in names] for values in last.values()]
    return Motion.hermite(times, table, names=names)
