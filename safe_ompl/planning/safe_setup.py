"""`SafeSetup`, OMPL's SimpleSetup with constraints, danger, proofs and reports; and `repair` for given motions."""

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
from safe_ompl.planning.run import PlanningRun, best_start, noted_ctrl_c, stopping, validated, with_progress
from safe_ompl.planning.start_and_goals import StartAndGoals
from safe_ompl.planning.ways import all_ways
from safe_ompl.robot import GoalRegion, Robot, ScratchState, joint_space, target_pose
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

UP = (0.0, 0.0, 1.0)


class SafeSetup(og.SimpleSetup):  # type: ignore[misc]
    """An `og.SimpleSetup` with the robot's joint space, certified motions and the danger objective.

    All methods of OMPL's SimpleSetup work as usual. `plan` plans in one call and returns a report with the path. Every
    path satisfies the constraints that are set, whichever planner found it, and this is proven along whole motions. If
    the start or all goals violate a new constraint, a CollisionError says why, and the setup is unchanged.

    Parameters
    ----------
    robot, scene : Robot, Scene
        The robot, and the obstacles.
    danger : mapping or None
        Options of `DangerField` (aggregate, weighting, …) and `spacing` of the danger points [m]. If no obstacle is
        dangerous, the danger is zero everywhere. None: plan without danger.
    movable : sequence of str
        Names of obstacles that will move. `moveObstacle` is then fast from its first call on.

    Attributes
    ----------
    counts, field : Counts, DangerField or None
        Numbers of queries and field evaluations so far, and the danger field.

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
        # LOG_DEBUG is OMPL's default level. A user who chose another level keeps it.
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

    # The `repr` of OMPL's SimpleSetup would make thousands of collision queries.
    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.robot!r}, {self.scene!r})"

    @property
    def checker(self) -> CollisionChecker:
        """The collision checker of the robot in the scene."""
        return self.validity.checker

    @property
    def motion_prover(self) -> MotionProver:
        """The prover of motions under the constraints that are set now."""
        return self.validator.motion

    # -------------------------------------------------------------------------------------------------------- the scene

    @property
    def scene(self) -> Scene:
        """The obstacles."""
        return self.checker.scene

    def addObstacle(self, obstacle: Obstacle) -> None:
        """Add an obstacle to the scene; errors as `setScene`, and an InputError if its name is already used."""
        self.setScene(self.scene.with_obstacles(obstacle))

    def removeObstacle(self, name: str) -> None:
        """Remove an obstacle from the scene; raise UnknownNameError if no obstacle has the name."""
        self.setScene(self.scene.without(name))

    def moveObstacle(self, name: str, place: Any) -> None:
        """Move one obstacle to a pose, or a person to key points, or a cloud to points; errors as `Scene.moved`."""
        self.moveObstacles({name: place})

    def moveObstacles(self, places: Mapping[str, Any]) -> None:
        """Move several obstacles at once; places and errors as `Scene.moved`."""
        self.setScene(self.scene.moved(places))

    def setScene(self, scene: Scene) -> None:
        """Replace the scene; all constraints stay set.

        The call takes about a millisecond if only poses of obstacles differ that are `movable` or have moved before.
        The solution and the planner's data are cleared. Start and goals are checked when planning begins. Raises
        InputError if `scene` is no Scene, and UnknownNameError if a constraint names an obstacle that the new scene
        lacks; the old scene is then kept.
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
        """Return the constraints that every path must satisfy besides joint limits and collision."""
        return self.validity.getConstraints()

    def setConstraints(self, constraints: Constraints) -> None:
        """Replace all constraints; on an error the old constraints are kept.

        The solution and the planner's data are cleared, because they may violate the new constraints. Raises
        CollisionError if the start or all goals that are set violate a constraint, and UnknownNameError if a constraint
        names an obstacle that the scene lacks.
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
        """Give the constraints, and optionally the checker of a new scene, to validity checker and motion validator."""
        if constraints.user is not None and not self._user_is_let_go:
            # A user's function refers to its module, and the module refers to the setup. The reference cycle passes
            # through C++, where Python's garbage collector cannot find it. OMPL would report a leak at exit.
            atexit.register(_let_go, ref(self))
            self._user_is_let_go = True
        self.validity.setConstraints(constraints, checker)
        self.validator.setConstraints(constraints, checker)

    def _constrain(self, **changed: Any) -> None:
        self.setConstraints(replace(self.getConstraints(), **changed))

    def setMaxDanger(self, limit: float) -> None:
        """Set the largest danger of any configuration on a path, in the units of the danger field; 0: no limit.

        Errors as `setConstraints`; an InputError if the limit is negative or not finite, or there is no danger field.
        """
        if self.field is None:
            raise InputError("max danger needs a danger field, and this setup has none")
        self._constrain(danger=DangerLimit(self.field, limit) if number("max danger", limit, at_least=0) else None)

    def setMinClearance(
        self, distance: float, obstacles: Sequence[str] | None = None, exempt: Sequence[tuple[str, str]] = ()
    ) -> None:
        """Set the distance [m] that every path must keep from obstacles; arguments and errors of `MinClearance.of`.

        If no obstacles are named, the distance holds for all dangerous obstacles, also after `setScene`. Errors also as
        `setConstraints`.
        """
        constraints = self.getConstraints()
        self.setConstraints(constraints.with_min_clearance(self.checker, distance, obstacles, exempt))

    def setTube(self, widths: ArrayLike | Mapping[str, float]) -> None:
        """Require that every motion within the tube about the planned motion is free, too; 0 removes the tube.

        A width is the largest deviation of a joint from the plan [rad or m], such as a controller's tracking error.
        Widths are one number for all joints, one for each joint (n,), or a mapping by joint name.
        """
        tube = motions.tube_of(widths, self.robot)
        self.setConstraints(self.getConstraints().with_separation(tube=tube))

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Require motions that stay free for a time [s], however the named obstacles move within their speeds [m/s].

        Arguments and errors of `Separation`; errors also as `setConstraints`.
        """
        self.setConstraints(self.getConstraints().with_separation(speeds=speeds, time=time))

    def setToolConstraint(
        self, axis: ArrayLike | None = None, direction: ArrayLike = UP, angle: float | None = None
    ) -> None:
        """Require that an axis of the tool (3,) stays within an angle [rad] of a direction (3,) along the path.

        The axis is given in the frame of the tip and the direction in the world frame. Without an axis, the axis that
        has the direction at the start is used: an angle alone keeps a tool upright that is upright at the start. A call
        without arguments removes the constraint. Errors as `ToolOrientation` and `setConstraints`; an InputError for an
        angle without an axis if no start is set, and for an axis without an angle.
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
        """Require that the tip stays inside a box [m], given by opposite corners (3,) in the world frame.

        An infinite coordinate leaves that side of the box open. None removes the constraint. Errors as `TipBounds` and
        `setConstraints`; an InputError if only one corner is given.
        """
        if (lower is None) is not (upper is None):
            raise InputError("give both corners of the tip's box, or neither")
        self._limit_tool(TipBounds, None if lower is None or upper is None else TipBounds(self.robot, lower, upper))

    def _limit_tool(self, kind: type[ToolLimit], limit: ToolLimit | None) -> None:
        """Replace the constraint of one class on the tool; None removes it."""
        others = [other for other in self.getConstraints().tool if not isinstance(other, kind)]
        self._constrain(tool=tuple(others if limit is None else [*others, limit]))

    def setStateValidityChecker(self, checker: Any, resolution: float = RESOLUTION) -> None:
        """Require that a user's checker accepts every state, in addition to joint limits and collision.

        Planners, motions, simplification, goals and reports use the checker. Its condition cannot be proven: motions
        are sampled at distances of `resolution` [rad or m] in joint space, and reports say so.

        The checker is an `ob.StateValidityChecker` or a function that returns a bool for a state; None removes it. Its
        exceptions arrive unchanged. Raises InputError for other types, and CollisionError if the checker refuses the
        start or all goals that are set; the old checker is then kept.
        """
        self._constrain(user=None if checker is None else SampledValidity(checker, self.bridge, resolution))

    # --------------------------------------------------------------------------------------------------- start and goal

    def setConfigurations(self, start: Any, goals: Any) -> None:
        """Set the start configuration (n,) and one goal (n,) or several (G, n) [rad or m].

        Configurations are numbers in the order of the robot's joints, mappings by joint name, or names of group states
        of the SRDF. Raises InputError for a wrong shape, NaN, an unknown name, a missing joint, or a value outside the
        limits, and CollisionError for a configuration in collision or against a constraint. Of several goals, those
        that are not allowed are left out; at least one must be allowed.

        A start slightly outside the limits is moved to the limits, with a warning (`Robot.clipped_start`). For
        continuous joints, paths keep the full turns of the start; goals that differ by full turns are equal.
        """
        self.query.set_configurations(start, goals)

    def setStartConfiguration(self, start: Any) -> None:
        """Set the start configuration (n,) [rad or m], in a form of `setConfigurations` and with its errors."""
        self.query.set_start(start)

    def setWorkspaceGoal(
        self, position: ArrayLike | Any, rotation: ArrayLike | None = None, tolerance: float = TOLERANCE
    ) -> None:
        """Set a position or pose of the tip as the goal, in the world frame [m]; errors as `WorkspaceGoal`.

        The rotation is a matrix, a quaternion x, y, z, w, or a pin.Quaternion; the position may also be a pin.SE3. Goal
        configurations set before are kept: `plan` uses them with planners that plan to configurations.
        """
        target = target_pose(self.robot, position, rotation)
        self._set_tip_goal(WorkspaceGoal, target, tolerance)

    def setGoalRegion(self, region: GoalRegion, tolerance: float = REGION_TOLERANCE) -> None:
        """Set bounds of the tip's position and orientation as the goal, instead of a `setWorkspaceGoal`.

        Arguments and errors of `RegionGoal`.
        """
        self._set_tip_goal(RegionGoal, region, tolerance)

    def _set_tip_goal(self, kind: type[WorkspaceGoal], target: Any, tolerance: float) -> None:
        self.query.forget_stale()
        si = self.getSpaceInformation()
        self.query.tip_goal = kind(si, self.robot, target, tolerance=tolerance, field=self.field, seed=0)
        self.setGoal(self.query.tip_goal)

    # --------------------------------------------------------------------------------------------------------- planning

    def setup(self) -> None:
        """Prepare for `solve`, as OMPL's `setup`; raise InputError if no start or no goal is set."""
        self.query.check_complete(self.getPlanner())
        self._choose_planner()
        with self.query.without_nan(self.getPlanner()):
            super().setup()

    def setPlanner(self, planner: Any) -> None:
        """Set the planner, which must have this setup's space information; an InputError if it cannot be used."""
        if isinstance(planner, str):
            raise InputError(f"planner must be an ob.Planner, got {planner!r}; `plan` takes names")
        check_planner(planner, self.getSpaceInformation())
        if planner is not self.getPlanner():
            # The planner may have been used before, for another scene or problem.
            planner.clear()
        super().setPlanner(planner)

    def _choose_planner(self) -> None:
        """If no planner is set, make one by the allocator, or a `SafeRRTConnect` if the goal can be sampled."""
        allocator = self.getPlannerAllocator()
        if self.getPlanner() is not None:
            return
        if allocator is not None:
            self.setPlanner(allocator(self.getSpaceInformation()))
        elif isinstance(self.getGoal(), ob.GoalSampleableRegion):
            self.setPlanner(SafeRRTConnect(self.getSpaceInformation()))

    def solve(self, time: float | ob.PlannerTerminationCondition = 1.0) -> ob.PlannerStatus:
        """Plan with the planner that is set, by default `SafeRRTConnect`, as OMPL's `solve`.

        The goal is the one set last; `SafeJTRRT` plans to the `setWorkspaceGoal` even if configurations were set later.
        Solutions of another problem are removed, and the planner's data as far as they are no longer valid. Ctrl-C and
        exceptions of the user's callbacks end `solve` at once and arrive unchanged. There is then no solution, and the
        planner is cleared, because it may have stopped in the middle of a step. The time is a limit [s], infinity for
        no limit, or an `ob.PlannerTerminationCondition`. Raises InputError for another time, or if no start or no goal
        is set, and PlanningError if the planner returns a path that does not lead from a start to the goal.
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
            start, goal) -> way points (N, n)`. The path of a function is checked, repaired where it collides, and
            proven (see `FunctionPlanner`); `PlanResult.repaired` says how it was repaired.
        time : float
            Time limit [s] of planning and simplification together.
        seed : int
            Seed of the planner's random numbers.
        parameters : mapping, optional
            Parameters for a planner given by name.
        simplify : bool or float
            Simplify the solution as `simplifySolution` does. A number limits the simplification [s]; True simplifies
            until the path no longer improves. The time limit holds, too.
        optimise : float, optional
            Total time [s], instead of `time`: plan and simplify again and again, and return the best path.
        starts : int
            Plan this many times with consecutive seeds from `seed`, and return the path of least cost by this setup's
            objective, the first one of equal cost. The time limit holds for each start.
        workers : int
            Number of processes that share the starts; all starts take at most ⌈starts/workers⌉ time limits. The result
            does not depend on `workers`, as long as no start reaches its time limit.
        ways : 1 or "all"
            "all": search for ways that pass people and obstacles on other sides, or in other postures, and return the
            safest way found. The search takes about four times as long as `simplify=True`. It runs several starts with
            consecutive seeds from `seed`, joins their paths into better ones, and compares them after simplification by
            this setup's objective. `simplify` is then implied; a number limits the simplification of each path [s].
            `PlanResult.ways` has the costs of the ways found. A planner that ignores its seed finds one way.

        Raises
        ------
        InputError
            If the time is not positive; the planner or a parameter is unknown, or the planner belongs to another setup;
            `optimise` is given without danger; `starts` or `workers` is less than 1; `ways` is neither 1 nor "all", or
            is "all" together with `optimise` or several `starts`.
        PlanningError
            If a planner returns a path that the validator refuses, or that does not lead from a start to the goal.
        KeyboardInterrupt
            On Ctrl-C before a path is found. Later, Ctrl-C ends simplification and optimisation; the best path so far
            is returned, and `PlanResult.interrupted` is true.
        """
        begin = perf_counter()
        time = number("time limit", time if optimise is None else optimise, above=0.0, kind="number of seconds")
        simplification = simplification_time(simplify)
        starts, seed, every = whole_number("starts", starts, at_least=1), checked_seed(seed), all_ways(ways)
        if every and (optimise is not None or starts > 1):
            other = "starts" if starts > 1 else "optimise"
            raise InputError(f'ways="all" chooses the number of starts: leave out {other}')
        # With these options Ctrl-C returns the best path so far instead of an exception.
        keeps = starts > 1 or every or simplification is not None or optimise is not None

        def once(seed: int) -> PlanResult:
            run = PlanningRun(self, *self.prepare(planner, seed, parameters), seed)
            if optimise is not None or (simplification is not None and self.field is not None):
                self.simplifier  # noqa: B018  # Made before the clock starts.
            if every:
                seconds = simplification or np.inf
                return run.every_way(time, self._any_simplifier, seconds, lambda: bool(interrupts))
            if optimise is not None:
                return run.optimised(time, with_progress(run.name, time, lambda: bool(interrupts)))
            return run.planned(time, simplification)

        with noted_ctrl_c() if keeps else nullcontext(list[int]()) as interrupts:
            seeds = [(seed + k) % 2**32 for k in range(starts)]
            result = once(seed) if starts == 1 else best_start(self, once, seeds, workers, interrupts)
        result = validated(self, result, begin)
        if interrupts and not result:
            raise KeyboardInterrupt
        return replace(result, interrupted=bool(interrupts))

    def prepare(self, planner: str | Any, seed: int, parameters: Mapping[str, Any] | None = None) -> tuple[Any, str]:
        """Seed OMPL and the planner, and set planner and goal for a run; return the planner and its name."""
        seed = checked_seed(seed)
        check_planner(planner, self.getSpaceInformation())
        # These checks draw random numbers, so they happen before the seed is set.
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
        """Return OMPL's problem definition; solutions of an earlier problem are removed first."""
        self.query.forget_stale()
        return super().getProblemDefinition()

    def haveSolutionPath(self) -> bool:
        """Return whether there is a path from the present start towards the present goal."""
        self.query.forget_stale()
        self.query.forget_wrong()
        return bool(super().haveSolutionPath())

    def haveExactSolutionPath(self) -> bool:
        """Return whether there is a path from the present start to the present goal."""
        return self.haveSolutionPath() and bool(super().haveExactSolutionPath())

    def getSolutionPath(self) -> Any:
        """Return the solution, an `og.PathGeometric`; an InputError if the present problem has no solution."""
        if not self.haveSolutionPath():
            raise InputError("there is no solution: call solve or plan first, and check its result")
        return super().getSolutionPath()

    def solution(self) -> FloatArray:
        """Return the solution path (N, n) found last [rad or m]; raise InputError if there is none.

        Angles of continuous joints begin with the full turns of the start and do not jump at ±π: no step is longer than
        half a turn. OMPL's own path has them in [−π, π).
        """
        path = self.bridge.way_points(self.getSolutionPath())
        if not self.bridge.circular.any():
            return path
        start = self.query.start
        turns = np.zeros(self.bridge.n) if start is None else np.round((start - path[0]) / (2 * np.pi))
        return path + 2 * np.pi * turns * self.bridge.circular

    def set_solution(self, path: FloatArray) -> None:
        """Replace the solution by a path (N, n); the new solution is approximate if the old one was."""
        solution, scratch = og.PathGeometric(self.getSpaceInformation()), ScratchState(self.bridge)
        for q in path:
            solution.append(scratch.set(q))
        problem = self.getProblemDefinition()
        approximate, difference = problem.hasApproximateSolution(), problem.getSolutionDifference()
        problem.clearSolutionPaths()
        # If no planner found the solution, there may be no planner.
        planner = self.getPlanner()
        name = "" if planner is None else planner.getName()
        problem.addSolutionPath(solution, approximate, max(0.0, difference), name)
        self.query.begin()

    def _rows(self, path: Any) -> Any:
        """Return the way points (N, n) of an `og.PathGeometric`; other paths are returned unchanged."""
        return self.bridge.way_points(path) if isinstance(path, og.PathGeometric) else path

    def report(self, path: ArrayLike | og.PathGeometric) -> simplification.PathReport:
        """Validate a path, (N, n) or OMPL's, and return its report; danger and clearance are computed on first use."""
        return simplification.PathReport.of(self._rows(path), self.checker, self.field, self.motion_prover)

    def is_free(self, path: ArrayLike | og.PathGeometric) -> simplification.Validation:
        """Prove that a path, (N, n) or OMPL's, is free in this scene under the constraints that are set.

        The `Validation` is true if the path is proven free. Else `why` names the edge and the pair of bodies, and
        `refused` holds them. Raises InputError if the path is empty, has the wrong shape, or is not finite.
        """
        return simplification.validate(self._rows(path), self.motion_prover)

    def getPlannerData(self, data: Any) -> None:
        """Fill an `ob.PlannerData` with the planner's graph; planners of this package also have a `plannerGraph`."""
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
        """The danger-aware simplifier of paths; raises InputError if this setup plans without danger."""
        if self._simplifier is None or self._simplifier.checker is not self.checker:
            self.setSimplification(**self._simplification)
        assert self._simplifier is not None
        if self._simplifier.motion is not self.motion_prover:
            self._simplifier = self._simplifier.proving_by(self.motion_prover)
        return self._simplifier

    def setSimplification(self, **options: Any) -> None:
        """Set options of danger-aware simplification; options and errors of `Simplifier`, errors of `simplifier`."""
        if self.field is None:
            raise InputError("danger-aware simplification needs a danger field, and this setup has none")
        self._simplifier = simplification.Simplifier(self.checker, self.field, self.motion_prover, **options)
        self._simplification = options

    def simplifySolution(self, time: Any = 0.0) -> None:
        """Make the solution shorter and safer by a `Simplifier`; every intermediate path is proven, too.

        The time is a limit [s] or an `ob.PlannerTerminationCondition`; 0: until the path no longer improves. Raises
        InputError if there is no solution. A setup without danger shortens the path and keeps its clearance. The user's
        checker tests every new edge, and the whole path at the end.
        """
        begin, path = perf_counter(), self.solution()
        self.set_solution(self._any_simplifier.simplify(path, stopping(time), proven=True))
        if self.getConstraints().user is not None and not self.is_free(self.solution()):
            # A whole motion and its parts are sampled at different points, so the user's checker may refuse the result.
            _log.info("the simplified path is refused; the solution is unchanged")
            self.set_solution(path)
        if self.query.forget_nan():
            _log.info("the objective is NaN on the simplified path; the solution is unchanged")
            self.set_solution(path)
        self._simplification_time = perf_counter() - begin

    @property
    def _any_simplifier(self) -> simplification.Simplifier:
        """The `simplifier`, or for a setup without danger a simplifier that shortens paths."""
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
        """Prove a given motion under the constraints that are set; see `safe_ompl.check`."""
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
        """Change a given motion as little as possible until it is proven; see `safe_ompl.repair`."""
        limit = number("time limit", time, above=0.0, kind="number of seconds")

        def another() -> SafeSetup:
            setup = SafeSetup(self.robot, self.scene, danger=self.danger_options)
            setup.setConstraints(self.getConstraints())
            return setup

        return motions.repair_with(motion, self.motion_prover, limits, connecting(another, limit), people)


