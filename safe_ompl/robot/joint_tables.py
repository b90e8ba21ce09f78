"""Tables of the joints and key points that compiled kinematics read; mimic joints follow the planned ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray
from safe_ompl.robot.kernels import kinematics as kernel

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
        The tables, for kernels; see `safe_ompl.robot.kernels.kinematics`. Nobody writes to them.
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


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: value = multiplier · primary + offset."""

    primary: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Coupling:
    """The affine map from the n planned joints to the m joints of Pinocchio's model, matrix·q + offsets.

    A planned joint has a row of the identity, a mimic joint its multiplier in the column of its primary. What is
    known for each of the m joints (radii, Jacobians) becomes what is known for the n planned ones. Where nothing
    mimics, m = n and every array is returned as it came.

    Attributes
    ----------
    matrix : ndarray, shape (m, n)
        Rates of the model's joints per rate of the planned ones.
    offsets : ndarray, shape (m,)
        Values of the model's joints at q = 0 [rad or m].
    trivial : bool
        Whether nothing mimics.
    """

    matrix: FloatArray
    offsets: FloatArray
    trivial: bool

    @classmethod
    def of(cls, joints: list[str], mimics: Mapping[str, Mimic]) -> Coupling:
        """Return the coupling of the model's `joints`, of which those in `mimics` follow planned ones directly."""
        planned = [name for name in joints if name not in mimics]
        matrix, offsets = np.zeros((len(joints), len(planned))), np.zeros(len(joints))
        for row, name in enumerate(joints):
            mimic = mimics.get(name, Mimic(name, 1.0, 0.0))
            matrix[row, planned.index(mimic.primary)] = mimic.multiplier
            offsets[row] = mimic.offset
        for array in (matrix, offsets):
            array.setflags(write=False)
        return cls(matrix, offsets, not mimics)

    def values(self, q: FloatArray) -> FloatArray:
        """Return the values (…, m) of the model's joints at `q: (…, n)`."""
        return q if self.trivial else q @ self.matrix.T + self.offsets

    def motions(self, delta: FloatArray) -> FloatArray:
        """Return the motions (…, m) of the model's joints while the planned ones move by `delta: (…, n)`."""
        return delta if self.trivial else delta @ self.matrix.T

    def reach(self, steps: FloatArray) -> FloatArray:
        """Return how far (…, m) the model's joints move while the planned ones move by up to `steps: (…, n)` ≥ 0."""
        return steps if self.trivial else steps @ np.abs(self.matrix).T

    def radii(self, radii: FloatArray) -> FloatArray:
        """Return the radii (…, n) that bound what `radii: (…, m)` bound: Σ_j r_j·|Δ_j| ≤ Σ_i (Σ_j r_j·|c_ji|)·|Δ_i|."""
        return radii if self.trivial else radii @ np.abs(self.matrix)

    def columns(self, derivatives: FloatArray) -> FloatArray:
        """Return derivatives (…, n) by the planned joints from those (…, m) by the model's joints."""
        return derivatives if self.trivial else derivatives @ self.matrix


def resolved(mimics: Mapping[str, Mimic], source: str) -> dict[str, Mimic]:
    """Return `mimics` with chains (a joint that mimics a mimic joint) followed to the first joint of each.

    Raises
    ------
    InputError
        If joints mimic each other in a circle.
    """
    found = {}
    for name, mimic in mimics.items():
        seen = [name]
        while mimic.primary in mimics:
            if mimic.primary in seen:
                raise InputError(f"joints mimic each other in a circle: {', '.join(seen)}", source)
            seen.append(mimic.primary)
            above = mimics[mimic.primary]
            mimic = Mimic(
                above.primary,
                mimic.multiplier * above.multiplier,
                mimic.multiplier * above.offset + mimic.offset,
            )
        found[name] = mimic
    return found
