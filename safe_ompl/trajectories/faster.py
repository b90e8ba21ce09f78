"""Paths that are driven faster: random local changes, each proven, and kept where the trajectory takes less time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import InputError
from safe_ompl.trajectories.caps import StandstillError
from safe_ompl.trajectories.timing import PathTimer

COARSE = 60  # cells, while looking
_LARGEST, _SMALLEST = 0.5, 0.02  # [rad] of a change
_LONGER, _SHORTER = 1.4, 0.85  # what a success and a failure make of its size
_REMOVALS = 0.2  # share of the changes that take way points out
_SPACING = 0.5  # [rad] between way points
_STALE = 40  # changes in a row that gain nothing: the end


def duration_of(timer: PathTimer, path: FloatArray, cells: int = COARSE) -> float:
    """Return how long a path takes [s]; +inf where nothing allows motion."""
    try:
        return timer.time(path, cells=cells).duration
    except (InputError, StandstillError):
        return float("inf")


def faster(
    path: FloatArray,
    timer: PathTimer,
    motion: CertifiedMotion,
    rng: np.random.Generator,
    stop: Callable[[], bool],
    on_better: Callable[[FloatArray, float], None] | None = None,
) -> tuple[FloatArray, float]:
    """Return a path that is driven in less time, and how long it takes [s].

    What is minimised is the duration of the trajectory itself, under all limits and caps of the timer, with coarse
    cells. Way points are moved at random, neighbours with them, or taken out; the changed edges are proven. Steps grow
    when they succeed and shrink when they fail. That finds a local optimum at best, and not always that.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        Proven way points; continuous joints do not jump.
    timer : PathTimer
        Limits and caps.
    motion : CertifiedMotion
        Proves edges.
    rng : numpy.random.Generator
        Random numbers.
    stop : callable
        When it returns True, that is the end.
    on_better : callable, optional
        Told every better path, and its duration.
    """
    best, least = path, duration_of(timer, path)
    if not np.isfinite(least):
        return best, least
    dense = _divided(path)
    if len(dense) == 2:
        dense = np.vstack([dense[0], dense.mean(axis=0), dense[1]])
    size, stale = _LARGEST / 2, 0
    while stale < _STALE and not stop():
        changed, first, last = _changed(dense, rng, size, timer)
        stale += 1
        if changed is None or not _proven(changed[first:last], motion):
            size = max(_SMALLEST, size * _SHORTER)
            continue
        duration = duration_of(timer, changed)
        if duration < least:
            stale = 0 if duration < least * (1 - 1e-3) else stale
            dense, best, least = changed, changed, duration
            size = min(_LARGEST, size * _LONGER)
            if on_better is not None:
                on_better(best, least)
        else:
            size = max(_SMALLEST, size * _SHORTER)
    return best, least


def _changed(
    path: FloatArray, rng: np.random.Generator, size: float, timer: PathTimer
) -> tuple[FloatArray | None, int, int]:
    """Return a changed path and the range of its way points whose edges are new; None where it leaves the limits."""
    number, robot = len(path), timer.robot
    centre = int(rng.integers(1, number - 1))
    if number > 3 and rng.random() < _REMOVALS:
        return np.delete(path, centre, axis=0), centre - 1, centre + 1
    width = float(rng.choice([0.5, 1.0, 2.0]))
    weights = np.exp(-0.5 * ((np.arange(number) - centre) / width) ** 2)
    weights[weights < 0.05] = 0.0
    weights[[0, -1]] = 0.0
    direction = rng.normal(size=robot.n)
    changed = path + size * weights[:, None] * direction / np.linalg.norm(direction)
    moved = np.flatnonzero(weights)
    if not all(robot.within_limits(q).all() for q in changed[moved]):
        return None, 0, 0
    return changed, int(moved[0]) - 1, int(moved[-1]) + 2


def _proven(path: FloatArray, motion: CertifiedMotion) -> bool:
    return all(motion.is_free(a, b) for a, b in pairwise(path))


def _divided(path: FloatArray) -> FloatArray:
    """Return the same path with way points no more than the spacing apart."""
    parts = [
        a
        + np.linspace(0, 1, max(1, int(np.ceil(np.linalg.norm(b - a) / _SPACING))), endpoint=False)[:, None]
        * (b - a)
        for a, b in pairwise(path)
    ]
    return np.vstack([*parts, path[-1]])
