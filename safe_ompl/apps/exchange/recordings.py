"""People and joints from recordings of ROS 2: MCAP, and rosbag2's folders and databases.

People are a `visualization_msgs/MarkerArray` (the namespace is the person, the id the number of the key point, the text
its name if it has one) or a `geometry_msgs/PoseArray` (the poses are the key points of one person, NaN where one is not
seen). Joints are `sensor_msgs/JointState`, `trajectory_msgs/JointTrajectory`, of which each takes the place of the one
before from its own beginning on, or `control_msgs/JointTrajectoryControllerState`, which has both what was commanded
and what was measured. The time of a message is its stamp; without one, when it was recorded. Lengths are metres, and z
points upwards, whatever the skeleton.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from safe_ompl.apps.exchange.mcap_log import reading
from safe_ompl.apps.exchange.messages import JOINT_STATE, JOINT_TRAJECTORY, MARKERS, POSES, SECOND
from safe_ompl.apps.exchange.received import DELETIONS, in_metres
from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.common import documents as document
from safe_ompl.geometry import STANDING
from safe_ompl.motions import Motion
from safe_ompl.people import Recording, Skeleton, find_skeleton, skeleton_of
from safe_ompl.people.simulation import ALL_KEYPOINTS

CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
_GAP = 3.5  # usual times between two messages: nobody is seen in a longer one

Rows = list[tuple[int, dict[str, float]]]
"""Times [ns], and values by name."""


class Bag:
    """A recording: the types of its `topics`; raises InputError if it cannot be read or is broken."""

    def __init__(self, file: str | Path) -> None:
        self.file = str(file)
        with reading(file), _opened(Path(file)) as (topics, _):
            self.topics = topics

    def read(self, topic: str) -> list[tuple[int, Any]]:
        """Return all messages of a topic, and when they were recorded [ns]; raises InputError if one is broken."""
        with reading(self.file), _opened(Path(self.file)) as (_, messages):
            return list(messages(topic))

    def topic(self, given: str | None, kinds: Collection[str], option: str) -> str:
        """Return the topic that is given, or the only one of some types.

        Raises
        ------
        InputError
            If there is none, or several, or the topic has another type.
        UnknownNameError
            If there is no such topic.
        """
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


Topics = tuple[dict[str, str], Callable[[str], Iterator[tuple[int, Any]]]]


@contextmanager
def _opened(path: Path) -> Iterator[Topics]:
    """Yield topics with their types, and what reads one."""
    if path.suffix.lower() != ".mcap" or path.is_dir():
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            yield {each.topic: each.msgtype for each in bag.connections}, partial(_bag_messages, bag)
        return
    with path.open("rb") as stream:  # rosbags reads no logs that have other messages, too
        reader, types, topics = make_reader(stream, validate_crcs=True), get_typestore(Stores.EMPTY), {}
        summary = reader.get_summary()
        for channel in () if summary is None else summary.channels.values():
            schema = summary.schemas.get(channel.schema_id)
            if schema is not None and (channel.message_encoding, schema.encoding) == ("cdr", "ros2msg"):
                types.register(get_types_from_msg(schema.data.decode(), schema.name))
                topics[channel.topic] = schema.name

        def messages(topic: str) -> Iterator[tuple[int, Any]]:
            for _, _, message in reader.iter_messages(topics=[topic]):
                yield message.log_time, types.deserialize_cdr(message.data, topics[topic])

        yield topics, messages


def _bag_messages(bag: AnyReader, topic: str) -> Iterator[tuple[int, Any]]:
    chosen = [connection for connection in bag.connections if connection.topic == topic]
    for connection, time, data in bag.messages(chosen):
        yield time, bag.deserialize(data, connection.msgtype)


def _stamp(header: Any, recorded: int) -> int:
    time = header.stamp.sec * SECOND + header.stamp.nanosec
    return time if time > 0 else recorded


# ------------------------------------------------------------------------------------------------------ people


class PeopleSource(NamedTuple):
    """A person in a recording; None is for what there is only one of."""

    topic: str | None = None
    who: str | None = None  # Namespace of markers
    skeleton: str | None = None  # Where the key points have no names


def read_people(file: str | Path, source: PeopleSource) -> Recording:
    """Return a person of a recording, at equal times.

    Between two messages key points are interpolated; where the next one is missing, nobody is seen.

    Raises
    ------
    InputError
        If the recording cannot be read, does not say what its key points are, has several topics or people to choose
        from, or fewer than two messages; if its frame changes.
    UnknownNameError
        If there is no such topic, person or skeleton.
    """
    skeleton = None if source.skeleton is None else in_metres(find_skeleton(source.skeleton))
    bag = Bag(file)
    topic = bag.topic(source.topic, (MARKERS, POSES), "--topic")
    with document.within(f"{file}: {topic}", ": "):
        if bag.topics[topic] == POSES:
            if source.who is not None:
                raise InputError("poses have no names: choose the person with --topic", "--clip")
            times, frames, names = _posed(bag.read(topic))
        else:
            times, frames, names = _marked(bag.read(topic), source.who)
        skeleton = _skeleton(names) if skeleton is None else skeleton
        if frames.shape[1] != len(skeleton.points):
            known = f"{skeleton.name} has {len(skeleton.points)}"
            raise InputError(f"has {frames.shape[1]} key points, {known}", "skeleton")
        if np.isinf(frames).any():
            raise InputError("must be finite, or NaN where they are not seen", "key points")
        return _evenly(times, frames, skeleton, f"{Path(file).name}:{topic}")


def _skeleton(names: Sequence[str]) -> Skeleton:
    if not all(names):
        raise InputError(f"{len(names)} key points without names: say which skeleton with --skeleton", "skeleton")
    return ALL_KEYPOINTS if tuple(names) == ALL_KEYPOINTS.points else in_metres(skeleton_of(names))


def _posed(found: Sequence[tuple[int, Any]]) -> tuple[list[int], FloatArray, list[str]]:
    """Return times, key points (T, J, 3), and empty names from a PoseArray."""
    _one_frame([message.header.frame_id for _, message in found])
    counts = {len(message.poses) for _, message in found}
    if len(counts) > 1:
        raise InputError(f"must have as many poses in all messages, got {sorted(counts)}", "poses")
    frames = [[_point(each.position) for each in message.poses] for _, message in found]
    table = np.array(frames, dtype=float).reshape(len(found), -1, 3)
    return [_stamp(message.header, time) for time, message in found], table, [""] * table.shape[1]


def _marked(found: Sequence[tuple[int, Any]], who: str | None) -> tuple[list[int], FloatArray, list[str]]:
    """Return times, key points (T, J, 3) and their names, those of our body in its own order, from a MarkerArray."""
    shown = [
        (time, [marker for marker in message.markers if marker.action not in DELETIONS]) for time, message in found
    ]
    _one_frame([marker.header.frame_id for _, markers in shown for marker in markers])
    people = sorted({marker.ns for _, markers in shown for marker in markers})
    if who is None:
        if len(people) != 1:
            raise InputError(f"has the people {', '.join(people) or '(none)'}: say who with --clip")
        who = people[0]
    elif who not in people:
        raise UnknownNameError("person", who, people)
    own = [(time, [marker for marker in markers if marker.ns == who]) for time, markers in shown]
    names = {marker.id: marker.text for _, markers in own for marker in markers}
    if min(names) < 0 or max(names) >= 1000:
        raise InputError(f"ids must be numbers of key points, got {min(names)} to {max(names)}")
    table = np.full((len(own), max(names) + 1, 3), np.nan)
    times = []
    for row, (time, markers) in enumerate(own):
        times.append(_stamp(markers[0].header, time) if markers else time)
        for marker in markers:
            table[row, marker.id] = _point(marker.pose.position)
    called = [names.get(k, "") for k in range(table.shape[1])]
    if set(STANDING) <= set(called):
        return times, table[:, [called.index(name) for name in STANDING]], list(STANDING)
    return times, table, called


def _point(place: Any) -> tuple[float, float, float]:
    return place.x, place.y, place.z


def _one_frame(frames: Collection[str]) -> None:
    if len(set(frames)) > 1:
        raise InputError(f"must be one in all messages, got {', '.join(sorted(set(frames)))}", "frame_id")


def _evenly(times: Sequence[int], frames: FloatArray, skeleton: Skeleton, source: str) -> Recording:
    """Return key points (T, J, 3) that were measured at some times [ns] as a recording."""
    order = np.argsort(times, kind="stable")
    sorted_times = np.asarray(times)[order]
    last = np.append(np.diff(sorted_times) > 0, True)  # of messages of one time the last one counts
    at, seen = (sorted_times[last] - sorted_times[0]) / SECOND, frames[order][last]
    if len(at) < 2:
        raise InputError(f"must have messages at two times at least, got {len(at)}")
    usual = float(np.median(np.diff(at)))
    even = np.arange(round(at[-1] / usual) + 1) * usual
    after = np.clip(np.searchsorted(at, even, side="left"), 1, len(at) - 1)
    span = at[after] - at[after - 1]
    share = np.clip((even - at[after - 1]) / span, 0.0, 1.0).round(6)[:, None, None]
    found = (1 - share) * seen[after - 1] + share * seen[after]
    found[span > _GAP * usual] = np.nan
    for exact, neighbour in ((share == 0, after - 1), (share == 1, after)):  # the other one may be NaN
        found = np.where(exact, seen[neighbour], found)
    return Recording(skeleton, 1 / usual, found, source)


# ------------------------------------------------------------------------------------------------------ joints


def read_joint_log(
    file: str | Path, commanded: str | None = None, measured: str | None = None
) -> tuple[Motion, Motion]:
    """Return the commanded and the measured motion of a recording; between samples they are straight.

    Parameters
    ----------
    file : path-like
        The recording.
    commanded, measured : str, optional
        Topics. Default: the only `JointTrajectoryControllerState`, if there is one; else the only `JointTrajectory` and
        the only `JointState`.

    Raises
    ------
    InputError
        If the recording cannot be read, or what is needed is not there, or there are several to choose from.
    UnknownNameError
        If there is no such topic.
    """
    bag = Bag(file)
    states = [topic for topic, kind in bag.topics.items() if kind == CONTROLLER_STATE]
    if commanded is None and measured is None and len(states) == 1:
        commanded = measured = states[0]
    kinds = (JOINT_TRAJECTORY, CONTROLLER_STATE, JOINT_STATE)
    topic = bag.topic(commanded, (JOINT_TRAJECTORY,) if commanded is None else kinds, "--commanded-topic")
    asked = _rows(bag, topic, ("reference", "desired"))
    topic = bag.topic(measured, (JOINT_STATE,) if measured is None else kinds[1:], "--measured-topic")
    found = _rows(bag, topic, ("feedback", "actual"))
    names = tuple(asked[0][1])
    begin = min(asked[0][0], found[0][0])
    with document.within(str(file), ": "):
        return tuple(_motion(rows, names, begin) for rows in (asked, found))  # type: ignore[return-value]


def _rows(bag: Bag, topic: str, keys: Sequence[str]) -> Rows:
    """Return the samples of a topic in the order of their times; of a controller's state what one of the keys names."""
    kind = bag.topics[topic]
    rows: Rows = []
    messages = [(_stamp(message.header, time), message) for time, message in bag.read(topic)]
    for time, message in sorted(messages, key=lambda each: each[0]):
        if kind == JOINT_TRAJECTORY:
            while rows and rows[-1][0] >= time:
                rows.pop()
            for point in message.points:
                after = point.time_from_start.sec * SECOND + point.time_from_start.nanosec
                rows.append((time + after, _by_name(message.joint_names, point.positions, topic)))
        elif kind == CONTROLLER_STATE:
            point = next(found for key in keys if (found := getattr(message, key, None)) is not None)
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
    """Return the samples of some joints as a motion; those of other joints alone are left out."""
    own = [(time, values) for time, values in rows if any(name in values for name in names)]
    for time, values in own:
        missing = [name for name in names if name not in values]
        if missing:
            at = (time - begin) / SECOND
            raise InputError(f"{', '.join(missing)} missing at {at:.3f} s", "joints")
    last = dict(own)  # of samples of one time the last one counts
    if len(last) < 2:
        raise InputError(f"must have samples of {', '.join(names)} at two times at least, got {len(last)}")
    times = (np.array(list(last)) - begin) / SECOND
    table = [[values[name] for name in names] for values in last.values()]
    return Motion.hermite(times, table, names=names)
