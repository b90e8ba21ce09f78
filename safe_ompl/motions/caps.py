"""Caps of the speed along a motion, proven over whole cells: what people allow, and speeds of tool and links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import RATE_BOUNDS, FloatArray, InputError, SafeOmplError, number
from safe_ompl.danger import KinetostaticField
from safe_ompl.motions.cells import Cells
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.trajectory import SpeedCap
from safe_ompl.scene import People

# The names of caps.
TOOL_SPEED, LINK_SPEED = "tool speed", "link speed"
# Share of the accelerations that blends may take beside people; the rest is for braking.
BENDING = 0.5


@dataclass(frozen=True)
class MotionCaps:
    """What bounds the speed of trajectories besides the limits of the joints; see `PathTimer`."""

    people: People | None = None
    tool_speed: float | None = None
    link_speed: float | None = None
    danger: KinetostaticField | None = None
    max_danger: float | None = None

    def __post_init__(self) -> None:
        if (self.danger is None) != (self.max_danger is None):
            raise InputError(
                "give a danger and the largest that it may reach, or neither",
                "danger" if self.danger is None else "max_danger",
            )
        for key, name in (("tool_speed", TOOL_SPEED), ("link_speed", LINK_SPEED)):
            if (value := getattr(self, key)) is not None:
                object.__setattr__(self, key, number(name, value, kind="number of m/s", **RATE_BOUNDS["speed"]))
        if self.max_danger is not None:
            object.__setattr__(self, "max_danger", number("max_danger", self.max_danger, above=0.0))


@dataclass(frozen=True)
class Standstill:
    """Where the robot may not move at any speed: arc length [rad], configuration (n,), and what forbids it."""

    arc_length: float
    configuration: FloatArray
    reason: str
    person: str | None = None
    limb: str | None = None
    link: str | None = None


class StandstillError(SafeOmplError):
    """No speed along a path is allowed somewhere; `standstill` says where and why.

    Examples
    --------
    >>> robot, anna = Robot.from_example("ur5"), Obstacle("anna", Person(), Pose([0.75, 0.0, -0.75]))
    >>> prover = MotionProver(CollisionChecker(robot, Scene([anna])))
    >>> path = [[0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0]]
    >>> time_path(path, robot, RateLimits.of(robot, acceleration=8.0), motion=prover, people=People(speed=1.6))
    Traceback (most recent call last):
    safe_ompl.motions.caps.StandstillError: nothing allows the robot to move at 0.401 rad of its path: 'anna' ...
    """

    def __init__(self, standstill: Standstill) -> None:
        super().__init__(
            f"nothing allows the robot to move at {standstill.arc_length:.3f} rad of its path: {standstill.reason}"
        )
        self.standstill = standstill

    def __reduce__(self) -> tuple[type[StandstillError], tuple[Standstill]]:
        return type(self), (self.standstill,)


def bending_cap(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ (N,) with which blends take half of the accelerations; the rest is left for braking."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.sqrt((BENDING * limits.acceleration / cells.d2q_ds2).min(axis=1)))


def braking(cells: Cells, limits: RateLimits, speeds: FloatArray) -> FloatArray:
    """Return the deceleration along the path (N,) [rad/s²] that the accelerations leave at ṡ of `speeds: (N,)`."""
    rest = limits.acceleration - cells.d2q_ds2 * (speeds * speeds)[:, None]
    dq_ds = cells.dq_ds
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(dq_ds > 0, rest / dq_ds, np.inf).min(axis=1))


def speed_caps(speeds: FloatArray, tool_speed: float | None, link_speed: float | None) -> tuple[SpeedCap, ...]:
    """Return the caps that keep the tip, and all points of all bodies, below speeds [m/s]; `speeds` of `BodySpeeds`."""
    caps = []
    for name, limit, bound in ((TOOL_SPEED, tool_speed, speeds[:, -1]), (LINK_SPEED, link_speed, speeds.max(axis=1))):
        if limit is not None:
            with np.errstate(divide="ignore"):
                caps.append(SpeedCap(name, np.where(bound > 0, limit / bound, np.inf), limit))
    return tuple(caps)
