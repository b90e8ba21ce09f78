"""Joints, key points and their velocities at many configurations, and gradients pulled back through both."""

from __future__ import annotations

from dataclasses import dataclass

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
    beneath : ndarray of bool, shape (m, m)
        For each of the m joints of Pinocchio's model which joints lie between it and the base, itself not included.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        chain = robot.shared.chain
        self.prismatic: BoolArray = chain.prismatic
        self.beneath: BoolArray = np.zeros((len(chain.parents),) * 2, dtype=bool)
        for j, parent in enumerate(chain.parents):
            self.beneath[j, chain.path_to_root(parent)] = True

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


@dataclass(frozen=True)
class MovingSkeleton:
    """Key points of a robot that moves, at B configurations.

    Attributes
    ----------
    keypoints, velocities : ndarray, shape (B, K, 3)
        [m] and [m/s].
    """

    keypoints: FloatArray
    velocities: FloatArray
    _joints: JointMotions
    _Q: FloatArray
    _origins: FloatArray
    _axes: FloatArray
    _angular: FloatArray
    _linear: FloatArray

    @classmethod
    def of(cls, joints: JointMotions, Q: FloatArray, rates: FloatArray) -> MovingSkeleton:
        """Return the skeleton at `Q: (B, n)` while the joints move at `rates: (B, n)`."""
        _, origins, axes = joints.frames(Q)
        angular, linear = joints.twists(origins, axes, rates)
        support = joints.robot.joint_keypoint_support.astype(np.float64)
        keypoints = joints.robot.keypoints_batch(Q)
        velocities = np.cross(support @ angular, keypoints) + support @ linear
        return cls(keypoints, velocities, joints, Q, origins, axes, angular, linear)

    def pull_back(self, by_place: FloatArray, by_velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Map gradients by key points and their velocities to gradients by the joints and their rates.

        While joint j turns, what it carries turns: a key point and its velocity relative to the parent of j, and the
        parent's motion is felt at another place. With the axis z, the origin o and the parent's angular velocity Ω

            ∂v_k/∂q_j = z × (v_k − v_parent(x_k)) + Ω × (z × (x_k − o));    Ω × z where the joint slides.

        Parameters
        ----------
        by_place, by_velocity : ndarray, shape (B, K, 3)

        Returns
        -------
        two ndarrays, shape (B, n)
        """
        joints, robot = self._joints, self._joints.robot
        beneath = joints.beneath.astype(np.float64)
        turning, drift = (beneath @ part for part in (self._angular, self._linear))
        x, z = self.keypoints[:, :, None], self._axes[:, None]
        spin = np.broadcast_to(turning[:, None], (*self.keypoints.shape[:2], *turning.shape[1:]))
        relative = self.velocities[:, :, None] - (np.cross(spin, x) + drift[:, None])
        turned = np.cross(z, relative) + np.cross(spin, np.cross(z, x - self._origins[:, None]))
        changes = np.where(joints.prismatic[:, None], np.cross(spin, z), turned)
        carried = robot.joint_keypoint_support
        second = np.einsum("bkx,bkjx,kj->bj", by_velocity, changes, carried)
        by_q = robot.pull_back(self._Q, by_place) + robot.coupling.columns(second)
        return by_q, robot.pull_back(self._Q, by_velocity)
