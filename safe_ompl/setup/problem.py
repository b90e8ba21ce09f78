"""What is to be planned: OMPL's SimpleSetup wired from a robot and a scene, with start, goal and limits."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import document
from safe_ompl.arrays import FloatArray, finite_array
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.min_clearance import MinClearance
from safe_ompl.collision.motion import FLOOR
from safe_ompl.collision.separation import Separation
from safe_ompl.counts import Counts
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import CollisionError, InputError
from safe_ompl.inputs import number
from safe_ompl.paths.report import PathReport
from safe_ompl.planners.registry import accepts
from safe_ompl.plugins.goals import TOLERANCE, WorkspaceGoal
from safe_ompl.plugins.motion import CertifiedMotionValidator
from safe_ompl.plugins.objective import DangerObjective
from safe_ompl.plugins.states import StateBridge, joint_space
from safe_ompl.plugins.validity import CollisionFreeValidity
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_log = logging.getLogger(__name__)


class SafeProblem(og.SimpleSetup):  # type: ignore[misc]
    """The part of `SafeSetup` that says what is to be planned, and looks at solutions; parameters as there."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        danger: Mapping[str, Any] | None = {},
        floor: float = FLOOR,
    ) -> None:
        super().__init__(joint_space(robot))
        si = self.getSpaceInformation()
        self.robot = robot
        self.scene = scene
        self.danger_options = None if danger is None else dict(danger)
        self.counts = Counts()
        self.checker = CollisionChecker(robot, scene, self.counts)
        self.field = None if danger is None else danger_field(robot, scene, danger, self.counts)
        self._validity = CollisionFreeValidity(si, self.checker)
        self.setStateValidityChecker(self._validity)
        self._validator = CertifiedMotionValidator(si, self.checker, floor)
        si.setMotionValidator(self._validator)
        if self.field is not None:
            self.setOptimizationObjective(DangerObjective(si, self.field))
        self._bridge = StateBridge(self.getStateSpace())
        self._danger_limit: DangerLimit | None = None
        self._given: tuple[FloatArray | None, list[FloatArray]] = None, []  # start and goals
        self._goal_region: Any = None
        self._place: WorkspaceGoal | None = None

    # ----------------------------------------------------------------------------------------- the problem

    def setConfigurations(self, start: ArrayLike, goals: ArrayLike) -> None:
        """Set the start configuration (n,) and one goal (n,) or several (G, n) [rad or m].

        Raises
        ------
        InputError
            Wrong shape, NaN, or outside the limits: names joint, value and limits.
        CollisionError
            In collision: names the pair. Of several goals only those that are free count; one must be.
        """
        rows = np.atleast_2d(np.asarray(goals, dtype=object))
        q_goals = self._checked_goals([list(row) for row in rows])
        self.setStartConfiguration(start)
        self._given = self._given[0], q_goals
        region = ob.GoalStates(self.getSpaceInformation())
        for q in q_goals:
            region.addState(self._state(q))
        self._goal_region = region
        self.setGoal(region)

    def setStartConfiguration(self, start: ArrayLike) -> None:
        """Set the start configuration (n,) [rad or m]; errors as `setConfigurations`."""
        q_start = self._checked_configuration(start, "start")
        self._given = q_start, self._given[1]
        self.clearStartStates()
        self.addStartState(self._state(q_start))

    def setWorkspaceGoal(
        self, position: ArrayLike, rotation: ArrayLike | None = None, tolerance: float = TOLERANCE
    ) -> None:
        """Set a place for the tip as the goal: `position: (3,)` [m], for a pose `rotation: (3, 3)` as well.

        Goal configurations set before stay for the planners that `plan` starts and that plan to configurations.

        Raises
        ------
        InputError
            Wrong shape, NaN, a matrix that is not a rotation, or a tolerance that is not positive.
        """
        self._place = WorkspaceGoal(
            self.getSpaceInformation(),
            self.robot,
            position,
            rotation,
            tolerance=tolerance,
            field=self.field,
            seed=0,
        )
        self.setGoal(self._place)

    def setMaxDanger(self, limit: float) -> None:
        """Set the danger that no configuration of a path may exceed, whoever plans it, proven along whole motions.

        Parameters
        ----------
        limit : float
            In the units of the danger field; 0: any danger.

        Raises
        ------
        InputError
            If it is negative or not finite, or there is no danger field.
        CollisionError
            If start or all goals are above it. Then the limit stays what it was.
        """
        if self.field is None:
            raise InputError("max danger needs a danger field; this setup plans without danger")
        before = self._danger_limit
        self._keep_to(DangerLimit(self.field, limit) if number("max danger", limit, at_least=0) else None)
        try:
            self._check_given()
        except BaseException:
            self._keep_to(before)
            raise

    def _keep_to(self, limit: DangerLimit | None) -> None:
        self._danger_limit = limit
        self._validity.setDangerLimit(limit)
        self._validator.setDangerLimit(limit)

    def setMinClearance(
        self,
        distance: float,
        obstacles: Sequence[str] | None = None,
        exempt: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Set the distance that every path must keep from obstacles, whoever plans it, proven along whole motions.

        Parameters
        ----------
        distance, obstacles, exempt
            As in `MinClearance.of`.

        Raises
        ------
        CollisionError
            If start or all goals are nearer. Then the distance stays what it was.
        InputError
            As there.
        """
        before = self._validator.getSeparation()
        self._keep_apart(before.with_min_clearance(self.checker, distance, obstacles, exempt))
        try:
            self._check_given()
        except BaseException:
            self._keep_apart(before)
            raise

    def getMinClearance(self) -> MinClearance | None:
        """Return the distance that every path must keep from obstacles; None where none is required."""
        return self._validator.getSeparation().min_clearance

    def _keep_apart(self, separation: Separation) -> None:
        self._validator.setSeparation(separation)
        # Obstacles that move are the validator's: states have no time.
        self._validity.setSeparation(Separation(separation.min_clearance, separation.margin))

    def setMovingObstacles(self, speeds: Mapping[str, float], time: float) -> None:
        """Have only motions that are free whatever obstacles do, no faster than their speeds, within a time.

        Parameters
        ----------
        speeds, time
            As in `CertifiedMotion.with_moving_obstacles`.

        Raises
        ------
        InputError
            As there.
        """
        self._validator.setMovingObstacles(speeds, time)

    def getMovingObstacles(self) -> tuple[dict[str, float], float]:
        """Return the speeds by obstacle [m/s] and the time [s] of `setMovingObstacles`; no speeds: all stand still."""
        separation = self._validator.getSeparation()
        return dict(separation.speeds), separation.time

    def _check_given(self) -> None:
        """Raise an error if the start or all goals that were given are not allowed any more."""
        start, goals = self._given
        if start is not None:
            self._checked_configuration(start, "start")
        if goals:
            self._checked_goals(goals)

    def _choose_goal(self, planner: Any, seed: int) -> None:
        """Of a place and goal configurations that were both set, take what the planner plans to."""
        if self._place is None:
            return
        self._place.setSeed(seed)
        if self._goal_region is not None:
            self.setGoal(self._goal_region if accepts(planner, self._goal_region) else self._place)

    def _choose_place(self) -> None:
        """Have a planner that plans to places only do so, though goal configurations were set later."""
        needs_place = not accepts(self.getPlanner(), self._goal_region)
        if needs_place and self._place is not None and self.getGoal() is self._goal_region:
            self.setGoal(self._place)

    def _checked_goals(self, goals: Sequence[ArrayLike]) -> list[FloatArray]:
        if len(goals) == 1:
            return [self._checked_configuration(goals[0], "goal")]
        free, refused = [], None
        for k, goal in enumerate(goals):
            try:
                free.append(self._checked_configuration(goal, f"goal {k}"))
            except CollisionError as error:
                _log.warning("%s", error)
                refused = error
        if refused is not None and not free:
            raise refused
        return free

    def _checked_configuration(self, value: ArrayLike, name: str) -> FloatArray:
        robot = self.robot
        q = finite_array(value, (robot.n,), f"{name} configuration")
        for i in np.flatnonzero(~robot.within_limits(q)):
            raise InputError(
                f"{name}: joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]"
            )
        pair = self.checker.colliding_pair(q)
        if pair is not None:
            raise CollisionError(f"{name} is in collision: {pair[0]!r} touches {pair[1]!r}")
        required = self._validity.getSeparation().required(self.checker)
        near = required.violating_pair(q)
        if near is not None:
            least = f"{1e3 * required.at_start.max():g} mm"
            raise CollisionError(f"{name} is too near: {near[0]!r} keeps less than {least} from {near[1]!r}")
        if self._danger_limit is not None and not self._danger_limit.allows(q):
            raise CollisionError(
                f"{name}: danger {self._danger_limit.danger(q):.4g} is above the limit {self._danger_limit.limit:g}"
            )
        # Within the tolerance of the limits a start is accepted; OMPL's own tolerance is smaller.
        return np.where(robot.continuous, q, np.clip(q, robot.lower, robot.upper))

    def _state(self, q: FloatArray) -> Any:
        state = self.getStateSpace().allocState()
        self._bridge.write(q, state)
        return state

    def setup(self) -> None:
        """Prepare for `solve`, as OMPL's `setup`.

        Raises
        ------
        InputError
            If no start or no goal is set.
        """
        self._check_problem()
        super().setup()

    def _check_problem(self) -> None:
        """Raise an error where OMPL would say less, or end the process."""
        if self.getGoal() is None:
            raise InputError("no goal is set: call setConfigurations, setWorkspaceGoal or setGoal")
        if not self.getProblemDefinition().getStartStateCount():
            raise InputError(
                "no start is set: call setConfigurations, setStartConfiguration or addStartState"
            )
        if isinstance(self.getPlanner(), og.SORRTstar) and self.getProblemDefinition().isTrivial():
            raise InputError("OMPL's SORRTstar never ends where the start is the goal; take InformedRRTstar")

    # ---------------------------------------------------------------------------------------- the solution

    def solution(self) -> FloatArray:
        """Return the solution path (N, n) found last."""
        path = self.getSolutionPath()
        return np.array([self._bridge.read(path.getState(i)) for i in range(path.getStateCount())])

    def report(self, path: ArrayLike) -> PathReport:
        """Validate and examine a path (N, n)."""
        array = finite_array(path, (None, self.robot.n), "path")
        return PathReport.of(array, self.checker, self.field, self._validator.motion)

    def _set_solution(self, path: FloatArray) -> None:
        solution = og.PathGeometric(self.getSpaceInformation())
        for q in path:
            solution.append(self._state(q))
        problem = self.getProblemDefinition()
        problem.clearSolutionPaths()
        planner = self.getPlanner()  # none, if a planner solved the problem on its own
        problem.addSolutionPath(solution, False, 0.0, "" if planner is None else planner.getName())


def danger_field(
    robot: Robot, scene: Scene, options: Mapping[str, Any], counts: Counts | None = None
) -> DangerField:
    """Return the danger of a robot in a scene; options as `danger` of `SafeSetup`, errors as there."""
    with document.within("danger"):
        document.check_keys(options, ("spacing", "aggregate", "weighting", "k1", "sharpness"))
    options = dict(options)
    points, weights, _ = scene.danger_points(options.pop("spacing", None))
    return DangerField(robot, points, weights, counts=counts, **options)
