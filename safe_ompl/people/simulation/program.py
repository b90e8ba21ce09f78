"""A robot that drives a program beside people: one replanner for each stretch, which takes over where it rests."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from safe_ompl.common import InputError
from safe_ompl.people.replanning import Replanner
from safe_ompl.people.simulation.movers import Drifting, PersonMover
from safe_ompl.people.simulation.simulation import ContactMonitor, Faults, Simulation
from safe_ompl.trajectories import Trajectory


@dataclass(frozen=True)
class Leg:
    """What is driven without a change of robot or scene, by a replanner of its own, after a pause [s]."""

    replanner: Replanner
    trajectory: Trajectory
    step: int = 0  # of the program
    pause: float = 0.0


class ProgramSimulation(Simulation):
    """Drives legs one after the other, each once; the robot stops for people, and goes on from where it stands.

    Then it rests, and `finished` is true. The summary counts legs as tasks. A leg that must stay on its way has a
    replanner without detours and retreats. Raises InputError if there is no leg.
    """

    def __init__(
        self,
        legs: Sequence[Leg],
        people: Mapping[str, PersonMover],
        objects: Mapping[str, Drifting] | None = None,
        *,
        faults: Faults | None = None,
    ) -> None:
        if not legs:
            raise InputError("there is nothing to drive", "legs")
        super().__init__(legs[0].replanner, [legs[0].trajectory], people, objects, faults=faults)
        self.legs, self.finished = tuple(legs), False
        self._rests_since: float | None = None

    @property
    def leg(self) -> Leg:
        """The leg that is driven now."""
        return self.legs[min(self.summary.tasks, len(self.legs) - 1)]

    def ticks(self, seconds: float) -> Generator[dict[str, Any], None, None]:
        """Run for a time [s] or until all legs are driven, and yield ticks as `Simulation.ticks`."""
        with closing(super().ticks(seconds)) as ticks:
            for tick in ticks:
                yield tick
                if self.finished:
                    return

    def _go_on(self, now: float) -> None:
        if self.finished:
            return
        self._rests_since = now if self._rests_since is None else self._rests_since
        later = self.legs[self.summary.tasks + 1 :]
        if later and now < self._rests_since + later[0].pause:
            return
        self.summary.tasks += 1
        self.finished, self._rests_since = not later, None
        if self.finished:
            return
        leg = self.leg
        self.replanner = leg.replanner
        if self.monitor is not None:
            contacts, self.monitor = self.monitor.contacts, ContactMonitor(leg.replanner.robot)
            self.monitor.contacts = contacts
        leg.replanner.start(leg.trajectory)
        self._measure(now)
