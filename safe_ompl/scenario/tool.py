"""Limits of the tool on every path of a scenario: plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import inf, pi
from typing import Any

from safe_ompl import document
from safe_ompl.errors import InputError

_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class ToolConstraint:
    """An axis of the tool that stays within an angle of a direction.

    Parameters
    ----------
    angle : float
        The largest angle [rad].
    axis : sequence of 3 float, optional
        The axis in the frame of the tip; default: the one that points in the direction at the start.
    direction : sequence of 3 float, optional
        Where it is to point, in the world frame; default: up.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    angle: float
    axis: tuple[float, ...] | None = None
    direction: tuple[float, ...] = _UP

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", document.number("angle", self.angle, above=0.0, at_most=pi))
        for key in ("axis", "direction"):
            if getattr(self, key) is not None:
                object.__setattr__(self, key, _direction(key, getattr(self, key)))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> ToolConstraint:
        """Read the constraint from a document."""
        document.check_keys(data, [field.name for field in fields(cls)])
        document.require(data, "angle")
        return cls(**data)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        data: dict[str, Any] = {"angle": self.angle}
        if self.axis is not None:
            data["axis"] = list(self.axis)
        if self.direction != _UP:
            data["direction"] = list(self.direction)
        return data


@dataclass(frozen=True)
class TipBox:
    """Bounds of the tip's position in the world; what is not given is not bounded.

    Parameters
    ----------
    x, y, z : (float, float), optional
        Least and largest coordinate [m].

    Raises
    ------
    InputError
        If bounds are no two numbers in the right order, or there are none; the message starts with the key.
    """

    x: tuple[float, ...] | None = None
    y: tuple[float, ...] | None = None
    z: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        given = [field.name for field in fields(self) if getattr(self, field.name) is not None]
        if not given:
            raise InputError("missing: give bounds of x, y or z", "x")
        for key in given:
            low, high = document.numbers(key, getattr(self, key), 2)
            if low >= high:
                raise InputError(f"must be the least and the largest value, got [{low:g}, {high:g}]", key)
            object.__setattr__(self, key, (low, high))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> TipBox:
        """Read the bounds from a document."""
        document.check_keys(data, [field.name for field in fields(cls)])
        return cls(**data)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return {key: list(bounds) for key, bounds in given.items() if bounds is not None}

    @property
    def corners(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The lower and the upper corner [m], infinite where there is no bound."""
        bounds = [given or (-inf, inf) for given in (self.x, self.y, self.z)]
        return tuple(low for low, _ in bounds), tuple(high for _, high in bounds)


def _direction(key: str, value: Any) -> tuple[float, ...]:
    numbers = document.numbers(key, value, 3)
    if not any(numbers):
        raise InputError("must be a vector that is not zero", key)
    return numbers
