"""The problem as planners see it: valid configurations, free motions and their danger, all on arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.planners.parts.room import Room
from safe_ompl.plugins.motion import CertifiedMotionValidator
from safe_ompl.plugins.objective import StateCost
from safe_ompl.plugins.states import ScratchState, StateBridge


class Task:
    """A space with its validity checker, motion validator and cost, asked with arrays instead of OMPL's states.

    Parameters
    ----------
    si : ob.SpaceInformation
        Any space of real vectors and SO(2) parts, with any validity checker and motion validator.

    Attributes
    ----------
    bridge : StateBridge
        The space.
    cost : StateCost
        Cost of configurations: the danger.
    limit : DangerLimit or None
        What a planner requires on top of the validity checker.
    """

    def __init__(self, si: Any) -> None:
        self.bridge = StateBridge(si.getStateSpace())
        self._si = si
        self._from, self._to = ScratchState(self.bridge), ScratchState(self.bridge)
        self._room = Room()
        self.take(None, None)

    def take(self, objective: Any, limit: DangerLimit | None) -> None:
        """Take another objective, or None, and another limit."""
        self.cost = StateCost(objective, self.bridge)
        self.limit = limit
        self._slope: float | None = None

    @property
    def slope(self) -> float:
        """The usual slope of the cost [danger/rad], see `StateCost.slope`; measured when it is first asked for."""
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

        With a margin [m], also whether it keeps that from obstacles, where a `CertifiedMotion` can tell. That is asked
        without the detour by OMPL's states, which costs a sixth of a check.
        """
        motion = self._certified
        if motion is not None:
            within = self.bridge.holds(start) and self.bridge.holds(end)
            free = within and motion.is_free(start, end, margin)
        else:
            free = self._si.checkMotion(self._from.set(start), self._to.set(end))
        return free and (self.limit is None or self.limit.allows_motion(start, end))

    def keeps(self, q: FloatArray, margin: float) -> bool:
        """Return whether the robot keeps a margin [m] from obstacles at `q: (n,)`; not, where nothing can tell."""
        motion = self._certified
        return motion is not None and self._room.is_enough(motion, q, margin)

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
