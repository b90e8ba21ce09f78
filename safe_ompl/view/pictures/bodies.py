"""Robots and scenes as surfaces with colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray
from safe_ompl.geometry import Limb, Person
from safe_ompl.view.pictures.surface import ColouredSurface, Surface, tessellate, tube
from safe_ompl.view.style import Colour

if TYPE_CHECKING:
    from safe_ompl.geometry import Obstacle
    from safe_ompl.robot import Robot

_HARMLESS_SURFACE: Colour = (0.80, 0.68, 0.53)
_DANGEROUS_SURFACE: Colour = (0.85, 0.45, 0.30)
_SKIN: Colour = (0.86, 0.64, 0.51)
SHIRT: Colour = (0.83, 0.43, 0.29)
_TROUSERS: Colour = (0.30, 0.33, 0.40)
_SHOES: Colour = (0.20, 0.20, 0.22)
_HAIR: Colour = (0.29, 0.21, 0.16)
_HAIRLINE = pin.SE3(pin.utils.rotate("y", -0.65), np.zeros(3))  # tilts the pole of the head backwards
_BASE_RADIUS = 0.06  # [m] of the foot of a robot that has no body
_CIRCLE_CORNERS = 48  # on every circle of an obstacle


class RobotBody:
    """The visible body of a robot, ready to be posed.

    Parameters
    ----------
    robot : Robot
        Its visual geometry is drawn; the collision geometry where a joint moves nothing visual; without either,
        capsules along its skeleton.
    coarse : bool
        Draw the collision geometry, which has fewer triangles.
    detail : float
        What is smaller is not drawn [m].

    Attributes
    ----------
    links : list of Surface
        Surfaces of the links, each in its own frame; none for a robot that has no bodies.
    """

    def __init__(self, robot: Robot, *, coarse: bool = False, detail: float = 1e-5) -> None:
        self._robot = robot
        self._geometry = robot.shared.collision_model if coarse else robot.visual_model
        shown = {part.parentJoint for part in self._geometry.geometryObjects}
        for part in robot.shared.collision_model.geometryObjects:
            if part.parentJoint not in shown:  # else the arm would be drawn in pieces
                self._geometry.addGeometryObject(part)
        self.links = [
            Surface.coarsened(*tessellate(part.geometry), detail) for part in self._geometry.geometryObjects
        ]

    def posed(self, q: FloatArray, moved_from: FloatArray | None = None) -> Surface:
        """Return the body at `q: (n,)` in the world frame, without what stands as at `moved_from: (n,)`."""
        if not self.links:
            return self._skeleton(q)
        places = self.placements(q)
        before = [None] * len(places) if moved_from is None else self.placements(moved_from)
        return Surface.merged(
            link.moved(place.rotation, place.translation)
            for link, place, old in zip(self.links, places, before, strict=True)
            if old is None or not place.isApprox(old, 1e-6)
        )

    def footprint(self) -> tuple[FloatArray, float, float]:
        """Return centre (2,), radius and lowest height of the part of the body that never moves [m]."""
        base = [
            link.moved(part.placement.rotation, part.placement.translation).vertices
            for link, part in zip(self.links, self._geometry.geometryObjects, strict=True)
            if part.parentJoint == 0
        ]
        if not base:
            return np.zeros(2), _BASE_RADIUS, 0.0
        low, high = np.vstack(base).min(axis=0), np.vstack(base).max(axis=0)
        return (low[:2] + high[:2]) / 2, float((high - low)[:2].max()) / 2, float(low[2])

    def placements(self, q: FloatArray) -> list[pin.SE3]:
        """Return where each of the links is in the world at `q: (n,)`."""
        model, data = self._robot.shared.model, self._robot.shared.model.createData()
        bodies = self._geometry.createData()
        pin.updateGeometryPlacements(
            model, data, self._geometry, bodies, self._robot.pinocchio_configuration(q)
        )
        return [pin.SE3(place) for place in bodies.oMg]

    def _skeleton(self, q: FloatArray) -> Surface:
        points = self._robot.keypoints_batch(q[None])[0]
        ends = points[self._robot.segments]
        radius = 0.03 * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
        bones = [Surface.from_triangles(*tube(pair, 0.7 * radius)) for pair in ends]
        joints = [Surface.from_triangles(*tube(point[None], radius)) for point in points]
        return Surface.merged(bones + joints)


def obstacle_surfaces(obstacle: Obstacle, marked: bool = True) -> list[ColouredSurface]:
    """Return the surfaces of an obstacle: people by limb, in skin and clothes, all else in one colour.

    Parameters
    ----------
    obstacle : Obstacle
        Its own colour comes first; that of a person is the colour of the shirt.
    marked : bool
        Whether a dangerous thing looks different from a harmless one.
    """
    own = None if obstacle.color is None else (obstacle.color[0], obstacle.color[1], obstacle.color[2])
    if isinstance(obstacle.shape, Person):
        return _person_surfaces(obstacle.shape, obstacle.pose.se3, own or SHIRT)
    colour = own or (_DANGEROUS_SURFACE if marked and obstacle.weight > 0 else _HARMLESS_SURFACE)
    return [ColouredSurface(Surface.from_triangles(*obstacle.triangles(_CIRCLE_CORNERS)), colour)]


def _person_surfaces(person: Person, world: pin.SE3, shirt: Colour) -> list[ColouredSurface]:
    things = []
    for limb in person.limbs():
        place = world * limb.placement
        for piece in limb_surfaces(limb, shirt):
            surface = piece.surface.moved(place.rotation, place.translation)
            things.append(ColouredSurface(surface, piece.colour))
    return things


def limb_surfaces(limb: Limb, shirt: Colour = SHIRT) -> list[ColouredSurface]:
    """Return the surfaces of a limb of a person in its own frame, along z: what is bare, and what is covered."""
    kind = limb.name.removeprefix("left_").removeprefix("right_")
    surface = Surface.from_triangles(*limb.shape.triangles(_CIRCLE_CORNERS))
    heights = surface.vertices[surface.faces, 2].mean(axis=1)
    covered = heights > (0.25 * limb.radius if kind == "head" else limb.length / 2)
    turn = _HAIRLINE.rotation if kind == "head" else np.eye(3)
    colours = _clothes(shirt).get(kind, (_SKIN, _SKIN))
    return [
        ColouredSurface(surface.part(faces).moved(turn, np.zeros(3)), colour)
        for colour, faces in zip(colours, (~covered, covered), strict=True)
        if faces.any()
    ]


def _clothes(shirt: Colour) -> dict[str, tuple[Colour, Colour]]:
    """Return two colours for each limb that is not bare: face and hair, or its length and its far end."""
    return {
        "head": (_SKIN, _HAIR),
        "shoulders": (shirt, shirt),
        "torso": (shirt, _TROUSERS),
        "flank": (shirt, _TROUSERS),
        "upper_arm": (shirt, _SKIN),
        "hips": (_TROUSERS, _TROUSERS),
        "thigh": (_TROUSERS, _TROUSERS),
        "shank": (_TROUSERS, _TROUSERS),
        "foot": (_SHOES, _SHOES),
    }
