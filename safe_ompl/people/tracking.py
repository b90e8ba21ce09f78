"""Tracked people and objects: where they were seen last, how long ago, and who moved farther than promised."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import (
    BoolArray,
    FloatArray,
    InputError,
    IntArray,
    Section,
    UnknownNameError,
    documents as document,
    float_array,
    key,
)
from safe_ompl.geometry import STANDING, PointCloud, Pose, placed
from safe_ompl.people.cameras import DepthFrame
from safe_ompl.people.objects import CloudTrack, ObjectTrack
from safe_ompl.people.occupancy import OccupancyGrid
from safe_ompl.people.reach import CalibratedReach, ReachSets, ReachViolation, limb_lines
from safe_ompl.people.skeletons import KEYPOINTS, Recording, Skeleton, TrackedBody
from safe_ompl.scene import People, Scene

_log = logging.getLogger(__name__)

_ROUNDING = 1e-9  # [m] or [s]
_LAG = 0.1  # [s] over which the speed is measured that a calibrated reach depends on
# A reach is doubted once it was left in more of the last measurements than this multiple of what its level allows.
_WATCHED, _OFTEN, _FEW = 200, 2.0, 4


@dataclass(frozen=True)
class Tracker(Section):
    """How a person is tracked."""

    skeleton: Skeleton  # The key points that the sensor gives
    body: TrackedBody = field(default_factory=TrackedBody)  # The person's size, and which limbs there are
    place: Pose = field(default_factory=Pose)  # The sensor's frame, turned to x forward, y left, z up, in the world
    noise: float = key(document.number, default=0.0, at_least=0.0)  # Bound of the errors of key points [m]
    # A key point that would have moved faster since it was last seen is not seen [m/s]; see `Gate`. None: all are
    gate: float | None = key(document.number, default=None, above=0.0)


class Gate:
    """Takes glitches for what they are: a key point that is too fast counts as not seen.

    What it says of a frame depends on that frame and those before it only. A key point that is not seen may be farther
    away the longer that lasts, so that each one comes back. It counts key points that were `seen` and `refused`.
    """

    def __init__(self, tracker: Tracker) -> None:
        count = len(tracker.skeleton.points)
        self._speed = None if tracker.gate is None else tracker.gate / tracker.skeleton.scale
        self._places: FloatArray = np.full((count, 3), np.nan)
        self._times: FloatArray = np.full(count, -np.inf)
        self.seen = self.refused = 0

    def passed(self, points: FloatArray, time: float) -> FloatArray:
        """Return the key points (J, 3) of a frame at a time [s], NaN where they are not seen or too fast."""
        if self._speed is None:
            return points
        away = np.linalg.norm(points - self._places, axis=1)
        fast = np.isfinite(away) & (away > self._speed * (time - self._times))
        found = np.where(fast[:, None], np.nan, points)
        new = np.isfinite(found).all(axis=1)
        self._places[new], self._times[new] = found[new], time
        self.seen += int(new.sum() + fast.sum())
        self.refused += int(fast.sum())
        return found


def without_glitches(recording: Recording, tracker: Tracker) -> tuple[Recording, Gate]:
    """Return a recording as the gate of a tracker leaves it, and the gate, which counted what it refused.

    Each key point moves straight between the frames in which it passes.
    """
    gate, times = Gate(tracker), np.arange(len(recording.frames)) / recording.rate
    frames = np.stack([gate.passed(points, t) for points, t in zip(recording.frames, times, strict=True)])
    for track in np.swapaxes(frames, 0, 1):
        seen = np.isfinite(track).all(axis=1)
        if seen.any():
            track[:] = np.stack([np.interp(times, times[seen], along[seen]) for along in track.T], axis=1)
    return replace(recording, frames=frames), gate


class PersonTrack:
    """A person as the sensor has seen them so far.

    A key point that is not seen keeps its place, and its age grows. One that was never seen is assumed, as
    `TrackedBody` says.
    """

    def __init__(self, name: str, tracker: Tracker, people: People, reach: CalibratedReach | None = None) -> None:
        self.name, self.tracker = name, tracker
        own = tracker.skeleton.name, tracker.gate
        if reach is not None and own != (reach.skeleton, reach.gate):
            raise InputError(
                f"the reach was calibrated with the skeleton {reach.skeleton!r} and a gate of {reach.gate:g} m/s, the "
                f"tracker has {own[0]!r} and {'no gate' if own[1] is None else f'one of {own[1]:g} m/s'}",
                name,
            )
        self._reach = reach
        self._lines = limb_lines(tracker.body.limbs, people, reach)
        self._public = limb_lines(tracker.body.limbs, people)[0]
        known = tracker.body.limbs if reach is None else reach.limbs
        self._calibrated: BoolArray = np.array([limb in known for limb in tracker.body.limbs], dtype=bool)
        self._recent: deque[tuple[float, FloatArray]] = deque()  # times [s] and ends of limbs, over the last `_LAG`
        self._left: deque[bool] = deque(maxlen=_WATCHED)  # whether a calibrated set was left at a measurement
        self.doubted = False  # Whether it was left so often that speeds hold instead
        self.time = -np.inf
        self.gate = Gate(tracker)
        self._places: FloatArray = np.full((len(KEYPOINTS), 3), np.nan)
        self._times: FloatArray = np.full(len(KEYPOINTS), -np.inf)
        self._completed: FloatArray | None = None
        self._sets: ReachSets | None = None  # of the last measurement, once they were asked for
        self._rests: IntArray = np.arange(len(KEYPOINTS))

    @property
    def age(self) -> float:
        """How old [s] the eldest of the key points is that were ever seen; infinite before the first one."""
        seen = self._times[np.isfinite(self._times)]
        return float(self.time - seen.min()) if len(seen) else np.inf

    @property
    def speed(self) -> float:
        """How fast the fastest calibrated limb was over the last 0.1 s [m/s]; infinite where that is not known."""
        if len(self._recent) < 2 or self._recent[-1][0] - self._recent[0][0] < _LAG - _ROUNDING:
            return np.inf
        (begin, first), (end, last) = self._recent[0], self._recent[-1]
        return float(np.linalg.norm(last - first, axis=2)[self._calibrated].max(initial=0.0)) / (end - begin)

    @property
    def lines(self) -> FloatArray:
        """The lines (M, L, 2) that bound how far limbs go, in the state in which the person is; see `limb_lines`."""
        if self._reach is None or self.doubted:
            return np.asarray(self._public)
        return np.asarray(self._lines[self._reach.state(self.speed)])

    @property
    def widest(self) -> FloatArray:
        """The lines (M, L, 2) of the state in which limbs go farthest."""
        return np.asarray(self._lines[-1])

    @property
    def keypoints(self) -> FloatArray | None:
        """Key points (18, 3) in the order of `KEYPOINTS`, in the world [m]; None before the person was seen."""
        return self._completed

    def observe(self, points: ArrayLike | None, time: float) -> ReachViolation | None:
        """Take what the sensor saw at a time [s], and return the limb that moved farther than was promised, if one did.

        Key points (J, 3) are as the skeleton has them; NaN, or None for all of them: not seen. Raises InputError if the
        time goes backwards, or as `Skeleton.keypoints`.
        """
        if time < self.time:
            raise InputError(f"time must not go backwards: {time:g} s after {self.time:g} s", self.name)
        seen = np.full((len(KEYPOINTS), 3), np.nan)
        if points is not None:
            skeleton = self.tracker.skeleton
            given = float_array(points, (len(skeleton.points), 3), f"key points of {skeleton.name}")
            seen = placed(self.tracker.place.se3, skeleton.keypoints(self.gate.passed(given, time)))
        new = np.isfinite(seen).all(axis=1)
        promised = self.sets() if new.any() and self._completed is not None else None
        since = time - self.time
        self._places[new], self._times[new] = seen[new], time
        self.time, self._sets = time, None
        if np.isfinite(self._places).any():
            self._completed, self._rests = self.tracker.body.completed(self._places)
        violation = None if promised is None else self._violation(promised, since)
        if self._completed is not None:
            self._recent.append((time, self.tracker.body.ends(self._completed)))
            while len(self._recent) > 2 and time - self._recent[1][0] >= _LAG - _ROUNDING:
                self._recent.popleft()
        if self._reach is not None and not self.doubted:
            self._left.append(violation is not None)
            self.doubted = sum(self._left) > max(_FEW, _OFTEN * (1 - self._reach.level) * _WATCHED)
            if self.doubted:
                said = "%r left the calibrated reach in %d of %d measurements: from now on bounds of speeds hold"
                _log.warning(said, self.name, sum(self._left), len(self._left))
        return violation

    def _violation(self, promised: ReachSets, since: float) -> ReachViolation | None:
        assert self._completed is not None
        excess = promised.excess(self.tracker.body.ends(self._completed), since)
        worst = int(excess.argmax())
        if excess[worst] <= self.tracker.noise + _ROUNDING:
            return None
        return ReachViolation(self.name, promised.names[worst][1], float(excess[worst]))

    def sets(self) -> ReachSets:
        """Return where the limbs may be from the time of the last measurement on; errors as `measured`."""
        if self._sets is None:
            ends, ages = self.measured()
            lines = self.lines
            known = self.tracker.noise + lines[..., 0] + lines[..., 1] * ages[:, None]
            body, growth = self.tracker.body, np.stack([known, lines[..., 1]], axis=-1)
            names = tuple((self.name, limb) for limb in body.limbs)
            self._sets = ReachSets.of(names, ends, body.radii(ends), growth)
        return self._sets

    def measured(self) -> tuple[FloatArray, FloatArray]:
        """Return where the ends (M, 2, 3) of the limbs were seen last [m], and how long ago (M,) the elder one was [s].

        Raises InputError if the person was never seen.
        """
        if self._completed is None:
            raise InputError("was never seen", self.name)
        body, ages = self.tracker.body, (self.time - self._times[self._rests])[: len(STANDING)]
        return body.ends(self._completed), np.where(body.weights > 0, ages, 0.0).max(axis=(1, 2))


class Surroundings:
    """What is around a robot: still obstacles, and all people and objects that move, each with its track.

    `sets` are where all may be from the `time` of the last measurement on [s] (−inf: there was none); none until all
    were seen. `still` are the obstacles that stand still.

    Parameters
    ----------
    scene : Scene
        All obstacles. Those that are named in `trackers` or `objects` move; the others stand still.
    trackers : mapping of str to Tracker, optional
        The people that are tracked, and how. They need not be obstacles of the scene.
    objects : mapping of str to float, optional
        Obstacles of the scene that move, and bounds of their speeds [m/s].
    people : People, optional
        How far people go (their reach, or else their speeds), the clearance from the robot that must be left, and
        whether the robot may touch people at speeds that they bear.
    depth : OccupancyGrid, optional
        What depth cameras see, whoever or whatever it is.

    Raises
    ------
    InputError
        If an object is no obstacle of the scene, or a person, too; if a reach has another skeleton or gate; if the
        grid is of another scene.
    """

    def __init__(
        self,
        scene: Scene,
        trackers: Mapping[str, Tracker] | None = None,
        objects: Mapping[str, float] | None = None,
        people: People | None = None,
        depth: OccupancyGrid | None = None,
    ) -> None:
        trackers, objects = trackers or {}, objects or {}
        self.rules = People() if people is None else people
        for name in trackers:
            if name in objects:
                raise InputError(f"{name!r} is a person and an object: give one of both", "objects")
        self.reach = None if self.rules.reach is None else CalibratedReach.load(self.rules.reach)
        self.people = {name: PersonTrack(name, how, self.rules, self.reach) for name, how in trackers.items()}
        self.shapes = {name: scene[name].shape for name in objects}
        kinds = {
            name: CloudTrack if isinstance(shape, PointCloud) else ObjectTrack for name, shape in self.shapes.items()
        }
        self.objects = {name: kinds[name](scene[name], speed) for name, speed in objects.items()}
        # Their sets come last: how many they are, and which, changes
        self.clouds = tuple(name for name, track in self.objects.items() if isinstance(track, CloudTrack))
        self.scene = scene.without(*(name for name in scene.names if name in trackers))
        self.still = self.scene.without(*objects)
        self.depth = depth
        if depth is not None:
            depth.check_scene(self.still)
        self.time = -np.inf
        self.sets = ReachSets.none()
        self._violations: list[ReachViolation] = []

    def __repr__(self) -> str:
        cameras = "" if self.depth is None else f", {len(self.depth.cameras)} cameras"
        return f"Surroundings({len(self.people)} people, {len(self.objects)} objects{cameras})"

    @property
    def _tracks(self) -> dict[str, PersonTrack | ObjectTrack]:
        return {**self.people, **self.objects}

    @property
    def known(self) -> bool:
        """Whether everybody and everything was seen."""
        seen = all(track.keypoints is not None for track in self.people.values())
        seen = seen and (self.depth is None or self.depth.known)
        return seen and all(np.isfinite(track.seen) for track in self.objects.values())

    def description(self) -> dict[str, Any]:
        """Return who and what moves, and what is assumed of them, as the header of ticks has it."""
        people = {}
        for name, track in self.people.items():
            body = track.tracker.body
            growth = dict(zip(body.limbs, track.widest.tolist(), strict=True))
            people[name] = {
                "height": body.height,
                "limbs": list(body.limbs),
                "noise": track.tracker.noise,
                "growth": growth,
            }
        rules = self.rules
        assumed = str(self.reach or f"limbs are no faster than {max([rules.speed, *rules.speeds.values()]):g} m/s")
        assumed += "" if self.depth is None else f"; {self.depth.options}"
        return {
            "people": people,
            "objects": {name: track.speed for name, track in self.objects.items()},
            "rules": {"clearance": rules.clearance, "contact": rules.contact, "assumed": assumed},
        }

    def seen(self) -> dict[str, Any]:
        """Return where all were seen last, as plain data, see `who_is_where`; nobody who was never seen."""
        people = {name: track.keypoints for name, track in self.people.items()}
        return who_is_where(people, {name: thing.pose for name, thing in self.objects.items()})

    def update(
        self,
        people: Mapping[str, ArrayLike | None],
        objects: Mapping[str, Any],
        time: float,
        depth: Mapping[str, DepthFrame] | None = None,
    ) -> list[ReachViolation]:
        """Take what sensors saw; see `Guard.update`."""
        document.number("time", time)
        frames = depth or {}
        cameras = {} if self.depth is None else self.depth.cameras
        if time < self.time:
            raise InputError(f"time must not go backwards: {time:g} s after {self.time:g} s", "time")
        asked = (("person", people, self.people), ("object", objects, self.objects), ("camera", frames, cameras))
        for kind, given, known in asked:
            for name in given:
                if name not in known:
                    raise UnknownNameError(kind, name, known)
        found = []
        for name, person in self.people.items():
            with document.within(f"people.{name}", ": "):
                found.append(person.observe(people.get(name), time))
        for name, thing in self.objects.items():
            with document.within(f"objects.{name}", ": "):
                found.append(thing.observe(objects.get(name), time))
        for name in sorted(frames, key=lambda name: frames[name].time):
            assert self.depth is not None
            with document.within(f"depth.{name}"):
                found.append(self.depth.observe(name, frames[name], time))
        self.time = float(time)
        self._violations = [violation for violation in found if violation is not None]
        if self.known:
            self.sets = limbs = ReachSets.none()
            for track in sorted(self._tracks.values(), key=lambda track: isinstance(track, CloudTrack)):
                self.sets = self.sets.beside(track.sets())
                limbs = self.sets if isinstance(track, PersonTrack) else limbs
            if self.depth is not None:
                self.sets = self.sets.beside(self.depth.sets(time, limbs))
        return list(self._violations)

    def take_over(self, before: Surroundings) -> None:
        """Know from now on what others knew, of the same people and objects among other still obstacles."""
        self.people, self.objects = before.people, before.objects
        self.time, self.sets, self._violations = before.time, before.sets, before._violations

    def trouble(self, time: float, lost_after: float) -> str | None:
        """Return who moved farther than promised or is lost, so that the robot must stop; else None."""
        for name, track in self._tracks.items():
            age = time - self.time + track.age
            if age > lost_after:
                return f"{name!r} was not seen " + ("yet" if np.isinf(age) else f"for {age:.2f} s")
        trouble = None if self.depth is None else self.depth.trouble(time, lost_after)
        return str(self._violations[0]) if self._violations else trouble


def who_is_where(people: Mapping[str, FloatArray | None], objects: Mapping[str, pin.SE3]) -> dict[str, dict[str, Any]]:
    """Return key points (18, 3) of people and poses of objects, as a tick (`safe_ompl.io.ticks`) has them [m]."""
    poses = {name: Pose.of(place) for name, place in objects.items()}
    return {
        "people": {
            name: dict(zip(KEYPOINTS, points.tolist(), strict=True))
            for name, points in people.items()
            if points is not None
        },
        "objects": {
            name: {"position": list(pose.position), "quaternion_xyzw": list(pose.quaternion_xyzw)}
            for name, pose in poses.items()
        },
    }
