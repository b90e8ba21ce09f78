"""People as they stand now, and what was seen of an edge beside them."""

from __future__ import annotations

from dataclasses import dataclass

from safe_ompl.live.guarded_path import GuardedPath
from safe_ompl.people.reach import ReachSets

_STALE = 0.3  # [s] looks at edges that people slow down are this old at most


@dataclass(frozen=True)
class Look:
    """What was seen of an edge beside people.

    Attributes
    ----------
    time : float
        How long it takes [s]; inf: barred.
    until : float
        Until when it needs no other look [s]: no sooner can anyone be so near that it takes longer.
    """

    time: float
    until: float


@dataclass(frozen=True)
class Around:
    """People as they stand now, for looks at edges.

    Attributes
    ----------
    sets : ReachSets
        Where they are.
    clearance : float
        What must be left [m].
    reaction : float
        From a measurement until the robot begins to brake at the latest [s].
    """

    sets: ReachSets
    clearance: float
    reaction: float

    def look(self, path: GuardedPath, now: float) -> Look:
        """Return how long a path takes, and until when that holds."""
        times, left = path.pace(self.sets, self.clearance, self.reaction)
        return Look(float(times.sum()), now + max(_STALE, left))
