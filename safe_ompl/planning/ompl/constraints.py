"""Constraints of configurations and motions beyond collision, the user's own checks among them."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any, TypeVar
from weakref import ref

import numpy as np
from ompl import base as ob

from safe_ompl.collision import (
    TOUCHING_ONLY,
    CollisionChecker,
    MotionLimit,
    MotionVerdict,
    Separation,
    ToolLimit,
    Verdict,
)
from safe_ompl.common import FloatArray, InputError, positive
from safe_ompl.danger import DangerLimit
from safe_ompl.planning.ompl.states import ScratchState, StateBridge
from safe_ompl.robot import JointLimits

Pairs = Sequence[tuple[str, str]]
Limit = TypeVar("Limit", bound=ToolLimit)

RESOLUTION = 0.01  # [rad] between two samples of a motion
_ROUNDING = 1e-9  # of a step
REFUSES = "its own answer"  # what a witness names beside the check


# ---------------------------------------------------------------------------------------------- the user's own checks


class UserCheck(ABC):
    """A check of motions that is the user's own: a `MotionLimit` for `CertifiedMotion.limits`.

    Attributes
    ----------
    name : str
        What it is called in reports.
    resolution : float or None
        Distance [rad or m] in joint space between the samples that it is asked about; None: it is asked about whole
        motions.
    """

    name: str
    resolution: float | None

    @abstractmethod
    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion between `start` and `end: (n,)`."""


class SampledValidity(UserCheck):
    """A state validity checker of the user's, asked at samples of motions, their ends included.

    Parameters
    ----------
    checker : ob.StateValidityChecker or callable
        Answers for a state; what it raises arrives unchanged.
    bridge : StateBridge
        Of the space of the states.
    resolution : float
        Largest distance [rad or m] in joint space between two samples.

    Raises
    ------
    InputError
        If it is neither, or the resolution is not positive.
    """

    def __init__(self, checker: Any, bridge: StateBridge, resolution: float = RESOLUTION) -> None:
        if not (isinstance(checker, ob.StateValidityChecker) or callable(checker)):
            raise InputError(
                "the state validity checker must be an ob.StateValidityChecker or a function of a state, got "
                f"{checker!r}"
            )
        self.checker = checker
        self.resolution: float = positive(resolution, "resolution", "distance in joint space [rad]")
        self.name = _name(checker)
        self._bridge = bridge
        self._scratch = ScratchState(bridge)

    def __repr__(self) -> str:
        return f"SampledValidity({self.name}, resolution={self.resolution:g})"

    def accepts(self, state: Any) -> bool:
        """Return what the checker says of an OMPL state.

        Raises
        ------
        InputError
            If it answers with anything but a bool: OMPL itself would refuse that.
        """
        asks = self.checker.isValid if isinstance(self.checker, ob.StateValidityChecker) else self.checker
        answer = asks(state)
        if not isinstance(answer, (bool, np.bool_)):
            raise InputError(f"the state validity checker {self.name} must return a bool, got {answer!r}")
        return bool(answer)

    def allows(self, q: FloatArray) -> bool:
        """Return what the checker says of a configuration (n,)."""
        return self.accepts(self._scratch.set(q))

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Ask at even steps of the straight motion between `start` and `end: (n,)`; says where it is refused."""
        delta = self._bridge.difference(start, end)
        count = max(1, ceil(float(np.linalg.norm(delta)) / self.resolution - _ROUNDING))
        for k in range(count + 1):
            if not self.allows(start + k / count * delta):
                return MotionVerdict(Verdict.BLOCKED, k / count, (self.name, REFUSES))
        return MotionVerdict(Verdict.FREE)


class AskedMotions(UserCheck):
    """A motion validator of the user's, asked about whole motions.

    Parameters
    ----------
    validator : ob.MotionValidator
        What it raises arrives unchanged.
    bridge : StateBridge
        Of the space of the states.
    """

    resolution = None

    def __init__(self, validator: Any, bridge: StateBridge) -> None:
        self.validator = validator
        self.name = _name(validator)
        self._from, self._to = ScratchState(bridge), ScratchState(bridge)

    def __repr__(self) -> str:
        return f"AskedMotions({self.name})"

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Ask about the straight motion between `start` and `end: (n,)`."""
        if self.validator.checkMotion(self._from.set(start), self._to.set(end)):
            return MotionVerdict(Verdict.FREE)
        return MotionVerdict(Verdict.BLOCKED, None, (self.name, REFUSES))


