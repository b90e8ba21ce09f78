"""People and objects that move in a simulation, and their positions at any time."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, whole_number
from safe_ompl.geometry import STANDING, Limb, Pose, Shape, placed
from safe_ompl.live import Recording, Skeleton, Surroundings, TrackedBody, Tracker, who_is_where
from safe_ompl.scene import People

# The skeleton of a simulated sensor that sees all key points of the body.
ALL_KEYPOINTS = Skeleton("standing", tuple(STANDING), {name: (name,) for name in STANDING})
STEP = 0.02  # [s] between two places
_MOST_KEPT_STEPS = 1000  # steps
_NEAREST_PLACE, _FARTHEST_PLACE = 0.55, 1.6  # [m] from the centre
# The sector to either side of the first place.
_SECTOR = 1.0  # [rad]
_ARMS_LOW, _ARMS_HIGH = np.array([0.0, -0.3, 0.0]), np.array([1.7, 0.9, 1.4])  # [rad] raised, outwards, bent
_HANGING: FloatArray = np.array([[0.05, 0.0, 0.1]] * 2)
# The largest angular velocities of the body and of the arms.
_BODY_TURN, _SWING = 2.0, 3.0  # [rad/s]
_ARRIVED = 0.05  # [m]
# After this time at one place a new one is drawn.
_MOST_TIME_AT_PLACE = 3.0  # [s]
# A step that is too long is multiplied by this factor.
_STEP_FACTOR = 0.7
_MOST_PLACE_TRIES = 30


class PersonMover(Protocol):
    """A person in a simulation."""

    tracker: Tracker

    def at(self, time: float) -> FloatArray:
        """Return the key points (J, 3) at a time [s] in the order, axes and unit of the tracker's skeleton."""


class Playback:
    """A recording of a person, played forwards and backwards in turn."""

    def __init__(self, recording: Recording, tracker: Tracker) -> None:
        self.recording, self.tracker = recording, tracker

    def at(self, time: float) -> FloatArray:
        """Return the key points (J, 3) at a time [s]."""
        return self.recording.at(time)


class Drifting:
    """An object that moves at a constant velocity (3,) [m/s] and is reflected at the walls of a room.

    The room (2, 3) [m] is given by its lowest and highest corner. Without a velocity the object stands still.
    """

    def __init__(self, place: pin.SE3, velocity: FloatArray | None = None, room: FloatArray | None = None) -> None:
        self._place, self._velocity, self._room = place, velocity, room

    def at(self, time: float) -> pin.SE3:
        """Return the pose at a time [s]."""
        if self._velocity is None:
            return self._place
        place = self._place.translation + time * self._velocity
        if self._room is not None:
            low, high = self._room
            beyond = np.mod(place - low, 2 * (high - low))
            place = low + np.minimum(beyond, 2 * (high - low) - beyond)
        return pin.SE3(self._place.rotation, place)


class Solid(NamedTuple):
    """A limb of a person, or a part of an object, with its pose."""

    who: str
    limb: str
    geometry: coal.CollisionGeometry
    placement: pin.SE3


def limb_solids(who: str, body: TrackedBody, keypoints: FloatArray) -> list[Solid]:
    """Return the limbs of a person with completed key points (18, 3) as capsules."""
    found, ends = [], body.ends(keypoints)
    for name, (start, end), radius in zip(body.limbs, ends, body.radii(ends).tolist(), strict=True):
        limb = Limb(name, start, end, radius)
        geometry = coal.Capsule(radius, limb.length) if limb.length > 0 else coal.Sphere(radius)
        found.append(Solid(who, name, geometry, limb.placement))
    return found


def part_solids(what: str, shape: Shape, place: pin.SE3) -> list[Solid]:
    """Return the parts of an object at its pose."""
    return [Solid(what, "", part.geometry, place * part.placement) for part in shape.parts()]


