"""What every way of the replanner keeps to: velocities and accelerations of joints, and speeds of tool and links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.trajectories.caps import LINK_SPEED, TOOL_SPEED
from safe_ompl.trajectories.limits import RateLimits
from safe_ompl.trajectories.trajectory import SpeedCap, Trajectory

# Caps of trajectories that the replanner has itself, from moment to moment.
_LIVE = ("joint velocity", "separation", "separation or contact", "bends beside people")


@dataclass(frozen=True)
class DriveLimits:
    """Limits that hold on every curve, with what is known of the curve alone.

    Attributes
    ----------
    joints : RateLimits
        Velocities and accelerations.
    tool_speed, link_speed : float, optional
        Of the tip, and of every point of every link [m/s].
    """

    joints: RateLimits
    tool_speed: float | None = None
    link_speed: float | None = None

    @classmethod
    def of(cls, trajectory: Trajectory) -> DriveLimits:
        """Return those of a trajectory."""
        speeds = {cap.name: cap.limit for cap in trajectory.caps}
        return cls(trajectory.limits, speeds.get(TOOL_SPEED), speeds.get(LINK_SPEED))

    def same_as(self, other: DriveLimits) -> bool:
        """Return whether the other ones are the same."""
        return (
            np.array_equal(self.joints.velocity, other.joints.velocity)
            and np.array_equal(self.joints.acceleration, other.joints.acceleration)
            and (self.tool_speed, self.link_speed) == (other.tool_speed, other.link_speed)
        )


def own_caps(trajectory: Trajectory) -> tuple[SpeedCap, ...]:
    """Return the caps of a trajectory that hold on its curve only, such as of danger: nothing proves them elsewhere."""
    return tuple(cap for cap in trajectory.caps if cap.name not in _LIVE and cap.limit is None)
