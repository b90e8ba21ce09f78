"""SafeSetup: OMPL's SimpleSetup for a robot in a scene, with constraints, danger, proofs and reports; and `repair`."""

from __future__ import annotations

import atexit
import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob, geometric as og, util as ou

import safe_ompl.motions as motions
import safe_ompl.planning.simplification as simplification
import safe_ompl.scene as scenes
from safe_ompl.collision import CollisionChecker, MotionProver, TipBounds, ToolLimit, ToolOrientation
from safe_ompl.common import (
    Counts,
    FloatArray,
    InputError,
    PlanningError,
    finite_array,
    instance,
    number,
    seed as checked_seed,
    whole_number,
)
from safe_ompl.danger import DangerField, DangerLimit
from safe_ompl.geometry import Obstacle
from safe_ompl.motions import Constraints
from safe_ompl.planning.ompl import (
    REGION_TOLERANCE,
    RESOLUTION,
    TOLERANCE,
    CertifiedMotionValidator,
    CollisionFreeValidity,
    DangerObjective,
    RegionGoal,
    SampledValidity,
    WorkspaceGoal,
)
from safe_ompl.planning.planners import (
    FunctionPlanner,
    SafePlanner,
    SafeRRTConnect,
    check_planner,
    make_planner,
    seed_ompl,
    termination,
)
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.run import PlanningRun, best_start, noted_ctrl_c, stopping, told, validated
from safe_ompl.planning.start_and_goals import StartAndGoals
from safe_ompl.planning.ways import all_ways
from safe_ompl.robot import GoalRegion, Robot, ScratchState, joint_space, place_of
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

UP = (0.0, 0.0, 1.0)


