"""One run of a planner: plan, simplify or optimise, and validate what comes of it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from safe_ompl.common import Counts, FloatArray, PlanningError, clock
from safe_ompl.danger import DangerLimit
from safe_ompl.paths import Stop
from safe_ompl.planning.optimise import optimise
from safe_ompl.planning.planners import SafePlanner, nodes_of
from safe_ompl.planning.result import PlanResult

_log = logging.getLogger(__name__)

_SHORTEST = 1e-3  # [s] a planner gets at least this


class PlanningRun:
    """One run of a planner that `SafeSetup.prepare` has made ready; `name` is what the result calls it."""

    def __init__(self, setup: Any, planner: Any, name: str, seed: int) -> None:
        self._setup, self._planner, self.name, self._seed = setup, planner, name, seed

    @contextmanager
    def under_own_limit(self) -> Iterator[None]:
        """Prove motions within the planner's own danger limit, too: what is made of its path must keep to that."""
        own = self._planner.getMaxDanger() if isinstance(self._planner, SafePlanner) else 0.0
        validator, constraints, field = self._setup.validator, self._setup.getConstraints(), self._setup.field
        limit = constraints.danger
        if not own or field is None or (limit is not None and limit.limit <= own):
            yield
            return
        validator.setConstraints(replace(constraints, danger=DangerLimit(field, own)))
        try:
            yield
        finally:
            validator.setConstraints(self._setup.getConstraints())

    def planned(self, time: float, simplification: float | None = None) -> PlanResult:
        """Plan once, and simplify for a duration [s] if one is given, 0 for as long as the time limit allows."""
        setup, begin = self._setup, clock()
        before = setup.counts.copy()
        status = setup.solve(time)
        path = setup.solution() if setup.haveExactSolutionPath() else None
        planned, raw = clock(), None
        left = time - (planned - begin)
        if path is not None and simplification is not None:
            if left > 0:
                setup.simplifySolution(min(simplification, left) if simplification else left)
                raw, path = path, setup.solution()
            else:
                _log.info("planning took all of the time limit: the path is not simplified")
        found = {"status": status.asString(), "path": path, "planned_path": raw}
        simplified = 0.0 if raw is None else clock() - planned
        return self._result(before, nodes_of(self._planner), planned - begin, simplified, found)

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
            status, path = found.asString(), setup.solution()
            return np.asarray(path)

        found = optimise(search, simplifier, time - (clock() - begin), stop)
        path, improvements = found.settled(simplifier)
        if path is not None and setup.getConstraints().user is not None:
            path = next((best for best in (path, *reversed(found.paths)) if setup.is_free(best)), None)
        if path is not None:
            setup.set_solution(path)
        elapsed = clock() - begin
        first = elapsed if found.first_path is None else found.first_path
        said = {"status": status, "path": path, "improvements": improvements}
        return self._result(before, nodes, first, elapsed - first, said)

    def validated(self, result: PlanResult, begin: float) -> PlanResult:
        """Return a result with the report on its path; a PlanningError if it is not proven, or leads elsewhere."""
        setup, path = self._setup, result.path
        setup_time = clock() - begin - result.planning_time - result.simplification_time
        begin, report = clock(), None
        if path is not None:
            report = setup.report(path)
            if not report.certified:
                raise PlanningError(f"{self.name} returned a path that is not proven free: {report.validation.why}")
            setup.problem.check_ends(path, self.name)
        separation = setup.getConstraints().separation
        moving = {"speeds": dict(separation.speeds), "time": separation.time} if separation.speeds else None
        return replace(
            result,
            report=report,
            setup_time=setup_time,
            validation_time=clock() - begin,
            robot=setup.robot,
            scene=setup.scene,
            danger=setup.danger_options,
            moving_obstacles=moving,
            motion=setup.motion_prover,
        )

    def _result(
        self, before: Counts, nodes: int, planning_time: float, simplification_time: float, found: dict[str, Any]
    ) -> PlanResult:
        """Return what was found, with times [s] and the work done since the counts were `before`."""
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
            **found,
        )
