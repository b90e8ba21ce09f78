"""Configurations and limits of time as people give them: lists, mappings by joint name, seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.robot.robot import Robot


def configuration_of(robot: Robot, value: Any, name: str) -> FloatArray:
    """Return a configuration (n,) [rad or m] from numbers or from a mapping by joint name, as `Robot.named` gives.

    Raises
    ------
    UnknownNameError
        If it names a joint that the robot does not have.
    InputError
        If a joint is missing, a number is none, or there is not one for each joint.
    """
    if isinstance(value, Mapping):
        for joint in value:
            if joint not in robot.joint_names:
                raise UnknownNameError("joint", joint, robot.joint_names, f"{name} configuration")
        missing = [joint for joint in robot.joint_names if joint not in value]
        if missing:
            raise InputError(f"no value for {', '.join(map(repr, missing))}", f"{name} configuration")
        value = [value[joint] for joint in robot.joint_names]
    return finite_array(value, (robot.n,), f"{name} configuration")


def several(goals: Any) -> list[Any]:
    """Return the configurations that were given: one, in any form, or several."""
    if isinstance(goals, Mapping):
        return [goals]
    if isinstance(goals, Sequence) and any(isinstance(goal, Mapping) for goal in goals):
        return list(goals)
    return [list(row) for row in np.atleast_2d(np.asarray(goals, dtype=object))]
