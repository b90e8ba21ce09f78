"""SafeSetup, OMPL's SimpleSetup for a robot in a scene; from a scenario to a setup or a result; repair."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob

import safe_ompl.motions as motions
import safe_ompl.planning.simplification as simplification
import safe_ompl.scene as scenes
from safe_ompl.common import (
    FloatArray,
    InputError,
    PlanningError,
    clock,
    ctrl_c_as_such,
    documents as document,
    number,
    seed as checked_seed,
    whole_number,
)
from safe_ompl.danger import DangerField
from safe_ompl.planning.ompl import DangerObjective
from safe_ompl.planning.planners import SafePlanner, SafeRRTConnect, check_planner, make_planner, seed_ompl, termination
from safe_ompl.planning.problem_setup import ProblemSetup
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.run import PlanningRun, best_start, noted_ctrl_c, stopping, told, validated
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)


class SafeSetup(ProblemSetup):
    """An `og.SimpleSetup` with the robot's joint space, certified motions and the danger objective.

    Everything that OMPL's SimpleSetup does works as usual; `plan` is a short cut that also reports.

    Parameters
    ----------
    robot, scene : Robot, Scene
        The robot, and the obstacles.
    danger : mapping or None
        Options of `DangerField` (aggregate, weighting, …) and `spacing` of the danger points [m]. Where no obstacle is
        dangerous, danger is zero. None plans without danger.
    movable : sequence of str
        Names of obstacles that will move, so that `moveObstacle` is quick from the first time on.

    Attributes
    ----------
    counts, field : Counts, DangerField or None
        Queries and field evaluations so far, and the danger.
    """

    _simplification_time = 0.0
    _simplifier: simplification.Simplifier | None = None
    _simplification: Mapping[str, Any] = {}

    # -------------------------------------------------------------------------------------------- planning

    def setup(self) -> None:
        """Prepare for `solve`, as OMPL's `setup`; raise InputError if no start or no goal is set."""
        self.problem.check_complete(self.getPlanner())
        self._choose_planner()
        super().setup()

    def setPlanner(self, planner: Any) -> None:
        """Plan with a planner on this setup's space information; an InputError if it cannot be used with it."""
        if isinstance(planner, str):
            raise InputError(f"planner must be an ob.Planner, got {planner!r}; `plan` takes names")
        check_planner(planner, self.getSpaceInformation())
        if planner is not self.getPlanner():
            planner.clear()  # may have been set before, for another scene or problem
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

    @ctrl_c_as_such()
    def solve(self, time: float | ob.PlannerTerminationCondition = 1.0) -> ob.PlannerStatus:
        """Plan with the planner that is set, `SafeRRTConnect` if none is, as OMPL's `solve`; may be interrupted.

        The goal is what was set last; `SafeJTRRT` plans to the `setWorkspaceGoal` even if configurations came later.
        Solutions of another problem are forgotten, and so is what the planner has built as far as it does not hold.
        Ctrl-C and exceptions of the user's callbacks end it at once and arrive unchanged. Then there is no solution,
        and the planner is cleared: it may have stopped between two halves of a step. The time is a limit [s], infinity
        for none, or an `ob.PlannerTerminationCondition`. An InputError if it is neither, or no start or no goal is set;
        a PlanningError if the planner returns a path that is not from a start to the goal.
        """
        stop = termination(time)
        self.problem.check_complete(self.getPlanner())
        self._choose_planner()
        self.problem.choose_place(self.getPlanner())
        objective = self.getOptimizationObjective()
        asked: AbstractContextManager[None] = nullcontext()
        if isinstance(objective, DangerObjective) and not isinstance(self.getPlanner(), SafePlanner):
            super().setup()
            asked = objective.asked_by(self.getPlanner())
        try:
            self.problem.forget_stale()
            self.problem.begin()
            with asked:
                status = super().solve(stop)
            self.problem.explain_missing_goal()
            if (wrong := self.problem.forget_wrong()) is not None:
                raise PlanningError(f"{self.getPlanner().getName()} returned a path that {wrong}")
            return status
        except BaseException:
            self.getProblemDefinition().clearSolutionPaths()
            if self.getPlanner() is not None:
                self.getPlanner().clear()
            raise

    @ctrl_c_as_such()
    def plan(
        self,
        planner: str | Any = "SafeRRTConnect",
        *,
        time: float = 5.0,
        seed: int = 0,
        parameters: Mapping[str, Any] | None = None,
        simplify: bool | float = False,
        optimise: float | None = None,
        starts: int = 1,
        workers: int = 1,
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
        starts : int
            Plan so often, with seeds that count up from `seed`, and return the best path: that of least cost by this
            setup's objective, of equal ones the first. The time limit is that of each start.
        workers : int
            How many processes share the starts, which then take ⌈starts/workers⌉ time limits at most. The result does
            not depend on it, as long as no start runs into its limit.

        Raises
        ------
        InputError
            Time not positive, unknown planner or parameter, a planner of another setup; to optimise without danger;
            less than 1 start or worker.
        PlanningError
            If a planner returns a path that the validator refuses, or that is not from a start to the goal.
        KeyboardInterrupt
            On Ctrl-C before there is a path. Later it ends simplification and optimisation, and the best path so far
            is returned; `PlanResult.interrupted` says so.
        """
        begin = clock()
        time = number("time limit", time if optimise is None else optimise, above=0.0, kind="number of seconds")
        simplification = simplification_time(simplify)
        starts, seed = whole_number("starts", starts, at_least=1), checked_seed(seed)
        keeps = starts > 1 or simplification is not None or optimise is not None  # the best path at Ctrl-C

        def once(seed: int) -> PlanResult:
            run = PlanningRun(self, *self.prepare(planner, seed, parameters), seed)
            if optimise is not None or (simplification is not None and self.field is not None):
                self.simplifier  # noqa: B018  # is made before the clock starts, as the planner is
            if optimise is not None:
                return run.optimised(time, told(run.name, time, lambda: bool(interrupts)))
            return run.planned(time, simplification)

        with noted_ctrl_c() if keeps else nullcontext(list[int]()) as interrupts:
            seeds = [(seed + k) % 2**32 for k in range(starts)]
            result = once(seed) if starts == 1 else best_start(self, once, seeds, workers, interrupts)
        result = validated(self, result, begin)
        if interrupts and not result:
            raise KeyboardInterrupt
        return replace(result, interrupted=bool(interrupts))

    def prepare(self, planner: str | Any, seed: int, parameters: Mapping[str, Any] | None = None) -> tuple[Any, str]:
        """Make planner and problem ready for a run that `seed` decides; return the planner and its name."""
        seed = checked_seed(seed)
        check_planner(planner, self.getSpaceInformation())
        self.problem.check_anew()  # draws random numbers, as the next lines do, so they go before the seed
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

    # ----------------------------------------------------------------------------------- motions from outside

    def check(
        self,
        motion: Any,
        limits: motions.RateLimits | None = None,
        people: scenes.People | None = None,
        time: float | None = None,
    ) -> motions.MotionCheck:
        """Prove a motion that something else made under the constraints set now; see `safe_ompl.check`."""
        limit = motions.TIME if time is None else time
        return motions.check_with(motion, self.motion_prover, limits, people=people, time=limit)

    def repair(
        self,
        motion: Any,
        limits: motions.RateLimits | None = None,
        people: scenes.People | None = None,
        *,
        time: float = 2.0,
    ) -> motions.Repair:
        """Return a motion with as little changed as a proof needs; see `safe_ompl.repair`."""
        limit = number("time limit", time, above=0.0, kind="number of seconds")
        return motions.repair_with(motion, self.motion_prover, limits, connecting(self, limit), people)

    # ----------------------------------------------------------------------------------------- simplification

    @property
    def simplifier(self) -> simplification.Simplifier:
        """What makes paths cheaper; raises InputError if this setup plans without danger."""
        if self._simplifier is None or self._simplifier.checker is not self.checker:
            self.setSimplification(**self._simplification)
        assert self._simplifier is not None
        if self._simplifier.motion is not self.motion_prover:
            self._simplifier = self._simplifier.proving_by(self.motion_prover)
        return self._simplifier

    def setSimplification(self, **options: Any) -> None:
        """Set options of the danger-aware simplification: names and errors as `Simplifier`, errors as `simplifier`."""
        if self.field is None:
            raise InputError("danger-aware simplification needs a danger field; this setup plans without danger")
        self._simplifier = simplification.Simplifier(self.checker, self.field, self.motion_prover, **options)
        self._simplification = options

    def simplifySolution(self, time: Any = 0.0) -> None:
        """Make the solution shorter and safer, see `Simplifier`; every path on the way is proven.

        The time is for how long [s], or an `ob.PlannerTerminationCondition`; 0: until nothing more is to gain. An
        InputError if there is no solution. A setup that plans without danger makes it shorter, and keeps its clearance
        all the same. The user's own checker is asked about every edge on the way, and about the path at the end.
        """
        if not self.haveSolutionPath():
            raise InputError("there is no solution to simplify")
        begin, path = perf_counter(), self.solution()
        simplifier = self._lengths_only if self.field is None else self.simplifier
        self.set_solution(simplifier.simplify(path, stopping(time), proven=True))
        if self.getConstraints().user is not None and not self.is_free(self.solution()):
            # Samples of a motion are not those of its parts: a check of the user's own may refuse these after all.
            _log.info("the simplified path is refused; the solution stays as it was")
            self.set_solution(path)
        self._simplification_time = perf_counter() - begin

    @property
    def _lengths_only(self) -> simplification.Simplifier:
        """What makes paths shorter where nothing is dangerous."""
        return simplification.Simplifier(self.checker, DangerField(self.robot, np.empty((0, 3))), self.motion_prover)

    def getLastSimplificationTime(self) -> float:
        """Return how long the last simplification took [s]."""
        return self._simplification_time


def simplification_time(value: bool | float) -> float | None:
    """Return for how long to simplify [s], 0 without limit; None for not at all."""
    if isinstance(value, (bool, np.bool_)):
        return 0.0 if value else None
    return number("simplify", value, above=0.0, kind="number of seconds")


def connecting(setup: SafeSetup, time: float) -> Callable[[FloatArray, FloatArray], FloatArray | None]:
    """Return what finds proven paths between configurations (n,) for repairs, within a time in all [s].

    It plans under the constraints of the setup, whose own problem stays as it is.
    """
    end, own = clock() + time, list[SafeSetup]()

    def connect(start: FloatArray, goal: FloatArray) -> FloatArray | None:
        if clock() >= end:
            return None
        if not own:
            own.append(SafeSetup(setup.robot, setup.scene, danger=setup.danger_options))
            own[0].setConstraints(setup.getConstraints())
        own[0].setConfigurations(start, goal)
        left = max(end - clock(), 1e-3)
        return own[0].plan("SafeRRTConnect", time=left, simplify=0.2 * left).path

    return connect


# ----------------------------------------------------------------------------------------------- from a scenario


def plan(
    scenario: scenes.Scenario | str | Path,
    planner: str = "SafeRRTConnect",
    time: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    **options: Any,
) -> PlanResult:
    """Plan a scenario: the problem itself, or the name or file of one; all else as in `SafeSetup.plan`.

    The time limit [s] is by default the scenario's own, `parameters` override those of the scenario, and `options` are
    `simplify`, `optimise`, `starts` and `workers`. Errors as `SafeSetup.plan`; an InputError, too, if the scenario
    cannot be used.
    """
    begin = clock()
    if not isinstance(scenario, scenes.Scenario):
        scenario = scenes.Scenario.load(scenario)
    setup = setup_scenario(scenario)
    own = scenario.planners.get(planner, {})
    built = clock() - begin
    result = setup.plan(
        planner,
        time=scenario.time if time is None else time,
        seed=seed,
        parameters={**own, **(parameters or {})},
        **options,
    )
    return replace(result, setup_time=built + result.setup_time)


def setup_scenario(scenario: scenes.Scenario, robot: Robot | None = None) -> SafeSetup:
    """Return a SafeSetup with the robot, scene, start and goals of a scenario."""
    robot = robot or scenario.build_robot()
    start, goal = scenario.start_configuration(robot), scenario.goal  # None: steps of a program say where to go
    goals = scenario.goal_configurations(robot) if goal is not None and goal.configurations else None
    with document.within(str(scenario.file or scenario.name), ": "):
        setup = SafeSetup(robot, scenario.scene, danger=scenario.danger)
        if goal is not None and goal.position is not None:
            setup.setWorkspaceGoal(goal.position, goal.rotation, goal.tolerance)
        elif goal is not None and goal.region is not None:
            setup.setGoalRegion(goal.region, goal.tolerance)
        if goals is None:
            setup.setStartConfiguration(start)
        else:
            setup.setConfigurations(start, goals)
        with document.within("limits"):
            limits = scenario.limits
            if limits.max_danger:
                setup.setMaxDanger(limits.max_danger)
            if limits.min_clearance:
                setup.setMinClearance(limits.min_clearance, limits.obstacles, limits.exempt)
            if limits.tool is not None:
                setup.setToolConstraint(limits.tool.axis, limits.tool.direction, limits.tool.angle)
            if limits.tip is not None:
                setup.setTipBounds(*limits.tip.corners)
            if limits.moving is not None:
                with document.within("moving", ": "):
                    setup.setMovingObstacles(limits.moving.speeds, limits.moving.time)
            if limits.tube is not None:
                setup.setTube(limits.tube)
    return setup


def setup_problem(problem: scenes.MbmProblem, robot: Robot) -> SafeSetup:
    """Return a SafeSetup with the scene, start and goals of a problem.

    Limits of joints are widened, with a warning, where a goal is slightly outside; see `MbmProblem.widened_limits`. An
    InputError if the joints are not those of the robot, or start or goals are outside the limits or in collision.
    """
    limits = problem.widened_limits(robot)
    if limits:
        listed = ", ".join(f"{joint} to [{low:g}, {high:g}]" for joint, (low, high) in limits.items())
        _log.warning("%s %d: a goal is outside the limits: widened %s", problem.family, problem.index, listed)
        robot = robot.with_limits(limits)
    setup = SafeSetup(robot, problem.scene)
    setup.setConfigurations(problem.start_configuration(robot), problem.goal_configurations(robot))
    return setup


def repair(
    motion: Any,
    robot: Robot,
    scene: Scene,
    *,
    tube: ArrayLike | Mapping[str, float] | None = None,
    limits: motions.RateLimits | None = None,
    people: scenes.People | None = None,
    time: float = 2.0,
) -> motions.Repair:
    """Return a motion that something else made with as little changed as a proof needs.

    The motion is what `Motion.of` takes, such as way points (N, n), a SciPy spline, or a plain `og.SimpleSetup` that is
    solved; other arguments and errors as `check`, under other constraints it is `SafeSetup.repair`. The time [s] is
    for planning ways round, where moving pieces aside does not succeed.

    Returns
    -------
    Repair
        True if it is proven. `motion` has the ends, the degree, the times and the smoothness of the one given; `path`
        the way points where it is straight between them; `how`, `deviation` and `changed` say what was done. Where
        rates exceed `limits`, or stops are too late for `people`, it takes `slower` times as long.
    """
    setup = SafeSetup(robot, scene)
    if tube is not None:
        setup.setTube(tube)
    return setup.repair(motion, limits, people, time=time)
