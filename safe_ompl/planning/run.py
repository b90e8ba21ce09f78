"""One run of a planner: plan, simplify or optimise the path, and validate the result."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from threading import current_thread, main_thread
from time import perf_counter
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np
from ompl import base as ob

import safe_ompl.common as common
import safe_ompl.planning.simplification as simplification
from safe_ompl.common import Counts, FloatArray, PlanningError, number
from safe_ompl.planning.planners import SafePlanner, nodes_of, termination
from safe_ompl.planning.result import Improvement, PlanResult
from safe_ompl.planning.ways import WaySearch

if TYPE_CHECKING:
    from safe_ompl.planning.safe_setup import SafeSetup
    from safe_ompl.planning.simplification import Simplifier, Stop

_log = logging.getLogger(__name__)

# A planner gets at least this time.
_LEAST_TIME = 1e-3  # [s]
# The best path is refined if this many consecutive starts find no better path.
_STALE_STARTS = 4
# With ways="all", further starts extend trees by up to this many times the planner's range. The first start has the
# planner's own. The longer motions lead more often to ways that the first start rarely finds.
_RANGE_FACTOR = 2.0
# A path counts as better if it reduces the cost by more than this share.
_BETTER_SHARE = 1e-3
# A refinement halves the spacing of the way points; there are at most this many refinements.
_SPACING_HALVINGS = 3

Search = Callable[[int, float], FloatArray | None]


@contextmanager
def noted_ctrl_c() -> Iterator[list[int]]:
    """Yield a list that gets an entry at each Ctrl-C during the block; the previous handler runs as before.

    Callers use it to return the best result so far. Python handles signals in the main thread only; in other threads
    the list stays empty.
    """
    noted, before = list[int](), signal.getsignal(signal.SIGINT)
    if not callable(before) or current_thread() is not main_thread():
        yield noted
        return

    def note(number: int, frame: FrameType | None) -> None:
        noted.append(number)
        before(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, before)


def stopping(time: Any) -> Stop:
    """Return a predicate for a time limit [s], 0 for none, or a termination condition."""
    if isinstance(time, ob.PlannerTerminationCondition):
        return lambda: bool(time())
    if not isinstance(time, bool) and isinstance(time, (int, float)) and time == 0:
        return lambda: False
    return simplification.timed(number("time of simplification", time, above=0.0, kind="number of seconds"))


@dataclass(eq=False, repr=False)
class Optimisation:
    """The paths (N, n) that were best in turn, with the times [s] at which they and the first path were found."""

    times: list[float]
    paths: list[FloatArray]
    first_path: float | None = None

    def settled(self, simplifier: Simplifier) -> tuple[FloatArray | None, tuple[Improvement, ...]]:
        """Return the best path, or None, and the improvements in order.

        During the descent the cost of a path covers only the danger points near it. Here the cost covers all danger
        points, and a path that costs no less than an earlier one is left out.
        """
        best, found = None, list[Improvement]()
        for time, path in zip(self.times, self.paths, strict=True):
            cost = simplifier.cost.of(path)
            if not found or cost < found[-1].cost:
                best = path
                found.append(Improvement(time, cost))
        return best, tuple(found)


def with_progress(name: str, seconds: float, stop: Stop) -> Stop:
    """Return `stop`; in notebooks the returned predicate also prints which share of the time [s] has passed."""
    if "ipykernel" not in sys.modules:
        return stop
    begin, printed_share = perf_counter(), -1

    def over() -> bool:
        nonlocal printed_share
        share = min(100, round(100 * (perf_counter() - begin) / seconds))
        if share > printed_share:
            printed_share = share
            print(f"\r{name}: {share} % of {seconds:g} s", end="", file=sys.stderr, flush=True)
        return stop()

    return over


def optimise(search: Search, simplifier: Simplifier, seconds: float, stop: Stop | None = None) -> Optimisation:
    """Search for the cheapest path until the time [s] is over or `stop` is true.

    Each start plans a new path by `search` and simplifies it. `search` takes the number of the start and a time limit
    [s], and returns a path (N, n) or None. If several consecutive starts find no better path, the best path is refined
    with more way points and smaller gains. Ctrl-C ends the search; the paths found so far are returned.
    """
    begin, over, found = perf_counter(), simplification.timed(seconds, stop), Optimisation([], [])
    best, stale, refinement, start = np.inf, 0, 0, 0

    def better(path: FloatArray, cost: float) -> None:
        nonlocal best, stale
        if cost < best:
            stale = 0 if cost < (1.0 - _BETTER_SHARE) * best else stale
            best = cost
            found.times.append(perf_counter() - begin)
            found.paths.append(path)

    # After Ctrl-C the best path so far is the result.
    with suppress(KeyboardInterrupt):
        while not over():
            if found.paths and stale >= _STALE_STARTS and refinement < _SPACING_HALVINGS:
                refinement, stale = refinement + 1, 0
                simplifier.refined(refinement).begin(found.paths[-1], over, better, proven=True).improve()
                continue
            path = search(start, seconds - (perf_counter() - begin))
            start, stale = start + 1, stale + 1
            if path is None:
                continue
            if found.first_path is None:
                found.first_path = perf_counter() - begin
                found.times.append(found.first_path)
                found.paths.append(path)
            simplifier.begin(path, over, better, proven=True).improve()
    return found


class _Starts:
    """The starts of one run; `status` is OMPL's status of the run and `nodes` the number of nodes of all starts."""

    def __init__(self, setup: SafeSetup, planner: Any, seed: int) -> None:
        self._setup, self._planner, self._seed = setup, planner, seed
        self.status, self.nodes, self._solved = "Timeout", 0, False

    def search(self, start: int, left: float, queries: float = np.inf) -> FloatArray | None:
        """Plan with the seed plus the number of the start; return a path or None.

        The start ends after the time `left` [s], or after so many collision queries once a path has been found.
        """
        setup = self._setup
        limit: Any = max(left, _LEAST_TIME)
        if self._solved and queries < np.inf:
            stop, most = termination(limit), setup.counts.queries + queries
            limit = ob.PlannerTerminationCondition(lambda: stop() or setup.counts.queries > most)
        if start:
            setup.clear()
            if isinstance(self._planner, SafePlanner):
                self._planner.setSeed((self._seed + start) % 2**32)
        found = setup.solve(limit)
        self.nodes += nodes_of(self._planner)
        if not setup.haveExactSolutionPath():
            self.status = self.status if self._solved else found.asString()
            return None
        self.status, self._solved = found.asString(), True
        return np.asarray(setup.solution())


