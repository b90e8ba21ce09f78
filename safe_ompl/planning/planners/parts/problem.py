"""The planning problem on arrays: valid configurations, free motions, their danger, and the goals."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, isfinite
from typing import Any

import numpy as np

from safe_ompl.collision import CertifiedMotion, PairSet
from safe_ompl.common import FloatArray
from safe_ompl.danger import DangerLimit
from safe_ompl.planning.ompl import CertifiedMotionValidator, ScratchState, StateBridge, StateCost

_FIRST_GOALS = 100  # taken before planning begins


class PlanningProblem:
    """A space with its validity checker, motion validator and cost, asked with arrays instead of OMPL's states.

    Attributes
    ----------
    bridge : StateBridge
        The space, of real vectors and SO(2) parts.
    cost : StateCost
        Cost of configurations: the danger.
    limit : DangerLimit or None
        What a planner requires on top of the validity checker.
    """

    def __init__(self, si: Any) -> None:
        self.bridge = StateBridge(si.getStateSpace())
        self._si = si
        self._from, self._to = ScratchState(self.bridge), ScratchState(self.bridge)
        self._clearances = ClearanceCache()
        self.take(None, None)

    def take(self, objective: Any, limit: DangerLimit | None) -> None:
        """Take another objective, or None, and another limit."""
        self.cost = StateCost(objective, self.bridge)
        self.limit = limit
        self._slope: float | None = None

    @property
    def slope(self) -> float:
        """The median of ‖∇cost‖ over valid configurations; measured when it is first asked for."""
        if self._slope is None:
            self._slope = self.cost.slope(self._si)
        return self._slope

    def is_valid(self, q: FloatArray) -> bool:
        """Return whether `q: (n,)` is valid, and no more dangerous than the limit."""
        if not self._si.isValid(self._from.set(q)):
            return False
        return self.limit is None or self.limit.allows(q)

    def motion_is_free(self, start: FloatArray, end: FloatArray, margin: float = 0.0) -> bool:
        """Return whether the motion between two configurations (n,) is free, and keeps to the limit.

        With a margin [m], also whether it keeps that distance from obstacles, where a `CertifiedMotion` can prove it.
        A `CertifiedMotion` is asked directly: the detour by OMPL's states would cost a sixth of a check.
        """
        motion = self._certified
        if motion is not None:
            within = self.bridge.holds(start) and self.bridge.holds(end)
            free = within and motion.is_free(start, end, margin)
        else:
            free = self._si.checkMotion(self._from.set(start), self._to.set(end))
        return free and (self.limit is None or self.limit.allows_motion(start, end))

    def keeps(self, q: FloatArray, margin: float) -> bool:
        """Return whether the robot is proven to keep a margin [m] from obstacles at `q: (n,)`."""
        motion = self._certified
        return motion is not None and self._clearances.keeps(motion, q, margin)

    @property
    def _certified(self) -> CertifiedMotion | None:
        """What proves motions; None where the problem's motion validator is another one."""
        validator = self._si.getMotionValidator()
        return validator.motion if type(validator) is CertifiedMotionValidator else None

    def random_configuration(self, rng: np.random.Generator) -> FloatArray:
        """Return a uniform random configuration (n,)."""
        return self.bridge.between_bounds(rng.random(self.bridge.n))

    def state(self, q: FloatArray) -> Any:
        """Return an `ob.State` at `q: (n,)`, which holds until the next question."""
        return self._from.set(q)


class ClearanceCache:
    """Lower bounds of the clearance from obstacles, computed once for each configuration.

    The first margin that is asked for should be the largest: bounds are only as tight as that margin needs them.
    """

    def __init__(self) -> None:
        # Pairs, their revision, and how good bounds are [m].
        self._source: tuple[PairSet, int, float] | None = None
        self._bounds: dict[bytes, float] = {}

    def keeps(self, motion: CertifiedMotion, q: FloatArray, margin: float) -> bool:
        """Return whether the robot is proven to keep a margin [m] from obstacles at `q: (n,)`."""
        bound = self._bound(motion.checker.pairs, q, margin)
        return bound >= margin if isfinite(bound) else motion.is_free(q, q, margin)

    def _bound(self, pairs: PairSet, q: FloatArray, enough: float) -> float:
        known = self._source
        if known is None or known[:2] != (pairs, pairs.revision) or known[2] < enough:
            self._source, self._bounds = (pairs, pairs.revision, enough), {}
        key = q.tobytes()
        if key not in self._bounds:
            bounds = pairs.bounds.of(q[None], np.flatnonzero(pairs.meets_obstacle), enough)
            self._bounds[key] = float(bounds.min(initial=inf))
        return self._bounds[key]


def first_goals(inputs: Any, goal: Any, ptc: Any) -> Iterator[Any]:
    """Yield the goal states that a problem offers before planning: all there are, up to a hundred.

    Where there is none yet, this waits for the first until `ptc` fires. Each state is valid until the next one.
    """
    if not goal.maxSampleCount():
        yield inputs.nextGoal(ptc)
    for _ in range(_FIRST_GOALS):
        if ptc() or not inputs.haveMoreGoalStates():
            return
        yield inputs.nextGoal()


def later_goals(inputs: Any, nodes: int) -> Iterator[Any]:
    """Yield another goal state, or none; this never waits.

    Goals that are taken while planning stay fewer than half of the nodes, as in OMPL: a region may have goals without
    end.
    """
    if 2 * inputs.getSampledGoalsCount() < nodes:
        yield inputs.nextGoal()
