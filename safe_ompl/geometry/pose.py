"""Poses, rotation vectors and rotations between directions."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, documents as document, finite_array, shown, warn_once

_log = logging.getLogger(__name__)

# Sizes and distances from the origin are at most this. A larger number is most likely in another unit.
LONGEST = 1e4  # [m]
# A position farther from the origin was most likely given in millimetres, and causes a warning.
UNLIKELY = 100.0  # [m]
# A larger angle was most likely given in degrees, and causes a warning.
_FULL_TURN = 6.3  # [rad]
# A quaternion whose norm is this close to 1 is not changed.
_UNIT_ROUNDING = 1e-12
# A quaternion whose norm is this close to 1 is normalised; any other is refused as a mistake.
_NORM_TOLERANCE = 1e-3
_NO_TURN = (0.0, 0.0, 0.0, 1.0)
_TURNS = ("quaternion_xyzw", "rpy", "yaw")
POSE_KEYS = ("position", *_TURNS)
"""Keys of a pose in a document; at most one of the orientations may be given."""

# If the cosine of an angle is below this, the logarithm is taken from `pin.log3`: the sine alone would lose digits.
_NEAR_HALF_TURN = -0.9
_LAST_ROW = [0.0, 0.0, 0.0, 1.0]  # of a rigid transform
# Angles this near to π count as half turns, which have two opposite rotation vectors of the same length.
_HALF_TURN = 1e-10  # [rad]
# At least one component of every unit vector is larger than this.
_DISTINCT = 0.1


@dataclass(frozen=True)
class Pose:
    """Position and orientation.

    Parameters
    ----------
    position : sequence of 3 float, optional
        Origin in the world frame [m].
    quaternion_xyzw : sequence of 4 float or pin.Quaternion, optional
        Orientation, the scalar last. It is normalised if its norm is within 0.001 of 1.

    Raises
    ------
    InputError
        If a number is not finite, the position is farther than 10 000 m away, or the quaternion is not a unit
        quaternion.

    Examples
    --------
    >>> Pose.from_rpy([0.5, 0.0, 0.4], [0.0, 0.0, 3.14]).position
    (0.5, 0.0, 0.4)
    """

    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, ...] = _NO_TURN

    # Type checkers see the types of the arguments. The fields hold what the arguments are converted to.
    if TYPE_CHECKING:

        def __init__(self, position: ArrayLike = ..., quaternion_xyzw: ArrayLike = ...) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", document.numbers("position", self.position, 3))
        farthest = max(self.position, key=abs)
        if abs(farthest) > LONGEST:
            raise InputError(f"{list(self.position)} is farther than {LONGEST:g} m away; are they metres?", "position")
        if abs(farthest) > UNLIKELY:
            warn_once(
                _log,
                f"position: {farthest:g} m is far away: positions are in metres "
                f"({farthest:g} mm are {farthest / 1e3:g})",
            )
        object.__setattr__(self, "quaternion_xyzw", _unit_quaternion(self.quaternion_xyzw))

    def __repr__(self) -> str:
        turn = "" if self.quaternion_xyzw == _NO_TURN else f", quaternion_xyzw={self.quaternion_xyzw}"
        return f"Pose({self.position}{turn})"

    @classmethod
    def of(cls, value: PoseLike, key: str = "pose") -> Pose:
        """Convert `value` to a pose: a `Pose`, `pin.SE3`, matrix (4, 4), position (3,) [m] or mapping of a document.

        Raises InputError if `value` has another type, or the matrix is not a rigid transform.
        """
        if isinstance(value, Pose):
            return value
        if isinstance(value, Mapping):
            with document.within(key):
                document.check_keys(value, POSE_KEYS)
                return cls.from_mapping(value)
        if isinstance(value, pin.SE3):
            rotation, position, last_row = value.rotation, value.translation, _LAST_ROW
        elif not isinstance(value, (np.ndarray, list, tuple)):
            raise InputError(f"must be a Pose, a pin.SE3 or a 4×4 matrix, got {shown(value)}", key)
        elif np.ndim(value[0] if len(value) else 0) == 0:
            with document.within(key):
                return cls(document.numbers("position", value, 3))
        else:
            matrix = finite_array(value, (4, 4), key)
            rotation, position, last_row = matrix[:3, :3], matrix[:3, 3], matrix[3].tolist()
        quaternion = pin.Quaternion(rotation)
        quaternion.normalize()
        apart = np.abs(quaternion.toRotationMatrix() - rotation).max()
        if last_row != _LAST_ROW or not apart <= _NORM_TOLERANCE:
            matrix = np.vstack([np.column_stack([rotation, position]), last_row])
            raise InputError(f"must be a rigid transform, got {matrix.round(4).tolist()}", key)
        return cls(tuple(position.tolist()), tuple(quaternion.coeffs().tolist()))

    @classmethod
    def from_rpy(cls, position: Sequence[float], rpy: Sequence[float]) -> Pose:
        """Return the pose at `position` [m], rotated by roll, pitch and yaw [rad] about fixed x, y and z, in turn."""
        return cls(tuple(position), _turned(_angles("rpy", document.numbers("rpy", rpy, 3))))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Pose:
        """Read `position` and at most one of `quaternion_xyzw`, `rpy` and `yaw` from a document."""
        turns = [key for key in _TURNS if key in data]
        if len(turns) > 1:
            raise InputError(f"give only one of {' and '.join(turns)}", turns[1])
        position = document.numbers("position", data.get("position", (0.0, 0.0, 0.0)), 3)
        if "rpy" in data:
            return cls.from_rpy(position, data["rpy"])
        if "yaw" in data:
            (yaw,) = _angles("yaw", (document.number("yaw", data["yaw"]),))
            return cls(position, _turned((0.0, 0.0, yaw)))
        return cls(position, data.get("quaternion_xyzw", _NO_TURN))

    def to_mapping(self) -> dict[str, Any]:
        """Return the pose as a mapping for `from_mapping`. The identity rotation is left out."""
        data = {"position": self.position}
        if self.quaternion_xyzw != _NO_TURN:
            data["quaternion_xyzw"] = self.quaternion_xyzw
        return data

    @property
    def se3(self) -> pin.SE3:
        """The pose as a `pin.SE3`."""
        return pin.XYZQUATToSE3(np.array(self.position + self.quaternion_xyzw))


PoseLike: TypeAlias = Pose | pin.SE3 | Mapping[str, Any] | ArrayLike


def placed(transform: pin.SE3, points: FloatArray) -> FloatArray:
    """Apply a rigid transform to `points`, shape (M, 3)."""
    return np.asarray(points @ transform.rotation.T + transform.translation)


def rotation_vectors(matrices: FloatArray) -> FloatArray:
    """Return the logarithms (S, 3) of rotation matrices (S, 3, 3), as `pin.log3`: axes times angles in [0, π] [rad].

    A half turn has two logarithms. Within 1e-10 rad of π the axis is the one whose first component above 0.1 is
    positive, so that rounding does not choose between them; the angle is then at most π + 1e-10.
    """
    vectors = 0.5 * (matrices[:, (2, 0, 1), (1, 2, 0)] - matrices[:, (1, 2, 0), (2, 0, 1)])
    sine = np.linalg.norm(vectors, axis=1)
    cosine = 0.5 * (np.trace(matrices, axis1=1, axis2=2) - 1)
    vectors *= np.where(sine > 1e-9, np.arctan2(sine, cosine) / np.maximum(sine, 1e-9), 1.0)[:, None]
    for k in np.flatnonzero(cosine < _NEAR_HALF_TURN):
        vector = pin.log3(matrices[k])
        angle = float(np.linalg.norm(vector))
        if angle > np.pi - _HALF_TURN and vector[np.abs(vector) > _DISTINCT * angle][0] < 0:
            vector *= 1 - 2 * np.pi / angle
        vectors[k] = vector
    return vectors


def turn_between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the rotation vector (3,) [rad], in world axes, from one orientation (3, 3) to another.

    `rotation_vectors` says which of the two rotation vectors of a half turn is returned.
    """
    return np.asarray(rotation_vectors((end @ start.T)[None])[0])


