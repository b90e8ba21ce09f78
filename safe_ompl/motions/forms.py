"""Convert representations of motions to polynomials on [0, 1]: way points, Hermite, Bézier and B-splines."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import (
    RATE_BOUNDS,
    BoolArray,
    FloatArray,
    InputError,
    documents,
    finite_array,
    listed,
    number,
    polynomials,
    whole_number,
)
from safe_ompl.robot import Robot

# Smallest difference of consecutive times. Times of 100 s are rounded by up to 1e-5 of this difference.
_LEAST_TIME_STEP = 1e-9  # [s]
# Largest degree. The conversion from Bernstein to monomial coefficients loses a factor of 3 in precision per degree,
# which is 1e7 at this degree.
_MOST_DEGREE = 15

Pieces: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
"""K polynomials of degree d in each of n joints, on [0, 1].

The times (K + 1,) of their ends, the coefficients c_0 … c_d (K, d + 1, n), lowest power first, and bounds (K, n) of the
sum of the coefficients' rounding errors.
"""


def straight(times: ArrayLike | None, points: ArrayLike, name: str) -> Pieces:
    """Return the lines through points (N, n) at times (N,), by default 0, 1, ….

    Without times, a single point gives a constant path.
    """
    held = finite_array(points, (None, None), name)
    if times is None and len(held) == 1:
        held = np.repeat(held, 2, axis=0)
    if len(held) < 2:
        raise InputError(f"must be at least two, got {len(held)}", name)
    checked_times = np.arange(float(len(held))) if times is None else _increasing(times, len(held))
    ends = np.stack([held[:-1], held[1:]], axis=1)
    return checked_times, *polynomials.hermite(np.diff(checked_times), ends, None, None)


def hermite(times: ArrayLike, positions: ArrayLike, velocities: Any, accelerations: Any) -> Pieces:
    """Return Hermite pieces; arguments and errors as `Motion.hermite`."""
    checked_times = _increasing(times)
    held = finite_array(positions, (len(checked_times), None), "positions")
    velocity_rows, has_velocities = _rate_rows(velocities, held.shape, "velocities")
    acceleration_rows, has_accelerations = _rate_rows(accelerations, held.shape, "accelerations")
    if (has_accelerations & ~has_velocities).any():
        point = int(np.flatnonzero(has_accelerations & ~has_velocities)[0])
        raise InputError(f"point {point} has accelerations, but no velocities", "motion")
    cubic = has_velocities[:-1] & has_velocities[1:]
    quintic = has_accelerations[:-1] & has_accelerations[1:]
    degrees = np.where(cubic, np.where(quintic, 5, 3), 1)
    coefficients = np.zeros((len(checked_times) - 1, int(degrees.max()) + 1, held.shape[1]))
    rounding = np.zeros_like(coefficients[:, 0])
    for degree in set(degrees.tolist()):
        which = np.flatnonzero(degrees == degree)
        ends = which[:, None] + [0, 1]
        v = velocity_rows[ends] if degree > 1 else None
        a = acceleration_rows[ends] if degree > 3 else None
        made = polynomials.hermite(checked_times[which + 1] - checked_times[which], held[ends], v, a)
        coefficients[which, : degree + 1], rounding[which] = made
    return checked_times, coefficients, rounding


def bezier(control_points: ArrayLike, times: ArrayLike) -> Pieces:
    """Return consecutive Bézier curves with control points (K, d + 1, n)."""
    points = check_degree(finite_array(control_points, (None, None, None), "control points"))
    return _increasing(times, len(points) + 1), *polynomials.powers(points, np.zeros_like(points[:, 0]))


def bspline(spline: Any) -> Pieces:
    """Convert a SciPy BSpline on its domain. SciPy has already validated the knots."""
    degree = whole_number("degree of the B-spline", int(spline.k), at_least=1, at_most=_MOST_DEGREE)
    knots = finite_array(spline.t, (None,), "knots")
    held = finite_array(vector_coefficients(spline, 2)[: len(knots) - degree - 1], (None, None), "control points")
    return polynomials.spline(knots, held, degree)


def from_ppoly(polynomial: Any) -> Pieces:
    """Convert a SciPy PPoly, whose coefficients of (t − x_j) have the highest power first."""
    pieces = np.swapaxes(vector_coefficients(polynomial, 3), 0, 1)
    pieces = finite_array(pieces, (None, None, None), "coefficients")
    times = _increasing(polynomial.x, len(pieces) + 1)
    # Highest powers that are zero in all pieces are dropped.
    unused = np.cumsum(np.abs(pieces[:, :-1]).sum(axis=(0, 2))) == 0
    lowest_first = check_degree(pieces[:, int(unused.sum()) :][:, ::-1])
    orders = np.arange(float(lowest_first.shape[1]))
    coefficients = lowest_first * (np.diff(times)[:, None] ** orders)[..., None]
    # Bounds of the number of roundings in the scaled coefficient of each power.
    rounding_counts = np.where(orders > 0, orders + 3, 0.0)
    return times, coefficients, polynomials.EPS * np.einsum("k,jkn->jn", rounding_counts, np.abs(coefficients))


def _increasing(times: ArrayLike, count: int | None = None) -> FloatArray:
    """Return times that increase by at least a nanosecond.

    Raises InputError if the times do not increase so, or if their number is not `count`.
    """
    found = finite_array(times, (None,), "times")
    if count is not None and len(found) != count:
        raise InputError(f"must be {count}, got {len(found)}", "times")
    if len(found) < 2:
        raise InputError(f"must be at least two, got {len(found)}", "times")
    steps = np.diff(found)
    if not (steps >= _LEAST_TIME_STEP).all():
        k = int((steps < _LEAST_TIME_STEP).argmax())
        least = " by at least 1e-9" * bool(steps[k] > 0)
        raise InputError(f"must increase{least}, got {found[k + 1]:.9g} after {found[k]:.9g} (times[{k + 1}])", "times")
    return found


def _rate_rows(values: Any, shape: tuple[int, int], name: str) -> tuple[FloatArray, BoolArray]:
    """Return derivatives (N, n), and which points have them. Rows of the other points are 0."""
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


def check_degree(pieces: FloatArray) -> FloatArray:
    """Return coefficients (K, d + 1, n); raise InputError if their degree is too high."""
    if pieces.shape[1] > _MOST_DEGREE + 1:
        raise InputError(
            f"must have a degree of at most {_MOST_DEGREE}, since rounding errors grow with the degree, "
            f"got {pieces.shape[1] - 1}",
            "motion",
        )
    return pieces


def vector_coefficients(function: Any, dimensions: int) -> Any:
    """Return the coefficients of a SciPy BSpline, PPoly or BPoly; raise InputError unless its values are vectors (n,).

    `dimensions` is the number of dimensions of the coefficients of such a function.
    """
    held = np.asarray(function.c)
    if held.ndim != dimensions:
        raise InputError(f"must have values of shape (n,), got {held.shape[dimensions - 1 :]}", type(function).__name__)
    return held


def named(names: Iterable[str], n: int) -> tuple[str, ...]:
    """Return the names of n joints; raise InputError if names repeat."""
    found = tuple(documents.text("joint name", name) for name in documents.sequence("joint names", names))
    if len(set(found)) < len(found):
        raise InputError(f"must differ, got {listed(found)}", "joint names")
    if len(found) != n:
        raise InputError(f"must be {n}, one for each column, got {len(found)}: {listed(found)}", "joint names")
    return found


def path_states(path: Any, space: Any) -> FloatArray:
    """Return the configurations (N, n) of OMPL's `PathGeometric`, given its space or the robot."""
    # A PathGeometric can only exist if OMPL is installed, so importing OMPL here is safe.
    from safe_ompl.robot import StateBridge, joint_space

    count = path.getStateCount()
    if not count:
        raise InputError("has no states", "PathGeometric")
    if space is None:
        raise InputError(
            "does not know its state space: pass `space`, or the SimpleSetup instead of the path", "PathGeometric"
        )
    return StateBridge(joint_space(space) if isinstance(space, Robot) else space).way_points(path)