class PlanningRun:
    """One run of a planner that `SafeSetup.prepare` has prepared; `name` is the planner's name in the result."""

    def __init__(self, setup: SafeSetup, planner: Any, name: str, seed: int) -> None:
        self._setup, self._planner, self.name, self._seed = setup, planner, name, seed

    def planned(self, time: float, simplification: float | None = None) -> PlanResult:
        """Plan once; then simplify for `simplification` [s], or for 0 up to the time limit, or not at all for None."""
        setup, begin = self._setup, perf_counter()
        before = replace(setup.counts)
        status = setup.solve(time)
        path = setup.solution() if setup.haveExactSolutionPath() else None
        planned, raw = perf_counter(), None
        left = time - (planned - begin)
        if path is not None and simplification is not None:
            if left > 0:
                setup.simplifySolution(min(simplification, left) if simplification else left)
                raw, path = path, setup.solution()
            else:
                _log.info("planning took all of the time limit: the path is not simplified")
        found = {"status": status.asString(), "path": path, "planned_path": raw}
        simplified = 0.0 if raw is None else perf_counter() - planned
        return self._result(before, nodes_of(self._planner), planned - begin, simplified, found)

    def optimised(self, time: float, stop: Stop) -> PlanResult:
        """Plan again and again until the time [s] is over, and return the best path; see `optimise`."""
        setup, begin = self._setup, perf_counter()
        before, simplifier, starts = replace(setup.counts), setup.simplifier, _Starts(setup, self._planner, self._seed)
        found = optimise(starts.search, simplifier, time - (perf_counter() - begin), stop)
        path, improvements = found.settled(simplifier)
        if path is not None and setup.getConstraints().user is not None:
            path = next((best for best in (path, *reversed(found.paths)) if setup.is_free(best)), None)
        if path is not None:
            setup.set_solution(path)
        elapsed = perf_counter() - begin
        first = elapsed if found.first_path is None else found.first_path
        outcome = {"status": starts.status, "path": path, "improvements": improvements}
        return self._result(before, starts.nodes, first, elapsed - first, outcome)

    def every_way(self, time: float, simplifier: Simplifier, seconds: float, interrupted: Stop) -> PlanResult:
        """Search for distinct ways, and return the way of least cost; see `WaySearch`.

        The time [s] limits the whole search; `seconds` limits the simplification of each path.
        """
        setup, planner, begin = self._setup, self._planner, perf_counter()
        own_range = planner.range if isinstance(planner, SafePlanner) else None
        ways = WaySearch(setup, simplifier, seconds, simplification.timed(time, interrupted))
        before, starts, first = replace(setup.counts), _Starts(setup, self._planner, self._seed), list[float]()

        def search(start: int) -> FloatArray | None:
            # A further start takes no more queries than all before it with their drafts, as single trees may grow a
            # hundred times larger than others.
            spent = setup.counts.queries - before.queries
            if start == 1 and own_range is not None:
                planner.range = _RANGE_FACTOR * planner.getRange()
            path = starts.search(start, time - (perf_counter() - begin), spent)
            if path is not None:
                first.append(perf_counter() - begin)
            return path

        try:
            # After Ctrl-C the best path so far is the result.
            with suppress(KeyboardInterrupt):
                ways.run(search)
        finally:
            if own_range is not None:
                planner.range = own_range
        outcome: dict[str, Any] = {"status": starts.status, "path": None}
        if found := ways.ways():
            best, costs = found[0][0], tuple(cost for _, cost in found)
            setup.set_solution(best.path)
            outcome |= {"path": best.path, "planned_path": best.planned, "ways": costs}
        elapsed = perf_counter() - begin
        planned = first[0] if first else elapsed
        return self._result(before, starts.nodes, planned, elapsed - planned, outcome)

    def _result(
        self, before: Counts, nodes: int, planning_time: float, simplification_time: float, found: dict[str, Any]
    ) -> PlanResult:
        """Return a PlanResult with times [s] and the differences of the counts from `before`."""
        counts = self._setup.counts - before
        counts.nodes = nodes
        return PlanResult(
            report=None,
            planner=self.name,
            seed=self._seed,
            joint_names=self._setup.robot.joint_names,
            planning_time=planning_time,
            simplification_time=simplification_time,
            counts=counts,
            repaired=getattr(self._planner, "repaired", ""),
            **found,
        )


