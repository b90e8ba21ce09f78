"""Joint limits of a trajectory: velocities, accelerations and, optionally, jerks."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import RATE_BOUNDS, FloatArray, InputError, UnknownNameError, finite_array, number, warn_once
from safe_ompl.robot import Robot

_log = logging.getLogger(__name__)

LimitByJoint: TypeAlias = float | Mapping[str, float] | ArrayLike
RATE_TOLERANCE = (1e-6, 1e-6, 1e-6, 1e-3)
"""Tolerances of positions, velocities, accelerations and jerks [rad or m, s], because files and solvers round.

Values may exceed their limits, and jump where they must be continuous, by this much. Slower motion counts as rest.
"""
# Without a known acceleration limit, a joint is assumed to reach its velocity limit in this time.
_DEFAULT_RISE_TIME = 0.25  # [s]
# A velocity limit in a URDF from this value on means that there is no limit.
_UNLIMITED_VELOCITY = 1e3  # [rad/s or m/s]


@dataclass(frozen=True)
class RateLimits:
    """Largest velocity, acceleration and (optionally) jerk of each joint.

    Parameters
    ----------
    joint_names : tuple of str
        The n joints.
    velocity : ndarray, shape (n,)
        [rad/s or m/s], > 0
    acceleration : ndarray, shape (n,)
        [rad/s² or m/s²], > 0
    jerk : ndarray, shape (n,), optional
        [rad/s³ or m/s³], > 0; None: not limited.

    Raises
    ------
    InputError
        If a limit is missing or implausible, such as a negative one or a velocity of 1000 rad/s. The error names the
        joint.

    Examples
    --------
    >>> limits = RateLimits.of(Robot.from_example("ur5"), acceleration=8.0)
    >>> limits.acceleration
    array([8., 8., 8., 8., 8., 8.])
    """

    joint_names: tuple[str, ...]
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """The limited quantities: "velocity", "acceleration", and "jerk" if it is limited."""
        return ("velocity", "acceleration") if self.jerk is None else ("velocity", "acceleration", "jerk")

    def __post_init__(self) -> None:
        for kind in self.kinds:
            values = finite_array(getattr(self, kind), (len(self.joint_names),), f"{kind} limits")
            for name, value in zip(self.joint_names, values.tolist(), strict=True):
                number(f"{kind} limit of joint {name!r}", value, **RATE_BOUNDS[kind])
            values.setflags(write=False)
            object.__setattr__(self, kind, values)

    @classmethod
    def of(
        cls,
        robot: Robot,
        velocity: LimitByJoint | None = None,
        acceleration: LimitByJoint | None = None,
        jerk: LimitByJoint | None = None,
    ) -> RateLimits:
        """Return the limits of a robot. Each limit is a number for all joints, a mapping for some joints, or (n,).

        Parameters
        ----------
        robot : Robot
            The robot.
        velocity, acceleration, jerk : float, mapping of str to float, or array_like of shape (n,), optional
            Default velocity: the URDF's. Default acceleration: the robot's own (`Robot.with_accelerations`, or its
            entry in a scenario); without one, the acceleration that reaches the velocity limit in 0.25 s, with a
            warning, because URDFs have no acceleration limits. Default jerk: that of the robot's `joint_limits`;
            without one the jerk is not limited. If the jerk is limited, it must be limited for all joints.

        Raises
        ------
        InputError
            If the URDF has no velocity for a joint and none is given, or as the class.
        UnknownNameError
            If there is no such joint.
        """
        names, model = robot.joint_names, robot.shared.model
        planned = [model.joints[model.getJointId(name)].idx_v for name in names]
        in_urdf: FloatArray = np.array(model.velocityLimit, dtype=np.float64).ravel()[planned]
        velocities = _chosen(names, velocity, in_urdf, "velocity")
        for name, value, known in zip(names, velocities.tolist(), in_urdf, strict=True):
            if value == known and not 0 < value < _UNLIMITED_VELOCITY:
                raise InputError(
                    f"joint {name!r} has no velocity limit in its URDF ({value:g}); give one, as "
                    f"velocity={{{name!r}: 2.0}} [rad/s or m/s]"
                )
        default, given = velocities / _DEFAULT_RISE_TIME, robot.accelerations
        accelerations = _chosen(names, given, default, "acceleration")
        if isinstance(acceleration, Mapping):
            given = {**given, **acceleration}
        accelerations = _chosen(names, acceleration, accelerations, "acceleration")
        not_given = [k for k, name in enumerate(names) if name not in given]
        if not_given and (acceleration is None or isinstance(acceleration, Mapping)):
            joints = "its joints" if len(not_given) == robot.n else ", ".join(names[k] for k in not_given)
            span = " to ".join(dict.fromkeys(f"{pick(default[not_given]):g}" for pick in (np.min, np.max)))
            warn_once(
                _log,
                f"{robot.name}: no acceleration limits are given for {joints}: those that reach the velocity limit in "
                f"{_DEFAULT_RISE_TIME:g} s are assumed ({span}); give accelerations",
            )
        if jerk is None and robot.jerks:
            # A time law limits the jerk of all joints or of none, so the other joints get the largest jerk that is
            # accepted.
            jerk = {name: robot.jerks.get(name, RATE_BOUNDS["jerk"]["at_most"]) for name in names}
        if isinstance(jerk, Mapping) and (missing := [name for name in names if name not in jerk]):
            raise InputError(f"joint {missing[0]!r} has no jerk limit; give those of all joints, or none")
        jerks = None if jerk is None else _chosen(names, jerk, np.ones(robot.n), "jerk")
        return cls(names, velocities, accelerations, jerks)

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return velocity, acceleration and, if limited, jerk by joint."""
        return {kind: dict(zip(self.joint_names, getattr(self, kind).tolist(), strict=True)) for kind in self.kinds}


def _chosen(names: tuple[str, ...], given: LimitByJoint | None, default: FloatArray, kind: str) -> FloatArray:
    if given is None:
        return default
    if isinstance(given, Mapping):
        chosen = default.copy()
        for name, value in given.items():
            if name not in names:
                raise UnknownNameError("joint", name, names, f"{kind} limits")
            chosen[names.index(name)] = number(f"{kind} limit of joint {name!r}", value, **RATE_BOUNDS[kind])
        return chosen
    if np.ndim(given) == 0:
        return np.full(len(names), number(f"{kind} limit", given, **RATE_BOUNDS[kind]))
    return finite_array(given, (len(names),), f"{kind} limits")
