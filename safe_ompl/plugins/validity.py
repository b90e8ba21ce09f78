"""State validity on coal: limits, NaN, collision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ompl import base as ob

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.separation import TOUCHING_ONLY, Separation
from safe_ompl.collision.tool_limits import ToolLimit
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.plugins.states import StateBridge
from safe_ompl.plugins.user_checks import SampledValidity, UserCheck
from safe_ompl.robot.joint_limits import JointLimits


class CollisionFreeValidity(ob.StateValidityChecker):  # type: ignore[misc]
    """Accepts states within the joint limits whose robot touches neither an obstacle nor itself.

    States nearer to an obstacle than `setMinClearance` allows are refused, too, and so are states more dangerous than
    `setDangerLimit` allows, those whose tool is where `setToolLimits` does not allow it, and those that a checker of
    the user's own refuses (`setUserChecks`). The limits of the joints are the robot's, however wide the space.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    checker : CollisionChecker
        Robot and scene.
    """

    def __init__(self, si: Any, checker: CollisionChecker) -> None:
        super().__init__(si)
        self.checker = checker
        self._separation = TOUCHING_ONLY
        self._limit: DangerLimit | None = None
        self._tool: tuple[ToolLimit, ...] = ()
        self._user: SampledValidity | None = None
        self._checks: tuple[UserCheck, ...] = ()
        self._joint_limits = JointLimits(checker.robot)
        self.setSeparation(TOUCHING_ONLY)
        self._space = si.getStateSpace()
        self._bridge = StateBridge(self._space)

    def setDangerLimit(self, limit: DangerLimit | None) -> None:
        """Accept only states whose danger keeps to a limit; None: whatever it is."""
        self._limit = limit

    def setToolLimits(self, limits: Sequence[ToolLimit]) -> None:
        """Accept only states whose tool keeps to limits, such as an angle."""
        self._tool = tuple(limits)

    def __repr__(self) -> str:
        return f"CollisionFreeValidity({self.checker!r})"

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Accept only states that keep a distance; arguments and errors of `MinClearance.of`."""
        self.setSeparation(self._separation.with_min_clearance(self.checker, distance, obstacles, exempt))

    def setChecker(self, checker: CollisionChecker, separation: Separation) -> None:
        """Ask another checker of the same robot from here on, about what must be kept from its obstacles."""
        self._required = separation.required(checker)
        self._separation, self.checker = separation, checker

    def setSeparation(self, separation: Separation) -> None:
        """Accept only states that keep a separation, instead of what was set before."""
        self._required = separation.required(self.checker)
        self._separation = separation

    def getSeparation(self) -> Separation:
        """Return what states must keep from obstacles."""
        return self._separation

    @property
    def settings(self) -> tuple[Any, ...] | None:
        """What decides which states are valid: checker and revision, distances, limits; None if the user's own does."""
        if self._user is not None:
            return None
        limit = None if self._limit is None else self._limit.limit
        return self.checker, self.checker.revision, self._separation, limit, self._tool

    def adds_nothing(self, other: Any) -> bool:
        """Return whether another checker is this one, or asks for nothing that this one does not ask for."""
        if other is self:
            return True
        if type(other) is not CollisionFreeValidity or other.checker is not self.checker:
            return False
        unlimited = other._limit is None and not other._tool and other._separation == TOUCHING_ONLY
        return unlimited and other._user is None

    def setUserChecks(self, checks: Sequence[UserCheck]) -> None:
        """Accept only states that a checker of the user's own among these accepts, too; and keep all of them alive."""
        self._checks = tuple(checks)
        self._user = next((check for check in checks if isinstance(check, SampledValidity)), None)

    def isValid(self, state: Any) -> bool:
        """Return whether `state` is within limits, finite, and free of collision."""
        if not self._space.satisfiesBounds(state):
            return False
        q = self._bridge.view(state)
        # OMPL's bounds let NaN pass, and a space may be wider than the robot's limits.
        if not self._joint_limits.hold(q) or self.checker.touches(q) or self._required.violated(q):
            return False
        if self._tool and not all(limit.allows(q) for limit in self._tool):
            return False
        if self._limit is not None and not self._limit.allows(q):
            return False
        return self._user is None or self._user.accepts(state)

    def clearance(self, state: Any) -> float:
        """Return the distance [m] between the robot and the nearest obstacle."""
        return self.checker.clearance(self._bridge.read(state)).distance
