"""What goes wrong in a simulation, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from safe_ompl.inputs import fraction, number


@dataclass(frozen=True)
class Faults:
    """What goes wrong between the world and the replanner.

    Parameters
    ----------
    noise : float
        Errors of measured key points and places of objects: uniform in a ball of this radius [m].
    drops : float
        Share of the frames in which nobody is seen.
    late : float
        Share of the ticks in which the replanner answers too late: the robot follows its last command to its stop.
    seed : int
        Of the generator that draws them.
    """

    noise: float = 0.0
    drops: float = 0.0
    late: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        number("noise", self.noise, at_least=0.0)
        fraction("drops", self.drops)
        fraction("late", self.late)


@dataclass
class Summary:
    """What came of a simulation.

    Attributes
    ----------
    seconds : float
        Simulated time [s].
    contacts_while_moving : int
        While the robot moved and all kept to the reach model: none, if what is proven holds.
    contacts_after_violations : int
        While the robot moved, but somebody had not kept to it.
    contacts_at_rest : int
        Somebody touched the robot that stood.
    model_obeyed : float
        Share of the time in which all had kept to the model since the measurement that the motion was proven against.
    tasks, stops, detours : int
        How often the goal was reached, the robot stopped on its way, and another way was taken.
    moving : float
        Share of the time in which it moved.
    reaction : tuple of float
        From a measurement to a proven command on the clock of this machine: median and 99 % [s].
    deadlines_missed : int
        Ticks without a new command: the robot followed its stop.
    violations : int
        Frames in which somebody was seen to have moved farther than promised.
    least_distance : float
        While it moved and all kept to the model [m].
    """

    seconds: float = 0.0
    contacts_while_moving: int = 0
    contacts_after_violations: int = 0
    contacts_at_rest: int = 0
    model_obeyed: float = 1.0
    tasks: int = 0
    stops: int = 0
    detours: int = 0
    moving: float = 0.0
    reaction: tuple[float, float] = (0.0, 0.0)
    deadlines_missed: int = 0
    violations: int = 0
    least_distance: float = np.inf

    def as_dict(self) -> dict[str, Any]:
        """Return all of it as plain data."""
        found = dict(self.__dict__)
        found["reaction"] = {"median": self.reaction[0], "p99": self.reaction[1]}
        return found
