"""Poses: position and orientation in the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl import document
from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.inputs import shown

_ROUNDING = 1e-12  # a quaternion this close to unit length is left as it is
_NORM_TOLERANCE = 1e-3  # one this close is brought to unit length; one farther off is a mistake
_NO_TURN = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Pose:
    """Position and orientation.

    Parameters
    ----------
    position : sequence of 3 float, optional
        Origin in the world frame [m].
    quaternion_xyzw : sequence of 4 float, optional
        Orientation, the scalar last; a `pin.Quaternion` will do. Brought to unit length if its norm
        is within 0.001 of 1.

    Raises
    ------
    InputError
        If a number is not finite, or the quaternion is not of unit length.
    """

    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, ...] = _NO_TURN

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", document.numbers("position", self.position, 3))
        object.__setattr__(self, "quaternion_xyzw", _unit_quaternion(self.quaternion_xyzw))

    def __repr__(self) -> str:
        turn = "" if self.quaternion_xyzw == _NO_TURN else f", quaternion_xyzw={self.quaternion_xyzw}"
        return f"Pose({self.position}{turn})"

    @classmethod
    def of(cls, value: Pose | pin.SE3 | ArrayLike) -> Pose:
        """Return a pose given as one, as Pinocchio's transform, or as a homogeneous matrix of shape (4, 4) [m].

        Raises
        ------
        InputError
            If it is none of them, or the matrix is no rigid transform.
        """
        if isinstance(value, Pose):
            return value
        if isinstance(value, pin.SE3):
            matrix = np.array(value.homogeneous)
        elif isinstance(value, (np.ndarray, list, tuple)):
            matrix = finite_array(value, (4, 4), "pose:")
        else:
            raise InputError(f"must be a Pose, a pin.SE3 or a 4×4 matrix, got {shown(value)}", "pose")
        rotation = matrix[:3, :3]
        turned = np.abs(rotation @ rotation.T - np.eye(3)).max() <= _NORM_TOLERANCE
        if not turned or np.linalg.det(rotation) < 0 or (matrix[3] != [0.0, 0.0, 0.0, 1.0]).any():
            raise InputError(f"must be a rigid transform, got {matrix.round(4).tolist()}", "pose")
        quaternion = pin.Quaternion(rotation)
        quaternion.normalize()
        return cls(tuple(matrix[:3, 3].tolist()), tuple(quaternion.coeffs().tolist()))

    @classmethod
    def from_rpy(cls, position: Sequence[float], rpy: Sequence[float]) -> Pose:
        """Return the pose turned by roll, pitch and yaw [rad] about the world's x, y and z, in this order."""
        angles = np.array(document.numbers("rpy", rpy, 3))
        return cls(tuple(position), tuple(pin.Quaternion(pin.rpy.rpyToMatrix(angles)).coeffs().tolist()))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Pose:
        """Read `position` and at most one of `quaternion_xyzw`, `rpy` and `yaw` from a document."""
        turns = [key for key in ("quaternion_xyzw", "rpy", "yaw") if key in data]
        if len(turns) > 1:
            raise InputError(f"give only one of {' and '.join(turns)}", turns[1])
        position = document.numbers("position", data.get("position", (0.0, 0.0, 0.0)), 3)
        if "rpy" in data:
            return cls.from_rpy(position, data["rpy"])
        if "yaw" in data:
            return cls.from_rpy(position, (0.0, 0.0, document.number("yaw", data["yaw"])))
        return cls(position, data.get("quaternion_xyzw", _NO_TURN))

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads, without a turn that is none."""
        data = {"position": self.position}
        if self.quaternion_xyzw != _NO_TURN:
            data["quaternion_xyzw"] = self.quaternion_xyzw
        return data

    @property
    def se3(self) -> pin.SE3:
        """The pose as Pinocchio's rigid transform."""
        return pin.XYZQUATToSE3(np.array(self.position + self.quaternion_xyzw))


def placed(transform: pin.SE3, points: FloatArray) -> FloatArray:
    """Return `points`, shape (M, 3), moved by a rigid transform."""
    moved: FloatArray = points @ transform.rotation.T + transform.translation
    return moved


def _unit_quaternion(value: Any) -> tuple[float, ...]:
    if isinstance(value, pin.Quaternion):
        value = value.coeffs()
    quaternion = np.array(document.numbers("quaternion_xyzw", value, 4))
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > _NORM_TOLERANCE:
        raise InputError(f"{quaternion.tolist()} must have length 1, not {norm:.4g}", "quaternion_xyzw")
    return tuple((quaternion if abs(norm - 1) <= _ROUNDING else quaternion / norm).tolist())
