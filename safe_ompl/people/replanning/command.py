"""What the robot does from one tick on: a proven motion until the next tick, and the stop on its path after it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.trajectories import State

if TYPE_CHECKING:
    from safe_ompl.people.replanning.guarded_path import GuardedPath


class Doing(str, Enum):
    """What the robot does, in one word."""

    MOVING = "moving"
    SLOWED = "slowed"
    BRAKING = "braking"
    STANDING = "standing"
    DONE = "done"


class Margin(NamedTuple):
    """The smallest margin between a motion of the robot and what moves around it.

    Attributes
    ----------
    margin : float
        Lower bound of distance − growth − required clearance [m]; +inf if nobody is there.
    link : str or None
        The link of the robot that is nearest.
    who : (str, str) or None
        The person or object that is nearest, and its limb.
    """

    margin: float
    link: str | None = None
    who: tuple[str, str] | None = None

    @property
    def description(self) -> str:
        """Who may come to which link, and how much is missing."""
        if self.link is None or self.who is None:
            return "not everybody was seen yet"
        who, limb = self.who
        named = f"{limb} of {who!r}" if limb else repr(who)
        return f"{named} may come to {self.link} before it stands ({1e3 * self.margin:.0f} mm)"


class StopMotion(NamedTuple):
    """A motion of one tick along a path, and the stop after it: W pieces of constant acceleration.

    Attributes
    ----------
    cells : ndarray of int, shape (W,)
        The cell of the path in which each piece lies.
    places, squares, times : ndarray, shape (W + 1,)
        s, ṡ², and the time since the motion began [s], where pieces meet.
    """

    cells: IntArray
    places: FloatArray
    squares: FloatArray
    times: FloatArray

    @property
    def duration(self) -> float:
        """How long it takes until the robot stands [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> tuple[float, float, float]:
        """Return s, ṡ and s̈ at a time since it began [s]; at rest after its end."""
        if time >= self.duration:
            return float(self.places[-1]), 0.0, 0.0
        k = max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)
        span, since = self.times[k + 1] - self.times[k], max(time, 0.0) - self.times[k]
        speed, after = np.sqrt(self.squares[k]), np.sqrt(self.squares[k + 1])
        push = (after - speed) / span if span > 0 else 0.0
        place = self.places[k] + since * (speed + 0.5 * since * push)
        return float(min(place, self.places[k + 1])), float(max(speed + since * push, 0.0)), float(push)


@dataclass(frozen=True)
class Command:
    """A motion of one tick and the stop after it, both proven against what was measured.

    A controller follows `at`. If no other command comes, it follows this one to its end, and stands.

    Attributes
    ----------
    time : float
        From when on it holds [s].
    measured : float
        When that was measured against which it is proven [s].
    path : GuardedPath
        The path that it follows.
    motion : StopMotion
        The motion and the stop.
    doing : Doing
        What the robot does.
    left : Margin
        The smallest margin along the motion. Where that is the rest of an earlier stop, or the robot stands: the margin
        of the motion that could not be proven.
    reason : str
        Why the robot is not as fast as it could be; empty if it is.
    """

    time: float
    measured: float
    path: GuardedPath
    motion: StopMotion
    doing: Doing
    left: Margin
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
