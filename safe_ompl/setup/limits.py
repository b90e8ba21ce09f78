"""Limits that every path must keep to: danger, clearance, obstacles that move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.min_clearance import MinClearance
from safe_ompl.collision.separation import Separation
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.errors import InputError
from safe_ompl.inputs import number
from safe_ompl.setup.obstacles import SceneSetup


class LimitedSetup(SceneSetup):
    """The part of `SafeSetup` that sets limits of paths; parameters as there."""

    _danger_limit: DangerLimit | None = None
    _kept_from_the_dangerous: tuple[float, Sequence[tuple[str, str]]] | None = None  # distance, exempt

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
        self._keep_to(DangerLimit(self.field, limit) if number("max danger", limit, at_least=0) else None)
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
            As in `MinClearance.of`.

        Raises
        ------
        CollisionError
            If start or all goals are nearer. Then the distance stays what it was.
        InputError
            As there.
        """
        before = self._validator.getSeparation()
        self._keep_apart(before.with_min_clearance(self.checker, distance, obstacles, exempt))
        self._kept_from_the_dangerous = (distance, exempt) if obstacles is None else None

    def _separation_in(self, checker: CollisionChecker) -> Separation:
        """Return what must be kept in another scene: from those that are dangerous there, if no others are named."""
        separation = self._validator.getSeparation()
        if self._kept_from_the_dangerous is not None:
            distance, exempt = self._kept_from_the_dangerous
            dangerous = [obstacle.name for obstacle in checker.scene if obstacle.weight > 0]
            still = [pair for pair in exempt if pair[1] in dangerous]
            separation = separation.with_min_clearance(
                checker, distance if dangerous else 0.0, dangerous, still
            )
        separation.required(checker)
        return separation

    def getMinClearance(self) -> MinClearance | None:
        """Return the distance that every path must keep from obstacles; None where none is required."""
        return self._validator.getSeparation().min_clearance

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Have only motions that are free whatever obstacles do, no faster than their speeds, within a time.

        Parameters
        ----------
        speeds, time
            As in `CertifiedMotion.with_moving_obstacles`.

        Raises
        ------
        CollisionError
            If an obstacle may come to the start or to all goals. Then all stays what it was.
        InputError
            As there.
        """
        self._keep_apart(replace(self._validator.getSeparation(), speeds=speeds, time=time))

    def getMovingObstacles(self) -> tuple[dict[str, float], float]:
        """Return the speeds by obstacle [m/s] and the time [s] of `setMovingObstacles`; no speeds: all stand still."""
        separation = self._validator.getSeparation()
        return dict(separation.speeds), separation.time

    def _keep_apart(self, separation: Separation) -> None:
        """Have paths keep a separation, if start and goals that were given do; else all stays what it was."""
        before = self._validator.getSeparation()
        self._require(separation)
        try:
            self._check_given()
        except BaseException:
            self._require(before)
            raise

    def _require(self, separation: Separation) -> None:
        self._validator.setSeparation(separation)
        self._validity.setSeparation(separation)

    def _objection(self, q: FloatArray) -> str | None:
        """Return why `q: (n,)`, within limits, can be no start or goal: words to follow its name; None if it can."""
        pair = self.checker.colliding_pair(q)
        if pair is not None:
            return f" is in collision: {pair[0]!r} touches {pair[1]!r}"
        separation = self._validator.getSeparation()
        still = replace(separation, speeds={}, time=0.0).required(self.checker)
        near = still.violating_pair(q)
        if near is not None:
            least = f"{1e3 * still.at_start.max():g} mm"
            return f" is too near: {near[0]!r} keeps less than {least} from {near[1]!r}"
        if self._danger_limit is not None and not self._danger_limit.allows(q):
            limit = self._danger_limit
            return f": danger {limit.danger(q):.4g} is above the limit {limit.limit:g}"
        near = separation.required(self.checker).violating_pair(q) if separation.speeds else None
        if near is not None:
            moved = 1e3 * separation.time * separation.speeds.get(near[1], 0.0)
            return f" is too near: {near[1]!r} may move {moved:g} mm, and come to {near[0]!r}"
        if self._sampled is not None and not self._sampled.allows(q):
            return f" is refused by your state validity checker {self._sampled.name}"
        return None
