"""People and things that move in a view, as a live simulation recorded them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.pictures.render.bodies import clothed, painted
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.person import Person
from safe_ompl.viewer.colours import rgb
from safe_ompl.viewer.figures import node_name, wxyz

Keypoints = Mapping[str, Sequence[float]]


@dataclass(frozen=True, eq=False)
class Movers:
    """Where people and things are at some instants; between two of them they stay where they were.

    Parameters
    ----------
    times : (T,) array
        Instants [s].
    heights : mapping of str to float
        Name of a person → height [m].
    people : sequence of mapping
        For each instant: name → key points in the world [m]; who is not there is not seen.
    places : sequence of mapping
        For each instant: name of an obstacle of the scene → its pose.
    """

    times: FloatArray
    heights: Mapping[str, float]
    people: Sequence[Mapping[str, Keypoints]]
    places: Sequence[Mapping[str, Pose]]

    @property
    def objects(self) -> frozenset[str]:
        """Names of the obstacles that move."""
        return frozenset(name for places in self.places for name in places)

    def sample(self, time: float) -> int:
        """Return the number of the instant at a time [s], or before it."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))

    def people_at(self, time: float) -> list[Obstacle]:
        """Return the people who are there at a time [s], as obstacles."""
        there = self.people[self.sample(time)]
        return [
            Obstacle(name, Person(self.heights[name], points), Pose(), weight=1.0)
            for name, points in there.items()
        ]

    def obstacles_at(self, time: float, scene: Scene) -> list[Obstacle]:
        """Return all that move, as they are at a time [s]: people, and obstacles of the scene at their places."""
        places = self.places[self.sample(time)]
        things = [replace(o, pose=places[o.name]) for o in scene if o.name in places]
        return [*self.people_at(time), *things]


class MoverFigures:
    """People and things that move, in a view.

    Limbs keep the length that they have where they are first seen; they move, and do not stretch.

    Parameters
    ----------
    view : viser.SceneApi
        Where they are shown.
    name : str
        Name of their node.
    movers : Movers
        Who moves.
    scene : Scene
        Its obstacles that move are shown by `movers`.
    """

    def __init__(self, view: Any, name: str, movers: Movers, scene: Scene) -> None:
        self._view, self._name, self._movers = view, name, movers
        self._limbs: dict[str, dict[str, list[Any]]] = {}
        self._things = {
            obstacle.name: (obstacle.pose, self._meshes(obstacle.name, painted(obstacle)))
            for obstacle in scene
            if obstacle.name in movers.objects
        }
        for people in movers.people:
            for person in people:
                if person not in self._limbs:
                    self._limbs[person] = self._figure(person, people[person])
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show where all are at a time [s]."""
        sample = self._movers.sample(time)
        people, places = self._movers.people[sample], self._movers.places[sample]
        for name, limbs in self._limbs.items():
            there = people.get(name)
            if there is not None:
                for limb in Person(self._movers.heights[name], there).limbs():
                    _place(limbs[limb.name], limb.placement)
            for mesh in (mesh for meshes in limbs.values() for mesh in meshes):
                if mesh.visible != (there is not None):
                    mesh.visible = there is not None
        for name, (first, meshes) in self._things.items():
            if name in places:
                _place(meshes, places[name].se3 * first.se3.inverse())

    def _figure(self, person: str, points: Keypoints) -> dict[str, list[Any]]:
        limbs = Person(self._movers.heights[person], points).limbs()
        return {limb.name: self._meshes(f"{person}/{limb.name}", clothed(limb)) for limb in limbs}

    def _meshes(self, name: str, pieces: Sequence[Any]) -> list[Any]:
        return [
            self._view.add_mesh_simple(
                f"{self._name}/{node_name(name)}_{k}",
                piece.surface.vertices,
                piece.surface.faces,
                color=rgb(piece.colour),
                side="double",
            )
            for k, piece in enumerate(pieces)
        ]


def _place(meshes: Sequence[Any], placement: pin.SE3) -> None:
    for mesh in meshes:
        mesh.wxyz, mesh.position = wxyz(placement.rotation), placement.translation
