"""Validity of states and motions, by the same `Constraints`: what OMPL asks; and the user's own checker."""

from __future__ import annotations

from math import ceil, isfinite
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.collision import CollisionChecker, MotionProver, MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, number
from safe_ompl.motions import ConfigurationCheck, Constraints, UserCheck
from safe_ompl.robot import ScratchState, StateBridge


class CollisionFreeValidity(ob.StateValidityChecker):  # type: ignore[misc]
    """Accepts states within the joint limits and the constraints, whose robot touches neither an obstacle nor itself.

    The coordinates of the space must be the robot's joints (`joint_space`), but their limits are the robot's, however
    wide the space. `check` is the check of configurations (n,) that states undergo. An UnknownNameError if the scene
    has no obstacle of a name in the constraints.

    Examples
    --------
    >>> from ompl import geometric as og
    >>> from safe_ompl.robot import joint_space
    >>> robot = Robot.from_example("ur5")
    >>> plain = og.SimpleSetup(joint_space(robot))
    >>> checker = CollisionFreeValidity(plain.getSpaceInformation(), CollisionChecker(robot, Scene()))
    >>> plain.setStateValidityChecker(checker)
    """

    def __init__(self, si: Any, checker: CollisionChecker, constraints: Constraints | None = None) -> None:
        super().__init__(si)
        self.check = ConfigurationCheck(checker, constraints or Constraints())
        self._space = si.getStateSpace()
        self.bridge = StateBridge(self._space)

    @property
    def checker(self) -> CollisionChecker:
        """Robot and scene."""
        return self.check.checker

    def getConstraints(self) -> Constraints:
        """Return what states must keep to besides joint limits and collision."""
        return self.check.constraints

    def setConstraints(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Set what states must keep to; with a checker also another scene of the same robot; errors as the class."""
        self.check = ConfigurationCheck(checker or self.checker, constraints)

    @property
    def settings(self) -> tuple[Any, ...] | None:
        """What decides which states are valid: checker, revision and constraints; None if the user's checker does."""
        checker, constraints = self.checker, self.getConstraints()
        if constraints.user is not None:
            return None
        limit = None if constraints.danger is None else constraints.danger.limit
        return checker, checker.revision, constraints.separation, limit, constraints.tool

    def isValid(self, state: Any) -> bool:
        """Return whether `state` is within limits, finite, free of collision, and allowed by the constraints."""
        # OMPL's bounds let NaN pass, and a space may be wider than the robot's limits.
        if not self._space.satisfiesBounds(state):
            return False
        return self.check.allows(self.bridge.view(state), state)

    def clearance(self, state: Any) -> float:
        """Return the distance [m] between the robot and the nearest obstacle."""
        return self.checker.clearance(self.bridge.read(state)).distance


def bridge_of(si: Any) -> StateBridge:
    """Return the bridge of a space information's space: that of its validity checker, while the bounds are the same."""
    validity = si.getStateValidityChecker()
    known = validity.bridge if isinstance(validity, CollisionFreeValidity) else None
    return known if known is not None and known.is_current else StateBridge(si.getStateSpace())


class CertifiedMotionValidator(ob.MotionValidator):  # type: ignore[misc]
    """Accepts straight motions that are proven free, not sampled (`safe_ompl.collision.MotionProver`).

    Any OMPL planner that asks `si.checkMotion` plans certified paths with it. The coordinates of the space must be the
    robot's joints (see `joint_space`). An edge with less clearance than about `safe_ompl.collision.FLOOR` stays
    undecided, and counts as blocked. The state validity checker should have the same constraints: the user's checker
    among them is asked about what is proven free, and kept alive by `CollisionFreeValidity` only. `motion` is what
    proves motions; `setConstraints` puts another one in its place.

    Examples
    --------
    >>> from ompl import geometric as og
    >>> from safe_ompl.robot import joint_space
    >>> robot = Robot.from_example("ur5")
    >>> plain = og.SimpleSetup(joint_space(robot))
    >>> si, checker = plain.getSpaceInformation(), CollisionChecker(robot, Scene())
    >>> si.setMotionValidator(CertifiedMotionValidator(si, checker))
    """

    def __init__(self, si: Any, checker: CollisionChecker, constraints: Constraints | None = None) -> None:
        super().__init__(si)
        # Keeping `si` itself would be a reference cycle through OMPL, which is never freed.
        self._space = si.getStateSpace()
        self._bridge = bridge_of(si)
        self.setConstraints(constraints or Constraints(), checker)

    @property
    def checker(self) -> CollisionChecker:
        """Robot and scene."""
        return self.motion.checker

    def getConstraints(self) -> Constraints:
        """Return what motions must keep to besides joint limits and collision."""
        return self._constraints

    def setConstraints(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Set what motions must keep to; with a checker also another scene of the same robot; errors as the class."""
        borrowed = constraints.borrowed()
        separation, limits = borrowed.separation, borrowed.limits
        self.motion = MotionProver(checker or self.checker, separation=separation, limits=limits)
        self._constraints = borrowed

    def checkMotion(self, start: Any, end: Any) -> bool:
        """Return whether the straight motion between two states is within limits and proven free."""
        if not (self._space.satisfiesBounds(start) and self._space.satisfiesBounds(end)):
            return False
        q_start, q_end = self._bridge.read(start), self._bridge.read(end)
        # OMPL's bounds accept NaN, so it is refused here.
        if not isfinite(q_start.dot(q_end)):
            return False
        return self.motion.is_free(q_start, q_end)


# Distance between two samples of a motion.
RESOLUTION = 0.01  # [rad]
_STEP_ROUNDING = 1e-9
# A witness names this beside the user's checker.
_REFUSES = "its own answer"


class SampledValidity(UserCheck):
    """A state validity checker of the user's, or a function of a state; what it raises arrives unchanged."""

    def __init__(self, checker: Any, bridge: StateBridge, resolution: float = RESOLUTION) -> None:
        if not (isinstance(checker, ob.StateValidityChecker) or callable(checker)):
            raise InputError(
                "the state validity checker must be an ob.StateValidityChecker or a function of a state, got "
                f"{checker!r}"
            )
        self._asks = checker.isValid if isinstance(checker, ob.StateValidityChecker) else checker
        self.resolution: float = number("resolution", resolution, above=0.0, kind="distance in joint space [rad]")
        name = getattr(checker, "__qualname__", None) or type(checker).__qualname__
        self.name = str(name).rsplit("<locals>.", 1)[-1]
        self._bridge, self._scratch = bridge, ScratchState(bridge)

    def allows(self, q: FloatArray, state: Any = None) -> bool:
        """Return what the checker says of a configuration (n,); raise InputError for anything but a bool."""
        answer = self._asks(self._scratch.set(q) if state is None else state)
        if not isinstance(answer, (bool, np.bool_)):
            raise InputError(f"the state validity checker {self.name} must return a bool, got {answer!r}")
        return bool(answer)

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Ask at even steps of the straight motion between `start` and `end: (n,)`; says where it is refused."""
        delta = self._bridge.difference(start, end)
        count = max(1, ceil(float(np.linalg.norm(delta)) / self.resolution - _STEP_ROUNDING))
        for k in range(count + 1):
            if not self.allows(start + k / count * delta):
                return MotionVerdict(Verdict.BLOCKED, k / count, (self.name, _REFUSES))
        return MotionVerdict(Verdict.FREE)
