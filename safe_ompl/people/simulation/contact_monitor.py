"""The contact monitor of a simulation: coal's distances between the robot and everything that moves, at fine steps.

It shares nothing with the replanner except the robot's collision model and the bodies of people.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.collision import fresh_data
from safe_ompl.common import FloatArray
from safe_ompl.geometry import Limb
from safe_ompl.robot import Robot


class Nearest(NamedTuple):
    """The smallest distance at one instant [m], the link of the robot, and the limb of a person or object."""

    distance: float
    link: str | None = None
    who: str | None = None
    limb: str | None = None


class Solid(NamedTuple):
    """A limb of a person, or a part of an object, at its place."""

    who: str
    limb: str
    geometry: coal.CollisionGeometry
    placement: pin.SE3


@dataclass
class Contact:
    """A contact between the robot and a person or object.

    Attributes
    ----------
    time : float
        When it began [s].
    link, who, limb : str
        The link of the robot, and the limb of the person or object.
    moving : bool
        Whether the robot moved then, or later while it lasted.
    obeyed : bool
        Whether everybody had kept to the reach model since the measurement that the motion was proven against.
    """

    time: float
    link: str
    who: str
    limb: str
    moving: bool
    obeyed: bool


def limb_solids(who: str, limbs: tuple[str, ...], ends: FloatArray, radii: FloatArray) -> list[Solid]:
    """Return the limbs of a person as capsules, ends (M, 2, 3) and radii (M,) [m]."""
    found = []
    for name, (start, end), radius in zip(limbs, ends, radii.tolist(), strict=True):
        limb = Limb(name, start, end, radius)
        length = limb.length
        geometry = coal.Capsule(radius, length) if length > 0 else coal.Sphere(radius)
        found.append(Solid(who, name, geometry, limb.placement))
    return found


class ContactMonitor:
    """Measures distances between a robot and everything that moves, and notes contacts.

    Parameters
    ----------
    robot : Robot
        The robot.

    Attributes
    ----------
    contacts : list of Contact
        All contacts so far, in order.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._model = robot.shared.model
        self._bodies = robot.shared.collision_model
        self._kinematics = self._model.createData()
        self._data = fresh_data(self._bodies)
        self._moving = [k for k, part in enumerate(self._bodies.geometryObjects) if part.parentJoint != 0]
        self._links = [part.name.rsplit("_", 1)[0] for part in self._bodies.geometryObjects]
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._touching: dict[tuple[str, str], Contact] = {}
        self.contacts: list[Contact] = []

    def nearest(self, q: FloatArray, solids: list[Solid]) -> Nearest:
        """Return the smallest distance between the robot at `q: (n,)` and any of the solids."""
        full = self._robot.pinocchio_configuration(q)
        pin.updateGeometryPlacements(self._model, self._kinematics, self._bodies, self._data, full)
        found = Nearest(np.inf)
        for k in self._moving:
            part, place = self._bodies.geometryObjects[k], self._data.oMg[k]
            where = coal.Transform3s(place.rotation, place.translation)
            for solid in solids:
                there = coal.Transform3s(solid.placement.rotation, solid.placement.translation)
                self._result.clear()  # or it keeps the smallest of all that it ever saw
                distance = coal.distance(
                    part.geometry, where, solid.geometry, there, self._request, self._result
                )
                if distance < found.distance:
                    found = Nearest(float(distance), self._links[k], solid.who, solid.limb)
        return found

    def observe(
        self, time: float, q: FloatArray, solids: list[Solid], *, moving: bool, obeyed: bool
    ) -> Nearest:
        """Note a contact at one instant if there is one, and return the smallest distance."""
        nearest = self.nearest(q, solids)
        if nearest.distance > 0:
            self.clear()
            return nearest
        key = str(nearest.who), str(nearest.limb)
        if key not in self._touching:
            self._touching = {key: Contact(time, str(nearest.link), *key, moving, obeyed)}
            self.contacts.append(self._touching[key])
        contact = self._touching[key]
        if moving and not contact.moving:
            contact.moving, contact.obeyed = True, obeyed
        return nearest

    def clear(self) -> None:
        """Note that nobody touches the robot now."""
        self._touching.clear()
