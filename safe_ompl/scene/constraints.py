"""Constraints of every path of a scenario: danger, clearance, tool, motion, moving obstacles; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, pi
from typing import Any, TypeAlias

from safe_ompl.common import RATE_BOUNDS, InputError
from safe_ompl.common import documents as document

ByJoint: TypeAlias = float | Mapping[str, float] | tuple[float, ...]
_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class ToolConstraint(document.Section):
    """An axis of the tool that stays within an angle of a direction.

    Parameters
    ----------
    angle : float
        The largest angle [rad].
    axis : sequence of 3 float, optional
        The axis in the frame of the tip; default: the one that points in the direction at the start.
    direction : sequence of 3 float, optional
        Where it is to point, in the world frame; default: up.
    """

    angle: float
    axis: tuple[float, ...] | None = None
    direction: tuple[float, ...] = _UP

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", document.number("angle", self.angle, above=0.0, at_most=pi))
        for key in ("axis", "direction"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, _direction(key, getattr(self, key)))


@dataclass(frozen=True)
class TipBox(document.Section):
    """Bounds of the tip's position in the world, least and largest coordinate [m]; what is not given is not bounded."""

    x: tuple[float, ...] | None = None
    y: tuple[float, ...] | None = None
    z: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        given = [field.name for field in fields(self) if getattr(self, field.name) is not None]
        if not given:
            raise InputError("missing: give bounds of x, y or z", "x")
        for key in given:
            object.__setattr__(self, key, document.interval(key, getattr(self, key)))

    @property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner [m], infinite where there is no bound."""
        bounds = [given or (-inf, inf) for given in (self.x, self.y, self.z)]
        return tuple(low for low, _ in bounds), tuple(high for _, high in bounds)


@dataclass(frozen=True)
class MovingObstacles(document.Section):
    """Obstacles whose place is not certain: each may go anywhere, no faster than its speed.

    Parameters
    ----------
    speeds : mapping of str to float
        Bound of the speed [m/s] of each, by name.
    time : float
        [s] from the moment of the scene to the end of the last motion.
    """

    speeds: Mapping[str, float]
    time: float

    def __post_init__(self) -> None:
        speeds = document.numbers_by_name("speeds", self.speeds, at_least=0.0)
        if not speeds:
            raise InputError("must name an obstacle at least", "speeds")
        object.__setattr__(self, "speeds", speeds)
        object.__setattr__(self, "time", document.number("time", self.time, above=0.0))


@dataclass(frozen=True)
class PathLimits(document.Section):
    """Hard limits of paths, proven along whole motions.

    Parameters
    ----------
    max_danger : float, optional
        No configuration is more dangerous, in the units of the danger field; 0: any danger.
    min_clearance : float, optional
        The robot keeps this distance [m]; 0: it only must not touch.
    obstacles : sequence of str, optional
        From these; default: from those with a danger weight, such as people.
    exempt : sequence of (str, str), optional
        Pairs of a link and an obstacle that need not keep it.
    tool : ToolConstraint, optional
        How an axis of the tool must point.
    tip : TipBox, optional
        Where the tip must stay.
    moving : MovingObstacles, optional
        Obstacles that may come nearer while the path is driven: it is free whatever they do.
    tube : float, mapping of str to float, or sequence of float, optional
        How far each joint may be from where it should be: one for all, or all [rad or m].
    """

    max_danger: float = 0.0
    min_clearance: float = 0.0
    obstacles: tuple[str, ...] | None = None
    exempt: tuple[tuple[str, str], ...] = ()
    tool: ToolConstraint | None = None
    tip: TipBox | None = None
    moving: MovingObstacles | None = None
    tube: ByJoint | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "tube", _by_joint("tube", self.tube, at_least=0.0))
        for key in ("max_danger", "min_clearance"):
            object.__setattr__(self, key, document.number(key, getattr(self, key), at_least=0.0))
        if self.obstacles is not None:
            names = document.sequence("obstacles", self.obstacles)
            object.__setattr__(self, "obstacles", tuple(document.text("obstacles", name) for name in names))
        pairs = [_pair(pair) for pair in document.sequence("exempt", self.exempt)]
        object.__setattr__(self, "exempt", tuple(pairs))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> PathLimits:
        """Read limits from a document, with the sections in them; errors as `Section.from_mapping`."""
        kinds: dict[str, type[document.Section]] = {"tool": ToolConstraint, "tip": TipBox, "moving": MovingObstacles}
        read = dict(data)
        for key in kinds.keys() & data.keys():
            read[key] = document.section(key, data[key], kinds[key].from_mapping)
        return super().from_mapping(read)


@dataclass(frozen=True)
class MotionLimits(document.Section):
    """Limits of trajectories.

    Parameters
    ----------
    velocity, acceleration : float, mapping of str to float, or sequence of float, optional
        Of the joints: one for all, those of some, or all [rad/s, rad/s²; m where they slide]; defaults as in
        `RateLimits.of`.
    jerk : as these, optional
        [rad/s³]; not limited unless given.
    tool_speed, link_speed : float, optional
        Of the tip, and of any point of any link [m/s].
    max_danger : float, optional
        Of the kinetostatic danger, that grows with speed: k2 and gamma are options of the scenario's danger.
    """

    velocity: ByJoint | None = None
    acceleration: ByJoint | None = None
    jerk: ByJoint | None = None
    tool_speed: float | None = None
    link_speed: float | None = None
    max_danger: float | None = None

    def __post_init__(self) -> None:
        for key in ("velocity", "acceleration", "jerk"):
            object.__setattr__(self, key, _by_joint(key, getattr(self, key), **RATE_BOUNDS[key]))
        for key in ("tool_speed", "link_speed", "max_danger"):
            if getattr(self, key) is not None:
                bound = {"above": 0.0} if key == "max_danger" else RATE_BOUNDS["speed"]
                object.__setattr__(self, key, document.number(key, getattr(self, key), **bound))


def _direction(key: str, value: Any) -> tuple[float, ...]:
    numbers = document.numbers(key, value, 3)
    if not any(numbers):
        raise InputError("must be a vector that is not zero", key)
    return numbers


def _pair(value: Any) -> tuple[str, str]:
    names = document.sequence("exempt", value)
    if len(names) != 2:
        raise InputError(f"must be pairs of a link and an obstacle, not {value!r}", "exempt")
    return document.text("exempt", names[0]), document.text("exempt", names[1])


def _by_joint(key: str, value: Any, **bound: float) -> ByJoint | None:
    if value is None:
        return None
    if isinstance(value, Mapping):
        return document.numbers_by_name(key, value, None, **bound)
    if isinstance(value, (list, tuple)):
        limits = document.numbers(key, value)
        return tuple(document.number(f"{key}[{k}]", limit, **bound) for k, limit in enumerate(limits))
    return document.number(key, value, **bound)
