"""SafeSetup: OMPL's SimpleSetup for a robot in a scene."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og

from safe_ompl.common import FloatArray, InputError, UnknownNameError, clock, finite_array
from safe_ompl.common import seed as checked_seed
from safe_ompl.paths import PathReport, Simplifier, Validation, validate
from safe_ompl.planning.ompl import DurationObjective, ScratchState
from safe_ompl.planning.optimise import COSTS, Cost, Simplification, Timing
from safe_ompl.planning.planners import SafePlanner, SafeRRTConnect, make_planner
from safe_ompl.planning.problem_setup import ProblemSetup
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.run import (
    Interrupts,
    Run,
    check_planner,
    seconds,
    seed_ompl,
    simplification_time,
    stopping,
    termination,
)
from safe_ompl.scene import MotionLimits, People
from safe_ompl.trajectories import PathTimer

_log = logging.getLogger(__name__)


class SafeSetup(ProblemSetup):
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
    field : DangerField or None
        The danger.
    """

    _simplification_time = 0.0

    @cached_property
    def _simplification(self) -> Simplification:
        return Simplification(self.field)

    @cached_property
    def _timing(self) -> Timing:
        return Timing(self.field)

    # -------------------------------------------------------------------------------------------- planning

    def setup(self) -> None:
        """Prepare for `solve`, as OMPL's `setup`; raise InputError if no start or no goal is set."""
        self._adopt_plugins()
        self.problem.check_complete(self.getPlanner())
        self._choose_planner()
        super().setup()

    def setPlanner(self, planner: Any) -> None:
        """Plan with a planner on this setup's space information.

        Raises
        ------
        InputError
            If it is none, one of another setup, or one of OMPL's that cannot be used from Python, such as PRM.
        """
        if isinstance(planner, str):
            raise InputError(f"planner must be an ob.Planner, got {planner!r}; `plan` takes names")
        check_planner(planner, self.getSpaceInformation())
        super().setPlanner(planner)

    def _choose_planner(self) -> None:
        """Take what the allocator makes where no planner is set; without one `SafeRRTConnect`, if the goal allows."""
        allocator = self.getPlannerAllocator()
        if self.getPlanner() is not None:
            return
        if allocator is not None:
            self.setPlanner(allocator(self.getSpaceInformation()))
        elif isinstance(self.getGoal(), ob.GoalSampleableRegion):
            self.setPlanner(SafeRRTConnect(self.getSpaceInformation()))

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
        self.problem.check_complete(self.getPlanner())
        self._choose_planner()
        self.problem.choose_place(self.getPlanner())
        try:
            status = super().solve(stop)
            self.problem.explain_missing_goal()
            return status
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
        time = seconds("time limit", time if optimise is None else optimise)
        simplification = simplification_time(simplify)
        with self._objective_of(cost, planner, parameters):
            run = Run(self, *self.prepare(planner, seed, parameters), seed=seed, cost=cost)
            if simplification is None and optimise is None:
                return run.validated(run.planned(time), report, begin)
            with run.under_own_limit():
                if self.field is not None or optimise is not None:
                    self.simplifier  # noqa: B018  # is made before the clock starts, as the planner is
                with Interrupts() as interrupts:
                    if optimise is not None:
                        result = run.optimised(time, lambda: interrupts.happened)
                    else:
                        result = run.planned(time, simplification)
                result = run.validated(result, report, begin)
            if interrupts.happened and not result:
                raise KeyboardInterrupt
            return replace(result, interrupted=interrupts.happened)

    def prepare(
        self, planner: str | Any, seed: int, parameters: Mapping[str, Any] | None = None
    ) -> tuple[Any, str]:
        """Make planner and problem ready for a run that `seed` decides; return the planner and its name."""
        seed = checked_seed(seed)
        check_planner(planner, self.getSpaceInformation())
        self._adopt_plugins()
        self.problem.check_anew()  # draws random numbers, as the next line does, so they go before the seed
        if not self.getSpaceInformation().isSetup():
            self.getSpaceInformation().setup()
        seed_ompl(seed)
        name = planner if isinstance(planner, str) else planner.getName()  # BITstar renames itself kBITstar
        if isinstance(planner, str):
            planner = make_planner(planner, self.getSpaceInformation(), parameters)
        if isinstance(planner, SafePlanner):
            planner.setSeed(seed)
        self.clear()
        self.problem.choose_goal(planner, seed)
        self.setPlanner(planner)
        self.setup()
        return planner, name

    def getPlannerData(self, data: Any) -> None:
        """Fill an `ob.PlannerData` with what the planner has built; ours also have a `plannerGraph`, with danger."""
        planner = self.getPlanner()
        fill = getattr(planner, "fillPlannerData", None)
        if fill is None:
            super().getPlannerData(data)
        else:
            data.clear()
            fill(data)

    # ------------------------------------------------------------------------------------- paths and solutions

    def solution(self) -> FloatArray:
        """Return the solution path (N, n) found last; raise InputError if there is none."""
        if not self.haveSolutionPath():
            raise InputError("there is no solution: call solve or plan first, and see whether it succeeds")
        path, bridge = self.getSolutionPath(), self.wiring.bridge
        return np.array([bridge.read(path.getState(i)) for i in range(path.getStateCount())])

    def set_solution(self, path: FloatArray) -> None:
        """Put a path (N, n) in the place of the solution; where that was approximate, so is this."""
        solution, scratch = og.PathGeometric(self.getSpaceInformation()), ScratchState(self.wiring.bridge)
        for q in path:
            solution.append(scratch.set(q))
        problem = self.getProblemDefinition()
        approximate, difference = problem.hasApproximateSolution(), problem.getSolutionDifference()
        problem.clearSolutionPaths()
        planner = self.getPlanner()  # none, if a planner solved the problem on its own
        name = "" if planner is None else planner.getName()
        problem.addSolutionPath(solution, approximate, max(0.0, difference), name)

    def report(self, path: ArrayLike) -> PathReport:
        """Validate a path (N, n), and return the report on it; danger and clearance are computed when looked at."""
        self._adopt_plugins()
        array = finite_array(path, (None, self.robot.n), "path")
        return PathReport.of(array, self.checker, self.field, self.certified_motion)

    def is_free(self, path: ArrayLike) -> Validation:
        """Return whether a path (N, n) may be driven in this scene, under the constraints set now.

        Returns
        -------
        Validation
            True if so; else `why` names the edge and the pair, and `refused` holds them.

        Raises
        ------
        InputError
            If the path is empty, has the wrong shape, or is not finite.
        """
        self._adopt_plugins()
        array = finite_array(path, (None, self.robot.n), "path")
        if not len(array):
            raise InputError("path must have a configuration at least, got none")
        return validate(array, self.certified_motion)

    # ----------------------------------------------------------------------------------------- simplification

    @property
    def simplifier(self) -> Simplifier:
        """What makes paths cheaper; raises InputError if this setup plans without danger."""
        return self._simplification.by(self.certified_motion)

    def setSimplification(self, **options: Any) -> None:
        """Set options of the danger-aware simplification; names and errors as `Simplifier`."""
        self._simplification.set(self.certified_motion, options)

    def simplifySolution(self, time: Any = 0.0, *, free_goal: bool = False) -> None:
        """Make the solution shorter and safer, see `simplify_danger`; every path on the way is proven.

        Without danger OMPL's own simplifier does it, and its path is taken if it is proven, too. The user's own checks
        are asked about every edge on the way, and about the path at the end.

        Parameters
        ----------
        time : float or ob.PlannerTerminationCondition
            For how long [s], or until when; 0: until nothing more is to gain.
        free_goal : bool
            Whether the goal configuration may move where the goal is a `WorkspaceGoal`.

        Raises
        ------
        InputError
            If there is no solution, or the time is neither.
        """
        if not self.haveSolutionPath():
            raise InputError("there is no solution to simplify")
        self._adopt_plugins()
        begin, path = perf_counter(), self.solution()
        if self.field is not None:
            place = self.problem.place
            goal = place if free_goal and self.getGoal() is place else None
            self.set_solution(self.simplifier.simplify(path, stopping(time), goal=goal, proven=True))
        else:
            super().simplifySolution(time)
        if (self.field is None or self.user_checks) and not self.is_free(self.solution()):
            # Samples of a motion are not those of its parts: a check of the user's own may refuse these after all.
            _log.info("the simplified path is refused; the solution stays as it was")
            self.set_solution(path)
        self._simplification_time = perf_counter() - begin

    def getLastSimplificationTime(self) -> float:
        """Return how long the last simplification took [s]."""
        return self._simplification_time

    # -------------------------------------------------------------------------------------------------- timing

    def setMotionLimits(self, motion: MotionLimits | None = None, people: People | None = None) -> None:
        """Say what trajectories keep to, for `plan(cost="duration")`: limits of the joints, speeds, and people.

        Parameters
        ----------
        motion : MotionLimits, optional
            Of joints, tool and links.
        people : People, optional
            Who may come near, and how fast.
        """
        self._timing = Timing(self.field, motion, people)

    @property
    def timer(self) -> PathTimer:
        """What times paths within the limits that `setMotionLimits` set; errors as `Timing.timer`."""
        return self._timing.timer(self.certified_motion)

    @contextmanager
    def _objective_of(
        self, cost: Cost, planner: str | Any, parameters: Mapping[str, Any] | None
    ) -> Iterator[None]:
        """Within, have OMPL's planners plan for a cost; ours plan away from danger in any case."""
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
        try:
            yield
        finally:
            if replaced is not None:
                self.setOptimizationObjective(replaced)
