"""State validity on coal: joint limits, NaN, collision, and what constraints ask for."""

from __future__ import annotations

from typing import Any

from ompl import base as ob

from safe_ompl.collision import CollisionChecker
from safe_ompl.planning.ompl.constraints import ConfigurationCheck, Constraints, with_former_setters
from safe_ompl.planning.ompl.states import StateBridge


@with_former_setters
class CollisionFreeValidity(ob.StateValidityChecker):  # type: ignore[misc]
    """Accepts states within the joint limits whose robot touches neither an obstacle nor itself.

    States that the constraints do not allow are refused, too. The limits of the joints are the robot's, however wide
    the space.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    checker : CollisionChecker
        Robot and scene.
    constraints : Constraints
        What else states must keep to.

    Raises
    ------
    UnknownNameError
        If the scene has no obstacle of a name in the constraints.
    """

    def __init__(self, si: Any, checker: CollisionChecker, constraints: Constraints | None = None) -> None:
        super().__init__(si)
        self._check = ConfigurationCheck(checker, constraints or Constraints())
        self._space = si.getStateSpace()
        self._bridge = StateBridge(self._space)

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
        return self._check.allows(self._bridge.view(state), state)

    def clearance(self, state: Any) -> float:
        """Return the distance [m] between the robot and the nearest obstacle."""
        return self.checker.clearance(self._bridge.read(state)).distance
