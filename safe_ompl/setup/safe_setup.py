"""SafeSetup: OMPL's SimpleSetup wired from a robot and a scene; and `plan`, from a scenario to a result."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from safe_ompl import document
from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import FLOOR
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.errors import InputError, PlanningError
from safe_ompl.paths.report import PathReport
from safe_ompl.paths.simplify.run import Stop
from safe_ompl.paths.simplify.simplifier import Simplifier, timed
from safe_ompl.planners.base import SafePlanner
from safe_ompl.planners.registry import make_planner
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.scenario import Scenario
from safe_ompl.scene.scene import Scene
from safe_ompl.setup.interrupts import Interrupts
from safe_ompl.setup.optimise import optimise as optimise_paths
from safe_ompl.setup.problem import SafeProblem
from safe_ompl.setup.result import PlanResult as PlanResult

_log = logging.getLogger(__name__)

_SHORTEST = 1e-3  # [s] a planner gets at least this


class SafeSetup(SafeProblem):
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

    Attributes
    ----------
    counts : Counts
        Queries and field evaluations so far.
    checker : CollisionChecker
        Robot against scene.
    field : DangerField or None
        The danger.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        danger: Mapping[str, Any] | None = {},
        floor: float = FLOOR,
    ) -> None:
        super().__init__(robot, scene, danger=danger, floor=floor)
        self._simplifier: Simplifier | None = None
        self._simplification_time = 0.0

    def __repr__(self) -> str:
        return f"SafeSetup({self.robot!r}, {self.scene!r})"

    # -------------------------------------------------------------------------------------------- planning

    def solve(self, time: Any = 1.0) -> Any:
        """Plan with the planner that is set, as OMPL's `solve`; may be interrupted.

        The goal is what was set last; `SafeJTRRT` plans to the `setWorkspaceGoal` even if configurations came later.
        Ctrl-C and exceptions of the user's callbacks end it at once and arrive unchanged. Then there is no solution,
        and the planner is cleared: it may have stopped between two halves of a step.

        Parameters
        ----------
        time : float or ob.PlannerTerminationCondition
            Time limit [s], or when to stop.

        Returns
        -------
        ob.PlannerStatus
            The outcome.

        Raises
        ------
        InputError
            If the time is neither, or no start or no goal is set.
        """
        stop = _termination(time)
        self._check_problem()
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
    ) -> PlanResult:
        """Plan from the start to a goal, validate, and report.

        Parameters
        ----------
        planner : str or ob.Planner
            A name of `planner_names()`, or a planner on this setup's space information.
        time : float
            Time limit [s].
        seed : int
            Seed of the planner's random numbers.
        parameters : mapping, optional
            Parameters for a planner given by name.
        simplify : bool or float
            Simplify the solution, as `simplifySolution` does: for some seconds, or until nothing more is to gain.
        optimise : float, optional
            Go on for so many seconds in all, instead of `time`: simplify, start anew, and return the best path.

        Raises
        ------
        InputError
            Time not positive, unknown planner or parameter; to optimise without danger.
        PlanningError
            If a planner returns a path that the validator refuses.
        KeyboardInterrupt
            On Ctrl-C before there is a path. Later it ends simplification and optimisation, and the best path so far
            is returned; `PlanResult.interrupted` says so.
        """
        time = _positive_time("time limit", time if optimise is None else optimise)
        duration = _simplification(simplify)
        planner, name = self.prepare(planner, seed, parameters)
        if duration is None and optimise is None:
            return self._planned(planner, name, seed, time, None)
        self._validator.setDangerLimit(self._limit_of(planner))
        try:
            if self.field is not None:
                self.simplifier  # noqa: B018  # is made before the clock starts, as the planner is
            with Interrupts() as interrupts:
                if optimise is not None:
                    result = self._optimised(planner, name, seed, time, lambda: interrupts.happened)
                else:
                    result = self._planned(planner, name, seed, time, duration)
        finally:
            self._validator.setDangerLimit(self._danger_limit)
        if interrupts.happened and not result:
            raise KeyboardInterrupt
        return replace(result, interrupted=interrupts.happened)

    def _planned(self, planner: Any, name: str, seed: int, time: float, duration: float | None) -> PlanResult:
        """Plan once, and simplify for a duration [s] if one is given, 0 for as long as it takes."""
        begin, before = perf_counter(), self.counts.copy()
        status = self.solve(float(time))
        elapsed = perf_counter() - begin
        nodes = _nodes(planner)
        path = self.solution() if self.haveExactSolutionPath() else None
        self._simplification_time = 0.0
        if path is not None and duration is not None:
            self.simplifySolution(duration)
            path = self.solution()
        counts = self.counts - before
        counts.nodes = nodes
        return PlanResult(
            status.asString(),
            path,
            self._checked_report(path, name),
            name,
            int(seed),
            self.robot.joint_names,
            elapsed,
            self._simplification_time,
            counts,
            **self._about(),
        )

    def prepare(
        self, planner: str | Any, seed: int, parameters: Mapping[str, Any] | None = None
    ) -> tuple[Any, str]:
        """Make planner and problem ready for a run that `seed` decides; return the planner and its name."""
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**32:
            raise InputError(f"seed must be an integer in [0, 2**32), got {seed!r}")
        if not self.getSpaceInformation().isSetup():
            self.getSpaceInformation().setup()  # draws random numbers, so it goes before the seed
        _seed_ompl(int(seed))
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
        begin, before = perf_counter(), self.counts.copy()
        simplifier, nodes, status = self.simplifier, 0, "Timeout"

        def search(start: int, seconds: float) -> FloatArray | None:
            nonlocal nodes, status
            if start:
                self.clear()
                if isinstance(planner, SafePlanner):
                    planner.setSeed((int(seed) + start) % 2**32)
            found = self.solve(max(seconds, _SHORTEST))
            nodes += _nodes(planner)
            if not self.haveExactSolutionPath():
                return None
            status = found.asString()
            return self.solution()

        found = optimise_paths(search, simplifier, time - (perf_counter() - begin), stop)
        elapsed = perf_counter() - begin
        counts = self.counts - before
        counts.nodes = nodes
        path, improvements = found.settled(simplifier)
        if path is not None:
            self._set_solution(path)
        first = elapsed if found.first_path is None else found.first_path
        return PlanResult(
            status,
            path,
            self._checked_report(path, name),
            name,
            int(seed),
            self.robot.joint_names,
            first,
            elapsed - first,
            counts,
            improvements,
            **self._about(),
        )

    def _about(self) -> dict[str, Any]:
        return {"robot": self.robot, "scene": self.scene, "danger": self.danger_options}

    def _checked_report(self, path: FloatArray | None, name: str) -> PathReport | None:
        if path is None:
            return None
        report = self.report(path)
        if not report.certified:
            raise PlanningError(f"{name} returned a path that is not proven free: {report.refused}")
        return report

    # -------------------------------------------------------------------------------------- simplification

    @property
    def simplifier(self) -> Simplifier:
        """What makes paths cheaper; `setSimplification` sets its options.

        Raises
        ------
        InputError
            If this setup plans without danger.
        """
        if self._simplifier is None:
            self.setSimplification()
        assert self._simplifier is not None
        if self._simplifier.motion is not self._validator.motion:
            self._simplifier = self._simplifier.proving_by(self._validator.motion)
        return self._simplifier

    def setSimplification(self, **options: Any) -> None:
        """Set the options of the danger-aware simplification: weight, exponent, clearance, … of `Simplifier`.

        Raises
        ------
        InputError
            If an option is out of range, or this setup plans without danger.
        """
        if self.field is None:
            raise InputError(
                "danger-aware simplification needs a danger field; this setup plans without danger"
            )
        self._simplifier = Simplifier(self.checker, self.field, self._validator.motion, **options)

    def simplifySolution(self, time: Any = 0.0, *, free_goal: bool = False) -> None:
        """Make the solution shorter and safer, see `simplify_danger`; every path on the way is proven.

        Without danger OMPL's own simplifier does it, and its path is taken if it is proven, too.

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
        begin, path = perf_counter(), self.solution()
        if self.field is not None:
            goal = self._place if free_goal and self.getGoal() is self._place else None
            self._set_solution(self.simplifier.simplify(path, _stopping(time), goal=goal, proven=True))
        else:
            super().simplifySolution(time)
            if not PathReport.of(self.solution(), self.checker, None, self._validator.motion).certified:
                self._set_solution(path)
        self._simplification_time = perf_counter() - begin

    def getLastSimplificationTime(self) -> float:
        """Return how long the last simplification took [s]."""
        return self._simplification_time

    def getPlannerData(self, data: Any) -> None:
        """Fill an `ob.PlannerData` with what the planner has built; ours also have a `plannerGraph`, with danger."""
        planner = self.getPlanner()
        if isinstance(planner, SafePlanner):
            data.clear()
            planner.fillPlannerData(data)
        else:
            super().getPlannerData(data)