class World:
    """The people and objects of a simulation, with their true positions at any time.

    Objects have the shapes, points and speeds of the replanner's surroundings.
    """

    def __init__(
        self, people: Mapping[str, PersonMover], objects: Mapping[str, Drifting], surroundings: Surroundings
    ) -> None:
        self.people, self.objects = dict(people), dict(objects)
        self.surroundings = surroundings

    def keypoints(self, time: float) -> dict[str, FloatArray]:
        """Return the key points (18, 3) of all people at a time [s]; missing ones are assumed by `TrackedBody`.

        With glitches they are the key points that sensors measure.
        """
        found = {}
        for name, mover in self.people.items():
            tracker = mover.tracker
            seen = placed(tracker.place.se3, tracker.skeleton.keypoints(mover.at(time)))
            found[name] = tracker.body.completed(seen)[0]
        return found

    def solids(self, keypoints: Mapping[str, FloatArray], time: float) -> list[Solid]:
        """Return all bodies: limbs of people with these key points, and parts of objects at a time [s]."""
        found = []
        for name, points in keypoints.items():
            found += limb_solids(name, self.people[name].tracker.body, points)
        for name, mover in self.objects.items():
            found += part_solids(name, self.surroundings.shapes[name], mover.at(time))
        return found

    def ends(self, keypoints: Mapping[str, FloatArray], time: float) -> list[FloatArray]:
        """Return the points of all bodies: ends of limbs (2, 3), and corners of objects."""
        found: list[FloatArray] = []
        for name, points in keypoints.items():
            found += list(self.people[name].tracker.body.ends(points))
        for name, mover in self.objects.items():
            found += self.surroundings.objects[name].points_at(mover.at(time))
        return found

    def tick(self, time: float) -> dict[str, Any]:
        """Return key points of the people and poses of the objects at a time [s] as plain values."""
        return who_is_where(self.keypoints(time), {name: mover.at(time) for name, mover in self.objects.items()})


