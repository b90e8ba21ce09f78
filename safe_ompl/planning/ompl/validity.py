"""OMPL's state validity checker and motion validator for the same `Constraints`, and checkers of users."""

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
    """Accepts states within the joint limits and the constraints, in which the robot is free of collision.

    The coordinates of the space must be the robot's joints (`joint_space`). The robot's limits hold even if the bounds
    of the space are wider. `check` is the check of configurations (n,). Raises UnknownNameError if a constraint names
    an obstacle that the scene lacks.

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
        """The collision checker of the robot in the scene."""
        return self.check.checker

    def getConstraints(self) -> Constraints:
        """Return the constraints on states besides joint limits and collision."""
        return self.check.constraints

    def setConstraints(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Set the constraints, and optionally a checker of the same robot in another scene; errors as the class."""
        self.check = ConfigurationCheck(checker or self.checker, constraints)

    @property
    def settings(self) -> tuple[Any, ...] | None:
        """A key of everything that decides validity: checker, revision, constraints; None with a user's checker."""
        checker, constraints = self.checker, self.getConstraints()
        if constraints.user is not None:
            return None
        limit = None if constraints.danger is None else constraints.danger.limit
        return checker, checker.revision, constraints.separation, limit, constraints.tool

    def isValid(self, state: Any) -> bool:
        """Return whether `state` is finite, within limits, free of collision, and allowed by the constraints."""
        # OMPL's bounds accept NaN, and may be wider than the robot's limits, so `check` tests both again.
        if not self._space.satisfiesBounds(state):
            return False
        return self.check.allows(self.bridge.view(state), state)

    def clearance(self, state: Any) -> float:
        """Return the distance [m] between the robot and the nearest obstacle."""
        return self.checker.clearance(self.bridge.read(state)).distance


def bridge_of(si: Any) -> StateBridge:
    """Return a StateBridge for the space; the validity checker's own bridge if its bounds are still the same."""
    validity = si.getStateValidityChecker()
    known = validity.bridge if isinstance(validity, CollisionFreeValidity) else None
    return known if known is not None and known.is_current else StateBridge(si.getStateSpace())


class CertifiedMotionValidator(ob.MotionValidator):  # type: ignore[misc]
    """Accepts straight motions that are proven free, not sampled (`safe_ompl.collision.MotionProver`).

    With it, any OMPL planner that calls `si.checkMotion` plans certified paths. The coordinates of the space must be
    the robot's joints (see `joint_space`). An edge with less clearance than about `safe_ompl.collision.FLOOR` remains
    undecided and counts as blocked. The state validity checker should have the same constraints. A user's checker among
    them tests edges that are proven free; only `CollisionFreeValidity` keeps it alive. `motion` is the prover of
    motions, which `setConstraints` replaces.

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
        """The collision checker of the robot in the scene."""
        return self.motion.checker

    def getConstraints(self) -> Constraints:
        """Return the constraints on motions besides joint limits and collision."""
        return self._constraints

    def setConstraints(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Set the constraints, and optionally a checker of the same robot in another scene; errors as the class."""
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
# The second name of the pair in a verdict, after the name of the user's checker.
_REFUSES = "its own answer"


class SampledValidity(UserCheck):
    """A user's state validity checker, or function of a state; its exceptions arrive unchanged."""

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
        """Return whether the checker accepts a configuration (n,); raise InputError if it does not return a bool."""
        answer = self._asks(self._scratch.set(q) if state is None else state)
        if not isinstance(answer, (bool, np.bool_)):
            raise InputError(f"the state validity checker {self.name} must return a bool, got {answer!r}")
        return bool(answer)

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Call the checker at even steps from `start` to `end`, each (n,); return where it refuses the motion."""
        delta = self._bridge.difference(start, end)
        count = max(1, ceil(float(np.linalg.norm(delta)) / self.resolution - _STEP_ROUNDING))
        for k in range(count + 1):
            if not self.allows(start + k / count * delta):
                return MotionVerdict(Verdict.BLOCKED, k / count, (self.name, _REFUSES))
        return MotionVerdict(Verdict.FREE)
