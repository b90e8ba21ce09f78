"""Paths that are driven faster: random local changes, each proven, and kept where the motion takes less time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from safe_ompl.collision import MotionProver
from safe_ompl.common import FloatArray, InputError
from safe_ompl.robot import Robot
from safe_ompl.trajectories.caps import StandstillError
from safe_ompl.trajectories.estimate import DurationEstimate
from safe_ompl.trajectories.timing import CELLS, PathTimer

_LARGEST, _SMALLEST = 0.6, 0.01  # [rad] of a change
_LONGER, _SHORTER = 1.5, 0.9  # what a success and a failure make of its size
_REMOVALS, _CUTS = 0.1, 0.05  # shares of the changes that take one way point out, or several
_STRAIGHTER, _AWAY = 0.2, 0.25  # shares of the directions that are not random
_NOISE = 0.5  # of a direction that is no random one
_WIDTHS = (0.4, 1.0, 2.0)  # how many way points beside the moved one move with it: Gaussian,
_LITTLE = 0.05  # and none by less than this share


class Change(NamedTuple):
    """A changed path, and where it is new.

    Attributes
    ----------
    path : ndarray, shape (N', n)
    first, last : int
        The edges between the way points first … last − 1 are new.
    offset : ndarray, shape (N', n), or None
        What was added, where no way point was taken out.
    """

    path: FloatArray
    first: int
    last: int
    offset: FloatArray | None


class PathChanges:
    """Draws changes of paths.

    Way points are taken out, one or several, or moved and their neighbours with them: in any direction, to the middle
    between their neighbours, or away from people. Most are moved where most of the time is spent. A direction that
    was a success is taken again; where it was none, the opposite one is tried next. Steps grow when they succeed and
    shrink when they fail.

    Parameters
    ----------
    robot : Robot
        Its joint limits are kept.
    estimate : DurationEstimate
        Says where people are farther away.
    rng : numpy.random.Generator
        Random numbers.
    """

    def __init__(self, robot: Robot, estimate: DurationEstimate, rng: np.random.Generator) -> None:
        self._robot, self._estimate, self._rng = robot, estimate, rng
        self._size = _LARGEST / 3
        self._next: FloatArray | None = None  # the offset that is tried next
        self._drawn = False  # whether the last offset was a new one

    def draw(self, path: FloatArray, times: FloatArray | None) -> Change | None:
        """Return a change of `path: (N ≥ 3, n)`, None where it leaves the joint limits.

        Parameters
        ----------
        path : ndarray, shape (N, n)
            The path.
        times : ndarray, shape (N - 1,), optional
            How long its edges take: where that is most, most changes are.
        """
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
    """Return a path that is driven in less time, and how long it takes [s].

    What is minimised is the duration of the trajectory itself, under all limits and caps of the timer. Changes of the
    path (`safe_ompl.trajectories.local_changes`) are judged by an estimate of it where there is one
    (`safe_ompl.trajectories.estimate`), proven if they are better, and after some of them the trajectory is timed: what
    is not better then is taken back. When nothing more is gained way points come nearer to each other. That finds a
    local optimum at best, and not always that.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        Proven way points; continuous joints do not jump.
    timer : PathTimer
        Limits and caps.
    motion : MotionProver
        Proves edges.
    rng : numpy.random.Generator
        Random numbers.
    stop : callable
        When it returns True, that is the end.
    on_better : callable, optional
        Told every better path, and its duration.
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
    """The path that `faster` changes, and the best one so far.

    Attributes
    ----------
    best : ndarray, shape (N, n)
        The path that takes the least time, and
    least : float
        how long it takes [s].
    """

    _path: FloatArray  # the path that is changed,
    _times: FloatArray | None  # how long its edges take, where that is estimated,
    _cost: float  # and all of it

    def __init__(self, path: FloatArray, timer: PathTimer, motion: MotionProver, rng: np.random.Generator) -> None:
        self._timer, self._motion = timer, motion
        self._estimate = DurationEstimate(timer)
        self._estimates = DurationEstimate.knows(timer)
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
        if self._estimates:
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