def columns(names: tuple[str, ...] | None, n: int, robot: Robot) -> list[int]:
    """Return the column of each of the robot's joints among n columns: by name, or in the robot's order."""
    if names is None:
        if n != robot.n:
            raise InputError(f"must have {robot.n} columns, for {', '.join(robot.joint_names)}, got {n}", "motion")
        return list(range(n))
    missing = [name for name in robot.joint_names if name not in names]
    surplus = [name for name in names if name not in robot.joint_names]
    if missing or surplus:
        reasons = [f"lacks the joints {listed(missing)}"] * bool(missing)
        reasons += [f"has joints that the robot has not: {listed(surplus)}"] * bool(surplus)
        raise InputError("; ".join(reasons), "motion")
    return [names.index(name) for name in robot.joint_names]


def sampled(times: ArrayLike, positions: ArrayLike, max_velocity: float | ArrayLike) -> tuple[Pieces, FloatArray]:
    """Return the lines through samples (N, n), and bounds of the distances of the true motion from these lines.

    The bounds (N − 1, n) [rad or m] follow from the largest velocities of the joints.
    """
    pieces, held = straight(times, positions, "positions"), np.asarray(positions, dtype=np.float64)
    n = held.shape[1]
    v = finite_array(np.full(n, max_velocity) if np.ndim(max_velocity) == 0 else max_velocity, (n,), "largest velocity")
    for value in v.tolist():
        number("largest velocity", value, **RATE_BOUNDS["velocity"])
    checked_times = pieces[0]
    spans = np.diff(checked_times)[:, None]
    means = np.abs(np.diff(held, axis=0)) / spans
    if (means > v * (1 + 1e-9)).any():
        sample, joint = np.unravel_index((means / v).argmax(), means.shape)
        raise InputError(
            f"column {joint} moves at {means[sample, joint]:.4g} after {checked_times[sample]:.6g} s, faster than the "
            f"largest velocity {v[joint]:.4g}",
            "samples",
        )
    v = np.maximum(v, means)
    slack: FloatArray = (v - means) * (v + means) * spans / (2 * v) + 8 * polynomials.EPS * v * spans
    return pieces, slack
