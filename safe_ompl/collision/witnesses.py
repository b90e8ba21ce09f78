"""Nearest points of robot and obstacles (witnesses), and the gradients of their distances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray, IntArray, positive
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.pair_distances import PairDistances
from safe_ompl.robot.robot import Robot

_REMEMBERED = 200  # configurations


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

    The distances that were found last bound most of those at configurations nearby well enough. What is found does not
    depend on that.

    Parameters
    ----------
    checker : CollisionChecker
        Robot and scene.
    within : float
        [m], > 0

    Attributes
    ----------
    distances : PairDistances
        Of all pairs that may come as near.

    Raises
    ------
    InputError
        If the distance is not positive.
    """

    def __init__(self, checker: CollisionChecker, within: float) -> None:
        self.checker = checker
        self.within = positive(within, "distance to obstacles", "length [m]")
        self.distances = PairDistances(checker, self.within)
        self._known: tuple[FloatArray, FloatArray] | None = None  # configurations (B, n), bounds there (B, K)

    def near(self, Q: FloatArray) -> BoolArray:
        """Return whether the robot is nearer than `within` to an obstacle (B,) at `Q: (B, n)`."""
        found, bounds = np.zeros(len(Q), dtype=bool), self._bounds(Q)
        for row, _ in self._near_pairs(Q, bounds):
            found[row] = True
        self._remember(Q, bounds)
        return found

    def witnesses(self, Q: FloatArray) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than `within` at the configurations `Q: (B, n)`."""
        bounds = self._bounds(Q)
        found = [
            (row, *self.distances.witness(pair))
            for row, pair in self._near_pairs(Q, bounds)
            if bounds[row, pair] > 0  # in contact there is no way from one to the other
        ]
        self._remember(Q, bounds)
        rows, joints, local, on_link, on_obstacle = zip(*found, strict=True) if found else ((),) * 5
        ends = np.reshape(on_obstacle, (-1, 3))
        normals = np.reshape(on_link, (-1, 3)) - ends
        normals /= np.sqrt(np.einsum("ci,ci->c", normals, normals))[:, None]
        return Witnesses(
            self.checker.robot,
            np.array(rows, dtype=np.intp),
            np.array(joints, dtype=np.intp),
            np.reshape(local, (-1, 3)),
            normals,
            np.einsum("ci,ci->c", normals, ends),
        )

    def _near_pairs(self, Q: FloatArray, bounds: FloatArray) -> Iterator[tuple[int, int]]:
        """Yield row and pair of what is near at `Q: (B, n)`; its lower bounds (B, K) become distances."""
        distances = self.distances
        for row in np.flatnonzero((bounds < self.within).any(axis=1)).tolist():
            here = bounds[row]
            if row:  # configurations that follow each other are near each other, as a rule
                np.maximum(here, distances.moved(bounds[row - 1], Q[row] - Q[row - 1]), out=here)
            for pair in distances.refine(Q[row], here, self.within).tolist():
                yield row, pair

    def _bounds(self, Q: FloatArray) -> FloatArray:
        """Return the lower bounds (B, K) of distances at `Q: (B, n)` that follow from what is known nearby."""
        if self.distances.follow():
            self._known = None
        if self._known is None or not len(Q):
            return np.full((len(Q), len(self.distances)), -np.inf)
        known, bounds = self._known
        nearest = (np.einsum("ij,ij->i", known, known) - 2.0 * (Q @ known.T)).argmin(axis=1)
        return self.distances.moved(bounds[nearest], Q - known[nearest])

    def _remember(self, Q: FloatArray, bounds: FloatArray) -> None:
        if self._known is None:
            self._known = Q.copy(), bounds
        else:
            known = zip((Q, bounds), self._known, strict=True)
            latest, before = (np.concatenate(arrays)[:_REMEMBERED] for arrays in known)
            self._known = latest, before
