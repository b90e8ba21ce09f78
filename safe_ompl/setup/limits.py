"""Limits that every path must keep to: danger, clearance, obstacles that move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import FLOOR, Verdict
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.errors import InputError
from safe_ompl.planners.base import non_negative
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.setup.wiring import WiredSetup


class LimitedSetup(WiredSetup):
    """The part of `SafeSetup` that sets limits of paths; parameters as there."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        danger: Mapping[str, Any] | None = {},
        floor: float = FLOOR,
    ) -> None:
        super().__init__(robot, scene, danger=danger, floor=floor)
        self._danger_limit: DangerLimit | None = None

    def _check_given(self) -> None:
        """Raise an error if the start or all goals that were given are not allowed any more; see `SafeProblem`."""

    def setMaxDanger(self, limit: float) -> None:
        """Set the danger that no configuration of a path may exceed, whoever plans it, proven along whole motions.

        Parameters
        ----------
        limit : float
            In the units of the danger field; 0: any danger.

        Raises
        ------
        InputError
            If it is negative or not finite, or there is no danger field.
        CollisionError
            If start or all goals are above it. Then the limit stays what it was.
        """
        if self.field is None:
            raise InputError("max danger needs a danger field; this setup plans without danger")
        before = self._danger_limit
        self._keep_to(DangerLimit(self.field, limit) if non_negative("max danger", limit) else None)
        try:
            self._check_given()
        except BaseException:
            self._keep_to(before)
            raise

    def _keep_to(self, limit: DangerLimit | None) -> None:
        self._danger_limit = limit
        self._validity.setDangerLimit(limit)
        self._validator.setDangerLimit(limit)

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Set the distance that every path must keep from obstacles, whoever plans it, proven along whole motions.

        Parameters
        ----------
        distance, obstacles, exempt
            As in `CollisionChecker.setMinClearance`.

        Raises
        ------
        CollisionError
            If start or all goals are nearer. Then the distance stays what it was.
        InputError
            As there.
        """
        before = self.checker.getMinClearance()
        self.checker.setMinClearance(distance, obstacles, exempt)
        try:
            self._check_given()
        except BaseException:
            self.checker.require(before)
            raise

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Have only motions that are free whatever obstacles do, no faster than their speeds, within a time.

        Parameters
        ----------
        speeds, time
            As in `CertifiedMotion.setMovingObstacles`.

        Raises
        ------
        CollisionError
            If an obstacle may come to the start or to all goals. Then all stays what it was.
        InputError
            As there.
        """
        before = self._validator.motion.getMovingObstacles()
        self._validator.setMovingObstacles(speeds, time)
        try:
            self._check_given()
        except BaseException:
            self._validator.setMovingObstacles(*before)
            raise

    def _objection(self, q: FloatArray) -> str | None:
        """Return why `q: (n,)`, within limits, can be no start or goal: words to follow its name; None if it can."""
        pair = self.checker.colliding_pair(q)
        if pair is not None:
            return f" is in collision: {pair[0]!r} touches {pair[1]!r}"
        if self.checker.too_near(q):
            near = self.checker.pair_within_margins(q) or ("robot", "obstacle")
            least = f"{1e3 * self.checker.required.max():g} mm"
            return f" is too near: {near[0]!r} keeps less than {least} from {near[1]!r}"
        if self._danger_limit is not None and not self._danger_limit.allows(q):
            limit = self._danger_limit
            return f": danger {limit.danger(q):.4g} is above the limit {limit.limit:g}"
        speeds, time = self._validator.motion.getMovingObstacles()
        if speeds:
            still = copy(self._validator.motion)
            still.limits = ()
            verdict = still.check(q, q)
            if verdict.verdict is not Verdict.FREE:
                link, obstacle = verdict.pair or ("robot", "obstacle")
                moved = 1e3 * time * speeds.get(obstacle, 0.0)
                return f" is too near: {obstacle!r} may move {moved:g} mm, and come to {link!r}"
        if self._sampled is not None and not self._sampled.allows(q):
            return f" is refused by your state validity checker {self._sampled.name}"
        return None
