"""Bounds of speed, acceleration and jerk of the key points of a robot on a straight joint motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.robot.robot import Robot


@dataclass(frozen=True)
class KeypointRates:
    """Proven bounds over whole edges q₁ + tΔ, t ∈ [0, 1].

    Differentiated by joints i ≤ j, counted from the base, key point k changes by at most R̄_kj, the proven radius, if
    joint i turns, and not at all if it slides; and so on for more joints.

    Attributes
    ----------
    speed, acceleration, jerk : ndarray, shape (E, K)
        Of the K key points of the skeleton on E edges [m].
    """

    speed: FloatArray
    acceleration: FloatArray
    jerk: FloatArray

    @classmethod
    def of(cls, robot: Robot, deltas: FloatArray) -> KeypointRates:
        """Return them for edges with `deltas: (E, n)`.

        With r_j = R̄_kj|Δ_j|, w_j = |Δ_j| if joint j turns, else 0, and W_j the sum of w over the joints between
        base and j: Σ r_j, Σ r_j (2W_j + w_j), Σ r_j (3W_j² + 3W_j w_j + w_j²).
        """
        steps = np.abs(robot.coupling.motions(deltas))[:, None, :]
        moved = steps * robot.bounds.joint_keypoint_radii
        turn = np.where(robot.joint_keypoint_support & ~robot.joint_prismatic, steps, 0.0)
        below = np.cumsum(turn, axis=2) - turn  # Pinocchio counts joints from the base
        return cls(
            moved.sum(axis=2),
            (moved * (2 * below + turn)).sum(axis=2),
            (moved * (3 * below * (below + turn) + turn * turn)).sum(axis=2),
        )

    def between(
        self, edges: IntArray, h: FloatArray, first: FloatArray, last: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return bounds of speed and acceleration between two configurations of an edge.

        Parameters
        ----------
        edges : ndarray of int, shape (I,)
            The edge of each of I intervals.
        h : ndarray, shape (I,)
            Their lengths, as fractions of the edge.
        first, last : ndarray, shape (I, 2, K)
            The exact speed and acceleration at their ends.

        Returns
        -------
        two ndarrays, shape (I, K)
        """
        middle = (first + last) / 2
        speed, acceleration = middle[:, 0], middle[:, 1]
        step = h[:, None] / 2
        acceleration = np.minimum(self.acceleration[edges], acceleration + step * self.jerk[edges])
        return np.minimum(self.speed[edges], speed + step * acceleration), acceleration
