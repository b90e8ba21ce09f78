"""Simulations of a robot that drives a program, and of one that knows of people only what depth cameras see."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import closing
from typing import Any

from safe_ompl.common import FloatArray
from safe_ompl.io import ticks_header
from safe_ompl.people import DepthFrame
from safe_ompl.people.replanning import Command, Leg, Legs, Replanner, Tour
from safe_ompl.people.simulation.movers import Drifting, PersonMover, Solid, World
from safe_ompl.people.simulation.simulation import ContactMonitor, Faults, Simulation
from safe_ompl.trajectories import Trajectory

# Renders what cameras of these names see of a robot at q (n,) and of solids: depths (H, W) [m].
Look = Callable[[FloatArray, list[Solid], Collection[str]], Mapping[str, FloatArray]]
_ROUNDING = 1e-6  # [s]


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


class SightedSimulation(Simulation):
    """A simulation in which the replanner takes images instead of key points and poses, at the rates of its cameras.

    It takes key points of people whom its surroundings track besides. Those of the `world` track all people and
    objects, to say whether they keep to the speed that is relied on. Of faults, images may be lost, and answers late.
    """

    def __init__(
        self,
        replanner: Replanner,
        trajectories: Sequence[Trajectory] | Tour,
        world: World,
        look: Look,
        *,
        faults: Faults | None = None,
    ) -> None:
        super().__init__(replanner, trajectories, {}, faults=faults)
        self.world, self._look, self._truth = world, look, world.surroundings

    def log_header(self) -> dict[str, Any]:
        """Return the header of a log of the ticks, with who and what is truly there, and what is assumed of them."""
        own = self.replanner.surroundings.description()["rules"]
        return ticks_header(
            self.replanner.tick, self.replanner.robot, self._truth.scene, {**self._truth.description(), "rules": own}
        )

    def _measure(self, now: float, command: Command | None) -> float:
        around, world, ways = self.replanner.surroundings, self.world, self.trajectories
        assert around.depth is not None
        people = {name: mover.at(now) for name, mover in world.people.items()}
        self._truth.update(people, {name: thing.at(now) for name, thing in world.objects.items()}, now)
        first = ways.places[0] if isinstance(ways, Tour) else ways[0].at(0.0).q
        q = first if command is None else command.at(now).q
        late = self._rng.random() < self.faults.drops
        before, after = now - self.replanner.tick + _ROUNDING, now + _ROUNDING
        due = [name for name, one in around.depth.cameras.items() if after * one.rate // 1 > before * one.rate // 1]
        names = [] if late else due  # cameras that have a new image since the last tick
        seen = self._look(q, world.solids(world.keypoints(now), now), names)
        begin = self.clock()
        frames = {name: DepthFrame(depths, now, q) for name, depths in seen.items()}
        tracked = {name: points for name, points in people.items() if name in around.people}
        violations = self.replanner.update(tracked, {}, now, frames)
        took = self.clock() - begin
        self._promise(now, self._truth, violations)
        return took
