"""Limits that every path of a scenario must keep to: plain data of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from safe_ompl import document
from safe_ompl.errors import InputError
from safe_ompl.scenario.moving import MovingObstacles
from safe_ompl.scenario.tool import TipBox, ToolConstraint


@dataclass(frozen=True)
class PathLimits:
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

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    max_danger: float = 0.0
    min_clearance: float = 0.0
    obstacles: tuple[str, ...] | None = None
    exempt: tuple[tuple[str, str], ...] = ()
    tool: ToolConstraint | None = None
    tip: TipBox | None = None
    moving: MovingObstacles | None = None

    def __post_init__(self) -> None:
        for key in ("max_danger", "min_clearance"):
            object.__setattr__(self, key, document.number(key, getattr(self, key), at_least=0.0))
        if self.obstacles is not None:
            names = document.sequence("obstacles", self.obstacles)
            object.__setattr__(self, "obstacles", tuple(document.text("obstacles", name) for name in names))
        pairs = [_pair(pair) for pair in document.sequence("exempt", self.exempt)]
        object.__setattr__(self, "exempt", tuple(pairs))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> PathLimits:
        """Read limits from a document."""
        document.check_keys(data, [field.name for field in fields(cls)])
        kinds: dict[str, type[ToolConstraint | TipBox | MovingObstacles]] = {
            "tool": ToolConstraint,
            "tip": TipBox,
            "moving": MovingObstacles,
        }
        read = dict(data)
        for key in kinds.keys() & data.keys():
            given = document.mapping(key, data[key])
            with document.within(key):
                read[key] = kinds[key].from_mapping(given)
        return cls(**read)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        given = {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}
        return {key: _lists(value) for key, value in given.items()}


def _lists(value: Any) -> Any:
    if isinstance(value, (ToolConstraint, TipBox, MovingObstacles)):
        return value.to_mapping()
    return [_lists(item) for item in value] if isinstance(value, tuple) else value


def _pair(value: Any) -> tuple[str, str]:
    names = document.sequence("exempt", value)
    if len(names) != 2:
        raise InputError(f"must be pairs of a link and an obstacle, not {value!r}", "exempt")
    return document.text("exempt", names[0]), document.text("exempt", names[1])
