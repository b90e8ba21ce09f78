"""A quick estimate of how long a path takes, to tell which of two paths is worth being timed; it proves nothing."""

from __future__ import annotations

import numpy as np

from safe_ompl.common import FloatArray
from safe_ompl.trajectories.caps import bending_cap, braking, next_stops
from safe_ompl.trajectories.curve import Cells, divided_edges
from safe_ompl.trajectories.kernels import Boxes, stopping_speeds
from safe_ompl.trajectories.time_law import TimeLaw, fastest_law, velocity_cap
from safe_ompl.trajectories.timing import PathTimer

_STEP = 0.15  # [rad] between samples
_SHORTEST = 1e-9  # [rad] of edges
_STRAIGHT, _SHARPEST = 1e-6, 1e-4  # [rad] turns of less are none; no blend is shorter
_NUDGE = 0.02  # [rad] of the joints, to see where people are farther away
_NEVER = 1e6  # [s] where nobody comes


class DurationEstimate:
    """The law of `PathTimer` at samples of a path, instead of in cells that are proven.

    It takes a tenth of what the coarsest timing takes. Corners count as the blends that the tolerance allows.

    Parameters
    ----------
    timer : PathTimer
        Limits and people.
    """

    def __init__(self, timer: PathTimer) -> None:
        self._timer = timer

    @staticmethod
    def knows(timer: PathTimer) -> bool:
        """Return whether the estimate accounts for all limits of the timer: joints, and people without contact."""
        contact = timer.people is not None and bool(timer.people.contact)
        return not (timer.has_other_caps or contact or timer.limits.jerk is not None)

    def times(self, path: FloatArray) -> FloatArray:
        """Return how long each edge (N − 1,) of a path (N, n) takes [s]; +inf where nothing allows motion."""
        steps = np.diff(path, axis=0)
        lengths = np.maximum(np.linalg.norm(steps, axis=1), _SHORTEST)
        panels = np.maximum(2, np.ceil(lengths / _STEP)).astype(np.intp)
        of = np.repeat(np.arange(len(panels)), panels)
        units, edges = steps / lengths[:, None], divided_edges(np.append(0.0, np.cumsum(lengths)), panels)
        bends = self._bends(units, lengths, np.diff(edges))
        boxes = Boxes(units[of], units[of], -bends, bends)
        cells, limits = (Cells(edges, boxes, np.zeros_like(bends), np.zeros(0, dtype=np.intp)), self._timer.limits)
        caps = np.minimum(velocity_cap(cells, limits), bending_cap(cells, limits))
        if self._timer.distances is not None:
            inside = np.arange(len(of)) - np.repeat(np.cumsum(panels) - panels, panels) + 0.5
            middles = path[of] + (inside / panels[of])[:, None] * steps[of]
            left = np.minimum(self._timer.distances.times_at(middles), _NEVER)[:, None]
            brakes, still = braking(cells, limits, caps), np.zeros_like(left)
            caps, *_ = stopping_speeds(cells.sizes, brakes, left, still, caps, next_stops(cells))
        if caps.min() <= 0:
            return np.full(len(panels), np.inf)
        law = TimeLaw.through(edges, fastest_law(cells, limits.acceleration, caps))
        return np.diff(law.times[np.append(0, np.cumsum(panels))])

    def away(self, q: FloatArray) -> FloatArray | None:
        """Return the direction (n,) in which people need longer to reach the robot at `q: (n,)`, or None."""
        if self._timer.distances is None:
            return None
        times = self._timer.distances.times_at(np.vstack([q, q + _NUDGE * np.eye(len(q))]))
        gradient: FloatArray = times[1:] - times[0]
        size = np.linalg.norm(gradient)
        return gradient / size if np.isfinite(size) and size > 0 else None

    def _bends(self, units: FloatArray, lengths: FloatArray, sizes: FloatArray) -> FloatArray:
        """Return |q″| (M, n) of the panels: that of the blend where one is, by the formulas of `blended`."""
        bends = np.zeros((len(sizes), units.shape[1]))
        middles = np.cumsum(sizes) - sizes / 2
        corners = np.cumsum(lengths)[:-1]
        changes = units[1:] - units[:-1]
        for k, (change, turn) in enumerate(zip(changes, np.linalg.norm(changes, axis=1).tolist(), strict=True)):
            if turn > _STRAIGHT:
                reach = max(min(lengths[k], lengths[k + 1]) / 2, _SHORTEST)
                reach = min(reach, max(4 * self._timer.tolerance / turn, _SHARPEST))
                near = np.abs(middles - corners[k]) <= max(reach, sizes.max() / 2)
                bends[near] = np.maximum(bends[near], np.abs(change) / (2 * reach))
        return bends
