"""Speed limits along a motion, proven over whole cells: for people, and for the speed of tool and links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import RATE_BOUNDS, FloatArray, InputError, SafeOmplError, number
from safe_ompl.danger import KinetostaticField
from safe_ompl.motions.cells import Cells
from safe_ompl.motions.limits import RateLimits
from safe_ompl.motions.trajectory import VelocityLimit
from safe_ompl.scene import People

# Names of velocity limits.
TOOL_SPEED, LINK_SPEED = "tool speed", "link speed"
# Share of the acceleration limits that blends may use beside people. The rest is left for braking.
BENDING = 0.5


@dataclass(frozen=True)
class TimingLimits:
    """Limits of a trajectory's speed, besides the joint limits; see `PathTimer`."""

    people: People | None = None
    tool_speed: float | None = None
    link_speed: float | None = None
    danger: KinetostaticField | None = None
    max_danger: float | None = None

    def __post_init__(self) -> None:
        if (self.danger is None) != (self.max_danger is None):
            raise InputError(
                "give both danger and max_danger, or neither", "danger" if self.danger is None else "max_danger"
            )
        for key, name in (("tool_speed", TOOL_SPEED), ("link_speed", LINK_SPEED)):
            if (value := getattr(self, key)) is not None:
                object.__setattr__(self, key, number(name, value, kind="number of m/s", **RATE_BOUNDS["speed"]))
        if self.max_danger is not None:
            object.__setattr__(self, "max_danger", number("max_danger", self.max_danger, above=0.0))


@dataclass(frozen=True)
class Standstill:
    """A point where no speed is allowed: arc length [rad], configuration (n,), and the reason."""

    arc_length: float
    configuration: FloatArray
    reason: str
    person: str | None = None
    limb: str | None = None
    link: str | None = None


class StandstillError(SafeOmplError):
    """Raised if no speed is allowed at some point of a path; `standstill` gives the point and the reason.

    Examples
    --------
    >>> robot, anna = Robot.from_example("ur5"), Obstacle("anna", Person(), Pose([0.75, 0.0, -0.75]))
    >>> prover = MotionProver(CollisionChecker(robot, Scene([anna])))
    >>> path = [[0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0]]
    >>> time_path(path, robot, RateLimits.of(robot, acceleration=8.0), motion=prover, people=People(speed=1.6))
    Traceback (most recent call last):
    safe_ompl.motions.velocity_limits.StandstillError: nothing allows the robot to move at 0.401 rad ...
    """

    def __init__(self, standstill: Standstill) -> None:
        super().__init__(
            f"nothing allows the robot to move at {standstill.arc_length:.3f} rad of its path: {standstill.reason}"
        )
        self.standstill = standstill

    def __reduce__(self) -> tuple[type[StandstillError], tuple[Standstill]]:
        return type(self), (self.standstill,)


def bending_velocity_limit(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ (N,) at which blends use half of the acceleration limits. The rest is left for braking."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.sqrt((BENDING * limits.acceleration / cells.d2q_ds2).min(axis=1)))


def braking(cells: Cells, limits: RateLimits, speeds: FloatArray) -> FloatArray:
    """Return the path deceleration (N,) [rad/s²] that the acceleration limits leave at ṡ = `speeds: (N,)`."""
    rest = limits.acceleration - cells.d2q_ds2 * (speeds * speeds)[:, None]
    dq_ds = cells.dq_ds
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(dq_ds > 0, rest / dq_ds, np.inf).min(axis=1))


def body_speed_limits(
    speeds: FloatArray, tool_speed: float | None, link_speed: float | None
) -> tuple[VelocityLimit, ...]:
    """Return the velocity limits for speed limits [m/s] of the tip and of all points of all bodies.

    `speeds` is computed by `BodySpeeds`.
    """
    found = []
    for name, limit, bound in ((TOOL_SPEED, tool_speed, speeds[:, -1]), (LINK_SPEED, link_speed, speeds.max(axis=1))):
        if limit is not None:
            with np.errstate(divide="ignore"):
                found.append(VelocityLimit(name, np.where(bound > 0, limit / bound, np.inf), limit))
    return tuple(found)
