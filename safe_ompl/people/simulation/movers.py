"""People and objects that move in a simulation, and where they are at any time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray
from safe_ompl.geometry import placed
from safe_ompl.people import KEYPOINTS, Recording, Surroundings, TrackedBody, Tracker
from safe_ompl.people.simulation.contact_monitor import Solid, limb_solids

_FORGOTTEN = 1000  # steps after which those of more than a second ago are forgotten


class PersonMover(Protocol):
    """A person in a simulation."""

    tracker: Tracker

    def at(self, time: float) -> FloatArray:
        """Return the key points (J, 3) at a time [s], as the tracker's skeleton has them."""


class ObjectMover(Protocol):
    """An object in a simulation."""

    def at(self, time: float) -> pin.SE3:
        """Return where it is at a time [s]."""


class Playback:
    """A recorded person, played back and forth.

    Parameters
    ----------
    recording : Recording
        A clip.
    tracker : Tracker
        How the person is tracked: size, and place in the world.
    speed : float
        How many times as fast as recorded.
    """

    def __init__(self, recording: Recording, tracker: Tracker, speed: float = 1.0) -> None:
        self.recording, self.tracker, self.speed = recording, tracker, speed

    def at(self, time: float) -> FloatArray:
        """Return the key points (J, 3) at a time [s]."""
        return self.recording.at(self.speed * time)


class Drifting:
    """An object that moves straight on, and is reflected at the surface of a ball and at a ball inside.

    Parameters
    ----------
    start, velocity : ndarray, shape (3,)
        Where it is at first [m], and its velocity [m/s].
    centre, radius : ndarray, float
        The ball that it does not leave [m].
    inner : (ndarray, float), optional
        A ball that it does not enter.
    step : float
        Time between two reflections at least [s].
    """

    def __init__(
        self,
        start: FloatArray,
        velocity: FloatArray,
        centre: FloatArray,
        radius: float,
        inner: tuple[FloatArray, float] | None = None,
        step: float = 0.01,
    ) -> None:
        self._velocity = np.array(velocity, dtype=np.float64)
        self._centre, self._radius, self._inner, self._step = centre, radius, inner, step
        self._places = Stepwise(np.array(start, dtype=np.float64), self._after, step)

    def at(self, time: float) -> pin.SE3:
        """Return where it is at a time [s], no earlier than a second before the latest that was asked for."""
        return pin.SE3(np.eye(3), self._places.at(time))

    def _after(self, place: FloatArray) -> FloatArray:
        for centre, radius, outwards in ((self._centre, self._radius, 1.0), *self._walls()):
            away = place + self._step * self._velocity - centre
            length = float(np.linalg.norm(away))
            normal = outwards * away / max(length, 1e-12)
            if outwards * (length - radius) > 0 and self._velocity @ normal > 0:
                self._velocity = self._velocity - 2 * (self._velocity @ normal) * normal
        after: FloatArray = place + self._step * self._velocity
        return after

    def _walls(self) -> list[tuple[FloatArray, float, float]]:
        return [] if self._inner is None else [(*self._inner, -1.0)]


class Resting:
    """An object that may move, but does not.

    Parameters
    ----------
    place : pin.SE3
        Where it stays.
    """

    def __init__(self, place: pin.SE3) -> None:
        self._place = place

    def at(self, time: float) -> pin.SE3:
        """Return where it is at any time."""
        return self._place


class Stepwise:
    """A sequence of arrays at equal time steps, each made from the one before; linear in between.

    Parameters
    ----------
    first : ndarray
        At time 0.
    after : callable
        Makes the next one from the last one.
    step : float
        Time between two [s].
    """

    def __init__(self, first: FloatArray, after: Callable[[FloatArray], FloatArray], step: float) -> None:
        self._known, self._after, self._step = [first], after, step
        self._first = 0  # step of the first one that is kept

    def at(self, time: float) -> FloatArray:
        """Return the array at a time [s], no earlier than a second before the latest that was asked for."""
        place = max(time, 0.0) / self._step - self._first
        k = max(int(place), 0)
        while len(self._known) <= k + 1:
            self._known.append(self._after(self._known[-1]))
        share = place - k
        kept = k - round(1 / self._step)
        if kept > _FORGOTTEN:
            del self._known[:kept]
            self._first, k = self._first + kept, k - kept
        found: FloatArray = (1 - share) * self._known[k] + share * self._known[k + 1]
        return found


class World:
    """The people and objects of a simulation, and where they truly are at any time.

    Parameters
    ----------
    people : mapping of str to PersonMover
        By name.
    objects : mapping of str to ObjectMover
        By obstacle.
    surroundings : Surroundings
        The replanner's: shapes, points and speeds of the objects.
    """

    def __init__(
        self,
        people: Mapping[str, PersonMover],
        objects: Mapping[str, ObjectMover],
        surroundings: Surroundings,
    ) -> None:
        self.people, self.objects = dict(people), dict(objects)
        self._surroundings = surroundings

    def keypoints(self, time: float) -> dict[str, FloatArray]:
        """Return the key points (18, 3) of all people at a time [s], completed as their bodies have it."""
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
            body = self._body(name)
            ends = body.ends(points)
            found += limb_solids(name, body.limbs, ends, body.radii(ends))
        for name, mover in self.objects.items():
            place = mover.at(time)
            for part in self._surroundings.shapes[name].parts():
                found.append(Solid(name, "", part.geometry, place * part.placement))
        return found

    def ends(self, keypoints: Mapping[str, FloatArray], time: float) -> list[FloatArray]:
        """Return the points of all bodies: ends of limbs (2, 3), and corners of objects."""
        found: list[FloatArray] = []
        for name, points in keypoints.items():
            found += list(self._body(name).ends(points))
        for name, mover in self.objects.items():
            found += self._surroundings.objects[name].points_at(mover.at(time))
        return found

    def description(self) -> dict[str, Any]:
        """Return heights and limbs of the people and bounds of the objects' speeds, as plain data."""
        bodies = {name: self._body(name) for name in self.people}
        return {
            "people": {n: {"height": body.height, "limbs": list(body.limbs)} for n, body in bodies.items()},
            "objects": {name: track.speed for name, track in self._surroundings.objects.items()},
        }

    def tick(self, time: float) -> dict[str, Any]:
        """Return key points of the people and poses of the objects at a time [s], as plain data."""
        people = {
            name: dict(zip(KEYPOINTS, points.tolist(), strict=True))
            for name, points in self.keypoints(time).items()
        }
        return {
            "people": people,
            "objects": {name: _pose(mover.at(time)) for name, mover in self.objects.items()},
        }

    def _body(self, name: str) -> TrackedBody:
        return self.people[name].tracker.body


def _pose(place: pin.SE3) -> dict[str, list[float]]:
    return {
        "position": place.translation.tolist(),
        "quaternion_xyzw": pin.Quaternion(place.rotation).coeffs().tolist(),
    }
