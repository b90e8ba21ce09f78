"""Nearest points of robot and obstacles (witnesses), and the gradients of their distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray, IntArray, positive
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.pair_distances import PairDistances
from safe_ompl.maths.kernels import path_cost as kernel
from safe_ompl.robot.joints.kinematic_tree import plain
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

    def hinge_costs(self, Q: FloatArray, hinges: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return Σ_c Σ_h w_h (1 − d_c/D_h)₊² of the distances d at `Q: (B, n)`, near where the witnesses were found.

        The link's witness moves with the link, the obstacle stays behind the plane at its own: exact to the first
        order where the witnesses were found, and for moves in which they remain the nearest points.

        Parameters
        ----------
        Q : ndarray, shape (B, n)
        hinges : ndarray, shape (H, 2)
            D > 0 [m] and w.

        Returns
        -------
        costs : ndarray, shape (B,)
        gradients : ndarray, shape (B, n)
        bends : ndarray, shape (C, n)
            Vectors v: the costs bend like Σ vvᵀ (Gauss-Newton).
        """
        coupling = self.robot.coupling
        costs, gradients, bends = kernel.hinge_costs(
            self.robot.kinematics.joints,
            plain(coupling.values(Q)),
            self.rows,
            self.joints,
            self.points,
            self.normals,
            self.offsets,
            hinges,
        )
        return costs, coupling.columns(gradients), coupling.columns(bends)


class Proximity:
    """Finds the pairs of link and obstacle that are nearer to each other than a distance.

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

    def near(self, Q: FloatArray) -> BoolArray:
        """Return whether the robot is nearer than `within` to an obstacle (B,) at `Q: (B, n)`."""
        found = np.zeros(len(Q), dtype=bool)
        found[[row for row, _, _ in self.distances.near(Q, self.within)]] = True
        return found

    def witnesses(self, Q: FloatArray) -> Witnesses:
        """Return the witnesses of all pairs that are nearer than `within` at the configurations `Q: (B, n)`."""
        found = [
            (row, *self.distances.witness(pair))
            for row, pair, distance in self.distances.near(Q, self.within)
            if distance > 0  # in contact there is no way from one to the other
        ]
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