class BorrowedCheck(UserCheck):
    """A check that somebody else keeps alive: what a motion validator holds of the user's is never freed by OMPL.

    Parameters
    ----------
    check : UserCheck
        It must live as long as it is asked.
    """

    def __init__(self, check: UserCheck) -> None:
        self.name, self.resolution = check.name, check.resolution
        self._check = ref(check)

    def __repr__(self) -> str:
        return f"BorrowedCheck({self.name})"

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Check the straight motion between `start` and `end: (n,)`."""
        check = self._check()
        if check is None:
            raise ReferenceError(f"the check {self.name} is gone")
        return check.check(start, end)


def _name(check: Any) -> str:
    name = getattr(check, "__qualname__", None) or type(check).__qualname__
    return str(name).rsplit("<locals>.", 1)[-1]


# -------------------------------------------------------------------------------------------------------- constraints


@dataclass(frozen=True)
class Constraints:
    """What every configuration and every motion must keep to, besides joint limits and collision.

    State validity, motion validity and `SafeSetup` read the same constraints. Others are put in place with
    `setConstraints`, as ``setConstraints(dataclasses.replace(getConstraints(), danger=None))``.

    Attributes
    ----------
    separation : Separation
        The distances from obstacles, at rest or moving.
    danger : DangerLimit or None
        The largest danger.
    tool : tuple of ToolLimit
        Orientation and place of the tool.
    user : tuple of UserCheck
        The user's own state validity checker and motion validator, which nothing can be proven of.
    from_dangerous : (float, sequence of (str, str)) or None
        Distance [m] and exempt pairs of a minimum clearance that is kept from whatever is dangerous, in any scene.
    """

    separation: Separation = TOUCHING_ONLY
    danger: DangerLimit | None = None
    tool: tuple[ToolLimit, ...] = ()
    user: tuple[UserCheck, ...] = ()
    from_dangerous: tuple[float, Pairs] | None = None

    @property
    def limits(self) -> tuple[MotionLimit, ...]:
        """All but the separation, in the order in which `CertifiedMotion` proves or asks."""
        danger = () if self.danger is None else (self.danger,)
        return (*self.user, *self.tool, *danger)

    @property
    def user_checker(self) -> SampledValidity | None:
        """The user's own state validity checker, if there is one."""
        return next((check for check in self.user if isinstance(check, SampledValidity)), None)

    def tool_limit(self, kind: type[Limit]) -> Limit | None:
        """Return the limit of the tool that is of a kind, if there is one."""
        return next((limit for limit in self.tool if isinstance(limit, kind)), None)

    def with_min_clearance(
        self,
        checker: CollisionChecker,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Pairs = (),
    ) -> Constraints:
        """Return the same with another distance from chosen obstacles; arguments and errors of `MinClearance.of`."""
        separation = self.separation.with_min_clearance(checker, distance, obstacles, exempt)
        from_dangerous = (distance, tuple(exempt)) if obstacles is None else None
        return replace(self, separation=separation, from_dangerous=from_dangerous)

    def with_moving_obstacles(self, speeds: Mapping[str, float], time: float) -> Constraints:
        """Return the same among obstacles that move; arguments as `CertifiedMotion.with_moving_obstacles`."""
        return replace(self, separation=replace(self.separation, speeds=speeds, time=time))

    def in_scene_of(self, checker: CollisionChecker) -> Constraints:
        """Return the same in another scene, in which other obstacles may be dangerous."""
        if self.from_dangerous is None:
            return self
        distance, exempt = self.from_dangerous
        dangerous = [obstacle.name for obstacle in checker.scene if obstacle.weight > 0]
        still = [pair for pair in exempt if pair[1] in dangerous]
        separation = self.separation.with_min_clearance(
            checker, distance if dangerous else 0.0, dangerous, still
        )
        return replace(self, separation=separation)

    def borrowed(self) -> Constraints:
        """Return the same without keeping the user's checks alive, for what OMPL never frees."""
        borrowed = (c if isinstance(c, BorrowedCheck) else BorrowedCheck(c) for c in self.user)
        return replace(self, user=tuple(borrowed))


