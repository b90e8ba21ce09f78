"""Limits of time: seconds or termination conditions, as planners and simplification ask for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.errors import InputError
from safe_ompl.maths.kernels.compiled import clock
from safe_ompl.paths.simplify.run import Stop
from safe_ompl.paths.simplify.simplifier import timed


def positive_time(name: str, value: Any) -> float:
    """Return a time [s], or raise InputError if it is not a positive finite number."""
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    if not (number and np.isfinite(value) and value > 0):
        raise InputError(f"{name} must be a positive number of seconds, got {value!r}")
    return float(value)


def simplification_time(value: bool | float) -> float | None:
    """Return for how long to simplify [s], 0 without limit; None for not at all."""
    if isinstance(value, (bool, np.bool_)):
        return 0.0 if value else None
    return positive_time("simplify", value)


def stopping(time: Any) -> Stop:
    """Return a predicate for a time limit [s], 0 for none, or a termination condition."""
    if isinstance(time, ob.PlannerTerminationCondition):
        return lambda: bool(time())
    if not isinstance(time, bool) and isinstance(time, (int, float)) and time == 0:
        return lambda: False
    return timed(positive_time("time of simplification", time))


def termination(time: Any) -> Any:
    """Return when to stop. It asks Python, which notices Ctrl-C only when it runs, whenever a C++ planner asks it."""
    if not isinstance(time, ob.PlannerTerminationCondition):
        number = isinstance(time, (int, float, np.integer, np.floating)) and not isinstance(time, bool)
        if not (number and time >= 0):
            raise InputError(f"time must be a number of seconds or a termination condition, got {time!r}")
        end = clock() + float(time)
        return ob.PlannerTerminationCondition(lambda: clock() >= end)
    return ob.PlannerTerminationCondition(lambda: bool(time()))
