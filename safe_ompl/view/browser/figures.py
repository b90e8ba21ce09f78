"""Robots and scenes as nodes of a viser scene, from coal's triangles: no mesh loaders."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray
from safe_ompl.geometry import Person
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.view.content import Keypoints, Movers
from safe_ompl.view.pictures.bodies import RobotBody, limb_surfaces, obstacle_surfaces
from safe_ompl.view.pictures.surface import Surface, tube
from safe_ompl.view.style import Colour, rgb

_DETAIL = 0.002  # [m]; what is smaller is not sent to the browser


class RobotModel:
    """The surfaces of a robot's links, made once for all figures of it.

    Parameters
    ----------
    robot : Robot
        Its visual geometry is shown; a robot without bodies is shown by its skeleton.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._body = RobotBody(robot)
        if self._body.links:
            self.surfaces = [link.simplified(_DETAIL) for link in self._body.links]
        else:
            self.surfaces = self._bones()

    def poses(self, q: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return quaternion (w, x, y, z) and position of each surface at `q: (n,)`."""
        places = self._body.placements(q) if self._body.links else self._bone_places(q)
        return [(wxyz(place.rotation), place.translation) for place in places]

    def _bones(self) -> list[Surface]:
        lengths = [float(np.linalg.norm(b - a)) for a, b in self._bone_ends(np.zeros(self.robot.n))]
        radius = 0.02 * sum(lengths)
        ends = [np.array([(0.0, 0.0, 0.0), (0.0, 0.0, length)]) for length in lengths]
        return [Surface.from_triangles(*tube(pair, radius)) for pair in ends]

    def _bone_places(self, q: FloatArray) -> list[pin.SE3]:
        return [
            pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), b - a).matrix(), a)
            for a, b in self._bone_ends(q)
        ]

    def _bone_ends(self, q: FloatArray) -> FloatArray:
        return np.asarray(self.robot.keypoints_batch(q[None])[0][self.robot.segments])


class RobotFigure:
    """A robot in a view, which can be posed.

    Parameters
    ----------
    view : viser.SceneApi
        Where it is shown.
    name : str
        Name of its node.
    model : RobotModel
        Its surfaces.
    colour : Colour
        Of all links.
    opacity : float, optional
        Of a translucent figure.
    """

    def __init__(
        self, view: Any, name: str, model: RobotModel, colour: Colour, opacity: float | None = None
    ) -> None:
        self._model = model
        self.root = view.add_frame(name, show_axes=False)
        self._links = [
            view.add_mesh_simple(
                f"{name}/{k}",
                surface.vertices,
                surface.faces,
                color=rgb(colour),
                opacity=opacity,
                cast_shadow=opacity is None,
                receive_shadow=opacity is None,
            )
            for k, surface in enumerate(model.surfaces)
        ]
        self._posed: list[tuple[FloatArray, FloatArray]] = []

    def show(self, visible: bool) -> None:
        """Show or hide the robot."""
        self.root.visible = visible

    def pose(self, q: FloatArray) -> None:
        """Bring the robot to `q: (n,)`; links that stay where they are send nothing."""
        poses = self._model.poses(q)
        for k, (link, (turn, place)) in enumerate(zip(self._links, poses, strict=True)):
            if self._posed and np.allclose(turn, self._posed[k][0]) and np.allclose(place, self._posed[k][1]):
                continue
            link.wxyz, link.position = turn, place
        self._posed = poses


def add_scenery(view: Any, name: str, scene: Scene) -> Any:
    """Add the obstacles of a scene, people in skin and clothes, dangerous things in red; return their common node."""
    marked = any(o.weight == 0 or isinstance(o.shape, Person) for o in scene)
    root = view.add_frame(name, show_axes=False)
    for obstacle in scene:
        for k, thing in enumerate(obstacle_surfaces(obstacle, marked)):
            view.add_mesh_simple(
                f"{name}/{node_name(obstacle.name)}/{k}",
                thing.surface.vertices,
                thing.surface.faces,
                color=rgb(thing.colour),
                side="double",
            )
    return root


def node_name(name: str) -> str:
    """Return a name without the slashes that divide the tree of nodes."""
    return name.replace("/", "_")


def wxyz(rotation: FloatArray) -> FloatArray:
    """Return the quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array([w, x, y, z])


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

    Attributes
    ----------
    limbs : dict of str to dict of str to list of viser handles
        Name of a person → name of a limb → its meshes.
    things : dict of str to (Pose, list of viser handles)
        Name of an obstacle that moves → where it was first, and its meshes.
    """

    def __init__(self, view: Any, name: str, movers: Movers, scene: Scene) -> None:
        self._view, self._name, self._movers = view, name, movers
        self.limbs: dict[str, dict[str, list[Any]]] = {}
        self.things = {
            obstacle.name: (obstacle.pose, self._meshes(obstacle.name, obstacle_surfaces(obstacle)))
            for obstacle in scene
            if obstacle.name in movers.objects
        }
        for people in movers.people:
            for person in people:
                if person not in self.limbs:
                    self.limbs[person] = self._figure(person, people[person])
        self.at(0.0)

    def at(self, time: float) -> None:
        """Show where all are at a time [s]."""
        sample = self._movers.sample(time)
        people, places = self._movers.people[sample], self._movers.places[sample]
        for name, limbs in self.limbs.items():
            there = people.get(name)
            if there is not None:
                for limb in Person(self._movers.heights[name], there).limbs():
                    _place(limbs[limb.name], limb.placement)
            for mesh in (mesh for meshes in limbs.values() for mesh in meshes):
                if mesh.visible != (there is not None):
                    mesh.visible = there is not None
        for name, (first, meshes) in self.things.items():
            if name in places:
                _place(meshes, places[name].se3 * first.se3.inverse())

    def _figure(self, person: str, points: Keypoints) -> dict[str, list[Any]]:
        limbs = Person(self._movers.heights[person], points).limbs()
        return {limb.name: self._meshes(f"{person}/{limb.name}", limb_surfaces(limb)) for limb in limbs}

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
