"""Legs of a program: one replanner for each stretch, which takes over where the one before rests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from safe_ompl.common import InputError
from safe_ompl.people.replanning.replanner import Replanner
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.trajectories import Trajectory


@dataclass(frozen=True)
class Leg:
    """What is driven without a change of robot or scene; then the robot rests for a pause [s].

    Without a trajectory it only rests, and the replanner is the one of the leg before. A leg that must stay on its
    curve has a replanner without detours and retreats.
    """

    replanner: Replanner
    trajectory: Trajectory | None
    robot: Robot  # with what it holds
    scene: Scene  # the obstacles, and which links may touch them
    step: int = 0  # of the program
    pause: float = 0.0


class Legs:
    """Legs in their order, each driven once; raises InputError if there is none, or a trajectory is not free."""

    def __init__(self, legs: Sequence[Leg]) -> None:
        if not legs or legs[0].trajectory is None:
            raise InputError("there is nothing to drive", "legs")
        self.legs, self.done = tuple(legs), 0
        self._rests_since: float | None = None
        for leg in self.legs:
            if leg.trajectory is not None:
                leg.replanner.start(leg.trajectory)

    @property
    def current(self) -> Leg:
        """The leg that is driven now, or was last."""
        return self.legs[min(self.done, len(self.legs) - 1)]

    @property
    def finished(self) -> bool:
        """Whether all are done."""
        return self.done == len(self.legs)

    def go_on(self, now: float) -> None:
        """Begin the next leg, if the robot, which stands at the end of this one, has rested as long as it must."""
        leg = self.current
        self._rests_since = now if self._rests_since is None else self._rests_since
        if self.finished or now < self._rests_since + leg.pause:
            return
        self.done += 1
        self._rests_since = None
        if self.current.replanner is not leg.replanner:
            self.current.replanner.surroundings.take_over(leg.replanner.surroundings)
