"""Tracking of people and objects: last measurements, their ages, reach sets, and violations of the reach sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import (
    FloatArray,
    InputError,
    IntArray,
    Section,
    UnknownNameError,
    documents as document,
    float_array,
    key,
    number,
)
from safe_ompl.geometry import STANDING, Obstacle, PointCloud, Pose, bounding_hull, placed
from safe_ompl.live.reach import ReachSets, ReachViolation
from safe_ompl.live.skeletons import KEYPOINTS, Skeleton, TrackedBody
from safe_ompl.scene import People, Scene

_REACH_ROUNDING = 1e-9  # [m] or [s]
# The reach sets of a cloud are at most this many balls around the cells of a grid, whose edges are at least this long.
_MOST_BALLS = 256
_LEAST_GRID_EDGE = 0.01  # [m]


@dataclass(frozen=True)
class Tracker(Section):
    """Options for tracking one person.

    Examples
    --------
    >>> from safe_ompl.live import find_skeleton
    >>> Tracker(find_skeleton("coco17"), noise=0.02).noise
    0.02
    """

    # The key points that the sensor measures.
    skeleton: Skeleton
    # The person's size, and which limbs exist.
    body: TrackedBody = field(default_factory=TrackedBody)
    # The sensor's frame in the world, turned to x forward, y left, z up.
    place: Pose = field(default_factory=Pose)
    # A bound of the errors of key points [m].
    noise: float = key(document.number, default=0.0, at_least=0.0)


class PersonTrack:
    """The measurements of one person so far.

    A key point that is not seen keeps its last position, and its age grows. A key point that was never seen is assumed
    (see `TrackedBody`).
    """

    def __init__(self, name: str, tracker: Tracker, people: People) -> None:
        self.name, self.tracker = name, tracker
        # Bounds of the speeds of the limbs (M,) [m/s].
        self.speeds: FloatArray = np.array([people.speed_of(limb) for limb in tracker.body.limbs])
        self.time = -np.inf
        self._places: FloatArray = np.full((len(KEYPOINTS), 3), np.nan)
        self._times: FloatArray = np.full(len(KEYPOINTS), -np.inf)
        self._completed: FloatArray | None = None
        # The reach sets of the last measurement, once they were requested.
        self._sets: ReachSets | None = None
        self._rests: IntArray = np.arange(len(KEYPOINTS))

    @property
    def age(self) -> float:
        """Age [s] of the oldest key point that was ever seen; infinite before the first measurement."""
        seen = self._times[np.isfinite(self._times)]
        return float(self.time - seen.min()) if len(seen) else np.inf

    @property
    def keypoints(self) -> FloatArray | None:
        """Key points (18, 3) in the order of `KEYPOINTS`, in the world [m]; None before the person was seen."""
        return self._completed

    def observe(self, points: ArrayLike | None, time: float) -> ReachViolation | None:
        """Take the measurement of a time [s]; return the limb that is farthest outside its reach set, or None.

        Key points (J, 3) are in the order, axes and unit of the skeleton. NaN: not seen; None: no key point is seen.
        Raises InputError if the time goes backwards; other errors as `Skeleton.keypoints`.
        """
        if time < self.time:
            raise InputError(f"time must not go backwards: {time:g} s after {self.time:g} s", self.name)
        seen = np.full((len(KEYPOINTS), 3), np.nan)
        if points is not None:
            skeleton = self.tracker.skeleton
            given = float_array(points, (len(skeleton.points), 3), f"key points of {skeleton.name}")
            seen = placed(self.tracker.place.se3, skeleton.keypoints(given))
        new = np.isfinite(seen).all(axis=1)
        promised = self.sets() if new.any() and self._completed is not None else None
        since = time - self.time
        self._places[new], self._times[new] = seen[new], time
        self.time, self._sets = time, None
        if np.isfinite(self._places).any():
            self._completed, self._rests = self.tracker.body.completed(self._places)
        return None if promised is None else self._violation(promised, since)

    def _violation(self, promised: ReachSets, since: float) -> ReachViolation | None:
        assert self._completed is not None
        excess = promised.excess(self.tracker.body.ends(self._completed), since)
        worst = int(excess.argmax())
        if excess[worst] <= self.tracker.noise + _REACH_ROUNDING:
            return None
        return ReachViolation(self.name, promised.names[worst][1], float(excess[worst]))

    def sets(self) -> ReachSets:
        """Return the reach sets of the limbs since the time of the last measurement; errors as `measured`."""
        if self._sets is None:
            ends, ages = self.measured()
            body, growth = self.tracker.body, np.column_stack([self.tracker.noise + self.speeds * ages, self.speeds])
            names = tuple((self.name, limb) for limb in body.limbs)
            self._sets = ReachSets.of(names, ends, body.radii(ends), growth)
        return self._sets

    def measured(self) -> tuple[FloatArray, FloatArray]:
        """Return the last measured ends (M, 2, 3) of the limbs [m], and the age (M,) of the older end of each [s].

        Raises InputError if the person was never seen.
        """
        if self._completed is None:
            raise InputError("was never seen", self.name)
        body, ages = self.tracker.body, (self.time - self._times[self._rests])[: len(STANDING)]
        return body.ends(self._completed), np.where(body.weights > 0, ages, 0.0).max(axis=(1, 2))


class ObjectTrack:
    """The measurements of one moving object, as hulls of its parts; `speed` bounds the speed of their points [m/s].

    The pose in the scene does not count as a measurement. Raises InputError if the speed is negative or not finite.
    """

    def __init__(self, obstacle: Obstacle, speed: float) -> None:
        self.name, self.obstacle = obstacle.name, obstacle
        self.speed = number(f"objects.{obstacle.name}", speed, at_least=0.0)
        self.time, self.seen = -np.inf, -np.inf
        self._hulls = [bounding_hull(part.geometry).moved(part.placement) for part in obstacle.shape.parts()]

    @property
    def pose(self) -> pin.SE3:
        """The last measured pose in the world."""
        return self.obstacle.pose.se3

    @property
    def age(self) -> float:
        """Age of the last measurement [s]."""
        return self.time - self.seen

    def observe(self, place: Any, time: float) -> ReachViolation | None:
        """Take the pose measured at a time [s], None: not seen; result and errors as `PersonTrack.observe`."""
        if time < self.time:
            raise InputError(f"time must not go backwards: {time:g} s after {self.time:g} s", self.name)
        violation = None
        if place is not None:
            moved = self._moved(place)
            if np.isfinite(self.seen):
                excess = self._way_to(moved) - self.speed * (time - self.seen)
                violation = ReachViolation(self.name, "", excess) if excess > _REACH_ROUNDING else None
            self.obstacle, self.seen = moved, time
        self.time = time
        return violation

    def _moved(self, place: Any) -> Obstacle:
        return self.obstacle.moved(Pose.of(place))

    def _way_to(self, moved: Obstacle) -> float:
        """Return the largest distance that a point moved [m], for clouds a lower bound."""
        pairs = zip(self.points_at(moved.pose.se3), self.points_at(self.pose), strict=True)
        return max(float(np.linalg.norm(new - old, axis=1).max()) for new, old in pairs)

    def points_at(self, pose: pin.SE3) -> list[FloatArray]:
        """Return the hull points (K, 3) of each part in the world [m] for a pose of the object."""
        return [placed(pose, hull.points) for hull in self._hulls]

    def sets(self) -> ReachSets:
        """Return the reach sets of the parts since the time of the last measurement."""
        found = ReachSets.none()
        growth = np.array([[self.speed * self.age, self.speed]])
        for points, hull in zip(self.points_at(self.pose), self._hulls, strict=True):
            found = found.beside(ReachSets.of(((self.name, ""),), points[None], np.array([hull.radius]), growth))
        return found


class CloudTrack(ObjectTrack):
    """The measurements of a moving point cloud whose points change with each measurement.

    `speed` bounds the speed of its points [m/s]. A new point violates the bound if it is too far from all points of the
    previous measurement, allowing for the size of the balls that stand for the points.
    """

    def _moved(self, place: Any) -> Obstacle:
        return self.obstacle.moved(place)

    def _balls(self, obstacle: Obstacle) -> tuple[FloatArray, float]:
        """Return centres (M, 3) in the world and the radius of balls that contain the balls of the cloud [m]."""
        shape = obstacle.shape
        assert isinstance(shape, PointCloud)
        centres, radius = ball_cover(placed(obstacle.pose.se3, shape.centres), _MOST_BALLS)
        return centres, radius + shape.radius

    def _way_to(self, moved: Obstacle) -> float:
        (new, wide), (old, narrow) = self._balls(moved), self._balls(self.obstacle)
        apart = np.linalg.norm(new[:, None] - old, axis=2).min(axis=1)
        return float(apart.max()) - wide - narrow

    def sets(self) -> ReachSets:
        centres, radius = self._balls(self.obstacle)
        count = len(centres)
        growth = np.tile([self.speed * self.age, self.speed], (count, 1))
        return ReachSets.of(((self.name, ""),) * count, centres[:, None], np.full(count, radius), growth)


def ball_cover(points: FloatArray, most: int) -> tuple[FloatArray, float]:
    """Return at most `most` balls that contain points (N, 3): their centres (M, 3) and one radius [m]."""
    edge, cells = _LEAST_GRID_EDGE, np.floor(points / _LEAST_GRID_EDGE).astype(np.int64)
    while True:
        low, extent = cells.min(axis=0), np.ptp(cells, axis=0) + 1
        flat = np.unique(np.ravel_multi_index(tuple((cells - low).T), tuple(extent)))
        cells = np.column_stack(np.unravel_index(flat, tuple(extent))) + low
        if len(cells) <= most:
            return (cells + 0.5) * edge, float(np.sqrt(0.75) * edge)
        edge, cells = 2 * edge, cells // 2


class Surroundings:
    """The surroundings of a robot: still obstacles, and a track for each moving person and object.

    `time` is the time of the last measurement [s], −inf before the first one. `sets` are the reach sets of all people
    and objects since that time; they are empty until all were seen. `still` is the scene of the still obstacles.

    Parameters
    ----------
    scene : Scene
        All obstacles. Obstacles named in `trackers` or `objects` move; the others stand still.
    trackers : mapping of str to Tracker, optional
        Tracking options of each person by name. People need not be obstacles of the scene.
    objects : mapping of str to float, optional
        Names of moving obstacles of the scene, and bounds of their speeds [m/s].
    people : People, optional
        Speeds of people, the clearance that the robot must keep, and whether the robot may touch people at speeds that
        they tolerate.

    Raises
    ------
    InputError
        If an object is no obstacle of the scene, or is also a person.

    Examples
    --------
    >>> from safe_ompl.live import find_skeleton
    >>> around = Surroundings(Scene(), {"anna": Tracker(find_skeleton("coco17"))}, people=People(speed=1.6))
    """

    def __init__(
        self,
        scene: Scene,
        trackers: Mapping[str, Tracker] | None = None,
        objects: Mapping[str, float] | None = None,
        people: People | None = None,
    ) -> None:
        trackers, objects = trackers or {}, objects or {}
        self.rules = People() if people is None else people
        for name in trackers:
            if name in objects:
                raise InputError(f"{name!r} is both a person and an object: give it as one of them", "objects")
        self.people = {name: PersonTrack(name, how, self.rules) for name, how in trackers.items()}
        self.shapes = {name: scene[name].shape for name in objects}
        kinds = {
            name: CloudTrack if isinstance(shape, PointCloud) else ObjectTrack for name, shape in self.shapes.items()
        }
        self.objects = {name: kinds[name](scene[name], speed) for name, speed in objects.items()}
        # The reach sets of clouds come last, because their number changes.
        self.clouds = tuple(name for name, track in self.objects.items() if isinstance(track, CloudTrack))
        self.scene = scene.without(*(name for name in scene.names if name in trackers))
        self.still = self.scene.without(*objects)
        self.time = -np.inf
        self.sets = ReachSets.none()
        self._violations: list[ReachViolation] = []

    def __repr__(self) -> str:
        return f"Surroundings({len(self.people)} people, {len(self.objects)} objects)"

    @property
    def _tracks(self) -> dict[str, PersonTrack | ObjectTrack]:
        return {**self.people, **self.objects}

    @property
    def known(self) -> bool:
        """Whether every person and object was seen at least once."""
        seen = all(track.keypoints is not None for track in self.people.values())
        return seen and all(np.isfinite(track.seen) for track in self.objects.values())

    def description(self) -> dict[str, Any]:
        """Return the tracked people and objects and the assumptions about them, for the header of ticks."""
        people = {}
        for name, track in self.people.items():
            body = track.tracker.body
            people[name] = {
                "height": body.height,
                "limbs": list(body.limbs),
                "noise": track.tracker.noise,
                "speeds": dict(zip(body.limbs, track.speeds.tolist(), strict=True)),
            }
        rules = self.rules
        assumed = f"limbs are no faster than {max([rules.speed, *rules.speeds.values()]):g} m/s"
        return {
            "people": people,
            "objects": {name: track.speed for name, track in self.objects.items()},
            "rules": {"clearance": rules.clearance, "contact": rules.contact, "assumed": assumed},
        }

    def seen(self) -> dict[str, Any]:
        """Return the last measurements as plain values (`who_is_where`), without people who were never seen."""
        people = {name: track.keypoints for name, track in self.people.items()}
        return who_is_where(people, {name: thing.pose for name, thing in self.objects.items()})

    def update(
        self, people: Mapping[str, ArrayLike | None], objects: Mapping[str, Any], time: float
    ) -> list[ReachViolation]:
        """Take the measurements of a time [s]; see `CommandProver.update`."""
        document.number("time", time)
        if time < self.time:
            raise InputError(f"time must not go backwards: {time:g} s after {self.time:g} s", "time")
        for kind, given, known in (("person", people, self.people), ("object", objects, self.objects)):
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
        self.time = float(time)
        self._violations = [violation for violation in found if violation is not None]
        if self.known:
            self.sets = ReachSets.none()
            for track in sorted(self._tracks.values(), key=lambda track: isinstance(track, CloudTrack)):
                self.sets = self.sets.beside(track.sets())
        return list(self._violations)

    def take_over(self, before: Surroundings) -> None:
        """Take the tracks and reach sets of other surroundings with the same people and objects."""
        self.people, self.objects = before.people, before.objects
        self.time, self.sets, self._violations = before.time, before.sets, before._violations

    def trouble(self, time: float, lost_after: float) -> str | None:
        """Return why the robot must stop: who is lost or left their reach set; None if there is no such reason."""
        for name, track in self._tracks.items():
            age = time - self.time + track.age
            if age > lost_after:
                return f"{name!r} was not seen " + ("yet" if np.isinf(age) else f"for {age:.2f} s")
        return str(self._violations[0]) if self._violations else None


def who_is_where(people: Mapping[str, FloatArray | None], objects: Mapping[str, pin.SE3]) -> dict[str, dict[str, Any]]:
    """Return key points (18, 3) [m] of people and poses of objects in the form of a tick (`safe_ompl.io.ticks`)."""
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
