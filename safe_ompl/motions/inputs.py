"""Checks of what motions are made of: times, rates, names, coefficients of SciPy, paths of OMPL."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, InputError, documents, finite_array, polynomials
from safe_ompl.planning.ompl import StateBridge
from safe_ompl.robot import Robot

_LEAST = 1e-9  # [s] between times; of less, powers have no digits
DEGREE = 15  # powers lose a factor of 3 in precision per degree: 1e7 at 15


def increasing(times: ArrayLike, count: int | None, name: str) -> FloatArray:
    """Return times that increase by a nanosecond at least, `count` of them if that is given."""
    found = finite_array(times, (None,), name)
    if count is not None and len(found) != count:
        raise InputError(f"must be {count}, got {len(found)}", name)
    if len(found) < 2:
        raise InputError(f"must be two at least, got {len(found)}", name)
    steps = np.diff(found)
    if not (steps >= _LEAST).all():
        k = int((steps < _LEAST).argmax())
        least = ", by 1e-9 at least" * bool(steps[k] > 0)
        raise InputError(
            f"must increase{least}, got {found[k + 1]:.9g} after {found[k]:.9g} (number {k + 1})", name
        )
    return found


def rate_rows(values: Any, shape: tuple[int, int], name: str) -> tuple[FloatArray, BoolArray]:
    """Return rates (N, n), and which points have any; rows of points that have none are 0."""
    if values is None:
        return np.zeros(shape), np.zeros(shape[0], dtype=bool)
    if (
        isinstance(values, np.ndarray)
        or not hasattr(values, "__len__")
        or len(values) != shape[0]
        or all(row is not None for row in values)
    ):
        return finite_array(values, shape, name), np.ones(shape[0], dtype=bool)
    rows, there = np.zeros(shape), np.array([row is not None for row in values])
    for k in np.flatnonzero(there):
        rows[k] = finite_array(values[k], shape[1:], f"{name} of point {k}")
    return rows, there


def of_degree(pieces: FloatArray) -> FloatArray:
    """Return coefficients (K, d + 1, n) if the degree is not too high."""
    if pieces.shape[1] > DEGREE + 1:
        raise InputError(
            f"must have a degree of {DEGREE} at most, beyond which powers lose digits, got {pieces.shape[1] - 1}",
            "motion",
        )
    return pieces


def vectors(thing: Any, dimensions: int) -> Any:
    """Return the coefficients of SciPy's `thing`, which must be those of vectors (n,)."""
    held = np.asarray(thing.c)
    if held.ndim != dimensions:
        raise InputError(
            f"must have values of shape (n,), got {held.shape[dimensions - 1 :]}", type(thing).__name__
        )
    return held


def named(names: Iterable[str], n: int) -> tuple[str, ...]:
    """Return the names of n joints, which must differ."""
    found = tuple(documents.text("joint name", name) for name in documents.sequence("joint names", names))
    if len(set(found)) < len(found):
        raise InputError(f"must differ, got {', '.join(found)}", "joint names")
    if len(found) != n:
        raise InputError(
            f"must be {n}, one for each column, got {len(found)}: {', '.join(found)}", "joint names"
        )
    return found


def path_states(path: Any, space: Any) -> FloatArray:
    """Return the configurations (N, n) of OMPL's `PathGeometric`."""
    count = path.getStateCount()
    if not count:
        raise InputError("has no states", "PathGeometric")
    if space is None:
        raise InputError("does not know its state space: give space, or the SimpleSetup", "PathGeometric")
    bridge = StateBridge(space)
    return np.array([bridge.read(path.getState(i)) for i in range(count)])


def columns(names: tuple[str, ...] | None, n: int, robot: Robot) -> list[int]:
    """Return which of n columns each joint of a robot has: by name, or in its own order."""
    if names is None:
        if n != robot.n:
            raise InputError(
                f"must have {robot.n} columns, for {', '.join(robot.joint_names)}, got {n}", "motion"
            )
        return list(range(n))
    missing = [name for name in robot.joint_names if name not in names]
    surplus = [name for name in names if name not in robot.joint_names]
    if missing or surplus:
        said = [f"lacks the joints {', '.join(missing)}"] * bool(missing)
        said += [f"has joints that the robot has not: {', '.join(surplus)}"] * bool(surplus)
        raise InputError("; ".join(said), "motion")
    return [names.index(name) for name in robot.joint_names]


def slack_between(at: FloatArray, held: FloatArray, max_velocity: float | ArrayLike) -> FloatArray:
    """Return how far (N − 1, n) joints no faster than `max_velocity` may be from the lines through samples (N, n)."""
    n = held.shape[1]
    v = finite_array(
        np.full(n, max_velocity) if np.ndim(max_velocity) == 0 else max_velocity, (n,), "largest velocity"
    )
    if (v <= 0).any():
        raise InputError(f"must be positive, got {v.min():g}", "largest velocity")
    spans = np.diff(at)[:, None]
    means = np.abs(np.diff(held, axis=0)) / spans
    if (means > v * (1 + 1e-9)).any():
        sample, joint = np.unravel_index((means / v).argmax(), means.shape)
        raise InputError(
            f"column {joint} moves at {means[sample, joint]:.4g} after {at[sample]:.6g} s, faster than the "
            f"largest velocity {v[joint]:.4g}",
            "samples",
        )
    v = np.maximum(v, means)
    slack: FloatArray = (v - means) * (v + means) * spans / (2 * v) + 8 * polynomials.EPS * v * spans
    return slack
