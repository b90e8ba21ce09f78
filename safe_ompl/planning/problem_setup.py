"""ProblemSetup: what `SafeSetup` plans: a robot in a scene, with constraints, a start and goals."""

from __future__ import annotations

import atexit
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike
from ompl import geometric as og, util as ou

import safe_ompl.motions as motions
import safe_ompl.planning.simplification as simplification
import safe_ompl.scene as scenes
from safe_ompl.collision import (
    CollisionChecker,
    EdgeTables,
    MotionProver,
    TipBounds,
    ToolLimit,
    ToolOrientation,
    prove_curve,
)
from safe_ompl.common import Counts, FloatArray, InputError, compile_together, finite_array, instance, number
from safe_ompl.danger import DangerField, DangerLimit
from safe_ompl.danger.kernels import dangers
from safe_ompl.geometry import Box, Obstacle, Person, Sphere
from safe_ompl.geometry.kernels import extreme_vertices
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
from safe_ompl.planning.planners import NearestNode, SafeRRTConnect
from safe_ompl.planning.problem import Problem
from safe_ompl.robot import GoalRegion, Robot, ScratchState, joint_space, place_of
from safe_ompl.robot.kernels import descend, lay_edge, steer
from safe_ompl.scene import Scene

UP = (0.0, 0.0, 1.0)


class ProblemSetup(og.SimpleSetup):  # type: ignore[misc]
    """An `og.SimpleSetup` for a robot in a scene, with constraints, a start and goals; parameters as `SafeSetup`.

    Every path keeps to the constraints, whichever planner plans it, and this is proven along whole motions. A
    constraint that the start or all goals break is refused: a CollisionError says why, and all stays what it was.
    """

    def __init__(
        self, robot: Robot, scene: Scene, *, danger: Mapping[str, Any] | None = {}, movable: Sequence[str] = ()
    ) -> None:
        counts = Counts()
        checker = CollisionChecker(robot, scene, counts, movable=movable)
        if danger is not None:
            compile_kernels()
        super().__init__(joint_space(robot))
        if ou.getLogLevel() == ou.LogLevel.LOG_DEBUG:  # OMPL's default: nobody has asked for its lines
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
        self.problem = Problem(self, super().getProblemDefinition())
        if self.field is not None:
            self.setOptimizationObjective(DangerObjective(si, self.field))

    def __repr__(self) -> str:  # OMPL's own would ask thousands of queries
        return f"{type(self).__name__}({self.robot!r}, {self.scene!r})"

    @property
    def checker(self) -> CollisionChecker:
        """Robot against scene."""
        return self.validity.checker

    @property
    def motion_prover(self) -> MotionProver:
        """What proves motions under the constraints that are set now."""
        return self.validator.motion

    # ------------------------------------------------------------------------------------------------ the scene

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
        except InputError:  # more than places of movable obstacles differs
            moved = {o.name for o in self.scene if o.name in scene.names and o != scene[o.name]}
            movable = [name for name in scene.names if name in moved | self.checker.movable]
            checker = CollisionChecker(self.robot, scene, self.counts, movable=movable)
            self._put(self.getConstraints().in_scene_of(checker), checker)
        if self.field is not None:
            self.field.move(scene)
        self.clear()
        self.problem.scene_changed()

    # -------------------------------------------------------------------------------------------- constraints

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
            self.problem.check()
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
            raise InputError("max danger needs a danger field; this setup plans without danger")
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
            if self.problem.start is None:
                raise InputError("the axis of the tool is that of the start: set a start before, or give the axis")
            turn = self.robot.tip_pose(self.problem.start).rotation
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

    # ------------------------------------------------------------------------------------------ start and goal

    def setConfigurations(self, start: Any, goals: Any) -> None:
        """Set the start configuration (n,) and one goal (n,) or several (G, n) [rad or m].

        They are numbers in the order of the robot's joints, or mappings by name, as `Robot.named` gives them. An
        InputError for a wrong shape, NaN, an unknown or missing joint, or what is outside the limits; a CollisionError
        in collision, or against a constraint. Of several goals only those that are allowed count; one must be.
        """
        self.problem.set_configurations(start, goals)

    def setStartConfiguration(self, start: Any) -> None:
        """Set the start configuration (n,) [rad or m], numbers or by name; errors as `setConfigurations`."""
        self.problem.set_start(start)

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

    def setStartState(self, state: Any) -> None:
        """Set the start as OMPL's setup does."""
        super().setStartState(state)
        self.problem.forget_stale()

    def addStartState(self, state: Any) -> None:
        """Add a start as OMPL's setup does."""
        super().addStartState(state)
        self.problem.forget_stale()

    def clearStartStates(self) -> None:
        """Forget the starts as OMPL's setup does."""
        super().clearStartStates()
        self.problem.forget_stale()

    def setGoalState(self, goal: Any, threshold: float = np.finfo(float).eps) -> None:
        """Set a state as the goal as OMPL's setup does."""
        super().setGoalState(goal, threshold)
        self.problem.forget_stale()

    def setGoal(self, goal: Any) -> None:
        """Set the goal as OMPL's setup does."""
        super().setGoal(goal)
        self.problem.forget_stale()

    def setStartAndGoalStates(self, start: Any, goal: Any, threshold: float = np.finfo(float).eps) -> None:
        """Set start and goal as OMPL's setup does."""
        super().setStartAndGoalStates(start, goal, threshold)
        self.problem.forget_stale()

    def setOptimizationObjective(self, objective: Any) -> None:
        """Set the objective as OMPL's setup does."""
        super().setOptimizationObjective(objective)
        self.problem.forget_stale()

    def _set_place(self, kind: type[WorkspaceGoal], place: Any, tolerance: float) -> None:
        si = self.getSpaceInformation()
        self.problem.place = kind(si, self.robot, place, tolerance=tolerance, field=self.field, seed=0)
        self.setGoal(self.problem.place)

    # ------------------------------------------------------------------------------------- paths and solutions

    def getProblemDefinition(self) -> Any:
        """Return OMPL's problem definition, whose solutions are of the problem as it is now."""
        self.problem.forget_stale()
        return super().getProblemDefinition()

    def haveSolutionPath(self) -> bool:
        """Return whether there is a path from a start towards the goal as they are now."""
        self.problem.forget_stale()
        self.problem.forget_wrong()
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

        Continuous joints count turns along it, from a start in [−π, π): no step is longer than half a turn.
        """
        return self.bridge.way_points(self.getSolutionPath())

    def set_solution(self, path: FloatArray) -> None:
        """Put a path (N, n) in the place of the solution; where that was approximate, so is this."""
        solution, scratch = og.PathGeometric(self.getSpaceInformation()), ScratchState(self.bridge)
        for q in path:
            solution.append(scratch.set(q))
        problem = self.getProblemDefinition()
        approximate, difference = problem.hasApproximateSolution(), problem.getSolutionDifference()
        problem.clearSolutionPaths()
        planner = self.getPlanner()  # none, if a planner solved the problem on its own
        name = "" if planner is None else planner.getName()
        problem.addSolutionPath(solution, approximate, max(0.0, difference), name)
        self.problem.begin()

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


def _let_go(setup: ref[ProblemSetup]) -> None:
    """Forget the user's checker at the end of the program."""
    alive = setup()
    if alive is not None:
        alive._put(replace(alive.getConstraints(), user=None))


