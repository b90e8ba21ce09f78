"""Motion validity with proof: the certified check as OMPL's motion validator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from ompl import base as ob

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import FLOOR, CertifiedMotion
from safe_ompl.collision.separation import TOUCHING_ONLY, Separation
from safe_ompl.collision.tool_limits import ToolLimit
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.plugins.states import StateBridge
from safe_ompl.plugins.user_checks import BorrowedCheck, UserCheck


class CertifiedMotionValidator(ob.MotionValidator):  # type: ignore[misc]
    """Accepts straight motions that are proven free, not sampled (`safe_ompl.collision.motion.CertifiedMotion`).

    Any OMPL planner that asks `si.checkMotion` plans certified paths with it.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    checker : CollisionChecker
        Robot and scene.
    floor : float
        [m] An edge with less clearance than about this stays undecided, and counts as blocked.
    """

    def __init__(self, si: Any, checker: CollisionChecker, floor: float = FLOOR) -> None:
        super().__init__(si)
        self._motion = CertifiedMotion(checker, floor)
        self._space = si.getStateSpace()  # keeping `si` itself would be a cycle that is never freed
        self._bridge = StateBridge(self._space)
        self._danger: DangerLimit | None = None
        self._tool: tuple[ToolLimit, ...] = ()
        self._checks: tuple[UserCheck, ...] = ()

    def __repr__(self) -> str:
        return f"CertifiedMotionValidator({self.motion!r})"

    def adds_nothing(self, other: Any) -> bool:
        """Return whether another validator is this one, or proves nothing that this one does not prove."""
        if other is self:
            return True
        if type(other) is not CertifiedMotionValidator:
            return False
        ours, theirs = self.motion, other.motion
        same = theirs.checker is ours.checker and theirs.separation in (ours.separation, TOUCHING_ONLY)
        return same and not theirs.limits

    @property
    def motion(self) -> CertifiedMotion:
        """What proves motions now; the setters put another one in its place."""
        return self._motion

    def setDangerLimit(self, limit: DangerLimit | None) -> None:
        """Accept only motions whose danger is proven to keep to a limit; None: whatever it is."""
        self._danger = limit
        self._take_limits()

    def setToolLimits(self, limits: Sequence[ToolLimit]) -> None:
        """Accept only motions whose tool is proven to keep to limits, such as an angle."""
        self._tool = tuple(limits)
        self._take_limits()

    def setUserChecks(self, checks: Sequence[UserCheck]) -> None:
        """Accept only motions that checks of the user's own accept, too; they are asked about what is proven free.

        They are not kept alive: `CollisionFreeValidity.setUserChecks` does that.
        """
        self._checks = tuple(BorrowedCheck(check) for check in checks)
        self._take_limits()

    def _take_limits(self) -> None:
        danger = () if self._danger is None else (self._danger,)
        self._motion = self._motion.with_limits((*self._checks, *self._tool, *danger))

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Accept only motions that are proven to keep a distance; arguments and errors of `MinClearance.of`.

        The state validity checker has a setter of the same name: it should know, too.
        """
        self._motion = self._motion.with_min_clearance(distance, obstacles, exempt)

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Accept only motions that are free whatever obstacles do; see `CertifiedMotion.with_moving_obstacles`."""
        self._motion = self._motion.with_moving_obstacles(speeds, time)

    def setChecker(self, checker: CollisionChecker, separation: Separation) -> None:
        """Prove motions with another checker of the same robot from here on, and what is kept from its obstacles."""
        self._motion = self._motion.with_checker(checker, separation)

    def setSeparation(self, separation: Separation) -> None:
        """Accept only motions that are proven to keep a separation, instead of what was set before."""
        self._motion = self._motion.with_separation(separation)

    def getSeparation(self) -> Separation:
        """Return what motions must keep from obstacles."""
        return self._motion.separation

    def checkMotion(self, start: Any, end: Any) -> bool:
        """Return whether the straight motion between two states is within limits and proven free."""
        if not (self._space.satisfiesBounds(start) and self._space.satisfiesBounds(end)):
            return False
        q_start, q_end = self._bridge.read(start), self._bridge.read(end)
        if not isfinite(q_start.dot(q_end)):  # OMPL's bounds let NaN pass
            return False
        return self._motion.is_free(q_start, q_end)
