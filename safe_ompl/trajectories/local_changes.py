"""Paths that are driven faster: random local changes, each proven, and kept where the motion takes less time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError
from safe_ompl.robot import Robot
from safe_ompl.trajectories.caps import StandstillError, bending_cap, braking, next_stops
from safe_ompl.trajectories.curve import Cells, divided_edges
from safe_ompl.trajectories.kernels import Boxes, stopping_speeds
from safe_ompl.trajectories.time_law import TimeLaw, fastest_law, velocity_cap
from safe_ompl.trajectories.timing import CELLS, PathTimer

_STEP = 0.15  # [rad] between samples
_SHORTEST = 1e-9  # [rad] of edges
_STRAIGHT, _SHARPEST = 1e-6, 1e-4  # [rad] turns of less are none; no blend is shorter
_NUDGE = 0.02  # [rad] of the joints, to see where people are farther away
_NEVER = 1e6  # [s] where nobody comes
_LARGEST, _SMALLEST = 0.6, 0.01  # [rad] of a change
_LONGER, _SHORTER = 1.5, 0.9  # what a success and a failure make of its size
_REMOVALS, _CUTS = 0.1, 0.05  # shares of the changes that take one way point out, or several
_STRAIGHTER, _AWAY = 0.2, 0.25  # shares of the directions that are not random
_NOISE = 0.5  # of a direction that is no random one
_WIDTHS = (0.4, 1.0, 2.0)  # how many way points beside the moved one move with it: Gaussian,
_LITTLE = 0.05  # and none by less than this share


class DurationEstimate:
    """The law of `PathTimer` at samples of a path, instead of in cells that are proven: it proves nothing.

    It takes a tenth of what the coarsest timing takes. Corners count as the blends that the tolerance allows.
    """

    def __init__(self, timer: PathTimer) -> None:
        self._timer = timer

    @property
    def complete(self) -> bool:
        """Whether it accounts for all limits of the timer: joints, and people without contact."""
        limits, caps = self._timer.limits, self._timer.caps
        others = limits.jerk, caps.tool_speed, caps.link_speed, caps.danger
        return all(limit is None for limit in others) and not (caps.people is not None and caps.people.contact)

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


class Change(NamedTuple):
    """A changed path, new between the way points `first` and `last`; by an offset, where no way point was taken out."""

    path: FloatArray
    first: int
    last: int
    offset: FloatArray | None


class PathChanges:
    """Draws changes of paths within the joint limits of a robot.

    Way points are taken out, one or several, or moved and their neighbours with them: in any direction, to the middle
    between their neighbours, or away from people. Most are moved where most of the time is spent. A direction that
    was a success is taken again; where it was none, the opposite one is tried next. Steps grow when they succeed and
    shrink when they fail.
    """

    def __init__(self, robot: Robot, estimate: DurationEstimate, rng: np.random.Generator) -> None:
        self._robot, self._estimate, self._rng = robot, estimate, rng
        self._size = _LARGEST / 3
        self._next: FloatArray | None = None  # the offset that is tried next
        self._drawn = False  # whether the last offset was a new one

    def draw(self, path: FloatArray, times: FloatArray | None) -> Change | None:
        """Return a change of `path: (N ≥ 3, n)`, most where `times` of edges are long; None if it leaves the limits."""
        if self._next is not None and len(self._next) == len(path):
            offset, self._next, self._drawn = self._next, None, False
            return self._moved(path, offset)
        number, kind = len(path), self._rng.random()
        self._drawn = True
        if number > 3 and kind < _REMOVALS:
            k = int(self._rng.integers(1, number - 1))
            return Change(np.delete(path, k, axis=0), k - 1, k + 1, None)
        if number > 4 and kind < _REMOVALS + _CUTS:
            a, b = sorted(self._rng.choice(number, 2, replace=False).tolist())
            if 1 < b - a < number - 1:
                return Change(np.delete(path, np.s_[a + 1 : b], axis=0), a, a + 2, None)
        return self._moved(path, self._offset(path, times))

    def succeeded(self, change: Change) -> None:
        """Take note that the change made the path better."""
        if change.offset is not None:
            self._size = min(_LARGEST, self._size * _LONGER)
            self._next = _LONGER * change.offset

    def failed(self, change: Change | None) -> None:
        """Take note that it did not."""
        if change is None or change.offset is None:
            return
        if self._drawn:
            self._next = -change.offset
        else:
            self._size = max(_SMALLEST, self._size * _SHORTER)

    def _offset(self, path: FloatArray, times: FloatArray | None) -> FloatArray:
        number = len(path)
        weights = np.ones(number - 2)
        if times is not None and np.isfinite(times).all():
            weights = times[:-1] + times[1:]
        centre = 1 + int(self._rng.choice(number - 2, p=weights / weights.sum()))
        near = np.exp(-0.5 * ((np.arange(number) - centre) / self._rng.choice(_WIDTHS)) ** 2)
        near[near < _LITTLE] = 0.0
        near[[0, -1]] = 0.0
        size = self._size * self._rng.uniform(0.3, 1.0)
        offset: FloatArray = size * near[:, None] * self._direction(path, centre)
        return offset

    def _direction(self, path: FloatArray, centre: int) -> FloatArray:
        """Return a direction (n,) for a way point."""
        kind = self._rng.random()
        noise = self._rng.normal(size=self._robot.n)
        noise /= np.linalg.norm(noise)
        wanted: FloatArray | None = None
        if kind < _STRAIGHTER:
            wanted = (path[centre - 1] + path[centre + 1]) / 2 - path[centre]
        elif kind < _STRAIGHTER + _AWAY:
            wanted = self._estimate.away(path[centre])
        if wanted is None or not np.linalg.norm(wanted) > 0:
            return noise
        mixed: FloatArray = wanted / np.linalg.norm(wanted) + _NOISE * noise
        return mixed / np.linalg.norm(mixed)

    def _moved(self, path: FloatArray, offset: FloatArray) -> Change | None:
        moved = np.flatnonzero(offset.any(axis=1))
        changed = path + offset
        if not len(moved) or not all(self._robot.within_limits(q).all() for q in changed[moved]):
            return None
        return Change(changed, int(moved[0]) - 1, int(moved[-1]) + 2, offset)


_COARSE = 60  # cells, where there is no estimate
_SPACINGS = (1.0, 0.5)  # [rad] between way points, at first, when nothing more is gained, and then
_STALE = 60  # changes in a row that gain nothing: the end of a spacing
_SLACK = 0.05  # share of the duration that fewer way points may cost, before changes
_GAIN = 1e-3  # share of the duration that counts as a gain
_ROUND = 50  # changes between two times that the trajectory itself is timed


def duration_of(timer: PathTimer, path: FloatArray, cells: int = CELLS) -> float:
    """Return how long a path takes [s]; +inf where nothing allows motion."""
    try:
        return timer.time(path, cells=cells).duration
    except (InputError, StandstillError):
        return float("inf")


def faster(
    path: FloatArray,
    timer: PathTimer,
    motion: MotionProver,
    rng: np.random.Generator,
    stop: Callable[[], bool],
    on_better: Callable[[FloatArray, float], None] | None = None,
) -> tuple[FloatArray, float]:
    """Return a path that is driven in less time, and how long it takes [s]; `on_better` is told every better one.

    What is minimised is the duration of the trajectory itself, under all limits and caps of the timer. Changes of the
    path (N, n), whose continuous joints do not jump, are judged by an estimate of it where there is one, proven if they
    are better, and after some of them the trajectory is timed: what is not better then is taken back. When nothing more
    is gained way points come nearer to each other. That finds a local optimum at best. It ends when `stop()` says so.
    """
    search = _LocalSearch(path, timer, motion, rng)
    if not np.isfinite(search.least):
        return path, search.least
    for spacing in _SPACINGS:
        search.begin(spacing, stop)
        while not search.stuck and not stop():
            search.try_changes(stop)
            if search.settle() and on_better is not None:
                on_better(search.best, search.least)
    return search.best, search.least


class _LocalSearch:
    """The path that `faster` changes, and the `best` one so far, which takes the `least` time [s]."""

    _path: FloatArray  # the path that is changed,
    _times: FloatArray | None  # how long its edges take, where that is estimated,
    _cost: float  # and all of it

    def __init__(self, path: FloatArray, timer: PathTimer, motion: MotionProver, rng: np.random.Generator) -> None:
        self._timer, self._motion = timer, motion
        self._estimate = DurationEstimate(timer)
        self._changes = PathChanges(timer.robot, self._estimate, rng)
        self.best, self.least, self._stale = path, duration_of(timer, path), 0
        self._take(path)
        self._cost_of_best = self._cost

    def begin(self, spacing: float, stop: Callable[[], bool]) -> None:
        """Begin anew from the best path, with way points where they are needed, and `spacing` [rad] apart at most."""
        self._take(self.best)
        self._thin(stop)
        path = _divided(self._path, spacing)
        if len(path) == 2:
            path = np.vstack([path[0], path.mean(axis=0), path[1]])
        self._take(path)
        self._stale = 0

    def _thin(self, stop: Callable[[], bool]) -> None:
        """Take way points out, one after the other, while that costs little time: changes of few go farther."""
        most = (1 + _SLACK) * self._cost
        for k in range(len(self._path) - 2, 0, -1):
            if stop():
                return
            path = np.delete(self._path, k, axis=0)
            times, cost = self._judge(path)
            if cost < most and self._proven(path[k - 1 : k + 1]):
                self._path, self._times, self._cost = path, times, cost

    @property
    def stuck(self) -> bool:
        """Whether nothing more is to be gained with way points so far apart."""
        return self._stale >= _STALE

    def try_changes(self, stop: Callable[[], bool]) -> None:
        """Try some changes, and keep what is better by the estimate and proven."""
        for _ in range(_ROUND):
            if self.stuck or stop():
                return
            self._stale += 1
            change = self._changes.draw(self._path, self._times)
            if change is None:
                continue
            times, cost = self._judge(change.path)
            if cost < self._cost and self._proven(change.path[change.first : change.last]):
                self._stale = 0 if cost < (1 - _GAIN) * self._cost else self._stale
                self._path, self._times, self._cost = change.path, times, cost
                self._changes.succeeded(change)
            else:
                self._changes.failed(change)

    def settle(self) -> bool:
        """Time the trajectory if it may be better, and return whether it is.

        Where the estimate is better, and the trajectory is not, the estimate does not see what matters: enough of it.
        """
        if self._cost >= self._cost_of_best:
            return False
        duration = duration_of(self._timer, self._path)
        if duration < self.least:
            self.best, self.least, self._cost_of_best = self._path, duration, self._cost
            return True
        self._stale = _STALE
        return False

    def _take(self, path: FloatArray) -> None:
        self._path = path
        self._times, self._cost = self._judge(path)

    def _judge(self, path: FloatArray) -> tuple[FloatArray | None, float]:
        """Return how long each edge takes, if that is known, and all of them, as far as can be said quickly [s]."""
        if self._estimate.complete:
            times = self._estimate.times(path)
            return times, float(times.sum())
        return None, duration_of(self._timer, path, _COARSE)

    def _proven(self, path: FloatArray) -> bool:
        return all(self._motion.is_free(a, b) for a, b in pairwise(path))


def _divided(path: FloatArray, spacing: float) -> FloatArray:
    """Return the same path with way points no more than the spacing apart."""
    parts = [
        a + np.linspace(0, 1, max(1, int(np.ceil(np.linalg.norm(b - a) / spacing))), endpoint=False)[:, None] * (b - a)
        for a, b in pairwise(path)
    ]
    return np.vstack([*parts, path[-1]])
