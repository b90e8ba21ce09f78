"""Lower bounds of the time in which people can reach the robot along a motion, proven for every cell.

A limb with a bounded speed covers a distance d [m] after the time d / speed at the earliest.

Every distance is a lower bound at the centre of a cell, minus the motion of the body from there to an end of the cell.
At the centre the distance is bounded by balls, then by a ball and a box, then by planes that separate convex bodies
(`geometry.convex`). Each finer bound is computed only for limbs that may arrive first by the coarser bound. Bodies that
are not convex are replaced by their hulls.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.geometry import ConvexBodies
from safe_ompl.motions.bodies import LimbArrivals
from safe_ompl.motions.cells import BodySpeeds, Cells
from safe_ompl.motions.contact import ContactLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.robot import Robot, plain
from safe_ompl.scene import People, Scene

_PREVIEW_TIME = 0.05  # [s] See `PeopleDistances.along`


class SeparationBounds(NamedTuple):
    """Distances and times left between M limbs and the robot in N cells, tight for limbs that may arrive first.

    `distances` [m] and `times` [s], (N, M): no body is nearer to a limb, and none is where a limb may be until then
    from when braking begins; `nearest` is the body that the limb comes to first. If bodies did not move within a cell
    the limb might be there later by `lost` [s]. A contact is harmless at a ṡ of `harmless: (N, M)`, whatever body
    touches; whether clamping decides that says `clamped`.
    """

    distances: FloatArray
    times: FloatArray
    nearest: IntArray
    lost: FloatArray
    harmless: FloatArray
    clamped: BoolArray


class PeopleDistances:
    """Distances between the bodies of a robot and the M `limbs` of people, which are pairs of obstacle and limb.

    `links` are the links of the bodies, and `moving` the bodies that move. No limb is faster than `speeds: (M,)` [m/s].
    Limbs with equal numbers in `alike: (M,)` have the same contact limits. `contact` gives the speeds at which limbs
    may be touched, or is None.
    """

    def __init__(self, robot: Robot, scene: Scene, people: People) -> None:
        self.robot, self.people = robot, people
        self.links = robot.shared.body_links
        self.moving: IntArray = np.flatnonzero(robot.bounds.body_corners[0])
        names = people.names(scene)
        found = [(name, *part) for name in names for part in scene[name].geometries()]
        self.limbs = tuple((name, part[len(name) + 1 :]) for name, part, _, _ in found)
        self.speeds: FloatArray = np.array([people.speed_of(limb) for _, limb in self.limbs])
        own = robot.bounds.convex_bodies
        placed = [pin.GeometryObject(f"person:{part}", 0, place, shape) for _, part, shape, place in found]
        tables = robot.kinematics.table, own.joined(ConvexBodies.of(placed)).table
        limbs, times = np.arange(len(placed)) + len(own.bodies), (people.clearance, people.reaction_time)
        self._arrivals = LimbArrivals(*tables, self.moving, limbs, self.speeds, *times)
        self.contact: ContactLimits | None = None
        self.alike: IntArray = np.zeros(len(self.limbs), dtype=np.intp)
        if people.contact:
            shapes = {name: scene[name].shape for name in names}
            heights = {name: getattr(shape, "height", np.inf) for name, shape in shapes.items()}
            still = scene.without(*names)
            self.contact = contact = ContactLimits(robot, still, people, self.limbs, heights)
            borne = np.stack([contact.bears, contact.bears_clamped, contact.thickness])
            self.alike = np.unique(borne, axis=1, return_inverse=True)[1].ravel()

    def grown(self, limb: int, time: float) -> float:
        """Return the largest distance [m] that a limb moves in a time [s]."""
        return float(self.speeds[limb] * time)

    def along(
        self, motion: Motion, cells: Cells, bodies: BodySpeeds, soon: float, short: float = _PREVIEW_TIME
    ) -> SeparationBounds:
        """Return the distances and times in the cells of a curve, tight only for limbs that may arrive first.

        Limbs that need longer than `soon` [s] may be skipped. If contact is allowed, limbs that may arrive within
        `short` [s] are checked one by one.
        """
        speeds, Q = bodies.bounds(motion, cells)[:, self.moving], motion.at(cells.centres)
        half = cells.sizes[:, None] / 2 * speeds
        short = short if self.people.contact else -inf
        found = self._arrivals.along(plain(self.robot.coupling.values(Q)), plain(half), soon, short)
        distances, times, nearest = found
        moved, zeros = np.take_along_axis(half, nearest, axis=1), np.zeros(times.shape)
        lost = np.divide(moved, self.speeds, out=zeros.copy(), where=self.speeds > 0)
        if self.contact is None:
            return SeparationBounds(distances, times, self.moving[nearest], lost, zeros, zeros > 0)
        borne, free = (s.min(axis=1) for s in self.contact.speeds(Q, cells.sizes, cells.dq_ds, speeds))
        return SeparationBounds(distances, times, self.moving[nearest], lost, borne, borne < free)