class ConfigurationCheck:
    """Says of single configurations whether constraints allow them: quickly, or in words.

    Parameters
    ----------
    checker : CollisionChecker
        Robot and scene.
    constraints : Constraints
        What else a configuration must keep to.

    Raises
    ------
    UnknownNameError
        If the scene has no obstacle of a name in the constraints.
    """

    def __init__(self, checker: CollisionChecker, constraints: Constraints) -> None:
        self.checker = checker
        self.constraints = constraints
        self._joint_limits = JointLimits(checker.robot)
        self._required = constraints.separation.required(checker)
        self._tool, self._danger = constraints.tool, constraints.danger
        self._sampled = constraints.user_checker

    def __repr__(self) -> str:
        return f"ConfigurationCheck({self.checker!r}, {self.constraints!r})"

    def within_limits(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is finite and within the joint limits of the robot."""
        return self._joint_limits.hold(q)

    def allows(self, q: FloatArray, state: Any = None) -> bool:
        """Return whether `q: (n,)` is finite, within the joint limits, and allowed.

        Where `state` is the same configuration as an OMPL state, the user's checker is asked about that.
        """
        if not self._joint_limits.hold(q) or self.checker.touches(q) or self._required.violated(q):
            return False
        if self._tool and not all(limit.allows(q) for limit in self._tool):
            return False
        if self._danger is not None and not self._danger.allows(q):
            return False
        if self._sampled is None:
            return True
        return self._sampled.allows(q) if state is None else self._sampled.accepts(state)

    def objection(self, q: FloatArray) -> str | None:
        """Return why `q: (n,)` is not allowed, in words that follow the name of a configuration; None where it is."""
        robot, separation, limit = self.checker.robot, self.constraints.separation, self._danger
        for i in np.flatnonzero(~robot.within_limits(q)):
            return (
                f": joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]"
            )
        pair = self.checker.colliding_pair(q)
        if pair is not None:
            return f" is in collision: {pair[0]!r} touches {pair[1]!r}"
        at_rest = replace(separation, speeds={}, time=0.0).required(self.checker)
        near = at_rest.violating_pair(q)
        if near is not None:
            least = f"{1e3 * at_rest.at_start.max():g} mm"
            return f" is too near: {near[0]!r} keeps less than {least} from {near[1]!r}"
        if limit is not None and not limit.allows(q):
            return f": danger {limit.danger(q):.4g} is above the limit {limit.limit:g}"
        near = self._required.violating_pair(q) if separation.speeds else None
        if near is not None:
            moved = 1e3 * separation.time * separation.speeds.get(near[1], 0.0)
            return f" is too near: {near[1]!r} may move {moved:g} mm, and come to {near[0]!r}"
        if self._sampled is not None and not self._sampled.allows(q):
            return f" is refused by your state validity checker {self._sampled.name}"
        return next((f": {tool.objection(q)}" for tool in self._tool if not tool.allows(q)), None)


# --------------------------------------------------------------------------- setters of before, for one version more

_SETTERS: dict[str, Callable[..., tuple[Constraints, CollisionChecker]]] = {
    "setMinClearance": lambda c, checker, *a, **k: (c.with_min_clearance(checker, *a, **k), checker),
    "setMovingObstacles": lambda c, checker, *a, **k: (c.with_moving_obstacles(*a, **k), checker),
    "setSeparation": lambda c, checker, separation: (replace(c, separation=separation), checker),
    "setDangerLimit": lambda c, checker, limit: (replace(c, danger=limit), checker),
    "setToolLimits": lambda c, checker, limits: (replace(c, tool=tuple(limits)), checker),
    "setUserChecks": lambda c, checker, checks: (replace(c, user=tuple(checks)), checker),
    "setChecker": lambda c, _, checker, separation: (replace(c, separation=separation), checker),
}


def with_former_setters(plugin: Any) -> Any:
    """Give a class that has `setConstraints` the setters that it had before, each of which warns."""

    def setter(name: str) -> Callable[..., None]:
        def call(self: Any, *args: Any, **kwargs: Any) -> None:
            warnings.warn(f"{name} will go: call setConstraints", DeprecationWarning, stacklevel=2)
            self.setConstraints(*_SETTERS[name](self.getConstraints(), self.checker, *args, **kwargs))

        call.__name__, call.__doc__ = name, "Deprecated: call `setConstraints`."
        return call

    for name in _SETTERS:
        setattr(plugin, name, setter(name))
    plugin.getSeparation = lambda self: self.getConstraints().separation
    return plugin
