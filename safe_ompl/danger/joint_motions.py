"""Frames and twists of joints at many configurations."""

from __future__ import annotations

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray
from safe_ompl.robot.robot import Robot


class JointMotions:
    """The frames and twists of a robot's joints while they move.

    Parameters
    ----------
    robot : Robot
        The robot.

    Attributes
    ----------
    prismatic : ndarray of bool, shape (m,)
        Which of the m joints of Pinocchio's model slide.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.prismatic: BoolArray = robot.shared.chain.prismatic

    def frames(self, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3), origins (B, m, 3) and world axes (B, m, 3) of the joints at `Q: (B, n)`."""
        return self.robot.kinematics.frames(self.robot.coupling.values(Q))

    def twists(
        self, origins: FloatArray, axes: FloatArray, rates: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what each joint adds to the motion of what it carries: x moves with angular × x + linear.

        Parameters
        ----------
        origins, axes : ndarray, shape (B, m, 3)
            From `frames`.
        rates : ndarray, shape (B, n)
            Rates of the planned joints.

        Returns
        -------
        two ndarrays, shape (B, m, 3)
            Angular, and linear at the origin of the world.
        """
        moved = self.robot.coupling.motions(rates)[..., None] * axes
        sliding = self.prismatic[:, None]
        return np.where(sliding, 0.0, moved), np.where(sliding, moved, np.cross(origins, moved))
