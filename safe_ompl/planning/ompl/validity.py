"""Validity of states and motions: constraints, the check of configurations, and what OMPL asks.

Both plug-ins read the same `Constraints`, and motions are proven.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, TypeVar

from ompl import base as ob

from safe_ompl.collision import (
    FLOOR,
    TOUCHING_ONLY,
    CollisionChecker,
    MotionLimit,
    MotionProver,
    Separation,
    ToolLimit,
)
from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerLimit
from safe_ompl.planning.ompl.states import StateBridge
from safe_ompl.planning.ompl.user_checks import BorrowedCheck, SampledValidity, UserCheck
from safe_ompl.robot import JointLimits

Pairs = Sequence[tuple[str, str]]
Limit = TypeVar("Limit", bound=ToolLimit)


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
        """All but the separation, in the order in which `MotionProver` proves or asks."""
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
        """Return the same among obstacles that move; arguments as `MotionProver.with_moving_obstacles`."""
        return replace(self, separation=replace(self.separation, speeds=speeds, time=time))

    def with_tube(self, widths: tuple[float, ...]) -> Constraints:
        """Return the same within a tube: how far each of the n joints may be from where it should be [rad or m]."""
        return replace(self, separation=replace(self.separation, tube=widths))

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


def danger_objection(limit: DangerLimit, q: FloatArray) -> str | None:
    """Return why `q: (n,)` is too dangerous, in words that follow the name of a configuration; None if it is not."""
    return None if limit.allows(q) else f": danger {limit.danger(q):.4g} is above the limit {limit.limit:g}"


class ConfigurationCheck:
    """Says of single configurations whether constraints allow them: quickly, or in words.

    An UnknownNameError if the scene has no obstacle of a name in the constraints.
    """

    def __init__(self, checker: CollisionChecker, constraints: Constraints) -> None:
        self.checker, self.constraints = checker, constraints
        self._joint_limits = JointLimits(checker.robot)
        self._required = constraints.separation.required(checker)
        self._tool, self._danger = constraints.tool, constraints.danger
        self._sampled = constraints.user_checker

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
        separation, limit = self.constraints.separation, self._danger
        beyond = self.checker.robot.beyond_limits(q)
        if beyond is not None:
            return f": {beyond}"
        pair = self.checker.colliding_pair(q)
        if pair is not None:
            return f" is in collision: {pair[0]!r} touches {pair[1]!r}"
        at_rest = self._required
        if separation.speeds:
            at_rest = replace(separation, speeds={}, time=0.0).required(self.checker)
        near = at_rest.violating_pair(q)
        if near is not None:
            least = f"{1e3 * at_rest.at_start.max():g} mm"
            return f" is too near: {near[0]!r} keeps less than {least} from {near[1]!r}"
        if limit is not None and (dangerous := danger_objection(limit, q)):
            return dangerous
        near = self._required.violating_pair(q) if separation.speeds else None
        if near is not None:
            moved = 1e3 * separation.time * separation.speeds.get(near[1], 0.0)
            return f" is too near: {near[1]!r} may move {moved:g} mm, and come to {near[0]!r}"
        if self._sampled is not None and not self._sampled.allows(q):
            return f" is refused by your state validity checker {self._sampled.name}"
        return next((f": {tool.objection(q)}" for tool in self._tool if not tool.allows(q)), None)


class CollisionFreeValidity(ob.StateValidityChecker):  # type: ignore[misc]
    """Accepts states within the joint limits whose robot touches neither an obstacle nor itself.

    States that the constraints do not allow are refused, too. The coordinates of the space must be the robot's joints
    (see `joint_space`), but their limits are the robot's, however wide the space. An UnknownNameError if the scene has
    no obstacle of a name in the constraints.
    """

    def __init__(self, si: Any, checker: CollisionChecker, constraints: Constraints | None = None) -> None:
        super().__init__(si)
        self._check = ConfigurationCheck(checker, constraints or Constraints())
        self._space = si.getStateSpace()
        self.bridge = StateBridge(self._space)

    def __repr__(self) -> str:
        return f"CollisionFreeValidity({self.checker!r})"

    @property
    def checker(self) -> CollisionChecker:
        """Robot and scene."""
        return self._check.checker

    @property
    def check(self) -> ConfigurationCheck:
        """The check of configurations (n,) that states undergo."""
        return self._check

    def getConstraints(self) -> Constraints:
        """Return what states must keep to besides joint limits and collision."""
        return self._check.constraints

    def setConstraints(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Set what states must keep to; with a checker also another scene of the same robot; errors as the class."""
        self._check = ConfigurationCheck(checker or self.checker, constraints)

    @property
    def settings(self) -> tuple[Any, ...] | None:
        """What decides which states are valid: checker, revision and constraints; None if the user's checker does."""
        checker, constraints = self.checker, self.getConstraints()
        if constraints.user_checker is not None:
            return None
        limit = None if constraints.danger is None else constraints.danger.limit
        return checker, checker.revision, constraints.separation, limit, constraints.tool

    def adds_nothing(self, other: Any) -> bool:
        """Return whether another checker is this one, or asks for nothing that this one does not ask for."""
        if other is self:
            return True
        if type(other) is not CollisionFreeValidity or other.checker is not self.checker:
            return False
        return bool(other.getConstraints() == Constraints())

    def isValid(self, state: Any) -> bool:
        """Return whether `state` is within limits, finite, free of collision, and allowed by the constraints."""
        # OMPL's bounds let NaN pass, and a space may be wider than the robot's limits.
        if not self._space.satisfiesBounds(state):
            return False
        return self._check.allows(self.bridge.view(state), state)

    def clearance(self, state: Any) -> float:
        """Return the distance [m] between the robot and the nearest obstacle."""
        return self.checker.clearance(self.bridge.read(state)).distance


