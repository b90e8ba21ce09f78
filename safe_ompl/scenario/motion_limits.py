"""Limits of velocity, acceleration and jerk: plain data of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from safe_ompl import document

ByJoint: TypeAlias = float | Mapping[str, float] | tuple[float, ...]


@dataclass(frozen=True)
class MotionLimits:
    """Limits of trajectories.

    Parameters
    ----------
    velocity, acceleration : float, mapping of str to float, or sequence of float, optional
        Of the joints: one for all, those of some, or all [rad/s, rad/s²; m where they slide]; defaults as in
        `RateLimits.of`.
    jerk : as these, optional
        [rad/s³]; not limited unless given. With it the robot stops at every way point where its path turns.
    tool_speed, link_speed : float, optional
        Of the tip, and of any point of any link [m/s].
    max_danger : float, optional
        Of the kinetostatic danger, that grows with speed: k2 and gamma are options of the scenario's danger.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    velocity: ByJoint | None = None
    acceleration: ByJoint | None = None
    jerk: ByJoint | None = None
    tool_speed: float | None = None
    link_speed: float | None = None
    max_danger: float | None = None

    def __post_init__(self) -> None:
        for key in ("velocity", "acceleration", "jerk"):
            object.__setattr__(self, key, _by_joint(key, getattr(self, key)))
        for key in ("tool_speed", "link_speed", "max_danger"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, document.number(key, getattr(self, key), above=0.0))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> MotionLimits:
        """Read limits from a document."""
        document.check_keys(data, [field.name for field in fields(cls)])
        return cls(**data)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        lists = {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}
        return {key: value for key, value in lists.items() if value is not None}


def _by_joint(key: str, value: Any) -> ByJoint | None:
    if value is None:
        return None
    if isinstance(value, Mapping):
        joints = document.mapping(key, value)
        with document.within(key):
            return {name: document.number(name, limit, above=0.0) for name, limit in joints.items()}
    if isinstance(value, (list, tuple)):
        limits = document.numbers(key, value)
        return tuple(document.number(f"{key}[{k}]", limit, above=0.0) for k, limit in enumerate(limits))
    return document.number(key, value, above=0.0)