class SafeSetup(og.SimpleSetup):  # type: ignore[misc]
    """An `og.SimpleSetup` with the robot's joint space, certified motions and the danger objective.

    Everything that OMPL's SimpleSetup does works as usual; `plan` is a short cut that also reports. Every path keeps to
    the constraints that are set, whichever planner plans it, and this is proven along whole motions. A constraint that
    the start or all goals break is refused: a CollisionError says why, and all stays what it was.

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

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> setup = SafeSetup(robot, Scene([Obstacle("post", Box([0.15, 0.15, 1.0]), Pose([0.45, 0.0, 0.4]), weight=1.0)]))
    >>> setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0])
    >>> bool(setup.plan("SafeRRTConnect", seed=0))
    True
    """

    _simplification_time = 0.0
    _simplifier: simplification.Simplifier | None = None
    _simplification: Mapping[str, Any] = {}

    def __init__(
        self, robot: Robot, scene: Scene, *, danger: Mapping[str, Any] | None = {}, movable: Sequence[str] = ()
    ) -> None:
        counts = Counts()
        checker = CollisionChecker(robot, scene, counts, movable=movable)
        super().__init__(joint_space(robot))
        # LOG_DEBUG is OMPL's default, so nobody asked for these lines.
        if ou.getLogLevel() == ou.LogLevel.LOG_DEBUG:
            ou.setLogLevel(ou.LogLevel.LOG_WARN)
        si = self.getSpaceInformation()
        self.robot, self.counts = robot, counts
        self.field = None if danger is None else DangerField.of_options(robot, scene, danger, self.counts)
        self.danger_options = None if danger is None else dict(danger)
        self.validity = CollisionFreeValidity(si, checker)
        si.setStateValidityChecker(self.validity)
        self.validator = CertifiedMotionValidator(si, checker)
        si.setMotionValidator(self.validator)
        self.bridge = self.validity.bridge
        self._user_is_let_go = False
        self.query = StartAndGoals(self, super().getProblemDefinition())
        if self.field is not None:
            self.setOptimizationObjective(DangerObjective(si, self.field))

    # OMPL's own `repr` would ask thousands of queries.
    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.robot!r}, {self.scene!r})"

    @property
    def checker(self) -> CollisionChecker:
        """Robot against scene."""
        return self.validity.checker

    @property
    def motion_prover(self) -> MotionProver:
        """What proves motions under the constraints that are set now."""
        return self.validator.motion

    # -------------------------------------------------------------------------------------------------------- the scene

    @property
    def scene(self) -> Scene:
        """The obstacles."""
        return self.checker.scene

    def addObstacle(self, obstacle: Obstacle) -> None:
        """Put one more obstacle into the scene; errors as `setScene`, and an InputError where its name is taken."""
        self.setScene(self.scene.with_obstacles(obstacle))

    def removeObstacle(self, name: str) -> None:
        """Take an obstacle out of the scene; raise UnknownNameError if there is none of that name."""
        self.setScene(self.scene.without(name))

    def moveObstacle(self, name: str, place: Any) -> None:
        """Move one obstacle to a pose, or a person to key points, or a cloud to points; errors as `Scene.moved`."""
        self.moveObstacles({name: place})

    def moveObstacles(self, places: Mapping[str, Any]) -> None:
        """Move several obstacles at once; places and errors as `Scene.moved`."""
        self.setScene(self.scene.moved(places))

    def setScene(self, scene: Scene) -> None:
        """Plan in another scene from here on, under all constraints that are set.

        Where only places of obstacles differ that were `movable`, or have moved before, it takes a millisecond. The
        solution and what the planner has built are forgotten; start and goals are checked when planning begins. An
        InputError if it is no scene, an UnknownNameError if a constraint is about an obstacle that it does not have:
        then the scene stays what it was.
        """
        instance("scene", scene, Scene)
        try:
            self.checker.move(scene)
        # More has changed than the poses of movable obstacles.
        except InputError:
            moved = {o.name for o in self.scene if o.name in scene.names and o != scene[o.name]}
            movable = [name for name in scene.names if name in moved | self.checker.movable]
            checker = CollisionChecker(self.robot, scene, self.counts, movable=movable)
            self._put(self.getConstraints().in_scene_of(checker), checker)
        if self.field is not None:
            self.field.move(scene)
        self.clear()
        self.query.scene_changed()

    # ------------------------------------------------------------------------------------------------------ constraints

    def getConstraints(self) -> Constraints:
        """Return what every path must keep to besides joint limits and collision."""
        return self.validity.getConstraints()

    def setConstraints(self, constraints: Constraints) -> None:
        """Set all constraints at once; where that fails they stay what they were.

        The solution and what the planner has built are forgotten, as other constraints need not allow them. A
        CollisionError if start or all goals that are set break them; an UnknownNameError if one is about an obstacle
        that the scene does not have.
        """
        before = self.getConstraints()
        self._put(instance("constraints", constraints, Constraints))
        try:
            self.query.check()
        except BaseException:
            self._put(before)
            raise
        self.clear()

    def _put(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Put constraints in place, and perhaps the checker of another scene; all stays what it was on an error."""
        if constraints.user is not None and not self._user_is_let_go:
            # A user's function refers to its module, which refers to the setup. The cycle closes in C++, where Python's
            # garbage collector cannot see it: OMPL would report a leak at the end of the program.
            atexit.register(_let_go, ref(self))
            self._user_is_let_go = True
        self.validity.setConstraints(constraints, checker)
        self.validator.setConstraints(constraints, checker)

    def _constrain(self, **changed: Any) -> None:
        self.setConstraints(replace(self.getConstraints(), **changed))

    def setMaxDanger(self, limit: float) -> None:
        """Set the danger that no configuration of a path may exceed, in the units of the danger field; 0: any danger.

        Errors as `setConstraints`; an InputError if it is negative or not finite, or there is no danger field.
        """
        if self.field is None:
            raise InputError("max danger needs a danger field, and this setup has none")
        self._constrain(danger=DangerLimit(self.field, limit) if number("max danger", limit, at_least=0) else None)

    def setMinClearance(
        self, distance: float, obstacles: Sequence[str] | None = None, exempt: Sequence[tuple[str, str]] = ()
    ) -> None:
        """Set the distance that every path must keep from obstacles; arguments and errors of `MinClearance.of`.

        Where no obstacles are named, it is kept from those that are dangerous, in other scenes, too. Errors as
        `setConstraints`, too.
        """
        constraints = self.getConstraints()
        self.setConstraints(constraints.with_min_clearance(self.checker, distance, obstacles, exempt))

    def setTube(self, widths: ArrayLike | Mapping[str, float]) -> None:
        """Require that every motion whose joints are so near to the one planned is free, too; 0 for no tube.

        The widths, one for all joints, one for each (n,), or by name, are how far each may be from where it should be,
        such as errors of control [rad or m].
        """
        tube = motions.tube_of(widths, self.robot)
        self.setConstraints(self.getConstraints().with_separation(tube=tube))

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Have only motions that are free whatever obstacles do, no faster than their speeds, within a time.

        Arguments and errors of `Separation`; errors as `setConstraints`, too.
        """
        self.setConstraints(self.getConstraints().with_separation(speeds=speeds, time=time))

    def setToolConstraint(
        self, axis: ArrayLike | None = None, direction: ArrayLike = UP, angle: float | None = None
    ) -> None:
        """Have only paths on which an axis of the tool (3,) stays within an angle [rad] of a direction (3,).

        The axis is in the frame of the tip, by default the one that points in the direction at the start; the direction
        is in the world frame. An angle alone keeps upright what is upright at the start; without arguments there is no
        such constraint any more. Errors as `ToolOrientation` and `setConstraints`; an InputError without an axis if no
        start is set, and for an axis without an angle.
        """
        if angle is None and axis is not None:
            raise InputError("give the angle [rad] within which the axis of the tool must stay")
        if angle is not None and axis is None:
            if self.query.start is None:
                raise InputError("the axis of the tool is that of the start: set a start before, or give the axis")
            turn = self.robot.tip_pose(self.query.start).rotation
            axis = turn.T @ finite_array(direction, (3,), "direction of the tool")
        limit = None if angle is None or axis is None else ToolOrientation(self.robot, axis, direction, angle)
        self._limit_tool(ToolOrientation, limit)

    def setTipBounds(self, lower: ArrayLike | None, upper: ArrayLike | None = None) -> None:
        """Have only paths on which the tip stays inside a box [m], given by opposite corners (3,) in the world frame.

        A coordinate is infinite where there is no wall. None: there is no such constraint any more. Errors as
        `TipBounds` and `setConstraints`; an InputError if only one corner is given.
        """
        if (lower is None) is not (upper is None):
            raise InputError("give both corners of the tip's box, or neither")
        self._limit_tool(TipBounds, None if lower is None or upper is None else TipBounds(self.robot, lower, upper))

    def _limit_tool(self, kind: type[ToolLimit], limit: ToolLimit | None) -> None:
        """Replace what limits the tool in one way."""
        others = [other for other in self.getConstraints().tool if not isinstance(other, kind)]
        self._constrain(tool=tuple(others if limit is None else [*others, limit]))

    def setStateValidityChecker(self, checker: Any, resolution: float = RESOLUTION) -> None:
        """Have only states that a checker of the user's own accepts, besides being within limits and free.

        Planners, motions, simplification, goals and reports obey it. Nothing can be proven of it: motions are sampled,
        at distances of `resolution` [rad or m] in joint space, and reports say so.

        It is an `ob.StateValidityChecker` or a function that answers for a state with a bool, and what it raises
        arrives unchanged; None: there is none any more. An InputError if it is nothing of the kind, a CollisionError if
        it refuses the start or all goals that are set: then the checker stays what it was.
        """
        self._constrain(user=None if checker is None else SampledValidity(checker, self.bridge, resolution))

    # --------------------------------------------------------------------------------------------------- start and goal

    def setConfigurations(self, start: Any, goals: Any) -> None:
        """Set the start configuration (n,) and one goal (n,) or several (G, n) [rad or m].

        They are numbers in the order of the robot's joints, mappings by joint name, or names of group states of the
        SRDF. An InputError for a wrong shape, NaN, an unknown name, a missing joint, or a value outside the limits; a
        CollisionError in collision, or against a constraint. Of several goals only those that are allowed count; one
        must be.

        A start that is slightly outside the limits begins at these, with a warning (`Robot.clipped_start`). Paths begin
        in the turn of continuous joints that the start has; goals are the same whatever their turn.
        """
        self.query.set_configurations(start, goals)

    def setStartConfiguration(self, start: Any) -> None:
        """Set the start configuration (n,) [rad or m], numbers or by name; errors as `setConfigurations`."""
        self.query.set_start(start)

    def setWorkspaceGoal(
        self, position: ArrayLike | Any, rotation: ArrayLike | None = None, tolerance: float = TOLERANCE
    ) -> None:
        """Set a place for the tip as the goal, in the world frame [m]; errors as `WorkspaceGoal`.

        The rotation is a matrix, a quaternion x, y, z, w, or a pin.Quaternion; the position may be a whole pin.SE3.
        Goal configurations set before stay for the planners that `plan` starts and that plan to configurations.
        """
        place = place_of(self.robot, position, rotation)
        self._set_place(WorkspaceGoal, place, tolerance)

    def setGoalRegion(self, region: GoalRegion, tolerance: float = REGION_TOLERANCE) -> None:
        """Set a region for the tip as the goal, bounds of position and orientation; it replaces a `setWorkspaceGoal`.

        Arguments and errors of `RegionGoal`.
        """
        self._set_place(RegionGoal, region, tolerance)

    def _set_place(self, kind: type[WorkspaceGoal], place: Any, tolerance: float) -> None:
        self.query.forget_stale()
        si = self.getSpaceInformation()
        self.query.place = kind(si, self.robot, place, tolerance=tolerance, field=self.field, seed=0)
        self.setGoal(self.query.place)

    # --------------------------------------------------------------------------------------------------------- planning

    def setup(self) -> None:
        """Prepare for `solve`, as OMPL's `setup`; raise InputError if no start or no goal is set."""
        self.query.check_complete(self.getPlanner())
        self._choose_planner()
        with self.query.without_nan(self.getPlanner()):
            super().setup()

    def setPlanner(self, planner: Any) -> None:
        """Plan with a planner on this setup's space information; an InputError if it cannot be used with it."""
        if isinstance(planner, str):
            raise InputError(f"planner must be an ob.Planner, got {planner!r}; `plan` takes names")
        check_planner(planner, self.getSpaceInformation())
        if planner is not self.getPlanner():
            # The planner may have been used before, for another scene or problem.
            planner.clear()
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
        self.query.check_complete(self.getPlanner())
        self._choose_planner()
        self.query.choose_place(self.getPlanner())
        objective = self.getOptimizationObjective()
        asked: AbstractContextManager[None] = nullcontext()
        if isinstance(objective, DangerObjective) and not isinstance(self.getPlanner(), SafePlanner):
            super().setup()
            asked = objective.asked_by(self.getPlanner())
        try:
            self.query.forget_stale()
            self.query.begin()
            with asked, self.query.without_nan(self.getPlanner()):
                status = super().solve(stop)
            self.query.explain_missing_goal()
            if (wrong := self.query.forget_wrong()) is not None:
                raise PlanningError(f"{self.getPlanner().getName()} returned a path that {wrong}")
            if self.query.forget_nan():
                name = self.getPlanner().getName()
                _log.warning("%s: the path is dropped, because the objective is NaN on it", name)
                return ob.PlannerStatus(ob.PlannerStatus.TIMEOUT)
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
        starts: int = 1,
        workers: int = 1,
        ways: Literal[1, "all"] = 1,
    ) -> PlanResult:
        """Plan from the start to a goal, and validate the path.

        Parameters
        ----------
        planner : str, ob.Planner or callable
            A name of `planner_names()`, a planner on this setup's space information, or a function `(robot, scene,
            start, goal) -> way points (N, n)`. The path of a function is checked, repaired where it touches, and
            proven, see `FunctionPlanner`; `PlanResult.repaired` says what became of it.
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
        ways : 1 or "all"
            "all": look for ways that pass people and obstacles on other sides, or in other postures, and return the
            safest one found, in about four times the time of `simplify=True`: several starts, with seeds that count up
            from `seed`, are joined into better paths and compared after simplification, by this setup's objective.
            `simplify` is then implied; if it is a number of seconds, this is the limit for each path. What the ways
            that were found cost is in `PlanResult.ways`. A planner that ignores its seed finds one way.

        Raises
        ------
        InputError
            Time not positive, unknown planner or parameter, a planner of another setup; to optimise without danger;
            less than 1 start or worker; `ways` that are neither 1 nor "all", or go with `optimise` or several `starts`.
        PlanningError
            If a planner returns a path that the validator refuses, or that is not from a start to the goal.
        KeyboardInterrupt
            On Ctrl-C before there is a path. Later it ends simplification and optimisation, and the best path so far
            is returned; `PlanResult.interrupted` says so.
        """
        begin = perf_counter()
        time = number("time limit", time if optimise is None else optimise, above=0.0, kind="number of seconds")
        simplification = simplification_time(simplify)
        starts, seed, every = whole_number("starts", starts, at_least=1), checked_seed(seed), all_ways(ways)
        if every and (optimise is not None or starts > 1):
            other = "starts" if starts > 1 else "optimise"
            raise InputError(f'ways="all" starts as often as it needs: leave out {other}')
        # Whether there is a best path to keep at Ctrl-C.
        keeps = starts > 1 or every or simplification is not None or optimise is not None

        def once(seed: int) -> PlanResult:
            run = PlanningRun(self, *self.prepare(planner, seed, parameters), seed)
            if optimise is not None or (simplification is not None and self.field is not None):
                self.simplifier  # noqa: B018  # is made before the clock starts, as the planner is
            if every:
                seconds = simplification or np.inf
                return run.every_way(time, self._any_simplifier, seconds, lambda: bool(interrupts))
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
        # Checking draws random numbers, as the next lines do, so it happens before the seed is set.
        self.query.check_anew()
        if not self.getSpaceInformation().isSetup():
            self.getSpaceInformation().setup()
        seed_ompl(seed)
        given = planner
        if isinstance(planner, str):
            planner = make_planner(planner, self.getSpaceInformation(), parameters)
        elif not isinstance(planner, ob.Planner):
            planner = FunctionPlanner(self.getSpaceInformation(), planner)
        name = given if isinstance(given, str) else planner.getName()  # BITstar renames itself kBITstar
        if isinstance(planner, SafePlanner):
            planner.setSeed(seed)
        self.clear()
        self.query.choose_goal(planner, seed)
        self.setPlanner(planner)
        self.setup()
        return planner, name

    # ---------------------------------------------------------------------------------------------- paths and solutions

    def getProblemDefinition(self) -> Any:
        """Return OMPL's problem definition, whose solutions are of the problem as it is now."""
        self.query.forget_stale()
        return super().getProblemDefinition()

    def haveSolutionPath(self) -> bool:
        """Return whether there is a path from a start towards the goal as they are now."""
        self.query.forget_stale()
        self.query.forget_wrong()
        return bool(super().haveSolutionPath())

    def haveExactSolutionPath(self) -> bool:
        """Return whether there is a path from a start to the goal as they are now."""
        return self.haveSolutionPath() and bool(super().haveExactSolutionPath())

    def getSolutionPath(self) -> Any:
        """Return the solution, an `og.PathGeometric`; an InputError if there is none for the problem as it is now."""
        if not self.haveSolutionPath():
            raise InputError("there is no solution: call solve or plan first, and see whether it succeeds")
        return super().getSolutionPath()

    def solution(self) -> FloatArray:
        """Return the solution path (N, n) found last; raise InputError if there is none.

        Continuous joints count turns along it, from those of the start: no step is longer than half a turn. The start
        of OMPL's own words is in [−π, π).
        """
        path, start = self.bridge.way_points(self.getSolutionPath()), self.query.start
        turns = np.zeros(self.bridge.n) if start is None else np.round((start - path[0]) / (2 * np.pi))
        return path + 2 * np.pi * turns * self.bridge.circular

    def set_solution(self, path: FloatArray) -> None:
        """Put a path (N, n) in the place of the solution; where that was approximate, so is this."""
        solution, scratch = og.PathGeometric(self.getSpaceInformation()), ScratchState(self.bridge)
        for q in path:
            solution.append(scratch.set(q))
        problem = self.getProblemDefinition()
        approximate, difference = problem.hasApproximateSolution(), problem.getSolutionDifference()
        problem.clearSolutionPaths()
        # There is no planner if the solution was set in another way.
        planner = self.getPlanner()
        name = "" if planner is None else planner.getName()
        problem.addSolutionPath(solution, approximate, max(0.0, difference), name)
        self.query.begin()

    def _rows(self, path: Any) -> Any:
        """Return the way points (N, n) of a path, which may be one of OMPL's."""
        return self.bridge.way_points(path) if isinstance(path, og.PathGeometric) else path

    def report(self, path: ArrayLike | og.PathGeometric) -> simplification.PathReport:
        """Validate a path, (N, n) or OMPL's, and return the report on it; danger and clearance come when looked at."""
        return simplification.PathReport.of(self._rows(path), self.checker, self.field, self.motion_prover)

    def is_free(self, path: ArrayLike | og.PathGeometric) -> simplification.Validation:
        """Return whether a path, (N, n) or OMPL's, may be driven in this scene, under the constraints set now.

        The `Validation` is true if so; else `why` names the edge and the pair, and `refused` holds them. An InputError
        if the path is empty, has the wrong shape, or is not finite.
        """
        return simplification.validate(self._rows(path), self.motion_prover)

    def getPlannerData(self, data: Any) -> None:
        """Fill an `ob.PlannerData` with what the planner has built; ours also have a `plannerGraph`."""
        planner = self.getPlanner()
        fill = getattr(planner, "fillPlannerData", None)
        if fill is None:
            super().getPlannerData(data)
        else:
            data.clear()
            fill(data)

    # --------------------------------------------------------------------------------------------------- simplification

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
            raise InputError("danger-aware simplification needs a danger field, and this setup has none")
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
        self.set_solution(self._any_simplifier.simplify(path, stopping(time), proven=True))
        if self.getConstraints().user is not None and not self.is_free(self.solution()):
            # Samples of a motion are not those of its parts: a check of the user's own may refuse these after all.
            _log.info("the simplified path is refused; the solution is unchanged")
            self.set_solution(path)
        if self.query.forget_nan():
            _log.info("the objective is NaN on the simplified path; the solution is unchanged")
            self.set_solution(path)
        self._simplification_time = perf_counter() - begin

    @property
    def _any_simplifier(self) -> simplification.Simplifier:
        """The `simplifier`; for a setup that plans without danger what makes paths shorter."""
        if self.field is not None:
            return self.simplifier
        return simplification.Simplifier(self.checker, DangerField(self.robot, np.empty((0, 3))), self.motion_prover)

    def getLastSimplificationTime(self) -> float:
        """Return how long the last simplification took [s]."""
        return self._simplification_time

    # --------------------------------------------------------------------------------------------- motions from outside

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


