"""SafeSetup: OMPL's SimpleSetup for a robot in a scene."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.errors import InputError, PlanningError
from safe_ompl.maths.kernels.compiled import clock
from safe_ompl.paths.report import PathReport
from safe_ompl.paths.simplify.run import Stop
from safe_ompl.planners.base import SafePlanner
from safe_ompl.planners.registry import make_planner
from safe_ompl.setup.duration import Cost, FastestPath, TimedSetup
from safe_ompl.setup.endpoints import check_endpoints
from safe_ompl.setup.given_planner import check_planner, nodes_of, seed_ompl
from safe_ompl.setup.interrupts import Interrupts
from safe_ompl.setup.optimise import Optimisation
from safe_ompl.setup.optimise import optimise as optimise_paths
from safe_ompl.setup.result import PlanResult
from safe_ompl.setup.time_limits import positive_time, simplification_time, termination

_log = logging.getLogger(__name__)

_SHORTEST = 1e-3  # [s] a planner gets at least this


class SafeSetup(TimedSetup):
    """An `og.SimpleSetup` with the robot's joint space, certified motions and the danger objective.

    Everything that OMPL's SimpleSetup does works as usual; `plan` is a short cut that also reports.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        The obstacles.
    danger : mapping or None
        Options of `DangerField` (aggregate, weighting, sharpness, …) and `spacing` of the danger points [m].
        Where no obstacle is dangerous, danger is zero. None plans without danger.
    floor : float
        [m] Motions with less clearance than about this stay undecided, and count as blocked.
    movable : sequence of str
        Names of obstacles that will move, so that `moveObstacle` is quick from the first time on.

    Attributes
    ----------
    counts : Counts
        Queries and field evaluations so far.
    checker : CollisionChecker
        Robot against scene.
    field : DangerField or None
        The danger.
    """

    def __repr__(self) -> str:
        return f"SafeSetup({self.robot!r}, {self.scene!r})"

    # -------------------------------------------------------------------------------------------- planning

    def solve(self, time: Any = 1.0) -> Any:
        """Plan with the planner that is set, `SafeRRTConnect` if none is, as OMPL's `solve`; may be interrupted.

        The goal is what was set last; `SafeJTRRT` plans to the `setWorkspaceGoal` even if configurations came later.
        Ctrl-C and exceptions of the user's callbacks end it at once and arrive unchanged. Then there is no solution,
        and the planner is cleared: it may have stopped between two halves of a step.

        Parameters
        ----------
        time : float or ob.PlannerTerminationCondition
            Time limit [s], infinity for none, or when to stop.

        Returns
        -------
        ob.PlannerStatus
            The outcome.

        Raises
        ------
        InputError
            If the time is neither, or no start or no goal is set.
        """
        stop = termination(time)
        self._adopt_plugins()
        self._check_problem()
        self._choose_planner()
        self._choose_place()
        try:
            return super().solve(stop)
        except BaseException:
            self.getProblemDefinition().clearSolutionPaths()
            if self.getPlanner() is not None:
                self.getPlanner().clear()
            raise

    def plan(
        self,
        planner: str | Any = "SafeRRTConnect",
        *,
        time: float = 5.0,
        seed: int = 0,
        parameters: Mapping[str, Any] | None = None,
        simplify: bool | float = False,
        optimise: float | None = None,
        cost: Cost = "danger",
        report: bool = True,
    ) -> PlanResult:
        """Plan from the start to a goal, and validate the path.

        Parameters
        ----------
        planner : str or ob.Planner
            A name of `planner_names()`, or a planner on this setup's space information.
        time : float
            Time limit [s] of planning and simplification together.
        seed : int
            Seed of the planner's random numbers.
        parameters : mapping, optional
            Parameters for a planner given by name.
        simplify : bool or float
            Simplify the solution, as `simplifySolution` does: for some seconds, or until nothing more is to gain, and
            no longer than the time limit allows.
        optimise : float, optional
            Go on for so many seconds in all, instead of `time`: simplify, start anew, and return the best path.
        cost : {"danger", "duration"}
            What simplification and optimisation make less: length and danger, or the time that the trajectory takes
            within what `setMotionLimits` says. OMPL's planners plan with a `DurationObjective` then.
        report : bool
            Whether the result has a report; its danger and clearance are computed when they are looked at. The path is
            validated in any case.

        Raises
        ------
        InputError
            Time not positive, unknown planner or parameter, a planner of another setup; to optimise without danger;
            unknown cost, or limits missing that a duration needs.
        PlanningError
            If a planner returns a path that the validator refuses, or that is not from a start to the goal.
        KeyboardInterrupt
            On Ctrl-C before there is a path. Later it ends simplification and optimisation, and the best path so far
            is returned; `PlanResult.interrupted` says so.
        """
        begin = clock()
        time = positive_time("time limit", time if optimise is None else optimise)
        duration = simplification_time(simplify)
        with self._choosing(cost, planner, parameters):
            planner, name = self.prepare(planner, seed, parameters)
            if duration is None and optimise is None:
                result = self._planned(planner, name, seed, time, None)
                return self._validated(result, name, report, begin)
            self._validator.setDangerLimit(self._limit_of(planner))
            try:
                if self.field is not None or optimise is not None:
                    self.simplifier  # noqa: B018  # is made before the clock starts, as the planner is
                with Interrupts() as interrupts:
                    if optimise is not None:
                        result = self._optimised(planner, name, seed, time, lambda: interrupts.happened)
                    else:
                        result = self._planned(planner, name, seed, time, duration)
                result = self._validated(result, name, report, begin)
            finally:
                self._validator.setDangerLimit(self._danger_limit)
            if interrupts.happened and not result:
                raise KeyboardInterrupt
            return replace(result, interrupted=interrupts.happened)

    def _planned(self, planner: Any, name: str, seed: int, time: float, duration: float | None) -> PlanResult:
        """Plan once, and simplify for a duration [s] if one is given, 0 for as long as the time limit allows."""
        begin, before = clock(), self.counts.copy()
        status = self.solve(time)
        exact = self.haveExactSolutionPath()
        found = self.solution() if self.haveSolutionPath() else None
        planned = simplified = clock()
        raw = None
        if found is not None and exact and duration is not None:
            left = time - (planned - begin)
            if left > 0:
                raw = found
                self._make_cheaper(min(duration, left) if duration else left, seed)
                found = self.solution()
            else:
                _log.info("planning took all of the time limit: the path is not simplified")
            simplified = clock()
        counts = self.counts - before
        counts.nodes = nodes_of(planner)
        return PlanResult(
            *(status.asString(), found if exact else None, None),
            *(name, int(seed), self.robot.joint_names),
            *(planned - begin, simplified - planned, counts),
            approximate_path=None if exact else found,
            planned_path=raw,
        )

    def _validated(self, result: PlanResult, name: str, report: bool, begin: float) -> PlanResult:
        """Return a result with the validation of its path; `begin` is when all began.

        Raises
        ------
        PlanningError
            If the path is not proven, or is none from a start to the goal.
        """
        setup_time = clock() - begin - result.planning_time - result.simplification_time
        begin = clock()
        path, short = result.path, result.approximate_path
        speeds, duration = self.getMovingObstacles()
        if short is not None and not self.is_free(short):
            _log.warning("%s: the approximate solution is not proven free, and dropped", name)
            short = None
        examined: PathReport | None = None
        if path is not None:
            examined = self.report(path)
            if not examined.certified:
                raise PlanningError(
                    f"{name} returned a path that is not proven free: {examined.validation.why}"
                )
            check_endpoints(path, self.getProblemDefinition(), self._bridge, name)
        return replace(
            result,
            report=examined if report else None,
            approximate_path=short,
            validation=None if examined is None else examined.validation,
            setup_time=setup_time,
            validation_time=clock() - begin,
            robot=self.robot,
            scene=self.scene,
            danger=self.danger_options,
            moving_obstacles={"speeds": speeds, "time": duration} if speeds else None,
            motion=self._validator.motion,
        )

    def prepare(
        self, planner: str | Any, seed: int, parameters: Mapping[str, Any] | None = None
    ) -> tuple[Any, str]:
        """Make planner and problem ready for a run that `seed` decides; return the planner and its name."""
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**32:
            raise InputError(f"seed must be an integer in [0, 2**32), got {seed!r}")
        check_planner(planner, self.getSpaceInformation())
        self._adopt_plugins()
        self._check_anew()  # draws random numbers, as the next line does, so they go before the seed
        if not self.getSpaceInformation().isSetup():
            self.getSpaceInformation().setup()
        seed_ompl(int(seed))
        name = planner if isinstance(planner, str) else planner.getName()  # BITstar renames itself kBITstar
        if isinstance(planner, str):
            planner = make_planner(planner, self.getSpaceInformation(), parameters)
        if isinstance(planner, SafePlanner):
            planner.setSeed(int(seed))
        self.clear()
        self._choose_goal(planner, int(seed))
        self.setPlanner(planner)
        self.setup()
        return planner, name

    def _limit_of(self, planner: Any) -> DangerLimit | None:
        """Return the limit that holds for what is made of a planner's path: the planner's own, or the setup's."""
        own = planner.getMaxDanger() if isinstance(planner, SafePlanner) else 0.0
        if not own or self.field is None or (self._danger_limit and self._danger_limit.limit <= own):
            return self._danger_limit
        return DangerLimit(self.field, own)

    def _optimised(self, planner: Any, name: str, seed: int, time: float, stop: Stop) -> PlanResult:
        """Plan again and again; see `safe_ompl.setup.optimise`."""
        begin, before = clock(), self.counts.copy()
        simplifier, nodes, status = self.simplifier, 0, "Timeout"

        def search(start: int, seconds: float) -> FloatArray | None:
            nonlocal nodes, status
            if start:
                self.clear()
                if isinstance(planner, SafePlanner):
                    planner.setSeed((int(seed) + start) % 2**32)
            found = self.solve(max(seconds, _SHORTEST))
            nodes += nodes_of(planner)
            if not self.haveExactSolutionPath():
                return None
            status = found.asString()
            return self.solution()

        left = time - (clock() - begin)
        found: Optimisation | FastestPath
        if self._cost == "duration":
            found = FastestPath(self.timer, simplifier, int(seed))
            found.search(search, left, stop)
        else:
            found = optimise_paths(search, simplifier, left, stop)
        path, improvements = found.settled(simplifier)
        if self.user_checks and path is not None:
            path = next((best for best in (path, *reversed(found.paths)) if self.is_free(best)), None)
        if path is not None:
            self._set_solution(path)
        elapsed = clock() - begin
        counts = self.counts - before
        counts.nodes = nodes
        first = elapsed if found.first_path is None else found.first_path
        return PlanResult(
            *(status, path, None, name, int(seed), self.robot.joint_names),
            *(first, elapsed - first, counts, improvements),
        )
