"""Distances of pairs of link and obstacle along configurations: exact where they may be small, else bounded below."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.queries import fresh_data

_MANY = 6  # pairs: of more it pays to ask first whether any is near


class PairDistances:
    """Distances of the K pairs of a link and an obstacle that may come nearer to each other than a reach.

    While the joints move by Δ, the bodies of pair k approach each other by at most Σ_i R_ki·|Δ_i|. So a distance that
    is known at one configuration bounds that at others, and coal is asked only about pairs whose bound is small. What
    is found does not depend on what was asked before.

    Parameters
    ----------
    checker : CollisionChecker
        Robot and scene.
    reach : float
        [m]

    Attributes
    ----------
    radii : ndarray, shape (K, n)
        Displacement radii R of the pairs.
    """

    def __init__(self, checker: CollisionChecker, reach: float) -> None:
        self._robot, self._counts = checker.robot, checker.counts
        self._set = checker.pairs_within(reach)
        self._geometry = self._set.geometry
        self._kinematics = self._robot.shared.model.createData()
        self._indices: list[int] = np.flatnonzero(self._set.meets_obstacle).tolist()
        links = self._set.bodies[self._indices, 0].tolist()
        self._joints = [self._geometry.geometryObjects[link].parentJoint for link in links]
        self._margins = dict[float, FloatArray]()
        self._take_places()

    def _take_places(self) -> None:
        self._revision = self._set.revision
        self._data = fresh_data(self._geometry)
        results = list(self._data.distanceResults)
        self._results = [results[k] for k in self._indices]
        self.radii = self._set.radii[self._indices]

    def follow(self) -> bool:
        """Take the places of obstacles that have moved; return whether any has: then no bound holds any more."""
        if self._revision == self._set.revision:
            return False
        self._take_places()
        return True

    def __len__(self) -> int:
        return len(self._indices)

    def __repr__(self) -> str:
        return f"PairDistances({self._robot.name!r}, {len(self)} pairs)"

    def moved(self, bounds: FloatArray, step: FloatArray) -> FloatArray:
        """Return lower bounds (…, K) [m] after the joints have moved by `step: (…, n)`."""
        found: FloatArray = bounds - np.abs(step) @ self.radii.T
        return found

    def refine(self, q: FloatArray, bounds: FloatArray, within: float) -> IntArray:
        """Return the pairs that are nearer than a distance [m] at `q: (n,)`.

        Lower bounds (K,) [m] that hold at `q` are given; those below the distance are replaced by exact distances.
        """
        close = np.flatnonzero(bounds < within)
        if not len(close):
            return close
        if len(close) > _MANY and not self._any_within(q, within):
            bounds[close] = within
            return close[:0]
        self._counts.distance_queries += 1
        geometry, data, indices = self._geometry, self._data, self._indices
        full = self._robot.pinocchio_configuration(q)
        pin.updateGeometryPlacements(self._robot.shared.model, self._kinematics, geometry, data, full)
        exact = np.array(
            [pin.computeDistance(geometry, data, indices[k]).min_distance for k in close.tolist()]
        )
        bounds[close] = exact
        return close[exact < within]

    def least(self, q: FloatArray, within: float) -> float:
        """Return the least distance [m] at `q: (n,)`, or `within` where that is less."""
        if not self._any_within(q, within):
            return within
        bounds = np.full(len(self), -np.inf)
        self.refine(q, bounds, within)
        return min(within, float(bounds.min(initial=np.inf)))

    def _any_within(self, q: FloatArray, distance: float) -> bool:
        if distance not in self._margins:
            self._margins[distance] = self._set.margins(distance)
        return self._set.within_margins(q, self._margins[distance])

    def witness(self, pair: int) -> tuple[int, FloatArray, FloatArray, FloatArray]:
        """Return the nearest points of a pair where its distance was found last.

        Returns
        -------
        joint : int
            Pinocchio's number of the joint that carries the link.
        local, on_link, on_obstacle : ndarray, shape (3,)
            Nearest point of the link in the frame of that joint and in the world, and that of the obstacle [m].
        """
        result, joint = self._results[pair], self._joints[pair]
        on_link = result.getNearestPoint1()
        return joint, self._kinematics.oMi[joint].actInv(on_link), on_link, result.getNearestPoint2()
