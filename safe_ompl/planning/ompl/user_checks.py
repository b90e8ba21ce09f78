"""The user's own checks of states and motions, which nothing can be proven of."""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.collision import MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, positive
from safe_ompl.paths import UserCheck, UserStateCheck
from safe_ompl.planning.ompl.states import ScratchState, StateBridge

RESOLUTION = 0.01  # [rad] between two samples of a motion
_ROUNDING = 1e-9  # of a step
REFUSES = "its own answer"  # what a witness names beside the check


class SampledValidity(UserStateCheck):
    """A state validity checker of the user's, or a function of a state, asked at samples of motions and their ends.

    What it raises arrives unchanged. Samples are no farther apart in joint space than `resolution` [rad or m].
    """

    def __init__(self, checker: Any, bridge: StateBridge, resolution: float = RESOLUTION) -> None:
        if not (isinstance(checker, ob.StateValidityChecker) or callable(checker)):
            raise InputError(
                "the state validity checker must be an ob.StateValidityChecker or a function of a state, got "
                f"{checker!r}"
            )
        self.checker = checker
        self.resolution: float = positive(resolution, "resolution", "distance in joint space [rad]")
        self.name = _name(checker)
        self._bridge = bridge
        self._scratch = ScratchState(bridge)

    def __repr__(self) -> str:
        return f"SampledValidity({self.name}, resolution={self.resolution:g})"

    def accepts(self, state: Any) -> bool:
        """Return what the checker says of an OMPL state; raise InputError for anything but a bool."""
        asks = self.checker.isValid if isinstance(self.checker, ob.StateValidityChecker) else self.checker
        answer = asks(state)
        if not isinstance(answer, (bool, np.bool_)):
            raise InputError(f"the state validity checker {self.name} must return a bool, got {answer!r}")
        return bool(answer)

    def allows(self, q: FloatArray) -> bool:
        """Return what the checker says of a configuration (n,)."""
        return self.accepts(self._scratch.set(q))

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Ask at even steps of the straight motion between `start` and `end: (n,)`; says where it is refused."""
        delta = self._bridge.difference(start, end)
        count = max(1, ceil(float(np.linalg.norm(delta)) / self.resolution - _ROUNDING))
        for k in range(count + 1):
            if not self.allows(start + k / count * delta):
                return MotionVerdict(Verdict.BLOCKED, k / count, (self.name, REFUSES))
        return MotionVerdict(Verdict.FREE)


class AskedMotions(UserCheck):
    """A motion validator of the user's, asked about whole motions; what it raises arrives unchanged."""

    resolution = None

    def __init__(self, validator: Any, bridge: StateBridge) -> None:
        self.validator = validator
        self.name = _name(validator)
        self._from, self._to = ScratchState(bridge), ScratchState(bridge)

    def check(self, start: FloatArray, end: FloatArray) -> MotionVerdict:
        """Ask about the straight motion between `start` and `end: (n,)`."""
        if self.validator.checkMotion(self._from.set(start), self._to.set(end)):
            return MotionVerdict(Verdict.FREE)
        return MotionVerdict(Verdict.BLOCKED, None, (self.name, REFUSES))


def _name(check: Any) -> str:
    name = getattr(check, "__qualname__", None) or type(check).__qualname__
    return str(name).rsplit("<locals>.", 1)[-1]
