"""Run: one run of a planner, ours or OMPL's, in a setup; its time limit, and Ctrl-C on the way."""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import current_thread, main_thread
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from safe_ompl.common import FloatArray, InputError, PlanningError, clock, number
from safe_ompl.danger import DangerLimit
from safe_ompl.paths import PathReport, Stop, timed
from safe_ompl.planning.optimise import Cost, FastestPath, Optimisation, optimise
from safe_ompl.planning.planners import SafePlanner, check_usable
from safe_ompl.planning.result import PlanResult

if TYPE_CHECKING:
    from safe_ompl.planning.safe_setup import SafeSetup

_log = logging.getLogger(__name__)

_SHORTEST = 1e-3  # [s] a planner gets at least this


class Run:
    """One run of a planner that a setup has prepared.

    Parameters
    ----------
    setup : SafeSetup
        Plans, simplifies and validates.
    planner : ob.Planner
        What `SafeSetup.prepare` returned.
    name : str
        What the planner is called in the result.
    seed : int
        Seed of the run.
    cost : {"danger", "duration"}
        What a better path has less of.
    """

    def __init__(
        self, setup: SafeSetup, planner: Any, name: str, seed: int = 0, cost: Cost = "danger"
    ) -> None:
        self._setup, self._planner, self._name = setup, planner, name
        self._seed, self._cost = int(seed), cost

    def __repr__(self) -> str:
        return f"Run({self._setup!r}, {self._name!r}, seed={self._seed})"

    @contextmanager
    def under_own_limit(self) -> Iterator[None]:
        """Prove motions within the planner's own danger limit, too: what is made of its path must keep to that."""
        own = self._planner.getMaxDanger() if isinstance(self._planner, SafePlanner) else 0.0
        wiring, field = self._setup.wiring, self._setup.field
        limit = wiring.constraints.danger
        if not own or field is None or (limit is not None and limit.limit <= own):
            yield
            return
        wiring.validator.setConstraints(replace(wiring.constraints, danger=DangerLimit(field, own)))
        try:
            yield
        finally:
            wiring.validator.setConstraints(wiring.constraints)

    def planned(self, time: float, simplification: float | None = None) -> PlanResult:
        """Plan once, and simplify for a duration [s] if one is given, 0 for as long as the time limit allows."""
        setup, begin = self._setup, clock()
        before = setup.counts.copy()
        status = setup.solve(time)
        exact = setup.haveExactSolutionPath()
        found = setup.solution() if setup.haveSolutionPath() else None
        planned = simplified = clock()
        raw = None
        if found is not None and exact and simplification is not None:
            left = time - (planned - begin)
            if left > 0:
                raw = found
                self._make_cheaper(min(simplification, left) if simplification else left)
                found = setup.solution()
            else:
                _log.info("planning took all of the time limit: the path is not simplified")
            simplified = clock()
        counts = setup.counts - before
        counts.nodes = nodes_of(self._planner)
        return self._result(
            status=status.asString(),
            path=found if exact else None,
            approximate_path=None if exact else found,
            planned_path=raw,
            planning_time=planned - begin,
            simplification_time=simplified - planned,
            counts=counts,
        )

    def optimised(self, time: float, stop: Stop) -> PlanResult:
        """Plan again and again until the time is up, and keep the best path; see `safe_ompl.planning.optimise`."""
        setup, begin = self._setup, clock()
        before, simplifier = setup.counts.copy(), setup.simplifier
        nodes, status = 0, "Timeout"

        def search(start: int, left: float) -> FloatArray | None:
            nonlocal nodes, status
            if start:
                setup.clear()
                if isinstance(self._planner, SafePlanner):
                    self._planner.setSeed((self._seed + start) % 2**32)
            found = setup.solve(max(left, _SHORTEST))
            nodes += nodes_of(self._planner)
            if not setup.haveExactSolutionPath():
                return None
            status = found.asString()
            return setup.solution()

        left = time - (clock() - begin)
        found: Optimisation | FastestPath
        if self._cost == "duration":
            found = FastestPath(setup.timer, simplifier, self._seed)
            found.search(search, left, stop)
        else:
            found = optimise(search, simplifier, left, stop)
        path, improvements = found.settled(simplifier)
        if setup.user_checks and path is not None:
            path = next((best for best in (path, *reversed(found.paths)) if setup.is_free(best)), None)
        if path is not None:
            setup.set_solution(path)
        elapsed = clock() - begin
        counts = setup.counts - before
        counts.nodes = nodes
        first = elapsed if found.first_path is None else found.first_path
        return self._result(
            status=status,
            path=path,
            planning_time=first,
            simplification_time=elapsed - first,
            counts=counts,
            improvements=improvements,
        )

    def validated(self, result: PlanResult, report: bool, begin: float) -> PlanResult:
        """Return a result with the validation of its path; `begin` is when all began.

        Raises
        ------
        PlanningError
            If the path is not proven, or is none from a start to the goal.
        """
        setup, name = self._setup, self._name
        setup_time = clock() - begin - result.planning_time - result.simplification_time
        begin = clock()
        path, short = result.path, result.approximate_path
        speeds, duration = setup.getMovingObstacles()
        if short is not None and not setup.is_free(short):
            _log.warning("%s: the approximate solution is not proven free, and dropped", name)
            short = None
        examined: PathReport | None = None
        if path is not None:
            examined = setup.report(path)
            if not examined.certified:
                raise PlanningError(
                    f"{name} returned a path that is not proven free: {examined.validation.why}"
                )
            setup.problem.check_ends(path, name)
        return replace(
            result,
            report=examined if report else None,
            approximate_path=short,
            validation=None if examined is None else examined.validation,
            setup_time=setup_time,
            validation_time=clock() - begin,
            robot=setup.robot,
            scene=setup.scene,
            danger=setup.danger_options,
            moving_obstacles={"speeds": speeds, "time": duration} if speeds else None,
            motion=setup.certified_motion,
        )

    def _result(self, **found: Any) -> PlanResult:
        names = self._setup.robot.joint_names
        return PlanResult(report=None, planner=self._name, seed=self._seed, joint_names=names, **found)

    def _make_cheaper(self, time: float) -> None:
        """Simplify the solution for some seconds."""
        setup = self._setup
        if self._cost == "danger":
            setup.simplifySolution(time)
            return
        path = setup.solution()
        better = FastestPath(setup.timer, setup.simplifier, self._seed).shorten(path, timed(time))
        setup.set_solution(better if setup.is_free(better) else path)


