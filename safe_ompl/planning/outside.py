"""Paths from outside: what any function returns is proven, or repaired first, and is a solution like all others."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

import safe_ompl.motions as motions
from safe_ompl.common import FloatArray, InputError, clock, finite_array
from safe_ompl.planning.planners import SafePlanner

_log = logging.getLogger(__name__)

Outside: TypeAlias = Callable[[FloatArray, FloatArray], ArrayLike | None]

_ALIKE = 1e-3  # [rad or m] A path may begin and end so far from start and goal, and is led there.
_LONGEST = 2.0  # [s] for one way round


class OutsidePlanner(SafePlanner):
    """Plans with a function that is the user's own, such as one that calls another package.

    The function takes the start (n,) and the goals (G, n), and returns a path (N, n) from the start to one of the
    goals, or None where it finds none. The setup proves its paths, or repairs them; a path that cannot be repaired is
    asked for anew, unless it is the same again.
    """

    def __init__(self, setup: Any, function: Outside) -> None:
        super().__init__(setup.getSpaceInformation(), getattr(function, "__name__", type(function).__name__))
        self._setup, self._function = setup, function

    def _search(self, ptc: Any) -> FloatArray | None:
        configurations, _, starts, ends = self._structure.graph()
        start, goals = configurations[starts[0]], configurations[ends]
        before: FloatArray | None = None
        connect = connecting(self._setup, ptc)
        while not ptc():
            found = self._function(start.copy(), goals.copy())
            if found is None:
                return None
            path = self._led_to_its_ends(found, start, goals)
            if before is not None and np.array_equal(path, before):
                return None
            repair = motions.repair_with(motions.Motion.through(path), self._setup.motion_prover, connect=connect)
            if repair:
                _log.info("%s: %s", self.getName(), repair)
                return repair.motion.knots
            _log.info("%s: its path is dropped: %s", self.getName(), repair)
            before = path
        return None

    def _led_to_its_ends(self, found: ArrayLike, start: FloatArray, goals: FloatArray) -> FloatArray:
        """Return the path that was found (N, n), with the ends that it was asked for."""
        path = np.array(finite_array(found, (None, len(start)), f"path of {self.getName()}"))
        if len(path) < 2:
            raise InputError(f"path of {self.getName()} must have two configurations at least, got {len(path)}")
        robot = self._setup.robot
        for index, wanted, name in ((0, start[None], "start"), (-1, goals, "goal")):
            apart = np.abs([robot.difference(path[index], q) for q in wanted]).max(axis=1)
            nearest = int(apart.argmin())
            if apart[nearest] > _ALIKE:
                raise InputError(
                    f"path of {self.getName()} must {'begin' if index == 0 else 'end'} at the {name}, is "
                    f"{apart[nearest]:.3g} rad away from it"
                )
            path[index] = wanted[nearest]
        return path


def connecting(setup: Any, ptc: Callable[[], bool] | float) -> Callable[[FloatArray, FloatArray], FloatArray | None]:
    """Return what finds proven paths between two configurations for repairs, under the constraints of a `SafeSetup`.

    The setup's problem stays as it is. `ptc` says when to give up, or for how long to try in all [s].
    """
    own: list[Any] = []
    end = clock() + ptc if isinstance(ptc, float) else None

    def connect(start: FloatArray, goal: FloatArray) -> FloatArray | None:
        over = ptc if end is None else lambda: clock() >= end
        if over():  # type: ignore[operator]
            return None
        if not own:
            own.append(type(setup)(setup.robot, setup.scene, danger=setup.danger_options))
            own[0].setConstraints(setup.getConstraints())
        own[0].setConfigurations(start, goal)
        left = _LONGEST if end is None else max(end - clock(), 1e-3)
        result = own[0].plan("SafeRRTConnect", time=left, simplify=0.2 * left)
        return result.path if result else None

    return connect
