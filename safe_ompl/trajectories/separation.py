"""Lower bounds of the time that people need to reach the robot along a curve, proven for every cell."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.collision import DISTANCE_ERROR, fresh_data
from safe_ompl.common import FloatArray, InputError, IntArray, PerThread
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories.contact import ContactLimits
from safe_ompl.trajectories.curve import BlendedCurve, Cells

_SHORT = 0.05  # [s] Limbs that may come so soon are looked at one by one where contact is allowed
_UNKNOWN = 1e6  # [m]


class SeparationBounds(NamedTuple):
    """What is left between people and robot in the cells of a curve.

    Attributes
    ----------
    distances : ndarray, shape (N, M)
        No body of the robot is nearer to limb m in a cell [m]; exact to what it moves in the cell where that matters.
    times : ndarray, shape (N, M)
        After that time from when braking begins a limb may be there [s]: (distance − clearance)/speed − reaction time.
    nearest : ndarray of int, shape (N, M)
        The body of the robot that it comes to first.
    """

    distances: FloatArray
    times: FloatArray
    nearest: IntArray


class PeopleDistances:
    """Distances between the bodies of a robot and the limbs of people.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        Where the people are.
    people : People
        Who counts, and how fast they are.

    Attributes
    ----------
    robot, people
        As given.
    limbs : tuple of (str, str)
        Obstacle and limb of each of the M limbs; the limb is empty where the obstacle is one body.
    links : tuple of str
        The link of each body.
    speeds : ndarray, shape (M,)
        How fast the limbs may move [m/s].
    moving : ndarray of int
        Which bodies of `collision_model` move.
    contact : ContactLimits or None
        With what speeds limbs may be touched; None: contact is not allowed.
    """

    def __init__(self, robot: Robot, scene: Scene, people: People) -> None:
        self.robot, self.people = robot, people
        bodies = robot.shared.collision_model
        self._geometry = bodies.copy()
        self._geometry.removeAllCollisionPairs()
        self.links = tuple(body.name.rsplit("_", 1)[0] for body in bodies.geometryObjects)
        moving = [k for k, body in enumerate(bodies.geometryObjects) if body.parentJoint != 0]
        self.moving: IntArray = np.array(moving, dtype=np.intp)
        limbs, pairs = [], []
        self._names = people.names(scene)
        self._parts: dict[str, int] = {}
        for name in self._names:
            for part, shape, placement in scene[name].geometries():
                added = self._geometry.addGeometryObject(
                    pin.GeometryObject(f"person:{part}", 0, placement, shape)
                )
                self._parts[part] = int(added)
                limbs.append((name, part[len(name) + 1 :]))
                pairs += [(body, int(added), len(limbs) - 1) for body in moving]
        for body, added, _ in pairs:
            self._geometry.addCollisionPair(pin.CollisionPair(body, added))
        self.limbs = tuple(limbs)
        self._body: IntArray = np.array([body for body, _, _ in pairs], dtype=np.intp)
        self._limb: IntArray = np.array([limb for _, _, limb in pairs], dtype=np.intp)
        self._memory = PerThread(partial(_memory, robot.shared.model, self._geometry))
        self.speeds: FloatArray = np.array([people.speed_of(limb) for _, limb in limbs])
        self.contact: ContactLimits | None = None
        if people.contact:
            shapes = {name: scene[name].shape for name in self._names}
            heights = {name: getattr(shape, "height", np.inf) for name, shape in shapes.items()}
            still = scene.without(*self._names)
            self.contact = ContactLimits(robot, still, people, limbs, heights)

    def move(self, scene: Scene) -> None:
        """Put the people where another scene has them.

        Raises
        ------
        InputError
            If they have other limbs there.
        UnknownNameError
            If the scene has no obstacle of such a name.
        """
        found = {
            part: (shape, place) for name in self._names for part, shape, place in scene[name].geometries()
        }
        if set(found) != set(self._parts):
            raise InputError(
                f"the people are not the same: {sorted(set(found) ^ set(self._parts))[0]!r}", "scene"
            )
        for part, (shape, place) in found.items():
            body = self._geometry.geometryObjects[self._parts[part]]
            body.placement, body.geometry = place, shape
        self._memory = PerThread(partial(_memory, self.robot.shared.model, self._geometry))

    def times_at(self, Q: FloatArray) -> FloatArray:
        """Return when the first limb may be at the robot (B,) [s] that stays at `Q: (B, n)`; see `SeparationBounds`."""
        speed = self.speeds[self._limb]
        slowness = np.where(speed > 0, 1 / np.where(speed > 0, speed, 1.0), 0.0)
        times, bounds, still = (
            np.empty(len(Q)),
            np.full(len(self._body), -_UNKNOWN),
            np.zeros(len(self._body)),
        )
        for j, q in enumerate(Q):
            if j:
                steps = self.robot.coupling.reach(np.abs(q - Q[j - 1])[None])[0]
                bounds -= (self.robot.bounds.joint_radii @ steps)[self._body]
            self._refresh(q, bounds, slowness, still, np.inf, by_limb=False)
            times[j] = self._time(bounds, slowness).min()
        return times

    def along(self, curve: BlendedCurve, cells: Cells, speeds: FloatArray, soon: float) -> SeparationBounds:
        """Return what is left in the cells of a curve.

        Every distance is kept as a bound, that falls by what the body can move from one cell to the next. Only
        the pairs whose bound may be the first to be reached are looked at anew.

        Parameters
        ----------
        curve, cells
            The curve.
        speeds : ndarray, shape (N, G)
            Bounds of the speed of each body in each cell, from `BodySpeeds` [m/rad].
        soon : float
            Limbs that need longer than this do not matter, and need not be looked at [s].
        """
        Q = curve.at(cells.centres).q
        half = (
            cells.sizes[:, None] / 2 * speeds[:, self._body]
        )  # (N, P) [m] from a centre to an end of its cell
        speed = self.speeds[self._limb]
        people = self.people
        slowness = np.where(speed > 0, 1 / np.where(speed > 0, speed, 1.0), 0.0)
        by_limb = bool(people.contact)
        # Body by body and limb by limb: pairs are in the order of limbs, and of bodies within each.
        shape = (len(self.limbs), len(self._body) // len(self.limbs))
        distances = np.empty((len(Q), shape[0]))
        times, nearest = np.empty_like(distances), np.empty(distances.shape, dtype=np.intp)
        bounds = np.full(len(self._body), -_UNKNOWN)
        for j, q in enumerate(Q):
            if j:
                bounds -= half[j - 1] + half[j]
            self._refresh(q, bounds, slowness, half[j], soon, by_limb)
            left = bounds - half[j]
            time = self._time(left, slowness).reshape(shape)
            first = time.argmin(axis=1)
            rows = np.arange(shape[0])
            times[j] = time[rows, first]
            distances[j] = left.reshape(shape).min(axis=1)
            nearest[j] = self._body.reshape(shape)[rows, first]
        return SeparationBounds(distances, times, nearest)

    def _time(self, distances: FloatArray, slowness: FloatArray) -> FloatArray:
        """Return when limbs at these distances may reach the robot; infinite for limbs at rest, unless too near."""
        left = distances - self.people.clearance
        time = left * slowness - self.people.reaction_time
        still = slowness == 0
        return np.where(still, np.where(left > 0, np.inf, -np.inf), time) if still.any() else time

    def _refresh(
        self,
        q: FloatArray,
        bounds: FloatArray,
        slowness: FloatArray,
        half: FloatArray,
        soon: float,
        by_limb: bool,
    ) -> None:
        """Replace bounds by distances at `q: (n,)` until those that are left cannot be the first to be reached."""
        time = self._time(bounds - half, slowness)
        near = np.flatnonzero(time <= soon)
        first = np.inf
        placed = False
        kinematics, data = self._memory.own
        for p in near[time[near].argsort()].tolist():
            if time[p] > first and not (by_limb and time[p] < _SHORT):
                break
            if not placed:
                pin.updateGeometryPlacements(
                    self.robot.shared.model,
                    kinematics,
                    self._geometry,
                    data,
                    self.robot.pinocchio_configuration(q),
                )
                placed = True
            distance = pin.computeDistance(self._geometry, data, p).min_distance - DISTANCE_ERROR
            bounds[p] = distance
            left = distance - half[p] - self.people.clearance
            first = min(first, left * slowness[p] - self.people.reaction_time if slowness[p] else first)


def _memory(model: pin.Model, geometry: pin.GeometryModel) -> tuple[pin.Data, pin.GeometryData]:
    return model.createData(), fresh_data(geometry)
