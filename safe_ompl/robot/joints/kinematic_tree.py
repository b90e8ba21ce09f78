"""The joints and key points of a robot as the tables that compiled kinematics read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import BoolArray, FloatArray, IntArray
from safe_ompl.maths.kernels import joints as kernel

_FLOAT = np.dtype(np.float64)


class KinematicTree:
    """Forward kinematics of the m joints of a robot and of K key points that they carry.

    Parameters
    ----------
    parents : sequence of int
        For each joint Pinocchio's number of the one before it; 0 is the base, joint i has the number i + 1.
    placements : sequence of pin.SE3
        Where each joint is in the frame of its parent, at zero.
    axes : ndarray, shape (m, 3)
        Unit vectors in the frames of the joints.
    slides : ndarray of bool, shape (m,)
        Which joints slide.
    carriers : ndarray of int, shape (K,)
        For each key point Pinocchio's number of the joint that carries it.
    offsets : ndarray, shape (K, 3)
        Where it is in the frame of that joint [m].

    Attributes
    ----------
    joints, keypoints : ndarray, shape (m,) and (K,)
        The tables, for kernels; see `safe_ompl.maths.kernels.joints`. Nobody writes to them.
    """

    def __init__(
        self,
        parents: Sequence[int],
        placements: Sequence[pin.SE3],
        axes: FloatArray,
        slides: BoolArray,
        carriers: IntArray,
        offsets: FloatArray,
    ) -> None:
        self.joints = np.zeros(len(parents), kernel.JOINT)
        self.joints["rotation"] = [placement.rotation for placement in placements]
        self.joints["translation"] = [placement.translation for placement in placements]
        self.joints["axis"] = axes
        self.joints["parent"] = parents
        self.joints["slides"] = slides
        self.keypoints = np.zeros(len(carriers), kernel.KEYPOINT)
        self.keypoints["offset"] = offsets
        self.keypoints["joint"] = carriers

    def frames(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return rotations (B, m, 3, 3), origins and axes (B, m, 3) of the joints in the world at `values: (B, m)`."""
        return kernel.joint_frames(self.joints, plain(values))

    def places(self, values: FloatArray) -> FloatArray:
        """Return the key points (B, K, 3) [m] at `values: (B, m)`."""
        return kernel.keypoints(self.joints, self.keypoints, plain(values))

    def pull_back(self, values: FloatArray, forces: FloatArray) -> FloatArray:
        """Return Σ_k J_kᵀ f_k (B, m) of `forces: (B, K, 3)` at the key points at `values: (B, m)`."""
        return kernel.pull_back(self.joints, self.keypoints, plain(values), plain(forces))

    def motions(self, values: FloatArray, rates: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places, velocities and accelerations (B, K, 3) of the key points at steady `rates: (B, m)`."""
        return kernel.keypoint_motions(self.joints, self.keypoints, plain(values), plain(rates))

    def point_jacobians(
        self, values: FloatArray, rows: IntArray, carriers: IntArray, points: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return places (C, 3) and transposed Jacobians (C, m, 3) of points of bodies at `values[rows]: (C, m)`."""
        return kernel.point_jacobians(
            self.joints, plain(values), _plain_numbers(rows), _plain_numbers(carriers), plain(points)
        )


def plain(array: Any) -> FloatArray:
    """Return `array` as the one kind of array that kernels are compiled for, itself where it is one."""
    flags = array.flags
    if array.dtype is _FLOAT and flags.c_contiguous and flags.writeable:
        return array  # type: ignore[no-any-return]
    return np.require(array, np.float64, ["C", "W"])


def _plain_numbers(array: Any) -> IntArray:
    return np.require(array, np.intp, ["C", "W"])
