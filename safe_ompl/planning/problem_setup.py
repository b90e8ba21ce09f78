"""ProblemSetup: what `SafeSetup` plans: a robot in a scene, with constraints, a start and goals."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import ArrayLike
from ompl import geometric as og

from safe_ompl.collision import (
    FLOOR,
    CertifiedMotion,
    CollisionChecker,
    MinClearance,
    TipBounds,
    ToolOrientation,
)
from safe_ompl.common import CollisionError, Counts, InputError, number
from safe_ompl.danger import DangerLimit
from safe_ompl.geometry import Obstacle
from safe_ompl.planning.ompl import (
    REGION_TOLERANCE,
    TOLERANCE,
    Constraints,
    DangerObjective,
    RegionGoal,
    UserCheck,
    WorkspaceGoal,
    joint_space,
)
from safe_ompl.planning.problem import Problem
from safe_ompl.planning.wiring import Wiring, danger_field
from safe_ompl.robot import GoalRegion, Robot
from safe_ompl.scene import Scene

_log = logging.getLogger(__name__)

UP = (0.0, 0.0, 1.0)


class ProblemSetup(og.SimpleSetup):  # type: ignore[misc]
    """An `og.SimpleSetup` for a robot in a scene, with constraints, a start and goals; parameters as `SafeSetup`.

    Every path keeps to the constraints, whichever planner plans it, and this is proven along whole motions. A
    constraint that the start or all goals break is refused: a CollisionError says why, and all stays what it was.

    Attributes
    ----------
    wiring : Wiring
        The plug-ins of the space information.
    problem : Problem
        Start and goals.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        danger: Mapping[str, Any] | None = {},
        floor: float = FLOOR,
        movable: Sequence[str] = (),
    ) -> None:
        super().__init__(joint_space(robot))
        si = self.getSpaceInformation()
        self.robot = robot
        self.counts = Counts()
        checker = CollisionChecker(robot, scene, self.counts, movable=movable)
        self.field = None if danger is None else danger_field(robot, scene, danger, self.counts)
        self.danger_options = None if danger is None else dict(danger)
        self.wiring = Wiring(si, checker, floor)
        self.problem = Problem(self, self.wiring)
        if self.field is not None:
            self.setOptimizationObjective(DangerObjective(si, self.field))

    def __repr__(self) -> str:  # OMPL's own would ask thousands of queries
        return f"{type(self).__name__}({self.robot!r}, {self.scene!r})"

    @property
    def checker(self) -> CollisionChecker:
        """Robot against scene."""
        return self.wiring.checker

    @property
    def certified_motion(self) -> CertifiedMotion:
        """What proves motions under the constraints that are set now."""
        return self.wiring.validator.motion

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

        Where nothing differs but places of obstacles that were `movable`, or have moved before, it takes a millisecond;
        else the checker is made anew. The solution is forgotten, and so is what the planner has built. Whether start
        and goals are still free is found out when planning begins.

        Raises
        ------
        InputError
            If it is no scene.
        UnknownNameError
            If a constraint is about an obstacle that it does not have. Then the scene stays what it was.
        """
        if not isinstance(scene, Scene):
            raise InputError(f"must be a Scene, got {scene!r}")
        try:
            self.checker.move(scene)
        except InputError:  # more than places of movable obstacles differs
            moved = {o.name for o in self.scene if o.name in scene.names and o != scene[o.name]}
            movable = [name for name in scene.names if name in moved | self.checker.movable]
            checker = CollisionChecker(self.robot, scene, self.counts, movable=movable)
            self.wiring.put(self.wiring.constraints.in_scene_of(checker), checker)
        if self.field is not None:
            self.field.stand_in(scene)
        self.clear()
        self.problem.scene_changed()

    # -------------------------------------------------------------------------------------------- constraints

    def getConstraints(self) -> Constraints:
        """Return what every path must keep to besides joint limits and collision."""
        return self.wiring.constraints

    def setConstraints(self, constraints: Constraints) -> None:
        """Set all constraints at once.

        Raises
        ------
        CollisionError
            If start or all goals that are set break them. Then the constraints stay what they were.
        UnknownNameError
            If one is about an obstacle that the scene does not have. Then they stay, too.
        """
        before = self.wiring.constraints
        self.wiring.put(constraints)
        try:
            self.problem.check()
        except BaseException:
            self.wiring.put(before)
            raise

    def setMaxDanger(self, limit: float) -> None:
        """Set the danger that no configuration of a path may exceed, in the units of the danger field; 0: any danger.

        Errors as `setConstraints`; an InputError if it is negative or not finite, or there is no danger field.
        """
        if self.field is None:
            raise InputError("max danger needs a danger field; this setup plans without danger")
        danger = DangerLimit(self.field, limit) if number("max danger", limit, at_least=0) else None
        self.setConstraints(replace(self.wiring.constraints, danger=danger))

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Set the distance that every path must keep from obstacles.

        Where no obstacles are named, it is kept from those that are dangerous, in other scenes, too.

        Parameters
        ----------
        distance, obstacles, exempt
            As in `MinClearance.of`; errors as there, and as `setConstraints`.
        """
        constraints = self.wiring.constraints
        self.setConstraints(constraints.with_min_clearance(self.checker, distance, obstacles, exempt))

    def getMinClearance(self) -> MinClearance | None:
        """Return the distance that every path must keep from obstacles; None where none is required."""
        return self.wiring.constraints.separation.min_clearance

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Have only motions that are free whatever obstacles do, no faster than their speeds, within a time.

        Parameters
        ----------
        speeds, time
            As in `CertifiedMotion.with_moving_obstacles`; errors as there, and as `setConstraints`.
        """
        self.setConstraints(self.wiring.constraints.with_moving_obstacles(speeds, time))

    def getMovingObstacles(self) -> tuple[dict[str, float], float]:
        """Return the speeds by obstacle [m/s] and the time [s] of `setMovingObstacles`; no speeds: all stand still."""
        separation = self.wiring.constraints.separation
        return dict(separation.speeds), separation.time

    def setToolConstraint(
        self, axis: ArrayLike | None = None, direction: ArrayLike = UP, angle: float | None = None
    ) -> None:
        """Have only paths on which an axis of the tool stays near a direction.

        ``setToolConstraint(angle=0.5)`` keeps upright what is upright at the start. Without arguments: there is no such
        constraint any more.

        Parameters
        ----------
        axis : array_like, shape (3,), optional
            The axis in the frame of the tip; default: the one that points in the direction at the start.
        direction : array_like, shape (3,)
            In the world frame; default: up.
        angle : float, optional
            [rad] The largest angle between the two.

        Raises
        ------
        InputError
            As `ToolOrientation`; without an axis if no start is set; an axis without an angle.
        CollisionError
            As `setConstraints`.
        """
        if angle is None and axis is not None:
            raise InputError("give the angle [rad] within which the axis of the tool must stay")
        orientation: ToolOrientation | None = None
        if axis is not None and angle is not None:
            orientation = ToolOrientation(self.robot, axis, direction, angle)
        elif angle is not None:
            if self.problem.start is None:
                raise InputError(
                    "the axis of the tool is that of the start: set a start before, or give the axis"
                )
            orientation = ToolOrientation.as_at(self.robot, self.problem.start, direction, angle)
        self._limit_tool(orientation, self.getTipBounds())

    def getToolConstraint(self) -> ToolOrientation | None:
        """Return the limit of the tool's orientation; None where there is none."""
        return self.wiring.constraints.tool_limit(ToolOrientation)

    def setTipBounds(self, lower: ArrayLike | None, upper: ArrayLike | None = None) -> None:
        """Have only paths on which the tip stays inside a box.

        Parameters
        ----------
        lower, upper : array_like, shape (3,), optional
            Opposite corners in the world frame [m]; infinite where there is no wall. None: there is no such constraint
            any more.

        Raises
        ------
        InputError
            As `TipBounds`; if only one corner is given.
        CollisionError
            As `setConstraints`.
        """
        bounds = None
        if lower is not None and upper is not None:
            bounds = TipBounds(self.robot, lower, upper)
        elif not (lower is None and upper is None):
            raise InputError("give both corners of the tip's box, or neither")
        self._limit_tool(self.getToolConstraint(), bounds)

    def getTipBounds(self) -> TipBounds | None:
        """Return the box that the tip stays in; None where there is none."""
        return self.wiring.constraints.tool_limit(TipBounds)

    def _limit_tool(self, *limits: ToolOrientation | TipBounds | None) -> None:
        tool = tuple(limit for limit in limits if limit is not None)
        self.setConstraints(replace(self.wiring.constraints, tool=tool))

    def tool_claim(self) -> dict[str, Any] | None:
        """Return what a certificate can claim of the tool (`tool` of `certificate`); None where nothing limits it."""
        given = {"orientation": self.getToolConstraint(), "position": self.getTipBounds()}
        return {key: limit.as_dict() for key, limit in given.items() if limit is not None} or None

    # ------------------------------------------------------------------------------ the user's own plug-ins

    def setStateValidityChecker(self, checker: Any) -> None:
        """Have only states that a checker of the user's own accepts, besides being within limits and free.

        Planners, motions, simplification, goals and reports obey it. Nothing can be proven of it: motions are sampled
        (`setSamplingResolution`), and reports say so. A checker that is set on the space information itself is taken
        over by the next `setup`, `solve`, `plan`, `report` or the like.

        Parameters
        ----------
        checker : ob.StateValidityChecker, callable or None
            Answers for a state with a bool; what it raises arrives unchanged. None: there is none any more.

        Raises
        ------
        CollisionError
            If it refuses the start or all goals that are set. Then the checker stays what it was.
        InputError
            If it is nothing of the kind.
        """
        before = self.wiring.constraints
        self.wiring.put_user_checker(checker)
        try:
            self.problem.check()
        except BaseException:
            self.wiring.put(before)
            raise

    def setSamplingResolution(self, distance: float) -> None:
        """Set the distance [rad or m] > 0 between the samples of motions that the user's checker is asked about."""
        self.wiring.resolution = distance

    def getSamplingResolution(self) -> float:
        """Return the distance [rad or m] in joint space that `setSamplingResolution` sets."""
        return self.wiring.resolution

    @property
    def user_checks(self) -> tuple[UserCheck, ...]:
        """The user's own state validity checker and motion validator, as far as there are."""
        return self.wiring.constraints.user

    def _adopt_plugins(self) -> None:
        """Take over plug-ins that the user has set on the space information."""
        if self.wiring.adopt():  # planners would only speak of an invalid start or goal
            try:
                self.problem.check()
            except CollisionError as error:
                _log.warning("%s", error)

    # ------------------------------------------------------------------------------------------ start and goal

    def setConfigurations(self, start: Any, goals: Any) -> None:
        """Set the start configuration (n,) and one goal (n,) or several (G, n) [rad or m].

        Parameters
        ----------
        start : array_like, shape (n,), or mapping of str to float
            In the order of the robot's joints, or by their names, as `Robot.named` gives them.
        goals : array_like, shape (n,) or (G, n), mapping, or sequence of mappings
            One, or several.

        Raises
        ------
        InputError
            Wrong shape, NaN, unknown or missing joint, or outside the limits: names joint, value and limits.
        CollisionError
            In collision, or against a constraint: says which. Of several goals only those that are allowed count; one
            must be.
        """
        self.problem.set_configurations(start, goals)

    def setStartConfiguration(self, start: Any) -> None:
        """Set the start configuration (n,) [rad or m], numbers or by name; errors as `setConfigurations`."""
        self.problem.set_start(start)

    def setWorkspaceGoal(
        self, position: ArrayLike | Any, rotation: ArrayLike | None = None, tolerance: float = TOLERANCE
    ) -> None:
        """Set a place for the tip as the goal.

        Goal configurations set before stay for the planners that `plan` starts and that plan to configurations.

        Parameters
        ----------
        position, rotation, tolerance
            As in `WorkspaceGoal`: a position with or without a rotation, or a `pin.SE3`.
            Errors as there.
        """
        options: dict[str, Any] = {"tolerance": tolerance, "field": self.field, "seed": 0}
        self.problem.set_place(
            WorkspaceGoal(self.getSpaceInformation(), self.robot, position, rotation, **options)
        )

    def setGoalRegion(self, region: GoalRegion, tolerance: float = REGION_TOLERANCE) -> None:
        """Set a region for the tip as the goal, bounds of position and orientation; it replaces a `setWorkspaceGoal`.

        Parameters
        ----------
        region : GoalRegion
            Where the tip may be.
        tolerance : float
            How far outside of it is near enough [m], > 0; a radian counts as 0.25 m.
        """
        options: dict[str, Any] = {"tolerance": tolerance, "field": self.field, "seed": 0}
        self.problem.set_place(RegionGoal(self.getSpaceInformation(), self.robot, region, **options))
