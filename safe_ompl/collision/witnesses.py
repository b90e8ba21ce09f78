"""Nearest points of robot and obstacles (witnesses), and the gradients of their distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray, IntArray, positive
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.queries import fresh_data
from safe_ompl.robot.robot import Robot


@dataclass(frozen=True)
class Witnesses:
    """Nearest points of C pairs of a link and an obstacle, at some of B configurations.

    Attributes
    ----------
    robot : Robot
        Whose links they are.
    rows : ndarray of int, shape (C,)
        Configuration of each pair.
    joints : ndarray of int, shape (C,)
        Pinocchio's number of the joint that carries the link.
    points : ndarray, shape (C, 3)
        Nearest point of the link, in the frame of its joint [m].
    normals : ndarray, shape (C, 3)
        Unit vectors from the obstacle to the link, in the world frame.
    offsets : ndarray, shape (C,)
        Abscissa of the obstacle's nearest point along the normal [m].
    """

    robot: Robot
    rows: IntArray
    joints: IntArray
    points: FloatArray
    normals: FloatArray
    offsets: FloatArray

    def distances(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (C,) [m] and their gradients (C, n) at `Q: (B, n)`, near where the witnesses were found.

        The link's witness moves with the link, the obstacle stays behind the plane at its own: exact to the first
        order where the witnesses were found, and for moves in which they remain the nearest points.
        """
        places, jacobians = self.robot.body_points(Q, self.rows, self.joints, self.points)
        distances = np.einsum("ci,ci->c", places, self.normals) - self.offsets
        return distances, np.einsum("cni,ci->cn", jacobians, self.normals)


class Proximity:
    """Finds the pairs of link and obstacle that are nearer to each other than a distance.

    Parameters
    ----------
    checker : CollisionChecker
        Robot and scene.
    within : float
        [m], > 0

    Raises
    ------
    InputError
        If the distance is not positive.
    """

    def __init__(self, checker: CollisionChecker, within: float) -> None:
        self.checker = checker
        self.within = positive(within, "distance to obstacles", "length [m]")
        self._pairs = checker.pairs_within(self.within)
        self._margins = self._pairs.margins(self.within)
        geometry = self._pairs.geometry.copy()
        bodies = self._pairs.bodies[self._pairs.meets_obstacle].tolist()
        geometry.removeAllCollisionPairs()
        for link, obstacle in bodies:
            geometry.addCollisionPair(pin.CollisionPair(link, obstacle))
        self._geometry = geometry
        self._revision = self._pairs.revision
        self._joints = [geometry.geometryObjects[link].parentJoint for link, _ in bodies]
        self._data = fresh_data(geometry)
        self._kinematics = checker.robot.shared.model.createData()
        self._results = list(self._data.distanceResults)

    def near(self, Q: FloatArray) -> BoolArray:
        """Return whether the robot is nearer than `within` to an obstacle (B,) at `Q: (B, n)`."""
        return np.array([self._pairs.within_margins(q, self._margins) for q in Q], dtype=bool)

    def witnesses(self, Q: FloatArray) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than `within` at the configurations `Q: (B, n)`."""
        self._follow()
        found = [
            witness for row in np.flatnonzero(self.near(Q)).tolist() for witness in self._at(row, Q[row])
        ]
        rows, joints, points, normals, offsets = zip(*found, strict=True) if found else ((),) * 5
        return Witnesses(
            self.checker.robot,
            np.array(rows, dtype=np.intp),
            np.array(joints, dtype=np.intp),
            np.reshape(points, (-1, 3)),
            np.reshape(normals, (-1, 3)),
            np.array(offsets, dtype=np.float64),
        )

    def _follow(self) -> None:
        """Put obstacles that have moved where they are now."""
        if self._revision != self._pairs.revision:
            places = list(
                zip(self._geometry.geometryObjects, self._pairs.geometry.geometryObjects, strict=True)
            )
            for mine, now in places[len(self.checker.links) :]:
                mine.placement, mine.geometry = now.placement, now.geometry
            self._revision = self._pairs.revision

    def _at(self, row: int, q: FloatArray) -> Sequence[tuple[int, int, FloatArray, FloatArray, float]]:
        robot = self.checker.robot
        self.checker.counts.distance_queries += 1
        full = robot.pinocchio_configuration(q)
        pin.computeDistances(robot.shared.model, self._kinematics, self._geometry, self._data, full)
        found = []
        for k, result in enumerate(self._results):
            if 0 < result.min_distance < self.within:
                on_link, on_obstacle = result.getNearestPoint1(), result.getNearestPoint2()
                normal = (on_link - on_obstacle) / result.min_distance
                local = self._kinematics.oMi[self._joints[k]].actInv(on_link)
                found.append((row, self._joints[k], local, normal, float(normal @ on_obstacle)))
        return found
