"""Distances of links and obstacles: exact where they may be small, nearest points (witnesses), and gradients."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

from safe_ompl.collision import kernels
from safe_ompl.collision.broad_phase import DISTANCE_ERROR, fresh_data
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.tree_distances import TreeDistances
from safe_ompl.common import BoolArray, FloatArray, IntArray, PerThread, positive
from safe_ompl.robot import Robot, plain


class PairDistances:
    """Distances of the K pairs of a link and an obstacle that may come nearer to each other than a reach [m].

    Lower bounds by the convex bodies that hold links and obstacles come first, for all pairs and configurations at
    once (`DistanceBounds`); coal is asked only about pairs that these cannot tell from near ones. `joints: (K,)` has
    Pinocchio's number of the joint that carries the link of each pair.
    """

    def __init__(self, checker: CollisionChecker, reach: float) -> None:
        self._robot, self._counts = checker.robot, checker.counts
        self._set = checker.pairs_within(reach)
        self._geometry = self._set.geometry
        self._indices: IntArray = np.flatnonzero(self._set.meets_obstacle)
        self._coal_indices: list[int] = self._indices.tolist()
        carriers = [body.parentJoint for body in self._geometry.geometryObjects]
        self.joints: IntArray = np.array(carriers, dtype=np.intp)[self._set.bodies[self._indices, 0]]
        model = self._robot.shared.model
        self._memory = PerThread(partial(_Memory, model, self._geometry, self._coal_indices))

    def __len__(self) -> int:
        return len(self._indices)

    def __repr__(self) -> str:
        return f"PairDistances({self._robot.name!r}, {len(self)} pairs)"

    def near(self, Q: FloatArray, within: float) -> Iterator[tuple[int, int, float]]:
        """Yield row, pair and distance [m] of what is nearer than a distance [m] at `Q: (B, n)`, row by row."""
        candidates = self._bounds(Q, within) < within
        self._memory.own.forget()
        for row in np.flatnonzero(candidates.any(axis=1)).tolist():
            pairs = np.flatnonzero(candidates[row]).tolist()
            for pair, distance in zip(pairs, self._exact(Q[row], pairs), strict=True):
                if distance < within:
                    yield row, pair, distance

    def least(self, Q: FloatArray, within: float) -> float:
        """Return the least distance [m] at any of `Q: (B, n)`, or `within` where that is less."""
        bounds = self._bounds(Q, within)
        lowest = bounds.min(axis=1, initial=np.inf)
        self._memory.own.forget()
        for row in np.argsort(lowest).tolist():
            if lowest[row] >= within:
                break
            within = min(within, *self._exact(Q[row], np.flatnonzero(bounds[row] < within).tolist()))
        return within

    def _bounds(self, Q: FloatArray, enough: float) -> FloatArray:
        """Return lower bounds (B, K) [m] of what coal calls the distances."""
        return self._set.bounds.of(Q, self._indices, enough + DISTANCE_ERROR) - DISTANCE_ERROR

    def _exact(self, q: FloatArray, pairs: Sequence[int]) -> list[float]:
        """Return the distances of pairs [m] at `q: (n,)`."""
        self._counts.distance_queries += 1
        geometry, own, indices = self._geometry, self._memory.own, self._coal_indices
        full = self._robot.pinocchio_configuration(q)
        with self._set.changes.none():
            data = own.at(self._set.revision)
            pin.updateGeometryPlacements(self._robot.shared.model, own.kinematics, geometry, data, full)
            return [
                own.trees.distance(data, indices[k])
                if indices[k] in own.trees
                else pin.computeDistance(geometry, data, indices[k]).min_distance
                for k in pairs
            ]

    def witness(self, pair: int) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points (3,) [m] of a pair, of link and obstacle, where this thread found its distance."""
        own = self._memory.own
        if self._coal_indices[pair] in own.trees:
            return own.trees.witness(self._coal_indices[pair])
        result = own.results[pair]
        return result.getNearestPoint1(), result.getNearestPoint2()