def best_start(
    setup: SafeSetup, plan: Callable[[int], PlanResult], seeds: Sequence[int], workers: int, interrupts: list[int]
) -> PlanResult:
    """Plan with each seed, and return the first result of least cost by the setup's objective.

    The path becomes the setup's solution; all other data of the starts are cleared. `workers` is the number of
    processes. On Ctrl-C the best result so far is returned; KeyboardInterrupt if there is no result yet.
    """
    results = list[PlanResult]()

    def lost(seed: int, words: str) -> PlanResult:
        raise PlanningError(f"the start with seed {seed} was lost: {words}")

    with suppress(KeyboardInterrupt):
        for result in common.in_order(plan, seeds, workers, lost):
            results.append(result)
            if interrupts:
                break
    setup.clear()
    objective = setup.getOptimizationObjective() or ob.PathLengthOptimizationObjective(setup.getSpaceInformation())
    best, least = None, objective.infiniteCost()
    for result in results:
        if result.path is None:
            continue
        setup.set_solution(result.path)
        cost = setup.getSolutionPath().cost(objective)
        if best is None or objective.isCostBetterThan(cost, least):
            best, least = result, cost
    if not results:
        raise KeyboardInterrupt
    if best is None or best.path is None:
        return results[0]
    setup.set_solution(best.path)
    return best


def validated(setup: SafeSetup, result: PlanResult, begin: float) -> PlanResult:
    """Return the result with a report; a PlanningError if the path is not proven or does not lead from start to goal.

    `begin` is the time at which the call of `plan` began [s].
    """
    path = result.path
    setup_time = perf_counter() - begin - result.planning_time - result.simplification_time
    begin, report = perf_counter(), None
    if path is not None:
        report = setup.report(path)
        if not report.certified:
            raise PlanningError(f"{result.planner} returned a path that is not proven free: {report.validation.why}")
        setup.query.check_ends(path, result.planner)
    separation = setup.getConstraints().separation
    moving = {"speeds": dict(separation.speeds), "time": separation.time} if separation.speeds else None
    return replace(
        result,
        report=report,
        setup_time=setup_time,
        validation_time=perf_counter() - begin,
        robot=setup.robot,
        scene=setup.scene,
        danger=setup.danger_options,
        moving_obstacles=moving,
        motion=setup.motion_prover,
    )