class Interrupts:
    """Notes Ctrl-C while a block runs, and has it handled as it was before; in the main thread, as Python has it.

    Used where the best result so far is returned and no exception is raised.

    Attributes
    ----------
    happened : bool
        Whether there was one.
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


def seconds(name: str, value: Any) -> float:
    """Return a time [s], or raise InputError if it is not a positive finite number."""
    return number(name, value, above=0.0, kind="number of seconds")


def simplification_time(value: bool | float) -> float | None:
    """Return for how long to simplify [s], 0 without limit; None for not at all."""
    if isinstance(value, (bool, np.bool_)):
        return 0.0 if value else None
    return seconds("simplify", value)


def stopping(time: Any) -> Stop:
    """Return a predicate for a time limit [s], 0 for none, or a termination condition."""
    if isinstance(time, ob.PlannerTerminationCondition):
        return lambda: bool(time())
    if not isinstance(time, bool) and isinstance(time, (int, float)) and time == 0:
        return lambda: False
    return timed(seconds("time of simplification", time))


def termination(time: Any) -> Any:
    """Return when to stop. It asks Python, which notices Ctrl-C only when it runs, whenever a C++ planner asks it."""
    if not isinstance(time, ob.PlannerTerminationCondition):
        is_number = isinstance(time, (int, float, np.integer, np.floating)) and not isinstance(time, bool)
        if not (is_number and time >= 0):
            raise InputError(f"time must be a number of seconds or a termination condition, got {time!r}")
        end = clock() + float(time)
        return ob.PlannerTerminationCondition(lambda: clock() >= end)
    return ob.PlannerTerminationCondition(lambda: bool(time()))


# ------------------------------------------------------------------------------------------- the planner given


def check_planner(planner: Any, si: Any) -> None:
    """Raise an error if this is neither a name nor a planner on a space information, or one that cannot be used."""
    if isinstance(planner, str):
        return
    if isinstance(planner, type) and issubclass(planner, ob.Planner):
        raise InputError(
            f"{planner.__name__} is a class: give a planner, {planner.__name__}(setup.getSpaceInformation())"
        )
    if not isinstance(planner, ob.Planner):
        raise InputError(f"planner must be a name of planner_names() or an ob.Planner, got {planner!r}")
    if planner.getSpaceInformation() is not si:
        raise InputError(
            f"{planner.getName()} is a planner of another setup: make it with this one's getSpaceInformation()"
        )
    check_usable(planner)


def seed_ompl(seed: int) -> None:
    """Seed OMPL's C++ planners, quietly: it complains of a second seed, though planners built later do follow it."""
    handler = ou.getOutputHandler()
    ou.noOutputHandler()
    ou.RNG.setSeed(seed + 1)  # zero would mean "by the clock"
    if handler is not None:
        ou.useOutputHandler(handler)


def nodes_of(planner: Any) -> int:
    """Return how many nodes a planner kept."""
    if isinstance(planner, SafePlanner):
        return planner.counts.nodes
    if isinstance(
        planner, og.BITstar
    ):  # reading its graph leaks it, and with it the robot: count its samples
        return int(planner.numBatches() * planner.getSamplesPerBatch())
    data = ob.PlannerData(planner.getSpaceInformation())
    planner.getPlannerData(data)
    return int(data.numVertices())


def planner_data(planner: Any) -> Any:
    """Return what a planner has built, as an `ob.PlannerData`: of our planners, of OMPL's, and outside `SafeSetup`.

    OMPL's bindings let no planner in Python answer `getPlannerData`: under a plain `og.SimpleSetup` that stays empty.
    """
    data = ob.PlannerData(planner.getSpaceInformation())
    fill = getattr(planner, "fillPlannerData", None) or planner.getPlannerData
    fill(data)
    return data
