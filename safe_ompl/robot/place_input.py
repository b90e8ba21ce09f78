"""Places of the tip as people have them: positions, rotation matrices, quaternions, `pin.SE3`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError
from safe_ompl.robot.inverse_kinematics import Place
from safe_ompl.robot.robot import Robot

_UNIT = (
    1e-3  # a quaternion whose norm is as near to 1 is brought to unit length; one farther off is a mistake
)


def place_of(robot: Robot, position: Any, rotation: Any = None) -> Place:
    """Return the place that a position, with or without a rotation, or a pose means.

    Parameters
    ----------
    robot : Robot
        The robot.
    position : array_like, shape (3,), or pin.SE3
        Of the tip in the world frame [m]; or its whole pose.
    rotation : array_like, shape (3, 3) or (4,), or pin.Quaternion, optional
        A matrix or a quaternion, x, y, z, w.

    Raises
    ------
    InputError
        Wrong shape, NaN, what is not a rotation; a rotation beside a pose.
    """
    if not isinstance(position, pin.SE3):
        return Place(robot, position, None if rotation is None else _matrix(rotation))
    if rotation is not None:
        raise InputError("rotation of the tip: the pose has one already; give the pose alone")
    return Place(robot, position.translation, position.rotation)


def _matrix(rotation: ArrayLike | pin.Quaternion) -> ArrayLike:
    if isinstance(rotation, pin.Quaternion):
        rotation = rotation.coeffs()
    if np.shape(rotation) != (4,):
        return rotation
    xyzw: FloatArray = finite_array(rotation, (4,), "rotation of the tip")
    norm = float(np.linalg.norm(xyzw))
    if abs(norm - 1) > _UNIT:
        raise InputError(
            f"rotation of the tip: a quaternion (x, y, z, w) must be of unit length, got {xyzw.tolist()}"
        )
    matrix: FloatArray = pin.Quaternion(xyzw / norm).matrix()
    return matrix
