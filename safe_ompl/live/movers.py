"""What moves in a simulation: recorded people, things that fly about, and things that only might move."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.live.stepwise import Stepwise
from safe_ompl.people.recordings import Recording
from safe_ompl.people.tracking import Tracker


class PersonMover(Protocol):
    """A person in a simulation."""

    tracker: Tracker

    def at(self, time: float) -> FloatArray:
        """Return her key points (J, 3) at a time [s], as her skeleton has them."""


class ObjectMover(Protocol):
    """A thing in a simulation."""

    def at(self, time: float) -> pin.SE3:
        """Return where it is at a time [s]."""


class Playback:
    """A recorded person, played back and forth.

    Parameters
    ----------
    recording : Recording
        A clip.
    tracker : Tracker
        Her size and where she stands.
    speed : float
        How many times as fast as she was.
    """

    def __init__(self, recording: Recording, tracker: Tracker, speed: float = 1.0) -> None:
        self.recording, self.tracker, self.speed = recording, tracker, speed

    def at(self, time: float) -> FloatArray:
        """Return her key points (J, 3) at a time [s]."""
        return self.recording.at(self.speed * time)


class Drifting:
    """A thing that flies straight on, and is reflected at the surface of a ball and at a ball inside.

    Parameters
    ----------
    start, velocity : ndarray, shape (3,)
        Where it is at first [m], and how it moves [m/s].
    centre, radius : ndarray, float
        The ball that it does not leave [m].
    inner : (ndarray, float), optional
        A ball that it does not enter.
    step : float
        Times between which it flies straight [s].
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
    """A thing that may move, but does not.

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
