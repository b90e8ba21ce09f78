"""Planning for a short duration: the timer of a setup, and the search for the path that is driven fastest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Literal, TypeAlias

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import UnknownNameError
from safe_ompl.maths.kernels.compiled import clock
from safe_ompl.paths.simplify.run import Stop, unrolled
from safe_ompl.paths.simplify.simplifier import Simplifier, timed
from safe_ompl.planners.base import SafePlanner
from safe_ompl.planners.registry import make_planner
from safe_ompl.plugins.duration import DurationObjective
from safe_ompl.scenario.motion_limits import MotionLimits
from safe_ompl.scenario.people import People
from safe_ompl.setup.optimise import Improvement, Search
from safe_ompl.setup.simplification import SimplifyingSetup
from safe_ompl.trajectories.faster import duration_of, faster
from safe_ompl.trajectories.limits import RateLimits
from safe_ompl.trajectories.timing import PathTimer

Cost: TypeAlias = Literal["danger", "duration"]
COSTS: tuple[Cost, ...] = ("danger", "duration")
_STARTS = 2  # paths that are looked for before the best is made faster, and again when that ends
_SIMPLIFICATION = 0.3  # [s] of each
_WEIGHTS = (0.0, 1.0)  # of danger, for shorter paths than the simplifier's own
_PROMISING = 1.5  # a new path that takes longer than this times the best one is left as it is


class TimedSetup(SimplifyingSetup):
    """The part of `SafeSetup` that knows how motions are timed; parameters as there."""

    _motion_limits = MotionLimits()
    _people: People | None = None
    _timer: PathTimer | None = None
    _cost: Cost = "danger"

    def setMotionLimits(self, motion: MotionLimits | None = None, people: People | None = None) -> None:
        """Say what trajectories keep to, for `plan(cost="duration")`: limits of the joints, speeds, and people.

        Parameters
        ----------
        motion : MotionLimits, optional
            Of joints, tool and links.
        people : People, optional
            Who may come near, and how fast.
        """
        self._motion_limits, self._people, self._timer = motion or MotionLimits(), people, None

    @property
    def timer(self) -> PathTimer:
        """What times paths within the limits that `setMotionLimits` set.

        Raises
        ------
        InputError
            If limits are missing, people are not in the scene, or a danger is limited but none is planned with.
        """
        motion, wanted = self._validator.motion, self._motion_limits
        if self._timer is None or self._timer.motion is not motion:
            danger = None if wanted.max_danger is None or self.field is None else self.field.moving
            self._timer = PathTimer(
                self.robot,
                RateLimits.of(self.robot, wanted.velocity, wanted.acceleration, wanted.jerk),
                motion=motion,
                people=self._people,
                tool_speed=wanted.tool_speed,
                link_speed=wanted.link_speed,
                danger=danger,
                max_danger=wanted.max_danger,
            )
        return self._timer

    @contextmanager
    def _choosing(
        self, cost: Cost, planner: str | Any, parameters: Mapping[str, Any] | None
    ) -> Iterator[None]:
        """Plan for a cost within: it is the objective of OMPL's planners; ours plan away from danger."""
        if cost not in COSTS:
            raise UnknownNameError("cost", cost, COSTS)
        replaced = None
        if cost == "duration":
            self.timer  # noqa: B018  # whatever it lacks is said now
            si = self.getSpaceInformation()
            made = make_planner(planner, si, parameters) if isinstance(planner, str) else planner
            if not isinstance(made, SafePlanner):
                replaced = self.getOptimizationObjective()
                self.setOptimizationObjective(DurationObjective(si, self.timer))
        self._cost = cost
        try:
            yield
        finally:
            self._cost = "danger"
            if replaced is not None:
                self.setOptimizationObjective(replaced)

    def _make_cheaper(self, seconds: float, seed: int) -> None:
        """Simplify the solution for some seconds."""
        if self._cost == "danger":
            self.simplifySolution(seconds)
            return
        path = self.solution()
        better = FastestPath(self.timer, self.simplifier, seed).shorten(path, timed(seconds))
        self._set_solution(better if self.is_free(better) else path)


class FastestPath:
    """Looks for the path that is driven in the least time.

    Paths of a planner, and what simplification makes of them, are timed; of several the best one is made faster by
    local changes (`safe_ompl.trajectories.faster`).

    Parameters
    ----------
    timer : PathTimer
        Limits and caps.
    simplifier : Simplifier
        Makes paths safer: beside people these may be driven faster.
    seed : int
        Of local changes.

    Attributes
    ----------
    times : list of float
        When each path was found [s].
    paths : list of ndarray, shape (N, n)
        Each faster than those before; only the first may be one that people allow no motion on.
    durations : list of float
        How long each takes [s]; +inf where nothing allows motion.
    """

    def __init__(self, timer: PathTimer, simplifier: Simplifier, seed: int) -> None:
        self.times: list[float] = []
        self.paths: list[FloatArray] = []
        self.durations: list[float] = []
        self._timer, self._simplifier = timer, simplifier
        shorter = (
            Simplifier(
                simplifier.checker, simplifier.danger.field, simplifier.motion, weight=weight, clearance=0.0
            )
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
        """Look until the time is up; parameters as `setup.optimise.optimise`. Ctrl-C ends it early."""
        over, start = timed(seconds, stop), 0
        with suppress(KeyboardInterrupt):  # the best path so far stands
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
        with suppress(KeyboardInterrupt):
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
        faster(path, self._timer, self._simplifier.motion, self._rng, over, self._better)

    def _timed(self, path: FloatArray) -> float:
        duration = duration_of(self._timer, path)
        self._better(path, duration)
        return duration

    def _better(self, path: FloatArray, duration: float) -> None:
        if not self.paths or duration < self.durations[-1]:
            self.times.append(clock() - self._begin)
            self.paths.append(path)
            self.durations.append(duration)
