"""State validity on coal: limits, NaN, collision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ompl import base as ob

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.separation import TOUCHING_ONLY, Separation
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.plugins.states import StateBridge


class CollisionFreeValidity(ob.StateValidityChecker):  # type: ignore[misc]
    """Accepts states within the joint limits whose robot touches neither an obstacle nor itself.

    States nearer to an obstacle than `setMinClearance` allows are refused, too, and so are states more dangerous than
    `setDangerLimit` allows.

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
        self._limit: DangerLimit | None = None
        self.setSeparation(TOUCHING_ONLY)
        self._space = si.getStateSpace()
        self._bridge = StateBridge(self._space)

    def setDangerLimit(self, limit: DangerLimit | None) -> None:
        """Accept only states whose danger keeps to a limit; None: whatever it is."""
        self._limit = limit

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Accept only states that keep a distance; arguments and errors of `MinClearance.of`."""
        self.setSeparation(self._separation.with_min_clearance(self.checker, distance, obstacles, exempt))

    def setSeparation(self, separation: Separation) -> None:
        """Accept only states that keep a separation, instead of what was set before."""
        self._required = separation.required(self.checker)
        self._separation = separation

    def getSeparation(self) -> Separation:
        """Return what states must keep from obstacles."""
        return self._separation

    @property
    def settings(self) -> tuple[CollisionChecker, Separation, float | None]:
        """What decides which states are valid: checker, distances to keep, limit of danger; hashable."""
        limit = None if self._limit is None else self._limit.limit
        return self.checker, self._separation, limit

    def isValid(self, state: Any) -> bool:
        """Return whether `state` is within limits, finite, and free of collision."""
        if not self._space.satisfiesBounds(state):
            return False
        q = self._bridge.view(state)
        square = q.dot(q)
        # OMPL's bounds let NaN pass: every comparison with it is false.
        if square != square or self.checker.touches(q) or self._required.violated(q):
            return False
        return self._limit is None or self._limit.allows(q)

    def clearance(self, state: Any) -> float:
        """Return the distance [m] between the robot and the nearest obstacle."""
        return self.checker.clearance(self._bridge.read(state)).distance
