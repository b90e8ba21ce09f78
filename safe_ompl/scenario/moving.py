"""Obstacles of a scenario that move: plain data of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from safe_ompl import document
from safe_ompl.errors import InputError


@dataclass(frozen=True)
class MovingObstacles:
    """Obstacles whose place is not certain: each may go anywhere, no faster than its speed.

    Parameters
    ----------
    speeds : mapping of str to float
        Bound of the speed [m/s] of each, by name.
    time : float
        [s] from the moment of the scene to the end of the last motion.

    Raises
    ------
    InputError
        If a value cannot be used; the message starts with its key.
    """

    speeds: Mapping[str, float]
    time: float

    def __post_init__(self) -> None:
        speeds = document.mapping("speeds", self.speeds)
        if not speeds:
            raise InputError("must name an obstacle at least", "speeds")
        with document.within("speeds"):
            checked = {name: document.number(name, speed, at_least=0.0) for name, speed in speeds.items()}
        object.__setattr__(self, "speeds", checked)
        object.__setattr__(self, "time", document.number("time", self.time, above=0.0))

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> MovingObstacles:
        """Read them from a document."""
        document.check_keys(data, ("speeds", "time"))
        return cls(document.require(data, "speeds"), document.require(data, "time"))

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads."""
        return {"speeds": dict(self.speeds), "time": self.time}
