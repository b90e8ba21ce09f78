"""The people and things of a simulation as they truly are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.live.judge import Solid, limb_solids
from safe_ompl.live.movers import ObjectMover, PersonMover
from safe_ompl.live.surroundings import Surroundings
from safe_ompl.people.body import TrackedBody
from safe_ompl.people.skeletons import KEYPOINTS
from safe_ompl.scene.pose import placed


class World:
    """Who and what moves, where they truly are at any time.

    Parameters
    ----------
    people : mapping of str to PersonMover
        By name.
    objects : mapping of str to ObjectMover
        By obstacle.
    surroundings : Surroundings
        What the replanner knows: shapes and points of the objects.
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
        """Return all bodies: limbs of people with these key points, and things at a time [s]."""
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
        """Return the points of all bodies: ends of limbs (2, 3), and corners of things."""
        found: list[FloatArray] = []
        for name, points in keypoints.items():
            found += list(self._body(name).ends(points))
        for name, mover in self.objects.items():
            found += self._surroundings.objects[name].points_at(mover.at(time))
        return found

    def header(self) -> dict[str, Any]:
        """Return what the header of a file of ticks says of them."""
        bodies = {name: self._body(name) for name in self.people}
        return {
            "people": {n: {"height": body.height, "limbs": list(body.limbs)} for n, body in bodies.items()},
            "objects": {name: track.speed for name, track in self._surroundings.objects.items()},
        }

    def tick(self, time: float) -> dict[str, Any]:
        """Return what a tick says of where they are at a time [s]."""
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
