"""Checks of the numbers to be drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.errors import InputError


def tables(profiles: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    """Return the profiles as arrays (R, S); those without runs as (0, 0)."""
    return {
        name: finite_array(runs, (None, None), f"profiles of {name}") if np.size(runs) else np.empty((0, 0))
        for name, runs in _some(profiles, "profiles").items()
    }


def rows(values: Mapping[str, ArrayLike], kind: str) -> dict[str, FloatArray]:
    """Return the values of each planner as an array (R,)."""
    return {
        name: finite_array(row, (None,), f"{kind} of {name}") for name, row in _some(values, kind).items()
    }


def _some(values: Mapping[str, ArrayLike], kind: str) -> Mapping[str, ArrayLike]:
    if not values:
        raise InputError(f"no {kind} to draw; give at least one planner")
    return values


def curve(values: ArrayLike, kind: str) -> FloatArray:
    """Return the values along one path as an array (S,) that is not empty."""
    curve = finite_array(values, (None,), kind)
    if not len(curve):
        raise InputError(f"{kind} has no values; give at least one")
    return curve


def check_partners(clearances: Mapping[str, FloatArray], dangers: Mapping[str, FloatArray]) -> None:
    """Raise InputError unless both hold the same planners with as many runs."""
    for name in {**clearances, **dangers}:
        counts = [len(table[name]) if name in table else None for table in (clearances, dangers)]
        if counts[0] != counts[1]:
            raise InputError(
                f"{name} has {counts[0]} clearances but {counts[1]} dangers; give one pair per run"
            )
