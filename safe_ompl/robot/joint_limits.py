"""The joint limits of a robot as one quick yes or no, for what asks at every state."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.robot.kernels.kinematics import within

if TYPE_CHECKING:
    from safe_ompl.robot.robot import Robot

_TOLERANCE = 1e-9  # that of `Robot.within_limits`
_LARGEST = sys.float_info.max


class JointLimits:
    """Says whether a configuration is finite and within the joint limits of a robot.

    The same as ``robot.within_limits(q).all()``, which takes twenty times as long for so few numbers.

    Parameters
    ----------
    robot : Robot
        The robot.
    """

    def __init__(self, robot: Robot) -> None:
        lower = np.where(robot.continuous, -_LARGEST, robot.lower - _TOLERANCE)
        upper = np.where(robot.continuous, _LARGEST, robot.upper + _TOLERANCE)
        self._bounds: FloatArray = np.array([lower, upper])

    def __repr__(self) -> str:
        return f"JointLimits({self._bounds.shape[1]} joints)"

    def hold(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is within limits; NaN and infinity never are."""
        return bool(within(q, self._bounds))
