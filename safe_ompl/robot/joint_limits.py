"""Reading MoveIt's `joint_limits.yaml`: limits of positions, velocities, accelerations and jerks of joints.

In MoveIt the file overrides the URDF in either direction. Here the narrower limit of a position or velocity applies,
since the URDF describes the hardware. A warning names limits of the file that are wider.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import inf, isfinite
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
_RANGES = {"position": ("min_position", "max_position"), "soft": ("soft_lower_limit", "soft_upper_limit")}
_LIMITS = _RANGES | {kind: (f"max_{kind}",) for kind in (*_RATES, "deceleration", "effort")}
# Efforts and gains are accepted but not used, because controllers share the file.
_FLAGS = (*(f"has_{kind}_limits" for kind in _LIMITS), "angle_wraparound")
_LIMIT_KEYS = (*_FLAGS, *(name for names in _LIMITS.values() for name in names), "k_position", "k_velocity")


def read_joint(name: str, value: Any) -> dict[str, float]:
    """Read the limits of one joint that apply [rad or m, s]: `min_position`, `max_position`, `max_velocity`, ….

    A limit applies unless its `has_…_limits` is false. Soft limits narrow the range. A deceleration of either sign
    narrows the acceleration. Raises InputError if a range is empty, a rate is out of range, or a `has_…_limits` is true
    and the limit is missing.
    """
    data = document.mapping(name, value, _LIMIT_KEYS)
    with document.within(name):
        given = {
            word: (document.flag if word in _FLAGS else document.number)(word, item) for word, item in data.items()
        }
        for kind, names in _LIMITS.items():
            has_limits = given.get(f"has_{kind}_limits")
            if has_limits and given.keys().isdisjoint(names):
                raise InputError(f"missing, but needed, as has_{kind}_limits is true", names[0])
            if has_limits is False:
                given = {word: item for word, item in given.items() if word not in names}
        low, high = (
            pick([given[names[k]] for names in _RANGES.values() if names[k] in given], default=end)
            for k, (pick, end) in enumerate(((max, -inf), (min, inf)))
        )
        if low >= high:
            raise InputError(f"must be above the least position {low:g}, got {high:g}", "max_position")
        if "max_deceleration" in given:
            given["max_acceleration"] = min(abs(given["max_deceleration"]), given.get("max_acceleration", inf))
        found = {"min_position": low, "max_position": high}
        rates = {f"max_{kind}": RATE_BOUNDS[kind] for kind in _RATES if f"max_{kind}" in given}
        found |= {word: document.number(word, given[word], **bounds) for word, bounds in rates.items()}
    return {word: item for word, item in found.items() if isfinite(item)}


@dataclass(frozen=True)
class JointLimitsFile(Section):
    """The limits in a `joint_limits.yaml` that apply, by joint, with the file that they were read from.

    MoveIt multiplies limits with the scaling factors in requests without a factor. Motions are checked against the
    limits without these factors.
    """

    joint_limits: Mapping[str, Mapping[str, float]] = key(document.mapping_of, read=read_joint)
    default_velocity_scaling_factor: float = key(document.number, default=1.0, above=0.0, at_most=1.0)
    default_acceleration_scaling_factor: float = key(document.number, default=1.0, above=0.0, at_most=1.0)
    file: Path | None = field(default=None, compare=False)

    @classmethod
    def read(cls, name: str, value: Any) -> JointLimitsFile:
        """Read the limits from a file name or a mapping; return an instance unchanged. Raises InputError."""
        if isinstance(value, cls):
            return value
        if isinstance(value, Mapping):
            with document.within(name):
                return cls.from_mapping(value)
        path, outer = document.file(name, value, (".yaml", ".yml")), ""
        with document.within(name, ": "), files.reading(path) as content:
            # ROS parameter files begin with additional levels, such as `/**` and `ros__parameters`.
            while "joint_limits" not in content and [dict] == [type(inner) for inner in content.values()]:
                ((word, content),) = content.items()
                outer += f"{word}."
            with document.within(outer, ""):
                return replace(cls.from_mapping(content), file=path)

    def to_mapping(self, folder: Path | None = None) -> Any:
        """Return the name of the file, or its content if there is none."""
        return super().to_mapping(folder) if self.file is None else document.file_name(self.file, folder)

    @property
    def content(self) -> dict[str, Any]:
        """The content of the file as plain data."""
        return super().to_mapping()

    def rates(self, kind: str) -> dict[str, float]:
        """Return the velocity, acceleration or jerk limits by joint, for joints that have one."""
        return {joint: given[f"max_{kind}"] for joint, given in self.joint_limits.items() if f"max_{kind}" in given}

    def narrow(self, full: pin.Model, source: str) -> None:
        """Narrow the position and velocity limits of a model, in place. Warn of wider limits and unknown joints.

        Raises UnknownNameError if the robot has none of the joints; InputError if a range does not intersect the range
        of the URDF, or belongs to a continuous joint, which has no range in MoveIt either.
        """
        where, known, wider = str(self.file or "joint_limits"), list(full.names)[1:], []
        unknown = [joint for joint in self.joint_limits if joint not in known]
        if unknown and len(unknown) == len(self.joint_limits):
            raise UnknownNameError("joint", unknown[0], known, where)
        for name, given in ((name, given) for name, given in self.joint_limits.items() if name in known):
            joint = full.joints[full.getJointId(name)]
            tables = [("max_velocity", full.velocityLimit, joint.idx_v, min)]
            if joint.nq == 1:
                tables.append(("min_position", full.lowerPositionLimit, joint.idx_q, max))
                tables.append(("max_position", full.upperPositionLimit, joint.idx_q, min))
            elif not {"min_position", "max_position"}.isdisjoint(given):
                raise InputError("must not have position limits, as it is continuous", f"{where}: {name}")
            for word, table, row, narrower in (entry for entry in tables if entry[0] in given):
                # A velocity limit of 0 or infinity in a URDF means no limit.
                if isfinite(table[row]) and (word != "max_velocity" or table[row] > 0.0):
                    wider += [f"{name}.{word}"] if narrower(given[word], table[row]) != given[word] else []
                    table[row] = narrower(given[word], table[row])
                else:
                    table[row] = given[word]
            # Pinocchio 4.1 stores a positive lower velocity limit, too. It must not be above the upper limit.
            full.lowerVelocityLimit[joint.idx_v] = -full.velocityLimit[joint.idx_v]
            if joint.nq == 1 and not full.lowerPositionLimit[joint.idx_q] <= full.upperPositionLimit[joint.idx_q]:
                raise InputError(f"must overlap the position limits in {source}", f"{where}: {name}")
        if unknown:
            warn_once(_log, f"{where}: the robot has no such joint: {', '.join(unknown)}")
        if wider:
            words = "wider than in the URDF, which applies (limits=, or motion of a scenario, give others)"
            warn_once(_log, f"{where}: {words}: {', '.join(wider)}")
