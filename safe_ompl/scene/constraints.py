"""Constraints of every path of a scenario: danger, clearance, tool, motion, moving obstacles; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, pi
from typing import Any, TypeAlias

from safe_ompl.common import RATE_BOUNDS, InputError, Section, key
from safe_ompl.common import documents as document

ByJoint: TypeAlias = float | Mapping[str, float] | tuple[float, ...]
_UP = (0.0, 0.0, 1.0)


def _direction(key: str, value: Any) -> tuple[float, ...]:
    numbers = document.numbers(key, value, 3)
    if not any(numbers):
        raise InputError("must be a vector that is not zero", key)
    return numbers


def _pairs(key: str, value: Any) -> tuple[tuple[str, str], ...]:
    pairs = []
    for pair in document.sequence(key, value):
        names = document.sequence(key, pair)
        if len(names) != 2:
            raise InputError(f"must be pairs of a link and an obstacle, not {pair!r}", key)
        pairs.append((document.text(key, names[0]), document.text(key, names[1])))
    return tuple(pairs)


def _by_joint(key: str, value: Any, **bounds: Any) -> ByJoint:
    if isinstance(value, Mapping):
        return document.numbers_by_name(key, value, **bounds)
    if isinstance(value, (list, tuple)):
        return document.each(key, value, document.number, **bounds)
    return document.number(key, value, **bounds)


@dataclass(frozen=True)
class ToolConstraint(Section):
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

    angle: float = key(document.number, above=0.0, at_most=pi)
    axis: tuple[float, ...] | None = key(_direction, default=None)
    direction: tuple[float, ...] = key(_direction, default=_UP)


@dataclass(frozen=True)
class TipBox(Section):
    """Bounds of the tip's position in the world, least and largest coordinate [m]; what is not given is not bounded."""

    x: tuple[float, ...] | None = key(document.interval, default=None)
    y: tuple[float, ...] | None = key(document.interval, default=None)
    z: tuple[float, ...] | None = key(document.interval, default=None)

    def check(self) -> None:
        if self.x is self.y is self.z is None:
            raise InputError("missing: give bounds of x, y or z", "x")

    @property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner [m], infinite where there is no bound."""
        bounds = [given or (-inf, inf) for given in (self.x, self.y, self.z)]
        return tuple(low for low, _ in bounds), tuple(high for _, high in bounds)


@dataclass(frozen=True)
class MovingObstacles(Section):
    """Obstacles whose place is not certain: each may go anywhere, no faster than its speed.

    Parameters
    ----------
    speeds : mapping of str to float
        Bound of the speed [m/s] of each, by name.
    time : float
        [s] from the moment of the scene to the end of the last motion.
    """

    speeds: Mapping[str, float] = key(document.numbers_by_name, at_least=0.0, least="obstacle")
    time: float = key(document.number, above=0.0)


@dataclass(frozen=True)
class PathLimits(Section):
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

    max_danger: float = key(document.number, default=0.0, at_least=0.0)
    min_clearance: float = key(document.number, default=0.0, at_least=0.0)
    obstacles: tuple[str, ...] | None = key(document.each, default=None, read=document.text)
    exempt: tuple[tuple[str, str], ...] = key(_pairs, default=())
    tool: ToolConstraint | None = key(document.section, default=None, kind=ToolConstraint)
    tip: TipBox | None = key(document.section, default=None, kind=TipBox)
    moving: MovingObstacles | None = key(document.section, default=None, kind=MovingObstacles)
    tube: ByJoint | None = key(_by_joint, default=None, at_least=0.0)


@dataclass(frozen=True)
class MotionLimits(Section):
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

    velocity: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["velocity"])
    acceleration: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["acceleration"])
    jerk: ByJoint | None = key(_by_joint, default=None, **RATE_BOUNDS["jerk"])
    tool_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    link_speed: float | None = key(document.number, default=None, **RATE_BOUNDS["speed"])
    max_danger: float | None = key(document.number, default=None, above=0.0)
