"""What moves around a robot, as it was measured last."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl import document
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.inputs import number
from safe_ompl.people.reach import ReachModel, ReachSets
from safe_ompl.people.tracking import ObjectTrack, PersonTrack, Tracker, Violation
from safe_ompl.robot.bodies.reach import bounding_hull
from safe_ompl.scenario.people import People
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose, placed
from safe_ompl.scene.scene import Scene


class Surroundings:
    """People and objects that move, each with its track.

    Parameters
    ----------
    scene : Scene
        All obstacles.
    trackers : mapping of str to Tracker
        People that are tracked.
    objects : mapping of str to float
        Obstacles that move, and bounds of their speeds [m/s].
    people : People
        How fast people may move.
    reach : ReachModel, optional
        What is assumed of how they do.

    Attributes
    ----------
    scene, still : Scene
        All obstacles but the people that are tracked; and those that stand still.
    shapes : dict of str to Shape
        Of the objects.
    people, objects : dict
        The tracks by name.
    time : float
        When was measured last [s]; −inf: never.
    """

    def __init__(
        self,
        scene: Scene,
        trackers: Mapping[str, Tracker],
        objects: Mapping[str, float],
        people: People,
        reach: ReachModel | None = None,
    ) -> None:
        for name in trackers:
            if name in objects:
                raise InputError(f"{name!r} is a person and an object: give one of both", "objects")
        self.people = {name: PersonTrack(name, how, people, reach) for name, how in trackers.items()}
        self.objects = {name: _track(scene[name], speed) for name, speed in objects.items()}
        self.shapes = {name: scene[name].shape for name in objects}
        self.scene = scene.without(*(name for name in scene.names if name in trackers))
        self.still = self.scene.without(*objects)
        self.time = -np.inf
        self.sets = ReachSets.none()
        self._violations: list[Violation] = []

    def __repr__(self) -> str:
        return f"Surroundings({len(self.people)} people, {len(self.objects)} objects)"

    @property
    def _tracks(self) -> dict[str, PersonTrack | ObjectTrack]:
        return {**self.people, **self.objects}

    @property
    def known(self) -> bool:
        """Whether everybody and everything was seen."""
        seen = all(track.keypoints is not None for track in self.people.values())
        return seen and all(np.isfinite(track.seen) for track in self.objects.values())

    def update(
        self, people: Mapping[str, ArrayLike | None], objects: Mapping[str, Any], time: float
    ) -> list[Violation]:
        """Take what sensors saw; see `Replanner.update`."""
        number("time", time)
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
                pose = None if objects.get(name) is None else Pose.of(objects[name]).se3
            found.append(thing.observe(pose, time))
        self.time = float(time)
        self._violations = [violation for violation in found if violation is not None]
        if self.known:
            self.sets = ReachSets.none()
            for track in self._tracks.values():
                self.sets = self.sets.beside(track.sets())
        return list(self._violations)

    def trouble(self, time: float, lost_after: float) -> str | None:
        """Return why the robot must stop whatever the sets say: who broke her promise, or is lost."""
        for name, track in self._tracks.items():
            age = time - self.time + track.age
            if age > lost_after:
                return (
                    f"{name!r} was not seen yet"
                    if np.isinf(age)
                    else f"{name!r} was not seen for {age:.2f} s"
                )
        return str(self._violations[0]) if self._violations else None


def _track(obstacle: Obstacle, speed: float) -> ObjectTrack:
    hulls = []
    for part in obstacle.shape.parts():
        hull = bounding_hull(part.geometry)
        hulls.append((placed(part.placement, hull.points), hull.radius))
    limit = number(f"objects.{obstacle.name}", speed, at_least=0.0)
    return ObjectTrack(obstacle.name, hulls, limit, obstacle.pose.se3)