def plan(
    scenario: Scenario | str | Path,
    planner: str = "SafeRRTConnect",
    time: float | None = None,
    seed: int = 0,
    parameters: Mapping[str, Any] | None = None,
    *,
    simplify: bool | float = False,
    optimise: float | None = None,
) -> PlanResult:
    """Plan a scenario.

    Parameters
    ----------
    scenario : Scenario, str or path
        The problem, or the name or file of one.
    planner : str
        A name of `planner_names()`.
    time : float, optional
        Time limit [s]; the scenario's own by default.
    seed : int
        Seed.
    parameters : mapping, optional
        Planner parameters that override those of the scenario.
    simplify, optimise
        As in `SafeSetup.plan`.

    Returns
    -------
    PlanResult
        True if solved.

    Raises
    ------
    InputError, PlanningError
        As `SafeSetup.plan`; and if the scenario cannot be used.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    setup = setup_scenario(scenario)
    own = scenario.planners.get(planner, {})
    return setup.plan(
        planner,
        time=scenario.time if time is None else time,
        seed=seed,
        parameters={**own, **(parameters or {})},
        simplify=simplify,
        optimise=optimise,
    )


def setup_scenario(scenario: Scenario, robot: Robot | None = None) -> SafeSetup:
    """Return a SafeSetup with the robot, scene, start and goals of a scenario."""
    robot = robot or scenario.build_robot()
    start, goal = scenario.start_configuration(robot), scenario.goal
    goals = scenario.goal_configurations(robot) if goal.configurations else None
    with document.within(str(scenario.file or scenario.name), ": "):
        setup = SafeSetup(robot, scenario.scene, danger=scenario.danger)
        if goal.position is not None:
            setup.setWorkspaceGoal(goal.position, goal.rotation, goal.tolerance)
        if goals is None:
            setup.setStartConfiguration(start)
        else:
            setup.setConfigurations(start, goals)
        with document.within("limits"):
            if scenario.limits.max_danger:
                setup.setMaxDanger(scenario.limits.max_danger)
            if scenario.limits.min_clearance:
                limits = scenario.limits
                setup.setMinClearance(limits.min_clearance, limits.obstacles, limits.exempt)
    return setup


def _positive_time(name: str, value: Any) -> float:
    if isinstance(value, bool) or not (isinstance(value, (int, float)) and np.isfinite(value) and value > 0):
        raise InputError(f"{name} must be a positive number of seconds, got {value!r}")
    return float(value)


def _simplification(value: bool | float) -> float | None:
    """Return for how long to simplify [s], 0 without limit; None for not at all."""
    if isinstance(value, bool):
        return 0.0 if value else None
    return _positive_time("simplify", value)


def _stopping(time: Any) -> Stop:
    """Return a predicate for a time limit [s], 0 for none, or a termination condition."""
    if isinstance(time, ob.PlannerTerminationCondition):
        return lambda: bool(time())
    if time == 0 and not isinstance(time, bool):
        return lambda: False
    return timed(_positive_time("time of simplification", time))


def _termination(time: Any) -> Any:
    """Return when to stop. It asks Python, which notices Ctrl-C only when it runs, whenever a C++ planner asks it."""
    if not isinstance(time, ob.PlannerTerminationCondition):
        if not (isinstance(time, (int, float)) and time >= 0):
            raise InputError(f"time must be a number of seconds or a termination condition, got {time!r}")
        time = ob.timedPlannerTerminationCondition(float(time))
    return ob.PlannerTerminationCondition(lambda: bool(time()))


def _seed_ompl(seed: int) -> None:
    """Seed OMPL's C++ planners, quietly: it complains of a second seed, though planners built later do follow it."""
    handler = ou.getOutputHandler()
    ou.noOutputHandler()
    ou.RNG.setSeed(seed + 1)  # zero would mean "by the clock"
    if handler is not None:
        ou.useOutputHandler(handler)


def _nodes(planner: Any) -> int:
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
