"""Velocities of joints and key points, and bounds of their speed, acceleration and jerk on a straight joint motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.robot import Robot


class JointMotions:
    """The frames and twists of a robot's joints while they move; `prismatic: (m,)` says which slide."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.prismatic: BoolArray = robot.shared.chain.prismatic

    def frames(self, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3), origins (B, m, 3) and world axes (B, m, 3) of the joints at `Q: (B, n)`."""
        return self.robot.kinematics.frames(self.robot.coupling.values(Q))

    def twists(self, origins: FloatArray, axes: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what each joint adds to what it carries, (B, m, 3) each: x moves with angular × x + linear.

        `origins` and `axes` are those of `frames`, `rates: (B, n)` of the planned joints. The linear part is that at
        the origin of the world.
        """
        moved = self.robot.coupling.motions(rates)[..., None] * axes
        sliding = self.prismatic[:, None]
        return np.where(sliding, 0.0, moved), np.where(sliding, moved, np.cross(origins, moved))


@dataclass(frozen=True)
class KeypointRates:
    """Proven bounds of speed, acceleration and jerk (E, K) [m] of the key points over whole edges q₁ + tΔ, t ∈ [0, 1].

    Differentiated by joints i ≤ j, counted from the base, key point k changes by at most R̄_kj, the proven radius, if
    joint i turns, and not at all if it slides; and so on for more joints.
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
        """Return bounds of speed and acceleration, each (I, K), between two configurations of an edge, of I intervals.

        `h: (I,)` is the length of each as a fraction of its edge, `first` and `last` (I, 2, K) are the exact speed and
        acceleration at its ends.
        """
        middle = (first + last) / 2
        speed, acceleration = middle[:, 0], middle[:, 1]
        step = h[:, None] / 2
        acceleration = np.minimum(self.acceleration[edges], acceleration + step * self.jerk[edges])
        return np.minimum(self.speed[edges], speed + step * acceleration), acceleration
