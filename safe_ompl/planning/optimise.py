"""Anytime search for the best path, and what ends it: time, a condition, Ctrl-C."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from threading import current_thread, main_thread
from types import FrameType, TracebackType
from typing import Any

import numpy as np
from ompl import base as ob

from safe_ompl.common import FloatArray, clock, positive, until_ctrl_c
from safe_ompl.paths import Simplifier, Stop, timed
from safe_ompl.planning.result import Improvement

_STALE_STARTS = 4  # starts in a row that find nothing better before the best path is refined
_WORTHWHILE = 1e-3  # share of the cost that a better path must save to count as such for that
_REFINEMENTS = 3  # each with half the spacing of the one before

Search = Callable[[int, float], FloatArray | None]


class Interrupts:
    """Notes Ctrl-C while a block runs, and has it handled as it was before; in the main thread, as Python has it.

    Used where the best result so far is returned and no exception is raised; `happened` says whether there was one.
    """

    def __init__(self) -> None:
        self.happened = False
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        before = signal.getsignal(signal.SIGINT)
        if callable(before) and current_thread() is main_thread():
            self._before = before
            signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.happened = True
        self._before(number, frame)


def stopping(time: Any) -> Stop:
    """Return a predicate for a time limit [s], 0 for none, or a termination condition."""
    if isinstance(time, ob.PlannerTerminationCondition):
        return lambda: bool(time())
    if not isinstance(time, bool) and isinstance(time, (int, float)) and time == 0:
        return lambda: False
    return timed(positive(time, "time of simplification", "number of seconds"))


@dataclass
class Optimisation:
    """The best path so far, and those that were best before; and when there was a path at all [s]."""

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
                best = path
                found.append(Improvement(time, cost))
        return best, tuple(found)


def told(name: str, seconds: float, stop: Stop) -> Stop:
    """Return the same `stop`, which in notebooks also says on one line how much of the time [s] is over."""
    if "ipykernel" not in sys.modules:
        return stop
    begin, said = clock(), -1

    def over() -> bool:
        nonlocal said
        share = min(100, round(100 * (clock() - begin) / seconds))
        if share > said:
            said = share
            print(f"\r{name}: {share} % of {seconds:g} s", end="", file=sys.stderr, flush=True)
        return stop()

    return over


def optimise(search: Search, simplifier: Simplifier, seconds: float, stop: Stop | None = None) -> Optimisation:
    """Look for the cheapest path until the time [s] is up, or `stop` says so.

    Every start is a new path of the planner, simplified; `search` plans: from a number that is another one for every
    start, and a time limit [s], to a path (N, n) or None. When several starts in a row have found nothing better, the
    best path is refined: more way points, smaller gains. Ctrl-C ends it early; what was found stands.
    """
    begin, over, found = clock(), timed(seconds, stop), Optimisation([], [])
    best, stale, refinement, start = np.inf, 0, 0, 0

    def better(path: FloatArray, cost: float) -> None:
        nonlocal best, stale
        if cost < best:
            stale = 0 if cost < (1.0 - _WORTHWHILE) * best else stale
            best = cost
            found.times.append(clock() - begin)
            found.paths.append(path)

    with until_ctrl_c():  # the best path so far stands
        while not over():
            if found.paths and stale >= _STALE_STARTS and refinement < _REFINEMENTS:
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
    return found
