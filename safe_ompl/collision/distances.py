"""Distances of links and obstacles: exact where they may be small, nearest points (witnesses), and gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.kernels.distances import hinge_costs
from safe_ompl.collision.queries import DISTANCE_ERROR, TreeDistances, fresh_data
from safe_ompl.common import BoolArray, FloatArray, IntArray, PerThread
from safe_ompl.robot import Robot, plain

_TINY = 1e-12  # [m]


class NearPairs(NamedTuple):
    """C pairs of a link and an obstacle that are near each other: rows and pairs (C,), distances (C,) [m].

    And the nearest points: `points: (C, 3)` of the link, in the frame of the joint that carries it [m]; unit `normals:
    (C, 3)` from the obstacle to the link, in the world; `offsets: (C,)`, the abscissa of the obstacle's point along the
    normal [m]. Of pairs in contact only the distance, ≤ 0, means something.
    """

    rows: IntArray
    pairs: IntArray
    distances: FloatArray
    points: FloatArray
    normals: FloatArray
    offsets: FloatArray


class PairDistances:
    """Distances of the K pairs of a link and an obstacle that may come nearer to each other than a reach [m].

    Lower bounds by the convex bodies that hold links and obstacles come first, for all pairs and configurations at
    once (`DistanceBounds`). Pairs that these cannot tell from near ones are measured, by the same kernels where both
    are convex, else by coal. `joints: (K,)` has Pinocchio's number of the joint that carries the link of each pair.
    """

    def __init__(self, checker: CollisionChecker, reach: float) -> None:
        self._robot, self._counts = checker.robot, checker.counts
        self._set = checker.pairs_within(reach)
        self._indices: IntArray = np.flatnonzero(self._set.meets_obstacle)
        self.joints: IntArray = self._set.carriers[self._indices]
        # Coal is only asked about bodies that are not convex: many scenes have none.
        self._memory = PerThread(lambda: _Memory(self._robot, self._set.geometry))

    def __len__(self) -> int:
        return len(self._indices)

    def __repr__(self) -> str:
        return f"PairDistances({self._robot.name!r}, {len(self)} pairs)"

    def near(self, Q: FloatArray, within: float) -> NearPairs:
        """Return the pairs that are nearer than a distance [m] at `Q: (B, n)`, row by row."""
        rows, pairs = np.nonzero(self._bounds(Q, within) < within)
        exact = self._exact[pairs]
        found = np.empty((len(rows), 8))
        found[exact] = self._set.bounds.nearest(Q, rows[exact], self._indices[pairs[exact]])
        others = np.flatnonzero(~exact)
        if len(others):
            self._memory.own.forget()
            found[others] = self._by_coal(Q, rows[others], pairs[others])
        near = found[:, 0] < within
        found = found[near]
        return NearPairs(rows[near], pairs[near], found[:, 0], found[:, 1:4], found[:, 4:7], found[:, 7])

    def witnesses(self, Q: FloatArray, within: float) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than a distance [m] at `Q: (B, n)`, but not in contact."""
        found = self.near(Q, within)
        apart = found.distances > 0  # in contact there is no way from one to the other
        nearest = (plain(part[apart]) for part in (found.points, found.normals, found.offsets))
        return Witnesses(self._robot, found.rows[apart], self.joints[found.pairs[apart]], *nearest)

    def least(self, Q: FloatArray, within: float) -> float:
        """Return the least distance [m] at any of `Q: (B, n)`, or `within` where that is less."""
        bounds = self._bounds(Q, within)
        rows, pairs = np.nonzero(bounds < within)
        candidates = bounds[rows, pairs]
        exact = self._exact[pairs]
        for most in (candidates.min(initial=np.inf), within):
            chosen = exact & (candidates <= min(most, within))
            found = self._set.bounds.nearest(Q, rows[chosen], self._indices[pairs[chosen]])
            within = min(within, float(found[:, 0].min(initial=np.inf)))
        others = np.flatnonzero(~exact)
        if len(others):
            self._memory.own.forget()
        for k in others[np.argsort(candidates[others], kind="stable")].tolist():
            if candidates[k] >= within:
                break
            within = min(within, float(self._by_coal(Q, rows[[k]], pairs[[k]])[0, 0]))
        return within

    @property
    def _exact(self) -> BoolArray:
        """Which pairs (K,) are of two convex bodies."""
        return self._set.bounds.exact[self._indices]

    def _bounds(self, Q: FloatArray, enough: float) -> FloatArray:
        """Return lower bounds (B, K) [m] of what coal calls the distances."""
        return self._set.bounds.of(Q, self._indices, enough + DISTANCE_ERROR) - DISTANCE_ERROR

    def _by_coal(self, Q: FloatArray, rows: IntArray, pairs: IntArray) -> FloatArray:
        """Return the same as `DistanceBounds.nearest`, (C, 8), of any pairs (C,) at rows (C,) that do not fall."""
        found, geometry, own = np.zeros((len(rows), 8)), self._set.geometry, self._memory.own
        on_link, placed = np.zeros((len(rows), 3)), -1
        with self._set.changes.none():
            data = own.at(self._set.revision)
            for c, (row, k) in enumerate(zip(rows.tolist(), self._indices[pairs].tolist(), strict=True)):
                if row != placed:
                    self._counts.distance_queries += 1
                    full, placed = self._robot.pinocchio_configuration(Q[row]), row
                    model = self._robot.shared.model
                    pin.updateGeometryPlacements(model, own.kinematics, geometry, data, full)
                if k in own.trees:
                    found[c, 0] = own.trees.distance(data, k)
                    on_link[c], on_obstacle = own.trees.witness(k)
                else:
                    result = pin.computeDistance(geometry, data, k)
                    found[c, 0] = result.min_distance
                    on_link[c], on_obstacle = result.getNearestPoint1(), result.getNearestPoint2()
                way = on_link[c] - on_obstacle
                found[c, 4:7] = way / max(float(np.sqrt(way @ way)), _TINY)
                found[c, 7] = found[c, 4:7] @ on_obstacle
        found[:, 1:4] = _in_joint_frames(self._robot, Q[rows], self.joints[pairs], on_link)
        return found


