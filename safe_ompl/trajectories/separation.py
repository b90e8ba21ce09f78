"""Lower bounds of the time that people need to reach the robot along a curve, proven for every cell.

A limb may be at a distance d [m] after the time τ with g(τ) = d, where g is its growth: speed · τ, or that of a
calibrated reach. Where g is the least of some lines a + bτ, it is below d until *all* lines reach d at the latest: τ is
the largest of all (d − a)/b.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.collision import DISTANCE_ERROR, fresh_data
from safe_ompl.common import FloatArray, InputError, IntArray, PerThread
from safe_ompl.people import CalibratedReach
from safe_ompl.robot import Robot
from safe_ompl.scene import People, Scene
from safe_ompl.trajectories.contact import ContactLimits
from safe_ompl.trajectories.curve import Cells, Curve

_SHORT = 0.05  # [s] See `PeopleDistances.along`
_UNKNOWN, _NEVER = 1e6, 1e6  # [m], [s]


class SeparationBounds(NamedTuple):
    """What is left between people and robot in the cells of a curve.

    Attributes
    ----------
    distances : ndarray, shape (N, M)
        No body of the robot is nearer to limb m in a cell [m]; exact to what it moves in the cell where that matters.
    times : ndarray, shape (N, M)
        After that time from when braking begins a limb may be there [s]: when its growth is distance − clearance, less
        the reaction time.
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
        How fast the limbs may move, at most [m/s].
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
        speeds = np.array([people.speed_of(limb) for _, limb in limbs])
        self._lines: FloatArray = np.stack([0 * speeds, speeds], axis=1)[:, None]
        if people.reach is not None:
            reach = CalibratedReach.load(people.reach)
            self._lines = reach.lines_of([limb for _, limb in limbs], people)
        self.speeds: FloatArray = self._lines[..., 1].max(axis=1)
        self._moves = (self.speeds > 0)[self._limb].tolist()
        self._starts, slopes = np.moveaxis(self._lines[self._limb], -1, 0)
        self._still = slopes <= 0
        self._any_still = bool(self._still.any())
        self._slowness = np.where(self._still, 0.0, 1 / np.where(self._still, 1.0, slopes))
        self._pair_lines = np.stack([self._starts, self._slowness], axis=-1).tolist()
        self.contact: ContactLimits | None = None
        if people.contact:
            shapes = {name: scene[name].shape for name in self._names}
            heights = {name: getattr(shape, "height", np.inf) for name, shape in shapes.items()}
            still = scene.without(*self._names)
            self.contact = ContactLimits(robot, still, people, limbs, heights)

    def grown(self, limb: int, time: float) -> float:
        """Return how far one of the limbs goes in a time [s], at most [m]."""
        return float((self._lines[limb] @ [1.0, time]).min())

    def speed(self, limb: int, time: float) -> float:
        """Return how fast the growth of one of the limbs is after a time [s], in [m/s]."""
        lines = self._lines[limb]
        return float(lines[(lines @ [1.0, np.clip(time, 0.0, _NEVER)]).argmin(), 1])

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
        times, bounds, still = (
            np.empty(len(Q)),
            np.full(len(self._body), -_UNKNOWN),
            np.zeros(len(self._body)),
        )
        for j, q in enumerate(Q):
            if j:
                steps = self.robot.coupling.reach(np.abs(q - Q[j - 1])[None])[0]
                bounds -= (self.robot.bounds.joint_radii @ steps)[self._body]
            times[j] = self._refresh(q, bounds, still, np.inf, by_limb=-np.inf).min()
        return times

    def along(
        self, curve: Curve, cells: Cells, speeds: FloatArray, soon: float, short: float = _SHORT
    ) -> SeparationBounds:
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
        short : float
            Limbs that may come so soon are looked at one by one where contact is allowed [s].
        """
        Q = curve.at(cells.centres).q
        # (N, P) [m] from a centre to an end of its cell
        half = cells.sizes[:, None] / 2 * speeds[:, self._body]
        by_limb = short if self.people.contact else -np.inf
        left, times = np.empty_like(half), np.empty_like(half)
        bounds = np.full(len(self._body), -_UNKNOWN)
        for j, q in enumerate(Q):
            if j:
                bounds -= half[j - 1] + half[j]
            times[j] = self._refresh(q, bounds, half[j], soon, by_limb)
            left[j] = bounds - half[j]
        # Body by body and limb by limb: pairs are in the order of limbs, and of bodies within each.
        left, times = (found.reshape(len(Q), len(self.limbs), -1) for found in (left, times))
        first = times.argmin(axis=2)
        nearest = self._body.reshape(times.shape[1:])[np.arange(len(self.limbs)), first]
        return SeparationBounds(left.min(axis=2), times.min(axis=2), nearest)

    def _time(self, distances: FloatArray) -> FloatArray:
        """Return when limbs at these distances may reach the robot; infinite for limbs at rest, unless too near."""
        left = (distances - self.people.clearance)[:, None] - self._starts
        time = left * self._slowness
        if self._any_still:
            time = np.where(self._still, np.where(left > 0, np.inf, -np.inf), time)
        return np.asarray(time.max(axis=1) - self.people.reaction_time)

    def _pair_time(self, pair: int, distance: float) -> float:
        """Return `_time` of one pair, bit for bit."""
        time, room = -np.inf, distance - self.people.clearance
        for start, slowness in self._pair_lines[pair]:
            left = room - start
            time = max(time, left * slowness if slowness else np.inf if left > 0 else -np.inf)
        return time - self.people.reaction_time

    def _refresh(
        self, q: FloatArray, bounds: FloatArray, half: FloatArray, soon: float, by_limb: float
    ) -> FloatArray:
        """Replace bounds by distances at `q: (n,)` until those that are left cannot be the first to be reached.

        Limbs that may come sooner than `by_limb` [s] are looked at in any case. Returned are the times (P,) then.
        """
        time = self._time(bounds - half)
        (near,) = (time <= soon).nonzero()
        if not len(near):
            return time
        kinematics, data = self._memory.own
        model, there = self.robot.shared.model, self.robot.pinocchio_configuration(q)
        pin.updateGeometryPlacements(model, kinematics, self._geometry, data, there)
        near, first = near[time[near].argsort()], np.inf
        for p, before, moved in zip(near.tolist(), time[near].tolist(), half[near].tolist(), strict=True):
            if before > first and before >= by_limb:
                break
            bounds[p] = distance = pin.computeDistance(self._geometry, data, p).min_distance - DISTANCE_ERROR
            time[p] = now = self._pair_time(p, distance - moved)
            if now < first and self._moves[p]:
                first = now
        return time


def _memory(model: pin.Model, geometry: pin.GeometryModel) -> tuple[pin.Data, pin.GeometryData]:
    return model.createData(), fresh_data(geometry)
