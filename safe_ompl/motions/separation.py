"""Lower bounds of the time that people need to reach the robot along a motion, proven for every cell.

A limb that is no faster than a speed may be at a distance d [m] after the time d / speed at the earliest.

Every distance is a lower bound for the middle of a cell, less what the body moves from there to an end of it. In the
middle it is bounded by balls, then by a ball and a box, then by planes that separate convex bodies
(`geometry.kernels`), each only where the one before may let the limb be the first to arrive. Bodies that are not
convex count as their hulls.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, IntArray, compiled, part
from safe_ompl.geometry import DISTANCE_ERROR, ConvexBodies
from safe_ompl.geometry.kernels import POSE, Shapes, begin_axis, distance_bounds, from_box, place_bodies
from safe_ompl.motions.cells import Cells
from safe_ompl.motions.contact import ContactLimits
from safe_ompl.motions.motion import Motion
from safe_ompl.robot import Robot, plain
from safe_ompl.robot.kernels import place_joints
from safe_ompl.scene import People, Scene

_SHORT = 0.05  # [s] See `PeopleDistances.along`
_ROUNDING = 1e-9  # [m]


class SeparationBounds(NamedTuple):
    """What is left between M limbs and the robot in N cells of a curve; exact, where it matters, to what it moves.

    `distances` [m] and `times` [s], (N, M): no body is nearer to a limb, and none is where a limb may be until then
    from when braking begins; `nearest` is the body that the limb comes to first.
    """

    distances: FloatArray
    times: FloatArray
    nearest: IntArray


class _Limbs(NamedTuple):
    """Which B moving bodies and M limbs there are among G shapes, and when limbs arrive."""

    bodies: IntArray  # (B,), their shapes
    limbs: IntArray  # (M,)
    speeds: FloatArray  # (M,), of the limbs, at most [m/s]
    clearance: float  # [m]
    reaction: float  # [s]


@part
def _arrival(limbs: _Limbs, m: int, distance: float) -> float:
    """Return when limb m may be at a body that is so far away; infinite at rest, −∞ if it is too near already."""
    room, speed = distance - limbs.clearance, limbs.speeds[m]
    time = room / speed if speed > 0.0 else inf if room > 0.0 else -inf
    return float(time - limbs.reaction)


@part
def _reach(limbs: _Limbs, m: int, time: float) -> float:
    """Return the distance from which limb m does not arrive before a time."""
    speed = limbs.speeds[m]
    return float(limbs.clearance + (speed * (time + limbs.reaction) if speed > 0.0 else 0.0))


@compiled
def arrivals(
    joints: Any, shapes: Shapes, limbs: _Limbs, values: FloatArray, half: FloatArray, soon: float, short: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return distances and arrival times (N, M) of limbs, and the body (N, M) that each comes to first.

    The joints have `values: (N, m)` in the middle of cells; bodies get by `half: (N, B)` [m] from there. Limbs at rest
    that are far enough arrive never. A time is exact to what bodies move in a cell if it is less than `soon`, and the
    least of its cell or less than `short` [s]; else no limb that matters is earlier.
    """
    N, B, M, m = len(values), len(limbs.bodies), len(limbs.limbs), values.shape[1]
    bodies = shapes.bodies
    poses, simplex = np.empty(len(bodies), POSE), np.empty((4, 6))
    axes, known = np.empty((B, M, 3)), np.zeros((B, M), np.bool_)
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    distances, times = np.full((N, M), inf), np.full((N, M), inf)
    nearest = np.zeros((N, M), np.intp)
    earliest = 0
    for row in range(N):
        place_joints(joints, values[row], rotations, origins, joint_axes)
        if row == 0:
            place_bodies(bodies, poses, rotations, origins, False)
        place_bodies(bodies, poses, rotations, origins, True)
        first, leader = inf, earliest
        for turn in range(M):
            # What was first in the cell before is looked at first: the others need coarser bounds then.
            limb = leader if turn == 0 else (turn - 1 if turn <= leader else turn)
            before = nearest[max(row - 1, 0), limb]
            for look in range(B):
                g = before if look == 0 else (look - 1 if look <= before else look)
                A, C = limbs.bodies[g], limbs.limbs[limb]
                enough = min(soon, times[row, limb], max(first, short))
                enough = _reach(limbs, limb, enough) + half[row, g] + DISTANCE_ERROR + _ROUNDING
                a, c = poses[A].centre, poses[C].centre
                x, y, z = a[0] - c[0], a[1] - c[1], a[2] - c[2]
                lower = sqrt(x * x + y * y + z * z) - bodies[A].reach - bodies[C].reach
                if lower < enough and not known[g, limb]:
                    u, v, w = from_box(bodies[C], poses[C], a)
                    lower = max(lower, sqrt(u * u + v * v + w * w) - bodies[A].reach)
                    begin_axis(axes[g, limb], u, v, w, x, y, z)
                    known[g, limb] = True
                if lower < enough:
                    found, _, _ = distance_bounds(shapes, poses, A, C, axes[g, limb], simplex, enough, -inf)
                    lower = max(lower, found)
                lower -= half[row, g] + DISTANCE_ERROR
                distances[row, limb] = min(distances[row, limb], lower)
                time = _arrival(limbs, limb, lower)
                if time < times[row, limb]:
                    times[row, limb], nearest[row, limb] = time, g
            if times[row, limb] < first and limbs.speeds[limb] > 0.0:
                first, earliest = times[row, limb], limb
    return distances, times, nearest


class PeopleDistances:
    """Distances between the bodies of a robot, of `links`, and the M `limbs` of people: pairs of obstacle and limb.

    No limb is faster than `speeds: (M,)` [m/s]; those with an equal number in `alike: (M,)` bear the same contacts.
    `moving` are the bodies that move; `contact` says with what speeds limbs may be touched, None: not at all.
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
        self._shapes = own.joined(ConvexBodies.of(placed)).shapes
        limbs = np.arange(len(placed)) + len(own.bodies)
        times = people.clearance, people.reaction_time
        self._limbs = _Limbs(self.moving, limbs, self.speeds, *times)
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
        """Return how far one of the limbs goes in a time [s], at most [m]."""
        return float(self.speeds[limb] * time)

    def along(
        self, motion: Motion, cells: Cells, speeds: FloatArray, soon: float, short: float = _SHORT
    ) -> SeparationBounds:
        """Return what is left in the cells of a curve; only what may arrive first is bounded well.

        Bodies are no faster than `speeds: (N, G)` [m/rad], of `BodySpeeds`. Limbs that need longer than `soon` [s] do
        not matter, and need not be looked at; those that may come within `short` [s] are looked at one by one where
        contact is allowed.
        """
        half = cells.sizes[:, None] / 2 * speeds[:, self.moving]
        values, joints = plain(self.robot.coupling.values(motion.at(cells.centres))), self.robot.kinematics.joints
        short = short if self.people.contact else -inf
        found = arrivals(joints, self._shapes, self._limbs, values, plain(half), soon, short)
        distances, times, nearest = found
        return SeparationBounds(distances, times, self.moving[nearest])
