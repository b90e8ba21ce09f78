"""What the robot is to do from one tick on: a proven motion until the next one, and the stop on its path after it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from safe_ompl.live.drive import Drive, Left
from safe_ompl.live.guarded_path import GuardedPath
from safe_ompl.trajectories.trajectory import State


class Doing(str, Enum):
    """What the robot does, in one word."""

    MOVING = "moving"
    SLOWED = "slowed"
    BRAKING = "braking"
    STANDING = "standing"
    DONE = "done"


@dataclass(frozen=True)
class Command:
    """A motion of one tick, and the stop after it; both are proven against what was measured.

    A controller follows `at`. If no other command comes it follows this one to its end, and stands.

    Attributes
    ----------
    time : float
        From when on it holds [s].
    measured : float
        When that was measured against which it is proven [s].
    path : GuardedPath
        What it moves along.
    motion : Drive
        The motion and the stop.
    doing : Doing
        What it is.
    left : Left
        The least that is left along it, where all of it is proven; what forbids more, where that is not so.
    reason : str
        Why the robot is not as fast as it could be; empty if it is.
    """

    time: float
    measured: float
    path: GuardedPath
    motion: Drive
    doing: Doing
    left: Left
    reason: str = ""

    @property
    def standstill(self) -> float:
        """When the robot stands at the latest [s]."""
        return self.time + self.motion.duration

    def at(self, time: float) -> State:
        """Return joint values, velocities and accelerations (n,) at a time [s] from `time` on."""
        s, speed, push = self.motion.at(time - self.time)
        place = self.path.curve.at(np.array([s]))
        slope, bend = place.slope[0], place.bend[0]
        return State(place.q[0], slope * speed, slope * push + bend * speed * speed)

    def moves(self, time: float) -> bool:
        """Return whether the robot moves at a time [s]."""
        return self.motion.at(time - self.time)[1] > 0