def _let_go(setup: ref[SafeSetup]) -> None:
    """Forget the user's checker at the end of the program."""
    alive = setup()
    if alive is not None:
        alive._put(replace(alive.getConstraints(), user=None))


def simplification_time(value: bool | float) -> float | None:
    """Return for how long to simplify [s], 0 without limit; None for not at all."""
    if isinstance(value, (bool, np.bool_)):
        return 0.0 if value else None
    return number("simplify", value, above=0.0, kind="number of seconds")


def connecting(setup: SafeSetup, time: float) -> Callable[[FloatArray, FloatArray], FloatArray | None]:
    """Return what finds proven paths between configurations (n,) for repairs, within a time in all [s].

    It plans under the constraints of the setup, whose own problem stays as it is.
    """
    end, own = perf_counter() + time, list[SafeSetup]()

    def connect(start: FloatArray, goal: FloatArray) -> FloatArray | None:
        if perf_counter() >= end:
            return None
        if not own:
            own.append(SafeSetup(setup.robot, setup.scene, danger=setup.danger_options))
            own[0].setConstraints(setup.getConstraints())
        own[0].setConfigurations(start, goal)
        left = max(end - perf_counter(), 1e-3)
        return own[0].plan("SafeRRTConnect", time=left, simplify=0.2 * left).path

    return connect


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
