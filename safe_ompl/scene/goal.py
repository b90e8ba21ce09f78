"""Configurations and goals as a user writes them down, and what they mean for a robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, InputError, UnknownNameError
from safe_ompl.common import documents as document
from safe_ompl.geometry import Pose
from safe_ompl.robot import GoalRegion, Robot

Configuration: TypeAlias = tuple[float, ...] | Mapping[str, float]
"""Joint values in the robot's order, or by the names of the joints [rad or m]."""

_TOLERANCE, _REGION_TOLERANCE = 0.01, 0.001  # [m]
_TURNS = ("quaternion_xyzw", "rpy")


@dataclass(frozen=True)
class Goal:
    """Where the robot is to go: to one of several configurations, or with its tip to a place.

    Both may be given; a planner takes the one that it can use.

    Parameters
    ----------
    configurations : sequence of Configuration, optional
        Goal configurations, any of which will do.
    position : sequence of 3 float, optional
        Where the tip of the robot is to be, in the world frame [m].
    quaternion_xyzw : sequence of 4 float, optional
        Orientation of the tip, which makes the place a pose.
    tolerance : float, optional
        How near to the place or region is near enough [m]; default: 0.01 for a place, 0.001 for a region.
    region : GoalRegion, optional
        Where the tip may be, instead of a position.

    Raises
    ------
    InputError
        If there is no configuration, position or region, both of the latter, or a value cannot be used.
    """

    configurations: tuple[Configuration, ...] = ()
    position: tuple[float, ...] | None = None
    quaternion_xyzw: tuple[float, ...] | None = None
    tolerance: Any = None  # becomes a float
    region: GoalRegion | None = None

    def __post_init__(self) -> None:
        given = document.sequence("configurations", self.configurations)
        read = tuple(read_configuration(key, item) for key, item in _numbered("configurations", given))
        object.__setattr__(self, "configurations", read)
        usual = _TOLERANCE if self.region is None else _REGION_TOLERANCE
        wanted = usual if self.tolerance is None else document.number("tolerance", self.tolerance, above=0.0)
        object.__setattr__(self, "tolerance", wanted)
        if self.region is not None and (self.position is not None or self.quaternion_xyzw is not None):
            raise InputError("give only one of position and region", "region")
        if self.position is not None:
            pose = Pose(self.position, self.quaternion_xyzw or (0.0, 0.0, 0.0, 1.0))
            object.__setattr__(self, "position", pose.position)
            object.__setattr__(self, "quaternion_xyzw", self.quaternion_xyzw and pose.quaternion_xyzw)
        elif self.quaternion_xyzw is not None:
            raise InputError("missing: an orientation alone is no goal", "position")
        elif not self.configurations and self.region is None:
            raise InputError(
                "missing: give configuration, configurations, position or region", "configuration"
            )

    @property
    def is_place(self) -> bool:
        """Whether it says where the tip is to be."""
        return self.position is not None or self.region is not None

    @property
    def rotation(self) -> FloatArray | None:
        """Orientation of the tip as a matrix (3, 3), or None where any will do."""
        if self.position is None or self.quaternion_xyzw is None:
            return None
        rotation: FloatArray = Pose(self.position, self.quaternion_xyzw).se3.rotation
        return rotation

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Goal:
        """Read ``configuration`` or ``configurations``, and ``position`` with orientation or ``region``."""
        document.check_keys(
            data, ("configuration", "configurations", "position", *_TURNS, "tolerance", "region")
        )
        if "configuration" in data and "configurations" in data:
            raise InputError("give only one of configuration and configurations", "configurations")
        if "configuration" in data:
            configurations = [read_configuration("configuration", data["configuration"])]
        else:
            configurations = document.sequence("configurations", data.get("configurations", ()))
        turn = None
        if any(key in data for key in _TURNS):
            turn = Pose.from_mapping(data).quaternion_xyzw
        region = None
        if "region" in data:
            bounds = document.mapping("region", data["region"])
            with document.within("region"):
                region = GoalRegion.from_mapping(bounds)
        return cls(tuple(configurations), data.get("position"), turn, data.get("tolerance"), region)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        data: dict[str, Any] = {}
        if len(self.configurations) == 1:
            data["configuration"] = self.configurations[0]
        elif self.configurations:
            data["configurations"] = self.configurations
        for key in ("position", "quaternion_xyzw"):
            if getattr(self, key) is not None:
                data[key] = getattr(self, key)
        if self.region is not None:
            data["region"] = self.region.to_mapping()
        if self.tolerance != (_TOLERANCE if self.region is None else _REGION_TOLERANCE):
            data["tolerance"] = self.tolerance
        return data

    def configuration_array(self, robot: Robot) -> FloatArray:
        """Return the goal configurations as an array (G, n); errors as `configuration_for`.

        Raises
        ------
        InputError
            If the goal is a place only.
        """
        if not self.configurations:
            raise InputError("missing: this planner needs a goal configuration", "configuration")
        if len(self.configurations) == 1:
            return configuration_for(robot, "configuration", self.configurations[0])[None]
        named = _numbered("configurations", self.configurations)
        return np.array([configuration_for(robot, key, given) for key, given in named])


def read_configuration(key: str, value: Any) -> Configuration:
    """Return a configuration of finite numbers from a list, or from a mapping of joint names to values."""
    if isinstance(value, Mapping):
        with document.within(key):
            return {str(joint): document.number(str(joint), given) for joint, given in value.items()}
    return document.numbers(key, value)


def configuration_for(robot: Robot, key: str, given: Configuration) -> FloatArray:
    """Return a configuration as joint values (n,) in the order of the robot's joints [rad or m].

    Parameters
    ----------
    robot : Robot
        The robot.
    key : str
        What the configuration is called, for errors.
    given : Configuration
        As the user wrote it.

    Raises
    ------
    UnknownNameError
        If it names a joint that the robot does not have (or that is locked).
    InputError
        If it has not one value for every joint, or a value is outside the joint's limits.
    """
    joints = robot.joint_names
    if isinstance(given, Mapping):
        q = _by_name(joints, key, given)
    elif len(given) != len(joints):
        names = ", ".join(joints)
        raise InputError(
            f"has {len(given)} values, but the robot has {len(joints)} joints to move: {names}", key
        )
    else:
        q = np.array(given, dtype=np.float64)
    for i in np.flatnonzero(~robot.within_limits(q)):
        raise InputError(
            f"joint {joints[i]!r} = {q[i]:g} is outside its limits [{robot.lower[i]:g}, {robot.upper[i]:g}]",
            key,
        )
    return q


def _by_name(joints: tuple[str, ...], key: str, given: Mapping[str, float]) -> FloatArray:
    for name in given:
        if name not in joints:
            raise UnknownNameError("joint", name, joints, key)
    missing = [name for name in joints if name not in given]
    if missing:
        raise InputError(f"no value for the joint {' and '.join(map(repr, missing))}", key)
    return np.array([given[name] for name in joints], dtype=np.float64)


def _numbered(key: str, items: Any) -> Iterator[tuple[str, Any]]:
    return ((f"{key}[{k}]", item) for k, item in enumerate(items))
