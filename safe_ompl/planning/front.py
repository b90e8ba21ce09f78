"""The Pareto front of length and danger: proven paths between the shortest and the least dangerous path."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import NamedTuple

from safe_ompl.common import InputError, instance, number, seed as checked_seed
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.run import noted_ctrl_c
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.planning.simplification import PathCost, timed

_WEIGHTS = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
# The first planner finds short paths, the second one finds detours around what is dangerous.
_PLANNERS = ("ClassicRRTConnect", "SafeRRTConnect")
_LARGEST_WEIGHT = 1e6
_STARTS = 6
# Another round follows if a round reduced the cost of some weight by more than this share.
_LEAST_SAVING = 1e-3
_FRONT_REFINEMENTS = 2
# The mean danger must fall by this share from one path of the front to the next.
_SAFER = 0.005


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """Proven paths from the shortest to the least dangerous one; false if there is no path.

    From each path to the next the length grows, ∫ CDF² ds falls, and the mean danger falls by at least 0.5 %.

    Attributes
    ----------
    results : tuple of PlanResult
        The paths with their reports. Planner and seed are those of the start from which a path was simplified.
    weights : tuple of float
        For each path the smallest weight of danger against length for which it is the best path, in rising order.
    interrupted : bool
        Whether Ctrl-C ended the search.

    Examples
    --------
    >>> front = tradeoff(setup_scenario("planar2"), time=2.0, seed=1)
    >>> lengths = [result.report.length for result in front.results]
    >>> lengths == sorted(lengths)
    True
    """

    results: tuple[PlanResult, ...]
    weights: tuple[float, ...]
    interrupted: bool = False

    def __len__(self) -> int:
        return len(self.results)

    def __str__(self) -> str:
        """Return a table with one line for each path."""
        lines = ["weight      length     mean danger      max   clearance"] if self else ["no path"]
        for weight, result in zip(self.weights, self.results, strict=True):
            report = result.report
            assert report is not None
            assert report.danger is not None
            near = f"{1e3 * report.clearance.min:.1f} mm" if report.clearance.obstacle is not None else "–"
            numbers = f"{report.danger.mean:11.3f} {report.danger.max:8.3f}"
            lines.append(f"{weight:6g} {report.length:7.3f} rad {numbers:>23} {near:>11}")
        return "\n".join(lines)


def tradeoff(setup: SafeSetup, weights: Sequence[float] = _WEIGHTS, *, time: float = 10.0, seed: int = 0) -> Tradeoff:
    """Compute the Pareto front of length and danger as proven paths.

    For each weight w the front has the path of least J = L + w·D of all paths found for any weight. L is the length and
    D = ∫ (CDF/reference)² ds. Paths of six starts are simplified for the first, the middle and the last weight. Then
    the best path of each weight is simplified again, until no cost falls. The result does not depend on the speed of
    the machine, unless the time runs out.

    Parameters
    ----------
    setup : SafeSetup
        A setup with start and goals. All paths satisfy its constraints and the obstacle cost of its simplification.
    weights : sequence of float
        Weights of danger against length, in [0, 1e6]; see `Simplifier`.
    time : float
        Time limit [s] of the whole search.
    seed : int
        Seed of the first start; the seeds of later starts are consecutive.

    Raises
    ------
    InputError
        If a weight, the time or the seed is invalid; if the setup plans without danger, or has no start or goal.
    KeyboardInterrupt
        On Ctrl-C before a path is found. Later, Ctrl-C ends the search, and the front of the paths so far is returned.
    """
    setup, seed = instance("setup", setup, SafeSetup), checked_seed(seed)
    time = number("time limit", time, above=0.0, kind="number of seconds")
    if isinstance(weights, str) or not len(weights):
        raise InputError(f"weights must be a non-empty list, got {weights!r}")
    ordered = sorted({number("weight", weight, at_least=0.0, at_most=_LARGEST_WEIGHT) for weight in weights})
    search = _FrontSearch(setup, ordered, time)
    with noted_ctrl_c() as interrupts, suppress(KeyboardInterrupt):
        search.start(time, seed)
        search.improve()
    if interrupts and not search.found:
        raise KeyboardInterrupt
    front = search.front()
    return Tradeoff(tuple(path.result for _, path in front), tuple(weight for weight, _ in front), bool(interrupts))


class _FoundPath(NamedTuple):
    """A proven path: its length plus obstacle cost, D, its length [rad], its mean danger, and its result."""

    way: float
    danger: float
    length: float
    mean: float
    result: PlanResult

    def cost(self, weight: float) -> float:
        return self.way + weight * self.danger


class _FrontSearch:
    """The search of `tradeoff`: all paths found, and for each weight the simplification of its best path."""

    def __init__(self, setup: SafeSetup, weights: Sequence[float], time: float) -> None:
        self._setup, self._over, self._half_over = setup, timed(time), timed(0.5 * time)
        self._simplifiers = {weight: setup.simplifier.weighing(weight) for weight in weights}
        self._danger, near = setup.simplifier.weighing(1.0).cost, setup.simplifier.obstacle_cost
        self._way = PathCost(setup.robot, [] if near is None else [near])
        self._tried: set[tuple[float, int, int]] = set()
        self.found: list[_FoundPath] = []

    def start(self, time: float, seed: int) -> None:
        """Plan up to six starts, until half of the time [s] is over and at least one path is found."""
        for k, planner in enumerate(islice(cycle(_PLANNERS), _STARTS)):
            if self._over() or (self.found and self._half_over()):
                break
            self._add(self._setup.plan(planner, time=0.5 * time if self.found else time, seed=(seed + k) % 2**32))

    def improve(self) -> None:
        """Simplify the starts for three weights, then for each weight its best path, with finer and finer spacing."""
        weights = list(self._simplifiers)
        for start in tuple(self.found):
            for weight in (weights[0], weights[len(weights) // 2], weights[-1]):
                self._simplify(start, weight, 0)
        for refinement in range(1 + _FRONT_REFINEMENTS):
            gains = self.found
            while gains and not self._over():
                before = {weight: self._best(weight) for weight in weights}
                for weight in weights:
                    self._simplify(self._best(weight), weight, refinement)
                # Each weight starts from the paths of its smaller and of its larger neighbour in turns.
                weights.reverse()
                gains = [p for w, p in before.items() if self._best(w).cost(w) < (1.0 - _LEAST_SAVING) * p.cost(w)]

    def front(self) -> list[tuple[float, _FoundPath]]:
        """Return the paths of the front with their weights.

        Let W be the cost without danger. For weights w₁ < w₂ the best paths have D₂ ≤ D₁ and W₂ ≥ W₁: add the
        inequalities W₁ + w₁D₁ ≤ W₂ + w₁D₂ and W₂ + w₂D₂ ≤ W₁ + w₂D₁. A path is left out if it is hardly safer than the
        one before, or if a path for a larger weight is both shorter and safer.
        """
        front = list[tuple[float, _FoundPath]]()
        for weight in sorted(self._simplifiers) if self.found else ():
            path = self._best(weight)
            while front and path.length <= front[-1][1].length and path.mean < front[-1][1].mean:
                front.pop()
            if not front or (path.danger < front[-1][1].danger and path.mean < (1.0 - _SAFER) * front[-1][1].mean):
                front.append((weight, path))
        return front

    def _best(self, weight: float) -> _FoundPath:
        return min(self.found, key=lambda path: (path.cost(weight), path.danger))

    def _add(self, result: PlanResult) -> None:
        report = result.report
        if result.path is not None and report is not None and report.certified and report.danger is not None:
            way, danger = self._way.of(result.path), self._danger.of(result.path) - report.length
            self.found.append(_FoundPath(way, danger, report.length, report.danger.mean, result))

    def _simplify(self, found: _FoundPath, weight: float, refinement: int) -> None:
        """Simplify a path for a weight, unless this was done before."""
        parent, step = found.result, (weight, refinement, id(found.result))
        if parent.path is None or step in self._tried or self._over():
            return
        self._tried.add(step)
        run = self._simplifiers[weight].refined(refinement).begin(parent.path, self._over, proven=True)
        run.improve()
        self._add(replace(parent, path=run.best, report=self._setup.report(run.best), planned_path=parent.path))
