"""Validity of states and motions: what OMPL asks.

Both plug-ins read the same `Constraints`, and motions are proven.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from ompl import base as ob

from safe_ompl.collision import FLOOR, TOUCHING_ONLY, CollisionChecker, MotionProver
from safe_ompl.paths import ConfigurationCheck, Constraints
from safe_ompl.planning.ompl.states import StateBridge


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
        self._motion = MotionProver(checker or self.checker, self._floor, separation=separation, limits=limits)
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
