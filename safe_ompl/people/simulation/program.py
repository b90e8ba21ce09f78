"""A robot that drives a program beside people, in simulated time."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.people.replanning import Leg, Legs
from safe_ompl.people.simulation.movers import Drifting, PersonMover
from safe_ompl.people.simulation.simulation import ContactMonitor, Faults, Simulation


class ProgramSimulation(Simulation):
    """Drives `legs` one after the other, each once; the robot stops for people, and goes on from where it stands.

    Then it rests. The summary counts legs as tasks. Raises InputError as `Legs`.
    """

    def __init__(
        self,
        legs: Sequence[Leg],
        people: Mapping[str, PersonMover],
        objects: Mapping[str, Drifting] | None = None,
        *,
        faults: Faults | None = None,
    ) -> None:
        self.legs = Legs(legs)
        super().__init__(self.legs.current.replanner, [], people, objects, faults=faults)

    def ticks(self, seconds: float) -> Generator[dict[str, Any], None, None]:
        """Run for a time [s] or until all legs are driven, and yield ticks as `Simulation.ticks`."""
        with closing(super().ticks(seconds)) as ticks:
            for tick in ticks:
                yield tick
                if self.legs.finished:
                    return

    def _go_on(self, now: float, q: FloatArray) -> None:
        self.legs.go_on(now)
        self.summary.tasks = self.legs.done
        leg = self.legs.current
        if leg.replanner is self.replanner:
            return
        self.replanner = leg.replanner
        if self.monitor is not None:
            contacts, self.monitor = self.monitor.contacts, ContactMonitor(leg.robot)
            self.monitor.contacts = contacts
