"""The intervals that cover the edges of a path, and the pairs of bodies whose distances prove them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.certificates.claims import Certificate
from safe_ompl.collision import DISTANCE_ERROR
from safe_ompl.common import BoolArray, FloatArray, PlanningError
from safe_ompl.io import schema
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_FIRST_REACH = 0.2  # [m] bodies move at most this far in half of a first interval
_FLOOR = 1e-6  # [m] intervals in which the bodies move less are not divided any more
_SPARE = 1e-7  # [m] by which margins exceed the approach, for rounding
_OVERLAP = 1e-6  # of intervals
_TINY = 1e-12  # [m]


class Pairs:
    """All pairs of a moving body and an obstacle's part, and the robot's own pairs; none is left out.

    Attributes
    ----------
    names : list of (str, str)
        Names of the bodies in Pinocchio's geometry, obstacles after "obstacle:".
    radii : ndarray, shape (P, n)
        Displacement radii of the pairs.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._robot = robot
        self._geometry = robot.shared.collision_model.copy()
        bodies = list(robot.shared.collision_model.geometryObjects)
        self._owners: list[str | None] = [None] * len(bodies)
        for obstacle in scene:
            for name, shape, placement in obstacle.geometries():
                added = pin.GeometryObject(f"{schema.OBSTACLE}{name}", 0, placement, shape)
                number = self._geometry.addGeometryObject(added)
                self._owners.append(obstacle.name)
                for k, body in enumerate(bodies):
                    if body.parentJoint != 0:
                        self._geometry.addCollisionPair(pin.CollisionPair(k, number))
        self._pairs = [(int(pair.first), int(pair.second)) for pair in self._geometry.collisionPairs]
        objects = self._geometry.geometryObjects
        self.names = [(objects[a].name, objects[b].name) for a, b in self._pairs]
        still = np.zeros((len(objects) - len(bodies), robot.bounds.joint_radii.shape[1]))
        self._moves: FloatArray = np.vstack([robot.bounds.joint_radii, still])
        self._first, self._second = np.array(self._pairs, dtype=np.intp).reshape(-1, 2).T
        self._approaching: BoolArray = (self._moves[self._first] > 0) != (self._moves[self._second] > 0)
        self.radii: FloatArray = self._between(self._moves)
        self._data, self._results = robot.shared.model.createData(), pin.GeometryData(self._geometry)

    def distances(self, q: FloatArray) -> FloatArray:
        """Return the distance (P,) [m] of every pair at `q: (n,)`."""
        full = self._robot.pinocchio_configuration(q)
        pin.computeDistances(self._robot.shared.model, self._data, self._geometry, self._results, full)
        return np.array([result.min_distance for result in self._results.distanceResults])

    def radii_at(self, q: FloatArray) -> FloatArray:
        """Return the displacement radii (P, n) for motions that start at `q: (n,)`; none larger than `radii`."""
        moves = self._moves.copy()
        known = len(self._robot.bounds.joint_radii)
        moves[:known] = np.minimum(moves[:known], self._robot.bounds.joint_radii_at(q))
        return self._between(moves)

    def _between(self, moves: FloatArray) -> FloatArray:
        first, second = moves[self._first], moves[self._second]
        return self._robot.coupling.radii(np.where(self._approaching, first + second, 0.0))

    def required(self, claims: Certificate) -> FloatArray:
        """Return the distance (P,) [m] that each pair must keep, as claimed."""
        owners = (self._owners[b] for _, b in self._pairs)
        return np.array([0.0 if owner is None else claims.required(owner) for owner in owners])


def intervals_of(
    pairs: Pairs, required: FloatArray, edge: int, start: FloatArray, delta: FloatArray, tube: FloatArray
) -> list[dict[str, Any]]:
    """Cover an edge from its start to its end: each interval as large as the distances at its centre allow."""
    steps = np.abs(delta)
    widest = float((pairs.radii @ steps).max(initial=0.0))
    least = min(0.5, _FLOOR / max(widest, _FLOOR))
    reached, half, proven = 0.0, min(0.5, _FIRST_REACH / max(widest, _FIRST_REACH)), []
    while reached < 1.0:
        centre = min(reached + half, (reached + 1.0) / 2)
        q = start + centre * delta
        radii = pairs.radii_at(q)
        approach, needed = np.maximum(radii @ steps, _TINY), required + radii @ tube
        room = pairs.distances(q) - needed - _SPARE - 1.2 * DISTANCE_ERROR
        free = float(np.min(room / approach, initial=1.0 - centre + _OVERLAP))
        if free >= centre - reached and free > 0:
            margins = needed + free * approach + _SPARE
            proven.append({"centre": centre, "half_length": free, "margins": margins.tolist()})
            reached, half = centre + free * (1 - _OVERLAP), 1.2 * free
        elif half < least:
            raise PlanningError(f"edge {edge} cannot be certified: too near at {centre:.6f} of its length")
        else:
            half = max(0.9 * free, half / 3)
    return proven
