"""MoveIt's `joint_limits.yaml`: positions, velocities, accelerations and jerks of joints, beside those of the URDF.

MoveIt lets the file override the URDF in either direction. Here the narrower of two limits of a position or a velocity
applies, since the URDF tells what the hardware can do, and a warning names limits of the file that are wider.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any

import pinocchio as pin

from safe_ompl.common import (
    RATE_BOUNDS,
    InputError,
    Section,
    UnknownNameError,
    documents as document,
    files,
    key,
    warn_once,
)

_log = logging.getLogger(__name__)

_RATES = ("velocity", "acceleration", "jerk")
_NODE = "ros__parameters"
_OUTER = ("robot_description_planning", _NODE)


@dataclass(frozen=True)
class JointEntry(Section):
    """What the file says of one joint [rad or m, s]; a limit counts unless its `has_…_limits` is false.

    Efforts and the gains of controllers are read, but not used.
    """

    has_position_limits: bool | None = key(document.flag, default=None)
    min_position: float | None = key(document.number, default=None)
    max_position: float | None = key(document.number, default=None)
    has_velocity_limits: bool | None = key(document.flag, default=None)
    max_velocity: float | None = key(document.number, default=None)
    has_acceleration_limits: bool | None = key(document.flag, default=None)
    max_acceleration: float | None = key(document.number, default=None)
    has_deceleration_limits: bool | None = key(document.flag, default=None)
    max_deceleration: float | None = key(document.number, default=None)
    has_jerk_limits: bool | None = key(document.flag, default=None)
    max_jerk: float | None = key(document.number, default=None)
    has_effort_limits: bool | None = key(document.flag, default=None)
    max_effort: float | None = key(document.number, default=None)
    has_soft_limits: bool | None = key(document.flag, default=None)
    soft_lower_limit: float | None = key(document.number, default=None)
    soft_upper_limit: float | None = key(document.number, default=None)
    k_position: float | None = key(document.number, default=None)
    k_velocity: float | None = key(document.number, default=None)
    angle_wraparound: bool | None = key(document.flag, default=None)

    def check(self) -> None:
        """Raise InputError if a range is empty, a rate is absurd, or a limit is announced and not given."""
        for kind in _RATES:
            if getattr(self, f"has_{kind}_limits"):
                document.require(self.to_mapping(), f"max_{kind}")
            self.rate(kind)
        low, high = self.range
        if not low < high:
            raise InputError(f"must be above the least position {low:g}, got {high:g}", "max_position")
        if self.has_position_limits and (low, high) == (-inf, inf):
            raise InputError("missing, but needed, as has_position_limits is true", "min_position")

    @property
    def range(self) -> tuple[float, float]:
        """The least and the largest position [rad or m], soft limits included; infinite where none is given."""
        low, high = [-inf], [inf]
        for given, least, most in (
            (self.has_position_limits, self.min_position, self.max_position),
            (self.has_soft_limits, self.soft_lower_limit, self.soft_upper_limit),
        ):
            if given is not False:
                low += [] if least is None else [least]
                high += [] if most is None else [most]
        return max(low), min(high)

    def rate(self, kind: str) -> float | None:
        """Return the largest velocity, acceleration or jerk, if one is given; braking is no stronger than it says."""
        found = []
        for name in (kind, "deceleration") if kind == "acceleration" else (kind,):
            value = getattr(self, f"max_{name}")
            if value is not None and getattr(self, f"has_{name}_limits") is not False:
                # A deceleration is written with either sign.
                value = abs(value) if name == "deceleration" else value
                found.append(document.number(f"max_{name}", value, **RATE_BOUNDS[kind]))
        return min(found, default=None)


@dataclass(frozen=True)
class JointLimitsFile(Section):
    """The content of a `joint_limits.yaml`, by joint, and the file that it was read from.

    The scaling factors are what MoveIt multiplies limits with in requests that name no factor. They are no limits of
    the robot: what a motion is checked against are the limits themselves.
    """

    joint_limits: Mapping[str, JointEntry] = key(document.by_name, read=document.section, kind=JointEntry)
    default_velocity_scaling_factor: float = key(document.number, default=1.0, above=0.0, at_most=1.0)
    default_acceleration_scaling_factor: float = key(document.number, default=1.0, above=0.0, at_most=1.0)
    file: Path | None = field(default=None, compare=False)

    @classmethod
    def read(cls, name: str, value: Any) -> JointLimitsFile:
        """Return the limits of a file, of a mapping with its content, or those given; an InputError says what fails."""
        if isinstance(value, cls):
            return value
        if isinstance(value, Mapping):
            with document.within(name):
                return cls.from_mapping(value)
        path = document.file(name, value, (".yaml", ".yml"))
        with document.within(name, ": "), files.reading(path) as content:
            outer = ""
            while "joint_limits" not in content and len(content) == 1:
                ((word, inner),) = content.items()
                # A file of ROS 2's parameters begins with the name of a node, such as `/**` or `move_group`.
                if word not in _OUTER and not (isinstance(inner, Mapping) and _NODE in inner):
                    break
                outer, content = f"{outer}{word}.", document.mapping(f"{outer}{word}", inner)
            with document.within(outer, ""):
                return replace(cls.from_mapping(content), file=path)

    def to_mapping(self, folder: Path | None = None) -> Any:
        """Return the name of the file, or its content if there is none."""
        return super().to_mapping(folder) if self.file is None else document.file_name(self.file, folder)

    @property
    def content(self) -> dict[str, Any]:
        """What the file says, as plain data."""
        return super().to_mapping()

    def rates(self, kind: str) -> dict[str, float]:
        """Return the velocities, accelerations or jerks by joint, of those that have any."""
        found = {joint: entry.rate(kind) for joint, entry in self.joint_limits.items()}
        return {joint: value for joint, value in found.items() if value is not None}

    def narrow(self, full: pin.Model, source: str) -> None:
        """Narrow positions and velocities of a model; warn of wider ones, and of joints that the robot has not.

        Raises UnknownNameError if the robot has none of the joints, and InputError if a range has no value in common
        with that of the URDF, or is of a continuous joint, which MoveIt gives no range either.
        """
        where, known = str(self.file or "joint_limits"), list(full.names)[1:]
        unknown = [joint for joint in self.joint_limits if joint not in known]
        if unknown and len(unknown) == len(self.joint_limits):
            raise UnknownNameError("joint", unknown[0], known, where)
        wider = []
        for name in self.joint_limits.keys() - unknown:
            entry, joint = self.joint_limits[name], full.joints[full.getJointId(name)]
            if entry.range != (-inf, inf):
                if joint.nq != 1:
                    raise InputError("must not have position limits, as it is continuous", f"{where}: {name}")
                low, high = full.lowerPositionLimit[joint.idx_q], full.upperPositionLimit[joint.idx_q]
                least, most = max(low, entry.range[0]), min(high, entry.range[1])
                if least > most:
                    raise InputError(
                        f"[{entry.range[0]:g}, {entry.range[1]:g}] must overlap [{low:g}, {high:g}] of {source}",
                        f"{where}: {name}: position",
                    )
                if -inf < entry.range[0] < low or high < entry.range[1] < inf:
                    wider.append(f"{name} (position)")
                full.lowerPositionLimit[joint.idx_q], full.upperPositionLimit[joint.idx_q] = least, most
            velocity, in_urdf = entry.rate("velocity"), float(full.velocityLimit[joint.idx_v])
            if velocity is not None:
                # URDFs that do not limit a velocity say 0, or a number that no joint reaches.
                limited = 0.0 < in_urdf < inf
                if limited and velocity > in_urdf:
                    wider.append(f"{name} (velocity)")
                velocity = min(velocity, in_urdf) if limited else velocity
                full.velocityLimit[joint.idx_v] = velocity
                # Pinocchio 4.1 reads the same positive number for the lower limit, which must not be above the upper.
                full.lowerVelocityLimit[joint.idx_v] = -velocity
        for names, words in (
            (unknown, "the robot has no such joint"),
            (sorted(wider), "wider than in the URDF, which applies (limits=, or motion of a scenario, give others)"),
        ):
            if names:
                warn_once(_log, f"{where}: {words}: {', '.join(names)}")