class CertifiedMotionValidator(ob.MotionValidator):  # type: ignore[misc]
    """Accepts straight motions that are proven free, not sampled (`safe_ompl.collision.MotionProver`).

    Any OMPL planner that asks `si.checkMotion` plans certified paths with it. The coordinates of the space must be the
    robot's joints (see `joint_space`). An edge with less clearance than about the `floor` [m] stays undecided, and
    counts as blocked. The state validity checker should have the same constraints. The user's checks among them are
    asked about what is proven free. They are not kept alive: `CollisionFreeValidity` does that. A `bridge` of the same
    space may be shared.
    """

    def __init__(
        self,
        si: Any,
        checker: CollisionChecker,
        floor: float = FLOOR,
        constraints: Constraints | None = None,
        *,
        bridge: StateBridge | None = None,
    ) -> None:
        super().__init__(si)
        self._floor = floor
        self._space = si.getStateSpace()  # keeping `si` itself would be a cycle that is never freed
        self._bridge = bridge or StateBridge(self._space)
        self.setConstraints(constraints or Constraints(), checker)

    def __repr__(self) -> str:
        return f"CertifiedMotionValidator({self.motion!r})"

    @property
    def checker(self) -> CollisionChecker:
        """Robot and scene."""
        return self._motion.checker

    @property
    def motion(self) -> MotionProver:
        """What proves motions now; `setConstraints` puts another one in its place."""
        return self._motion

    def getConstraints(self) -> Constraints:
        """Return what motions must keep to besides joint limits and collision."""
        return self._constraints

    def setConstraints(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Set what motions must keep to; with a checker also another scene of the same robot; errors as the class."""
        borrowed = constraints.borrowed()
        separation, limits = borrowed.separation, borrowed.limits
        self._motion = MotionProver(
            checker or self.checker, self._floor, separation=separation, limits=limits
        )
        self._constraints = borrowed

    def adds_nothing(self, other: Any) -> bool:
        """Return whether another validator is this one, or proves nothing that this one does not prove."""
        if other is self:
            return True
        if type(other) is not CertifiedMotionValidator:
            return False
        ours, theirs = self.motion, other.motion
        same = theirs.checker is ours.checker and theirs.separation in (ours.separation, TOUCHING_ONLY)
        return same and not theirs.limits

    def checkMotion(self, start: Any, end: Any) -> bool:
        """Return whether the straight motion between two states is within limits and proven free."""
        if not (self._space.satisfiesBounds(start) and self._space.satisfiesBounds(end)):
            return False
        q_start, q_end = self._bridge.read(start), self._bridge.read(end)
        if not isfinite(q_start.dot(q_end)):  # OMPL's bounds let NaN pass
            return False
        return self._motion.is_free(q_start, q_end)
