"""Points of a trajectory between which the polynomials that a receiver makes of them keep the limits.

Receivers join positions and velocities by cubics, and with accelerations by quintics; ROS 2's joint trajectory
controller does. Samples of a motion that keeps its limits do not do: where its acceleration jumps between two of them a
cubic has up to 5/3 of it, and a quintic more. So points stand where the acceleration jumps, or the jerk where that is
limited, as far as that is needed, and evenly between these. What is left is driven slower.
"""

from __future__ import annotations

from collections.abc import Callable
from math import perm

import numpy as np

from safe_ompl.common import FloatArray, polynomials
from safe_ompl.trajectories.curve import divided_edges
from safe_ompl.trajectories.limits import RateLimits

_SLOWER = 1e-3  # relative excess that slower driving takes care of, so that there are fewer points
_NEAREST = 1e-4  # [s] of two points
_WHOLE = 0.2  # of an interval: how long the first and the last are at least
_TICK = 1e-9  # [s] messages have whole nanoseconds
_ROUNDS = 20  # of driving slower; two in most cases


def points_within(
    at: Callable[[FloatArray], tuple[FloatArray, ...]],
    knots: FloatArray,
    jumps: FloatArray,
    limits: RateLimits,
    rate: float,
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return times (T,) [s] of points, whole nanoseconds, and the states there; they are proven to keep the limits.

    Parameters
    ----------
    at : callable
        Returns positions and velocities, and accelerations for quintics, each (S, n), at times (S,) of the motion.
    knots : ndarray, shape (K,)
        When the motion begins and ends, and between when its acceleration, or its jerk, may jump [s].
    jumps : ndarray, shape (K,)
        How far it jumps then, in limits.
    limits : RateLimits
        Of the joints.
    rate : float
        How many points there are in a second at least [Hz].

    Raises ArithmeticError where rounding is larger than the limits: of points in less than nanoseconds.
    """
    fixed = knots[[0, -1]]
    inside = np.abs(knots - fixed.mean()) < np.ptp(fixed) / 2 - _WHOLE / rate
    while True:
        parts = np.ceil(np.diff(fixed) * rate * (1 - 1e-9)).astype(np.intp)
        places = divided_edges(fixed, np.maximum(parts, 1))
        times, states = _slower(at, places, 1.0)
        after = np.clip(np.searchsorted(fixed, knots), 1, len(fixed) - 1)
        apart = np.minimum(knots - fixed[after - 1], fixed[after] - knots)
        worth = np.where((apart > _NEAREST) & inside, jumps, 0.0)
        new = []
        for k in np.flatnonzero(_excess(times, states, limits) > 1 + _SLOWER):
            first, last = np.searchsorted(knots, places[k : k + 2])
            best = first + int(worth[first:last].argmax()) if first < last else first
            if worth[best] > _SLOWER:
                new.append(knots[best])
        if not new:
            break
        fixed = np.union1d(fixed, new)
    factor = 1.0
    for _ in range(_ROUNDS):
        excess = float(_excess(times, states, limits).max())
        if excess <= 1:
            return times, states
        factor *= excess + _TICK
        times, states = _slower(at, places, factor)
    raise ArithmeticError(f"limits are kept by no points {places[-1]} s")


def _slower(
    at: Callable[[FloatArray], tuple[FloatArray, ...]], places: FloatArray, factor: float
) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Return when places (T,) [s] of the motion are passed if that takes longer by a factor, and the states there."""
    times = np.round(factor * places / _TICK) * _TICK
    asked = np.append(times[:-1] / factor, places[-1] + 1.0)  # at the end, and at rest
    return times, tuple(values / factor**order for order, values in enumerate(at(asked)))


def _excess(times: FloatArray, states: tuple[FloatArray, ...], limits: RateLimits) -> FloatArray:
    """Return by what factor (T − 1,) the pieces between points are to be slower to keep the limits."""
    spans = np.diff(times)[:, None]
    ends = [np.stack([values[:-1], values[1:]], axis=1) for values in states]
    held, rounding = polynomials.hermite(spans[:, 0], *ends, *[None] * (3 - len(ends)))
    degree, factor = held.shape[1] - 1, np.zeros(len(spans))
    for order, kind in enumerate(limits.kinds, start=1):
        held = held[:, 1:] * np.arange(1.0, held.shape[1])[:, None] / spans[..., None]
        error = (degree + 3) * polynomials.EPS * np.abs(held).sum(axis=1)
        error += perm(degree, order) * rounding / spans**order
        rows, most = np.moveaxis(polynomials.bernstein(held), 1, 2), getattr(limits, kind)
        bound = np.abs(rows).max(axis=2)
        over = bound + error > most
        if over.any():
            bound[over] = np.maximum(polynomials.peaks(rows[over]).bound, polynomials.peaks(-rows[over]).bound)
        factor = np.maximum(factor, ((bound + error) / most).max(axis=1) ** (1 / order))
    return factor
