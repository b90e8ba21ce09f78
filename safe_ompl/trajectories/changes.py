"""Random changes of a path that may make its motion shorter in time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.robot.robot import Robot
from safe_ompl.trajectories.estimate import DurationEstimate

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
