"""The time law of a trajectory: where on its curve it is at what time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.trajectories.curve import Cells
from safe_ompl.trajectories.kernels import fastest
from safe_ompl.trajectories.limits import RateLimits


@dataclass(frozen=True)
class TimeLaw:
    """Arc length by time: constant s̈ in every cell of a curve.

    Attributes
    ----------
    edges : ndarray, shape (N + 1,)
        Arc lengths of the grid points.
    squares : ndarray, shape (N + 1,)
        x = ṡ² there [rad²/s²].
    times : ndarray, shape (N + 1,)
        When they are passed [s].
    """

    edges: FloatArray
    squares: FloatArray
    times: FloatArray

    @classmethod
    def through(cls, edges: FloatArray, squares: FloatArray) -> TimeLaw:
        """Return the law with these ṡ² at the grid points; a cell takes 2h/(ṡ_start + ṡ_end)."""
        speeds = np.sqrt(squares)
        sizes, both = np.diff(edges), speeds[:-1] + speeds[1:]
        steps = np.divide(2 * sizes, both, out=np.zeros(len(sizes)), where=sizes > 0)
        return cls(edges, squares, np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    def squares_at(self, s: FloatArray) -> FloatArray:
        """Return ṡ² (S,) at arc lengths `s: (S,)` of the curve."""
        squares: FloatArray = np.interp(s, self.edges, self.squares)
        return squares

    def at(self, t: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Return cell, s, ṡ and s̈ (T,) at times `t: (T,)` [s]; at rest before the start and after the end."""
        cell: IntArray = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.edges) - 2)
        sizes = np.diff(self.edges)
        pushes = np.divide(np.diff(self.squares), 2 * sizes, out=np.zeros(len(sizes)), where=sizes > 0)
        speeds = np.sqrt(self.squares)
        since = np.clip(t, 0.0, self.duration) - self.times[cell]
        rate = speeds[cell] + pushes[cell] * since
        s = self.edges[cell] + since * (speeds[cell] + rate) / 2
        outside = (t < 0) | (t > self.duration)
        return (
            cell,
            np.clip(s, self.edges[cell], self.edges[cell + 1]),
            np.where(outside, 0.0, np.maximum(rate, 0.0)),
            np.where(outside, 0.0, pushes[cell]),
        )


def velocity_cap(cells: Cells, limits: RateLimits) -> FloatArray:
    """Return the largest ṡ (N,) of each cell that keeps the joints' velocities: min_i limit_i/max|q′_i|."""
    slopes = cells.slopes
    with np.errstate(divide="ignore"):
        cap: FloatArray = np.where(slopes > 0, limits.velocity / slopes, np.inf).min(axis=1)
    return cap


def fastest_law(cells: Cells, limits: RateLimits, cap: FloatArray, speed: float = 0.0) -> FloatArray:
    """Return ṡ² (N+1,) of the fastest law within joint limits and a cap of ṡ.

    Parameters
    ----------
    cells : Cells
        The curve.
    limits : RateLimits
        Of the joints.
    cap : ndarray, shape (N,)
        Largest ṡ in each cell.
    speed : float
        ṡ where it begins. If nothing in time slows it down from there, it begins with the largest ṡ that is possible.
    """
    within = np.minimum(cap, velocity_cap(cells, limits)) ** 2
    most = np.minimum(np.append(within, 0.0), np.concatenate([[0.0], within]))
    most[0] = min(within[0], speed * speed)
    most[cells.stops] = 0.0
    found: FloatArray = fastest(
        cells.sizes,
        cells.slope_low,
        cells.slope_high,
        cells.bend_low,
        cells.bend_high,
        limits.acceleration,
        most,
    )
    return found
