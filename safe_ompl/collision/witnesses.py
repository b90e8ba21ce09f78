"""Nearest points of robot and obstacles (witnesses), and the gradients of their distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray, IntArray, positive
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.pair_distances import PairDistances
from safe_ompl.maths.kernels import hinge_costs as kernel
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
        robot = self.checker.robot
        local, offsets = (
            _in_joint_frames(robot, Q[rows], joints, on_link),
            np.einsum("ci,ci->c", normals, ends),
        )
        return Witnesses(robot, rows, joints, local, normals, offsets)


def _in_joint_frames(robot: Robot, Q: FloatArray, joints: IntArray, places: FloatArray) -> FloatArray:
    """Return places (C, 3) in the world in the frames of joints (C,), by Pinocchio's numbers, at `Q: (C, n)`."""
    rotations, origins, _ = robot.kinematics.frames(robot.coupling.values(Q))
    local = places.copy()
    carried = np.flatnonzero(joints)  # the others are in the frame of the world
    at = carried, joints[carried] - 1
    local[carried] = np.einsum("cxy,cx->cy", rotations[at], places[carried] - origins[at])
    return local
