"""A motion of one tick along a path, and the stop after it, in time.

Without a limit of the jerk s̈ is constant in each piece. With one these are pieces of a plan σ(t), and the robot is at

    s(t) = 1/w ∫ σ(τ) dτ,  τ from t − w to t,

so that s̈ is continuous and s⃛ bounded (`safe_ompl.motions.time_law`). A motion then begins with what the plan did
in the window before it, and the next motion goes on with that: nothing jumps between two ticks. The plan leaves no
place more than w before the robot does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.motions import BRAKING, RateLimits

BENDS = 0.3  # share of the jerk that q‴ṡ³ may take
_SHORTEST = 1e-4  # [s] of averages that rounding does not touch


def averaging_window(limits: RateLimits) -> float:
    """Return the window w [s] with which a joint stops soonest, about; 0 where the jerk is not limited.

    Of the jerk J a plan may brake with K J w, K the shares. A stop from v takes v/(K J w) + w, and braking with more
    than the acceleration a is of no use.
    """
    if limits.jerk is None:
        return 0.0
    of_plan = BRAKING * (1 - BENDS) * limits.jerk
    windows = np.minimum(np.sqrt(limits.velocity / of_plan), limits.acceleration / of_plan)
    return max(float(windows.max()), _SHORTEST)


class StopMotion(NamedTuple):
    """A motion of one tick along a path, and the stop after it: W pieces of constant acceleration.

    With a `window` [s] they are those of the plan, from so long before the motion on: times are negative there.
    """

    cells: IntArray  # (W,), the cell of the path in which each piece lies
    places: FloatArray  # (W + 1,), s, ṡ², and the time since the motion began [s], where pieces meet
    squares: FloatArray
    times: FloatArray
    window: float = 0.0

    @property
    def duration(self) -> float:
        """How long it takes until the robot stands [s]."""
        return float(self.times[-1]) + self.window

    def at(self, time: float) -> tuple[float, float, float]:
        """Return s, ṡ and s̈ at a time since it began [s]; at rest after its end."""
        if time >= self.duration:
            return float(self.places[-1]), 0.0, 0.0
        now = max(time, 0.0)
        if self.window:
            ends = self._plan(np.array([now - self.window, now]))
            place, speed, push = (float(values[1] - values[0]) / self.window for values in ends)
            return min(max(place, 0.0), float(self.places[-1])), max(speed, 0.0), push
        k = max(int(np.searchsorted(self.times, time, side="right")) - 1, 0)
        span, since = self.times[k + 1] - self.times[k], now - self.times[k]
        speed, after = np.sqrt(self.squares[k]), np.sqrt(self.squares[k + 1])
        push = (after - speed) / span if span > 0 else 0.0
        place = self.places[k] + since * (speed + 0.5 * since * push)
        return float(min(place, self.places[k + 1])), float(max(speed + since * push, 0.0)), float(push)

    def _plan(self, at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return ∫σ from the first time on, σ and σ̇ (T,) at times."""
        speeds, spans = np.sqrt(self.squares), np.diff(self.times)
        areas = np.cumsum(spans * (self.places[:-1] + spans * (2 * speeds[:-1] + speeds[1:]) / 6))
        k = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, len(spans) - 1)
        since = np.clip(at - self.times[k], 0.0, spans[k])
        push = np.diff(speeds)[k] / np.where(spans[k] > 0, spans[k], 1.0)
        place = self.places[k] + since * (speeds[k] + since * push / 2)
        area = np.append(0.0, areas)[k] + since * (self.places[k] + since * (speeds[k] / 2 + since * push / 6))
        after = np.maximum(at - self.times[-1], 0.0)  # it stands
        return area + after * self.places[-1], place, np.where(after > 0, 0.0, speeds[k] + since * push)

    def past(self, time: float) -> StopMotion:
        """Return what the plan does in the window before a time, which is 0 in what is returned."""
        between = (self.times > time - self.window) & (self.times < time)
        times = np.concatenate([[time - self.window], self.times[between], [time]])
        _, (first, last), ends = self._plan(times[[0, -1]])
        begin, end = np.square(ends)
        k = np.searchsorted(self.times, (times[1:] + times[:-1]) / 2, side="right") - 1
        return StopMotion(
            self.cells[np.clip(k, 0, len(self.cells) - 1)],
            np.concatenate([[first], self.places[between], [last]]),
            np.concatenate([[begin], self.squares[between], [end]]),
            times - time,
            self.window,
        )

    def visits(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the cells (V,) in which the robot will be, until when [s], and bounds of ṡ² while it is there."""
        fastest = np.maximum(self.squares[:-1], self.squares[1:])
        if not self.window:
            return self.cells, self.times[1:], fastest
        ahead = self.places[1:] > self.at(0.0)[0]
        first, last = self.times[:-1] - self.window, self.times[1:] + self.window
        near = (self.times[:-1] <= last[ahead, None]) & (self.times[1:] >= first[ahead, None])
        return self.cells[ahead], last[ahead], np.where(near, fastest, 0.0).max(axis=1, initial=0.0)
