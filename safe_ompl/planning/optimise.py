"""What makes paths better: anytime search for the best path, and for the fastest one."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from threading import current_thread, main_thread
from types import FrameType, TracebackType
from typing import Any, Literal, TypeAlias

import numpy as np
from ompl import base as ob

import safe_ompl.trajectories as trajectories
from safe_ompl.common import FloatArray, clock, positive, until_ctrl_c
from safe_ompl.paths import Simplifier, Stop, timed, unrolled
from safe_ompl.planning.result import Improvement

Cost: TypeAlias = Literal["danger", "duration"]
COSTS: tuple[Cost, ...] = ("danger", "duration")

_STALE_STARTS = 4  # starts in a row that find nothing better before the best path is refined
_WORTHWHILE = 1e-3  # share of the cost that a better path must save to count as such for that
_REFINEMENTS = 3  # each with half the spacing of the one before

_STARTS = 2  # paths that are looked for before the fastest is made faster, and again when that ends
_SIMPLIFICATION = 0.3  # [s] of each
_WEIGHTS = (0.0, 1.0)  # of danger, for shorter paths than the simplifier's own
_PROMISING = 1.5  # a new path that takes longer than this times the fastest one is left as it is

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
                length, mean, peak = simplifier.danger_along(path)
                best = path
                found.append(Improvement(time, cost, length, mean, peak))
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


class FastestPath:
    """Looks for the path that is driven in the least time.

    Paths of a planner, and what simplification makes of them, are timed; of several the best one is made faster by
    local changes (`trajectories.faster`), drawn with `seed`. Beside people safer paths may be driven faster. Each path
    is faster than those before; only the first may be one that people allow no motion on: its duration is +inf.
    """

    def __init__(self, timer: trajectories.PathTimer, simplifier: Simplifier, seed: int) -> None:
        self.times: list[float] = []
        self.paths: list[FloatArray] = []
        self.durations: list[float] = []
        self._timer, self._simplifier = timer, simplifier
        shorter = (
            Simplifier(simplifier.checker, simplifier.danger.field, simplifier.motion, weight=weight, clearance=0.0)
            for weight in _WEIGHTS
        )
        self._simplifiers = simplifier, *shorter
        self._rng = np.random.default_rng(seed)
        self._begin = clock()

    @property
    def first_path(self) -> float | None:
        """When there was a path at all [s]."""
        return self.times[0] if self.times else None

    def search(self, search: Search, seconds: float, stop: Stop | None = None) -> None:
        """Look until the time is up; parameters as `optimise`. Ctrl-C ends it early."""
        over, start = timed(seconds, stop), 0
        with until_ctrl_c():  # the best path so far stands
            while not over():
                found = []
                for k in range(start, start + _STARTS):
                    path = None if over() else search(k, seconds - (clock() - self._begin))
                    found += [] if path is None else [self._simplified(path, over)]
                start += _STARTS
                if found:
                    duration, path = min(found, key=lambda pair: pair[0])
                    promising = duration < _PROMISING * self.durations[-1]
                    self._make_faster(path if promising else self.paths[-1], over)

    def shorten(self, path: FloatArray, over: Stop) -> FloatArray:
        """Return a path that is driven in less time, or the given one."""
        with until_ctrl_c():
            self._make_faster(self._simplified(path, over)[1], over)
        return self.paths[-1]

    def settled(self, simplifier: Simplifier) -> tuple[FloatArray | None, tuple[Improvement, ...]]:
        """Return the fastest path, if there is one, and those that were fastest before it, in order."""
        found = zip(self.times, self.paths, self.durations, strict=True)
        rows = [Improvement(time, cost, *simplifier.danger_along(path)) for time, path, cost in found]
        return (self.paths[-1] if self.paths else None), tuple(rows)

    def _simplified(self, path: FloatArray, over: Stop) -> tuple[float, FloatArray]:
        """Time a path, and what simplification for safety and for length make of it; return the fastest."""
        path = unrolled(self._timer.robot, path)
        candidates = [(self._timed(path), path)]
        for simplifier in self._simplifiers:
            if not over():
                simple = simplifier.simplify(path, timed(_SIMPLIFICATION, over), proven=True)
                candidates.append((self._timed(simple), simple))
        return min(candidates, key=lambda pair: pair[0])

    def _make_faster(self, path: FloatArray, over: Stop) -> None:
        trajectories.faster(path, self._timer, self._simplifier.motion, self._rng, over, self._better)

    def _timed(self, path: FloatArray) -> float:
        duration = trajectories.duration_of(self._timer, path)
        self._better(path, duration)
        return duration

    def _better(self, path: FloatArray, duration: float) -> None:
        if not self.paths or duration < self.durations[-1]:
            self.times.append(clock() - self._begin)
            self.paths.append(path)
            self.durations.append(duration)