class _Memory:
    """Where one thread keeps the places of bodies, and the distances of some pairs."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, indices: Sequence[int]) -> None:
        self.kinematics = model.createData()
        self._geometry, self._indices = geometry, indices
        self._revision = -1

    def at(self, revision: int) -> pin.GeometryData:
        """Return the memory of bodies; it is made anew where obstacles have moved since."""
        if self._revision != revision:
            self._revision, self._data = revision, fresh_data(self._geometry)
            results = list(self._data.distanceResults)
            self.results = [results[k] for k in self._indices]
            self.trees = TreeDistances(self._geometry)
        return self._data

    def forget(self) -> None:
        """Make distances of trees independent of earlier queries, also of their rounding."""
        if self._revision >= 0:
            self.trees.forget()


@dataclass(frozen=True)
class Witnesses:
    """Nearest points of C pairs of a link and an obstacle, at some of B configurations.

    Attributes
    ----------
    rows, joints : ndarray of int, shape (C,)
        Configuration of each pair, and Pinocchio's number of the joint that carries the link.
    points, normals : ndarray, shape (C, 3)
        Nearest point of the link, in the frame of its joint [m]; unit vectors from the obstacle to the link, in the
        world.
    offsets : ndarray, shape (C,)
        Abscissa of the obstacle's nearest point along the normal [m].
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
        joints, pairs = (self.robot.kinematics.joints, plain(coupling.values(Q))), (self.rows, self.joints)
        found = kernels.hinge_costs(*joints, *pairs, self.points, self.normals, self.offsets, hinges)
        costs, gradients, bends = found
        return costs, coupling.columns(gradients), coupling.columns(bends)


class Proximity:
    """Finds the pairs of link and obstacle that are nearer to each other than a distance [m], which is positive."""

    def __init__(self, checker: CollisionChecker, within: float) -> None:
        self.checker = checker
        self.within = positive(within, "distance to obstacles", "length [m]")
        self.distances = PairDistances(checker, self.within)

    def near(self, Q: FloatArray) -> BoolArray:
        """Return whether the robot is nearer than `within` to an obstacle (B,) at `Q: (B, n)`."""
        found = np.zeros(len(Q), dtype=bool)
        found[[row for row, _, _ in self.distances.near(Q, self.within)]] = True
        return found

    def witnesses(self, Q: FloatArray) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than `within` at the configurations `Q: (B, n)`."""
        found = [
            (row, pair, *self.distances.witness(pair))
            for row, pair, distance in self.distances.near(Q, self.within)
            if distance > 0  # in contact there is no way from one to the other
        ]
        each = zip(*found, strict=True) if found else ((),) * 4
        rows, pairs, on_link, on_obstacle = (np.array(column) for column in each)
        rows, joints = rows.astype(np.intp), self.distances.joints[pairs.astype(np.intp)]
        on_link, ends = on_link.reshape(-1, 3), on_obstacle.reshape(-1, 3)
        normals = on_link - ends
        normals /= np.sqrt(np.einsum("ci,ci->c", normals, normals))[:, None]
        local = _in_joint_frames(self.checker.robot, Q[rows], joints, on_link)
        offsets = np.einsum("ci,ci->c", normals, ends)
        return Witnesses(self.checker.robot, rows, joints, local, normals, offsets)


def _in_joint_frames(robot: Robot, Q: FloatArray, joints: IntArray, places: FloatArray) -> FloatArray:
    """Return places (C, 3) in the world in the frames of joints (C,), by Pinocchio's numbers, at `Q: (C, n)`."""
    rotations, origins, _ = robot.kinematics.frames(robot.coupling.values(Q))
    local = places.copy()
    carried = np.flatnonzero(joints)  # the others are in the frame of the world
    at = carried, joints[carried] - 1
    local[carried] = np.einsum("cxy,cx->cy", rotations[at], places[carried] - origins[at])
    return local