class _Memory:
    """Where one thread keeps the places of bodies, and the distances of some pairs."""

    def __init__(self, robot: Robot, geometry: pin.GeometryModel) -> None:
        self.kinematics = robot.shared.model.createData()
        self._geometry = geometry
        self._revision = -1

    def at(self, revision: int) -> pin.GeometryData:
        """Return the memory of bodies; it is made anew where obstacles have moved since."""
        if self._revision != revision:
            self._revision, self._data = revision, fresh_data(self._geometry)
            self.trees = TreeDistances(self._geometry)
        return self._data

    def forget(self) -> None:
        """Make distances of trees independent of earlier queries, also of their rounding."""
        if self._revision >= 0:
            self.trees.forget()


@dataclass(frozen=True)
class Witnesses:
    """Nearest points of C pairs of a link and an obstacle, at some of B configurations.

    `rows: (C,)` is the configuration of each, `joints: (C,)` Pinocchio's number of the joint that carries the link; all
    else is as in `NearPairs`.
    """

    robot: Robot
    rows: IntArray
    joints: IntArray
    points: FloatArray
    normals: FloatArray
    offsets: FloatArray

    def hinge_costs(self, Q: FloatArray, hinges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² (B,) of the distances d at `Q: (B, n)`, near where witnesses were found.

        The link's witness moves with the link, the obstacle stays behind the plane at its own: exact to the first
        order where the witnesses were found, and for moves in which they remain the nearest points. `hinges: (H, 2)`
        are D > 0 [m] and w. Besides the costs there are their gradients (B, n), and vectors v (C, n): the costs bend
        like Σ vvᵀ (Gauss-Newton).
        """
        coupling = self.robot.coupling
        joints, values = self.robot.kinematics.joints, plain(coupling.values(Q))
        witnesses = self.rows, self.joints, self.points, self.normals, self.offsets
        costs, gradients, bends = hinge_costs(joints, values, *witnesses, hinges)
        return costs, coupling.columns(gradients), coupling.columns(bends)


def _in_joint_frames(robot: Robot, Q: FloatArray, joints: IntArray, places: FloatArray) -> FloatArray:
    """Return places (C, 3) in the world in the frames of joints (C,), by Pinocchio's numbers, at `Q: (C, n)`."""
    rotations, origins, _ = robot.kinematics.frames(robot.coupling.values(Q))
    local = places.copy()
    carried = np.flatnonzero(joints)  # the others are in the frame of the world
    at = carried, joints[carried] - 1
    local[carried] = np.einsum("cxy,cx->cy", rotations[at], places[carried] - origins[at])
    return local