def turn_onto(start: ArrayLike, end: ArrayLike) -> FloatArray:
    """Return the smallest rotation (3, 3) that maps one direction (3,) to another; both must have length > 0."""
    given = np.array([start, end], dtype=np.float64)
    a, b = given / np.linalg.norm(given, axis=1, keepdims=True)
    if a @ b > _NEAR_HALF_TURN:
        return np.asarray(pin.Quaternion.FromTwoVectors(*given).matrix())
    # Pinocchio's function loses half of the digits near opposite directions. So a half turn about an axis
    # perpendicular to both first reverses `a`. The remaining rotation is small.
    across = np.linalg.svd([a, b])[2][2]
    half_turn = 2 * np.outer(across, across) - np.eye(3)
    return np.asarray(pin.Quaternion.FromTwoVectors(-a, b).matrix() @ half_turn)


def _turned(rpy: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(pin.Quaternion(pin.rpy.rpyToMatrix(np.array(rpy))).coeffs().tolist())


def _angles(key: str, angles: tuple[float, ...]) -> tuple[float, ...]:
    """Return the angles [rad], and warn if one seems to be in degrees."""
    largest = max(angles, key=abs)
    if abs(largest) > _FULL_TURN:
        warn_once(
            _log,
            f"{key}: {largest:g} rad is more than a turn: angles are in radians "
            f"({largest:g} degrees are {np.radians(largest):.5g})",
        )
    return angles


def _unit_quaternion(value: Any) -> tuple[float, ...]:
    if isinstance(value, pin.Quaternion):
        value = value.coeffs()
    quaternion = document.numbers("quaternion_xyzw", value, 4)
    # Most quaternions are unit quaternions, and math.hypot takes a small part of the time of np.linalg.norm. The two
    # differ in the last bit of one norm in six, so other quaternions, and the hashes of scenes, keep NumPy's norm.
    if abs(math.hypot(*quaternion) - 1) <= _UNIT_ROUNDING:
        return quaternion
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > _NORM_TOLERANCE:
        raise InputError(f"{list(quaternion)} must have length 1, not {norm:.4g}", "quaternion_xyzw")
    return tuple(number / norm for number in quaternion)
