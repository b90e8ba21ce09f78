"""Distances of pairs of link and obstacle along configurations: exact where they may be small, else bounded below."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.queries import DISTANCE_ERROR, fresh_data
from safe_ompl.collision.tree_distances import TreeDistances
from safe_ompl.threads import PerThread


class PairDistances:
    """Distances of the K pairs of a link and an obstacle that may come nearer to each other than a reach.

    Lower bounds by the convex bodies that hold links and obstacles come first, for all pairs and configurations at
    once (`DistanceBounds`); coal is asked only about pairs that these cannot tell from near ones.

    Parameters
    ----------
    checker : CollisionChecker
        Robot and scene.
    reach : float
        [m]

    Attributes
    ----------
    joints : ndarray of int, shape (K,)
        Pinocchio's number of the joint that carries the link of each pair.
    """

    def __init__(self, checker: CollisionChecker, reach: float) -> None:
        self._robot, self._counts = checker.robot, checker.counts
        self._set = checker.pairs_within(reach)
        self._geometry = self._set.geometry
        self._indices: IntArray = np.flatnonzero(self._set.meets_obstacle)
        self._coal_indices: list[int] = self._indices.tolist()
        links = self._set.bodies[self._indices, 0].tolist()
        self.joints: IntArray = np.array(
            [self._geometry.geometryObjects[link].parentJoint for link in links], dtype=np.intp
        )
        self._memory = PerThread(
            partial(_Memory, self._robot.shared.model, self._geometry, self._coal_indices)
        )

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
        bounds = self._set.bounds.of(Q, self._indices, enough + DISTANCE_ERROR)
        return bounds - DISTANCE_ERROR

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
        """Let distances of trees not depend on what was asked before, not even by rounding."""
        if self._revision >= 0:
            self.trees.forget()