class Walker:
    """A person who walks at random, turns, and reaches out with both arms.

    No end of a limb is faster than `speed` times `People.speed_of` the limb; with `speed` ≤ 1 limbs stay in their reach
    sets. The person stays in a sector of a ring about a centre (3,) at floor height [m], begins at the point of the
    ring nearest to `start: (2,)` [m], and walks through obstacles and the robot. A stance (9,) is the position about
    the centre (distance [m], angle [rad]), the direction of the body, and three angles of each arm [rad]. Raises
    InputError if the tracker's skeleton is not `ALL_KEYPOINTS` in the world frame.
    """

    def __init__(
        self,
        people: People,
        centre: FloatArray,
        start: FloatArray,
        *,
        tracker: Tracker | None = None,
        speed: float = 1.0,
        seed: int = 0,
    ) -> None:
        self.tracker = Tracker(ALL_KEYPOINTS) if tracker is None else tracker
        if self.tracker.skeleton != ALL_KEYPOINTS or self.tracker.place != Pose():
            raise InputError("must have the skeleton ALL_KEYPOINTS in the world's frame", "tracker")
        self._people, self._centre, self._speed = people, centre, speed
        self._rng = np.random.default_rng(whole_number("seed", seed, at_least=0))
        # The speed limit of each key point (17,) [m/s] is that of the slowest limb whose ends depend on it.
        body, speeds = self.tracker.body, np.array([people.speed_of(limb) for limb in self.tracker.body.limbs])
        self._bounds = np.where((body.weights > 0).any(axis=1), speeds[:, None], np.inf).min(axis=0)
        away = np.asarray(start, dtype=float) - centre[:2]
        self._home = float(np.arctan2(away[1], away[0]))
        first = np.array([np.clip(np.linalg.norm(away), _NEAREST_PLACE, _FARTHEST_PLACE), self._home])
        self._stance = np.concatenate([first, [self._home + np.pi], _HANGING.ravel()])
        self._goal, self._pace, self._left = self._stance, 1.0, 0
        self._steps = deque([self._keypoints(self._stance)], _MOST_KEPT_STEPS)  # the newest ones
        self._count = 1

    def at(self, time: float) -> FloatArray:
        """Return the key points (17, 3) at a time [s], at most some seconds before the latest time of earlier calls."""
        place = self._speed * max(time, 0.0) / STEP
        k = int(place)
        while self._count < k + 2:
            self._steps.append(self._after(self._steps[-1]))
            self._count += 1
        share, newest = place - k, k - self._count  # counted from the end
        return np.asarray((1 - share) * self._steps[newest] + share * self._steps[newest + 1])

    def _keypoints(self, stance: FloatArray) -> FloatArray:
        """Return the key points (17, 3) of a stance, in the world [m]."""
        far, angle, yaw = stance[:3].tolist()
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        at = self._centre + np.array([far * np.cos(angle), far * np.sin(angle), 0.0])
        return np.asarray(self.tracker.body.height * _posture(stance[3:].reshape(2, 3)) @ turn.T + at)

    def _after(self, before: FloatArray) -> FloatArray:
        """Take the longest step in which no key point is too fast, and return the key points (17, 3) after it."""
        if self._left <= 0 or float(np.linalg.norm(self._way())) < _ARRIVED:
            self._choose()
        self._left -= 1
        wanted = self._wanted()
        share = 1.0
        for _ in range(_MOST_PLACE_TRIES):
            stance = self._stance + share * (wanted - self._stance)
            points = self._keypoints(stance)
            if (np.linalg.norm(points - before, axis=1) <= self._bounds * STEP).all():
                self._stance = stance
                return points
            share *= _STEP_FACTOR
        return before.copy()

    def _choose(self) -> None:
        """Draw the next stance, and the speed at which the person goes there."""
        far = self._rng.uniform(_NEAREST_PLACE, _FARTHEST_PLACE)
        angle = self._home + self._rng.uniform(-_SECTOR, _SECTOR)
        arms = self._rng.uniform(_ARMS_LOW, _ARMS_HIGH, (2, 3))
        yaw = angle + np.pi + self._rng.uniform(-0.8, 0.8)
        self._goal = np.concatenate([[far, angle, yaw], arms.ravel()])
        self._pace, self._left = self._rng.uniform(0.3, 1.0), round(_MOST_TIME_AT_PLACE / STEP)

    def _way(self) -> FloatArray:
        """Return the remaining displacement (2,) to the goal, radial and tangential [m]."""
        return np.asarray((self._goal - self._stance)[:2] * [1.0, self._stance[0]])

    def _wanted(self) -> FloatArray:
        """Return the stance after the next step without the speed limits of limbs."""
        way, far = self._goal - self._stance, float(np.linalg.norm(self._way()))
        walked = min(1.0, self._pace * self._people.speed * STEP / max(far, 1e-9))
        most = np.repeat([_BODY_TURN * STEP, self._pace * _SWING * STEP], [1, 6])
        return np.asarray(self._stance + np.append(walked * way[:2], np.clip(way[2:], -most, most)))


def _posture(arms: FloatArray) -> FloatArray:
    """Return the key points (17, 3) of a body of height 1 at the origin that faces x, with these arms (2, 3) [rad]."""
    found = {name: np.array(place) for name, place in STANDING.items()}
    for side, sign, (raised, outwards, bent) in (("left", 1.0, arms[0]), ("right", -1.0, arms[1])):
        joints = [f"{side}_{name}" for name in ("shoulder", "elbow", "wrist", "hand")]
        for k, angle in enumerate((raised, raised + bent, raised + bent)):
            length = np.linalg.norm(STANDING[joints[k + 1]] - STANDING[joints[k]])
            across, down = np.sin(angle), -np.cos(angle)
            way = np.array([across * np.cos(outwards), sign * across * np.sin(outwards), down])
            found[joints[k + 1]] = found[joints[k]] + length * way
    return np.array(list(found.values()))