# ----------------------------------------------------------------- what the first plan after an installation compiles

# By two processes, each about half of the time; turns need what the first three compile, and come last. Kernels are
# compiled for one kind of arguments, whatever the robot: that of two joints beside a person has them all.
PLAN_JOBS = (
    f"{__name__}:ask_for_danger",
    f"{__name__}:ask_for_edges",
    f"{__name__}:ask_for_trees",
    f"{__name__}:ask_for_proofs",
    f"{SafeRRTConnect.__module__}:ask_for_turns",
)
_ANY_LENGTH = 1.0


@cache
def compile_kernels() -> None:
    """Compile the kernels of a plan, unless they are on disk: once in a process it is looked whether they are."""
    compile_together([dangers], PLAN_JOBS)


def small_robot() -> Robot:
    """Return a robot of two joints."""
    return scenes.Scenario.load("planar2").build_robot()


def ask_for_danger() -> None:
    """Call what danger, steps and reports need."""
    robot = small_robot()
    step, q, wraps = np.ones((2, robot.n)), np.zeros(robot.n), np.zeros(robot.n, dtype=bool)
    steer(q, q + _ANY_LENGTH, wraps, _ANY_LENGTH, step)
    descend(step, q, _ANY_LENGTH, q, q, wraps)
    robot.joint_limits.hold(q)
    DangerField(robot, np.ones((1, 3))).values_and_gradients(np.zeros((1, robot.n)))
    simplification.Curve(robot, np.zeros((2, robot.n))).at(q[:1])


def ask_for_edges() -> None:
    """Call what the proof of an edge needs that no pair of bodies is near."""
    nothing = EdgeTables.of_nothing()
    required, edge = nothing.required, nothing.edge
    lay_edge(required.distances, required.distances, nothing.coupling, nothing.limits, edge)
    arguments: Any = *nothing.pairs, edge, *required, nothing.floor, *nothing[8:]
    prove_curve(nothing.joints, *nothing.shapes, *arguments)


def ask_for_trees() -> None:
    """Call what finds the nearest of many nodes."""
    rows = np.eye(2)
    NearestNode(np.zeros(2, bool)).find(rows, rows[0], _ANY_LENGTH, rows[0])


def ask_for_proofs() -> None:
    """Call what else proofs and queries need."""
    shapes = {"person": Person(), "box": Box([1.0, 1.0, 1.0]), "ball": Sphere(1.0)}
    robot, scene = small_robot(), Scene([Obstacle(name, shape, weight=1.0) for name, shape in shapes.items()])
    scene.danger_points()
    extreme_vertices(np.zeros((1, 3)), 1)
    checker, q = CollisionChecker(robot, scene), np.zeros(robot.n)
    checker.in_collision(q)
    checker.pairs.bounds.of(q[None], np.arange(1), _ANY_LENGTH)
    MotionProver(checker).is_free(q, q + _ANY_LENGTH)
