"""Queries to coal for pairs of bodies: margin checks, distances, and nearest points."""

from __future__ import annotations

from math import inf
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.collision.geometry import SceneGeometry
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry import DISTANCE_ERROR
from safe_ompl.robot import Robot

# Upper bound for a first distance query with an octree. It exceeds the error of coal's distances.
_SPARE = 1e-4  # [m]
_DISTANCE = coal.DistanceRequest()


class Nearest(NamedTuple):
    """The distance [m] of two bodies, and in the world their nearest points (2, 3) [m] and normal (3,) to the second.

    In contact the distance is ≤ 0, and the normal the shortest way out.
    """

    distance: float
    points: FloatArray
    normal: FloatArray


_Placed: TypeAlias = tuple[coal.CollisionGeometry, pin.SE3]


class CoalPairs:
    """Coal queries for pairs (P, 2) of bodies, at the last configuration of `place` and the present poses of obstacles.

    An instance belongs to one thread, and `place` holds until another instance of this robot and thread places it.
    Nothing may change during a query.
    """

    def __init__(self, robot: Robot, geometry: SceneGeometry, pairs: IntArray) -> None:
        self._robot, self._geometry, self._pairs = robot, geometry, pairs
        self._model, self._bodies = robot.shared.model, robot.shared.collision_model
        self._kinematics, self._data = robot.shared.placing.own
        self._solids = list(self._bodies.geometryObjects)
        self._collision, self._result = coal.CollisionRequest(), coal.CollisionResult()

    def place(self, q: FloatArray) -> None:
        """Move the robot to `q: (n,)`."""
        full = self._robot.pinocchio_configuration(q)
        pin.updateGeometryPlacements(self._model, self._kinematics, self._bodies, self._data, full)

    def placed(self, body: int) -> _Placed:
        """Return the geometry of a body and its pose in the world."""
        own = len(self._solids)
        if body < own:
            return self._solids[body].geometry, self._data.oMg[int(body)]
        part = self._geometry.parts[body - own]
        return part.geometry, part.placement

    def are_nearer(self, pair: int, margin: float) -> bool:
        """Return whether a pair is nearer than a margin [m], ≥ 0.

        With a margin of zero, coal sometimes reports overlapping bodies, even by centimetres, as a micrometre apart and
        therefore free. Hence the distance error is added to the margin.
        """
        self._collision.security_margin = margin + DISTANCE_ERROR
        self._result.clear()
        first, second = map(self.placed, self._pairs[pair])
        return bool(coal.collide(*_posed(*first), *_posed(*second), self._collision, self._result))

    def nearest(self, pair: int) -> Nearest:
        """Return distance, nearest points and normal of a pair."""
        first, second = map(self.placed, self._pairs[pair])
        tree, result = isinstance(second[0], coal.OcTree), coal.DistanceResult()
        for seed in (_SPARE, inf) if tree else (inf,):
            # With a small upper bound, coal finds trees in contact without searching farther parts.
            result.min_distance = seed
            coal.distance(*_posed(*first), *_posed(*second), _DISTANCE, result)
            if result.min_distance < seed:
                break
        points, normal = np.array([result.getNearestPoint1(), result.getNearestPoint2()]), np.array(result.normal)
        # Coal returns the tree's point first, in either order of the two arguments.
        if tree:
            points, normal = points[::-1], -normal
        return Nearest(float(result.min_distance), points, normal)


def _posed(shape: coal.CollisionGeometry, place: pin.SE3) -> tuple[coal.CollisionGeometry, coal.Transform3s]:
    return shape, coal.Transform3s(place.rotation, place.translation)
