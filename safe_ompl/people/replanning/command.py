"""Commands of a robot that replans: a motion of one tick and its stop; and how a replanner or a shield works."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, number, positive
from safe_ompl.people.replanning.guarded_path import GuardedPath, MotionMargin, PathLimits, StopMotion
from safe_ompl.trajectories import State


class Doing(str, Enum):
    """What the robot does, in one word."""

    MOVING = "moving"
    SLOWED = "slowed"
    BRAKING = "braking"
    STANDING = "standing"
    RETREATING = "retreating"
    DONE = "done"


@dataclass(frozen=True)
class Command:
    """A motion of one tick and the stop after it, both proven against what was measured.

    A controller follows `at`. If no other command comes, it follows this one to its end, and stands.
    """

    time: float  # From when on it holds [s]
    measured: float  # When that was measured against which it is proven [s]
    path: GuardedPath  # That it follows
    motion: StopMotion
    doing: Doing
    # The smallest margin along the motion; where that is the rest of an earlier stop, or the robot stands, of the
    # motion that could not be proven.
    left: MotionMargin
    reason: str = ""  # Why the robot is not as fast as it could be
    rule: str = ""  # Which rule keeps people from making it faster: ``separation``, ``contact`` or ``clamping``

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

    def until_rest(self, time: float, step: float) -> tuple[FloatArray, list[State]]:
        """Return times (K,) from `time` on, `step` apart, the last one when the robot stands; and what holds then [s].

        There is one if it stands already.
        """
        steps = np.arange(time, self.standstill - 1e-6, step)
        states = [*(self.at(each) for each in steps.tolist()), self.at(np.inf)]
        return np.append(steps, max(time, self.standstill)), states

    def tick_at(self, time: float, step: float) -> dict[str, Any]:
        """Return what a tick (`safe_ompl.io.ticks`) says of the robot at a time [s]; the rest is in steps [s]."""
        times, states = self.until_rest(max(time, self.time), step)
        return {
            "time": time,
            "q": states[0].q.tolist(),
            "qd": states[0].qd.tolist(),
            "stop": stop_as_dict(times, states),
            "state": self.doing.value,
            "margin": self.left.margin,
            "reason": self.reason,
            "rule": self.rule or None,
            "measured": self.measured,
        }


def stop_as_dict(times: FloatArray, states: Sequence[State]) -> dict[str, Any]:
    """Return the rest of a command (K instants [s], and what holds then), as a tick has it."""
    return {
        "times": times.tolist(),
        "q": [state.q.tolist() for state in states],
        "qd": [state.qd.tolist() for state in states],
    }


@dataclass(frozen=True)
class ReplanningOptions:
    """How a `Replanner` or a `Shield` works; raises InputError if a number is out of its range."""

    tick: float = 0.05  # Time between two commands [s]
    lost_after: float = 0.5  # A person or object that is not seen for so long is lost: the robot stops [s]
    # Of joints, tool and links, for a `Shield`; default: those of the robot's joints. A `Replanner` keeps the limits
    # of its trajectories.
    limits: PathLimits | None = None
    # Whether `Replanner.think` searches detours, and motions away from people who are near a robot that stands. A robot
    # that retreats may be touched by who runs after it, as one that stands.
    detours: bool = True
    retreats: bool = True

    def __post_init__(self) -> None:
        positive(self.tick, "tick", "number of seconds")
        number("lost_after", self.lost_after, above=0.0)
