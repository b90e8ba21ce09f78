"""Simplification of solutions: danger-aware, or OMPL's own where there is no danger."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from time import perf_counter
from types import MappingProxyType
from typing import Any

from safe_ompl.errors import InputError
from safe_ompl.paths.simplify.simplifier import Simplifier
from safe_ompl.setup.problem import SafeProblem
from safe_ompl.setup.time_limits import stopping

_log = logging.getLogger(__name__)


class SimplifyingSetup(SafeProblem):
    """The part of `SafeSetup` that makes solutions shorter and safer; parameters as there."""

    _simplifier: Simplifier | None = None
    _simplification_options: Mapping[str, Any] = MappingProxyType({})
    _simplification_time = 0.0

    @property
    def simplifier(self) -> Simplifier:
        """What makes paths cheaper; `setSimplification` sets its options.

        Raises
        ------
        InputError
            If this setup plans without danger.
        """
        if self._simplifier is None:
            self.setSimplification(**self._simplification_options)
        assert self._simplifier is not None
        if self._simplifier.motion is not self._validator.motion:
            self._simplifier = self._simplifier.proving_by(self._validator.motion)
        return self._simplifier

    def setSimplification(self, **options: Any) -> None:
        """Set the options of the danger-aware simplification: weight, exponent, clearance, … of `Simplifier`.

        Raises
        ------
        InputError
            If an option is out of range, or this setup plans without danger.
        """
        if self.field is None:
            raise InputError(
                "danger-aware simplification needs a danger field; this setup plans without danger"
            )
        self._simplifier = Simplifier(self.checker, self.field, self._validator.motion, **options)
        self._simplification_options = options

    def _scene_changed(self, *, same_checker: bool) -> None:
        super()._scene_changed(same_checker=same_checker)
        if not same_checker:
            self._simplifier = None  # is made anew when it is wanted

    def simplifySolution(self, time: Any = 0.0, *, free_goal: bool = False) -> None:
        """Make the solution shorter and safer, see `simplify_danger`; every path on the way is proven.

        Without danger OMPL's own simplifier does it, and its path is taken if it is proven, too. The user's own checks
        are asked about every edge on the way, and about the path at the end.

        Parameters
        ----------
        time : float or ob.PlannerTerminationCondition
            For how long [s], or until when; 0: until nothing more is to gain.
        free_goal : bool
            Whether the goal configuration may move where the goal is a `WorkspaceGoal`.

        Raises
        ------
        InputError
            If there is no solution, or the time is neither.
        """
        if not self.haveSolutionPath():
            raise InputError("there is no solution to simplify")
        self._adopt_plugins()
        begin, path = perf_counter(), self.solution()
        if self.field is not None:
            goal = self._place if free_goal and self.getGoal() is self._place else None
            self._set_solution(self.simplifier.simplify(path, stopping(time), goal=goal, proven=True))
        else:
            super().simplifySolution(time)
        if (self.field is None or self.user_checks) and not self.is_free(self.solution()):
            # Samples of a motion are not those of its parts: a check of the user's own may refuse these after all.
            _log.info("the simplified path is refused; the solution stays as it was")
            self._set_solution(path)
        self._simplification_time = perf_counter() - begin

    def getLastSimplificationTime(self) -> float:
        """Return how long the last simplification took [s]."""
        return self._simplification_time
