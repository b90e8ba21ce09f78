"""Anytime optimisation: plan, simplify, start anew, and refine what is best, until the time is up."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.maths.kernels.compiled import clock
from safe_ompl.paths.simplify.run import Stop
from safe_ompl.paths.simplify.simplifier import Simplifier, timed

_PATIENCE = 4  # starts in a row that find nothing better before the best path is refined
_WORTHWHILE = 1e-3  # share of the cost that a better path must save to count as such for that
_REFINEMENTS = 3  # each with half the spacing of the one before

Search = Callable[[int, float], FloatArray | None]


@dataclass(frozen=True)
class Improvement:
    """A path that was better than all before it.

    Attributes
    ----------
    time : float
        Since the beginning [s].
    cost : float
        J of the path.
    length : float
        [rad]
    danger_mean, danger_max : float
        Over the path.
    """

    time: float
    cost: float
    length: float
    danger_mean: float
    danger_max: float

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name."""
        return dict(vars(self))


@dataclass
class Optimisation:
    """The best path so far, and those that were best before.

    Attributes
    ----------
    times : list of float
        When each path was found [s].
    paths : list of ndarray, shape (N, n)
        Each better than those before, as far as was known then.
    first_path : float or None
        When there was a path at all [s].
    """

    times: list[float]
    paths: list[FloatArray]
    first_path: float | None = None

    def settled(self, simplifier: Simplifier) -> tuple[FloatArray | None, tuple[Improvement, ...]]:
        """Return the best path, if there is one, and what it and those that were best before it cost, in order.

        While paths descend, their cost is known for the danger points near them alone; here it is that of all points,
        and a path that is not better than those before is left out.
        """
        best, found = None, list[Improvement]()
        for time, path in zip(self.times, self.paths, strict=True):
            cost = simplifier.cost.of(path)
            if not found or cost < found[-1].cost:
                length, mean, peak = simplifier.danger_along(path)
                best = path
                found.append(Improvement(time, cost, length, mean, peak))
        return best, tuple(found)


def optimise(
    search: Search, simplifier: Simplifier, seconds: float, stop: Stop | None = None
) -> Optimisation:
    """Look for the cheapest path until the time is up.

    Every start is a new path of the planner, simplified. When several in a row have found nothing better, the best
    one is refined: more way points, smaller gains. Ctrl-C ends it early; what was found stands.

    Parameters
    ----------
    search : callable
        Plans: from a number that is another one for every start, and a time limit [s], to a path (N, n) or None.
    simplifier : Simplifier
        Makes paths cheaper.
    seconds : float
        Time limit [s].
    stop : callable, optional
        Ends it early.
    """
    begin, over = clock(), timed(seconds, stop)
    found = Optimisation([], [])
    with suppress(KeyboardInterrupt):  # the best path so far stands
        _improve(found, search, simplifier, begin, seconds, over)
    return found


def _improve(
    found: Optimisation, search: Search, simplifier: Simplifier, begin: float, seconds: float, over: Stop
) -> None:
    best, stale, refinement, start = np.inf, 0, 0, 0

    def better(path: FloatArray, cost: float) -> None:
        nonlocal best, stale
        if cost < best:
            stale = 0 if cost < (1.0 - _WORTHWHILE) * best else stale
            best = cost
            found.times.append(clock() - begin)
            found.paths.append(path)

    while not over():
        if found.paths and stale >= _PATIENCE and refinement < _REFINEMENTS:
            refinement, stale = refinement + 1, 0
            simplifier.refined(refinement).begin(found.paths[-1], over, better, proven=True).improve()
            continue
        path = search(start, seconds - (clock() - begin))
        start, stale = start + 1, stale + 1
        if path is None:
            continue
        if found.first_path is None:
            found.first_path = clock() - begin
            found.times.append(found.first_path)
            found.paths.append(path)
        simplifier.begin(path, over, better, proven=True).improve()