def _let_go(setup: ref[SafeSetup]) -> None:
    """Remove the user's checker at exit, so that OMPL reports no leak."""
    alive = setup()
    if alive is not None:
        alive._put(replace(alive.getConstraints(), user=None))


def simplification_time(value: bool | float) -> float | None:
    """Return the time limit of simplification [s], 0 for no limit, or None for no simplification."""
    if isinstance(value, (bool, np.bool_)):
        return 0.0 if value else None
    return number("simplify", value, above=0.0, kind="number of seconds")


def connecting(make: Callable[[], SafeSetup], time: float) -> Callable[[FloatArray, FloatArray], FloatArray | None]:
    """Return a function that plans proven paths (N, n) between configurations (n,), for repairs.

    All calls together take at most `time` [s]. The setup for them is made at the first call.
    """
    end, own = perf_counter() + time, list[SafeSetup]()

    def connect(start: FloatArray, goal: FloatArray) -> FloatArray | None:
        if perf_counter() >= end:
            return None
        if not own:
            own.append(make())
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
    """Change a motion from another planner as little as possible until it is proven.

    The motion is any input of `Motion.of`, such as way points (N, n), a SciPy spline, or a plain `og.SimpleSetup` that
    is solved. Other arguments and errors as `check`; with other constraints use `SafeSetup.repair`. The time [s] is for
    planning detours, if moving pieces aside does not succeed.

    Returns
    -------
    Repair
        True if the motion is proven. `motion` has the ends, degree, times and smoothness of the given motion; `path`
        has the way points if the motion is straight between them; `how`, `deviation` and `changed` say what was
        changed. If rates exceed `limits`, or stops are too late for `people`, the duration is multiplied by `slower`.
    """
    limit = number("time limit", time, above=0.0, kind="number of seconds")
    proof = motions.prover_of(robot, scene, tube=tube)

    def setup() -> SafeSetup:
        made = SafeSetup(robot, scene)
        made.setConstraints(motions.Constraints(separation=proof.separation))
        return made

    return motions.repair_with(motion, proof, limits, connecting(setup, limit), people)
