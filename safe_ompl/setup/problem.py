"""The problem to plan: its start and its goal."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import CollisionError, InputError
from safe_ompl.planners.registry import accepts
from safe_ompl.planners.rrt_connect import SafeRRTConnect
from safe_ompl.plugins.goals import TOLERANCE, WorkspaceGoal
from safe_ompl.plugins.region_goal import REGION_TOLERANCE, RegionGoal
from safe_ompl.robot.region import GoalRegion
from safe_ompl.setup.given_planner import check_planner
from safe_ompl.setup.inputs import configuration_of, several
from safe_ompl.setup.tool import ToolLimitedSetup
from safe_ompl.setup.wiring import danger_field as danger_field

_log = logging.getLogger(__name__)


class SafeProblem(ToolLimitedSetup):
    """The part of `SafeSetup` that says what is to be planned; parameters as there."""

    _start: FloatArray | None = None  # as given
    _goals: Sequence[FloatArray] = ()  # as given, those that do not count, too
    _goal_region: Any = None
    _place: WorkspaceGoal | None = None
    _unchecked = False  # whether the scene has changed since start and goals were found free

    # ------------------------------------------------------------------------------------- start and goal

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
            In collision, or refused by the user's own checker: names the pair. Of several goals only those that are
            free count; one must be.
        """
        given = several(goals)
        free = self._checked_goals(given)
        self.setStartConfiguration(start)
        self._goals = [configuration_of(self.robot, goal, "goal") for goal in given]
        self._goal_region = self._region_of(free)
        self.setGoal(self._goal_region)

    def _region_of(self, goals: Sequence[FloatArray]) -> Any:
        region = ob.GoalStates(self.getSpaceInformation())
        for q in goals:
            region.addState(self._state(q))
        return region

    def setStartConfiguration(self, start: Any) -> None:
        """Set the start configuration (n,) [rad or m], numbers or by name; errors as `setConfigurations`."""
        q_start = self._checked_configuration(start, "start")
        self._start = q_start
        self.clearStartStates()
        self.addStartState(self._state(q_start))

    def setWorkspaceGoal(
        self, position: ArrayLike | Any, rotation: ArrayLike | None = None, tolerance: float = TOLERANCE
    ) -> None:
        """Set a place for the tip as the goal.

        Goal configurations set before stay for the planners that `plan` starts and that plan to configurations.

        Parameters
        ----------
        position, rotation, tolerance
            As in `WorkspaceGoal`: a position with or without a rotation, or a `pin.SE3`.

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

    def setGoalRegion(self, region: GoalRegion, tolerance: float = REGION_TOLERANCE) -> None:
        """Set a region for the tip as the goal: position and orientation within bounds.

        It takes the place of a `setWorkspaceGoal`; what is said there of configurations holds here, too.

        Parameters
        ----------
        region : GoalRegion
            Where the tip may be.
        tolerance : float
            How far outside of it is near enough [m]; a radian counts as 0.25 m.

        Raises
        ------
        InputError
            If it is no region, or the tolerance is not positive.
        """
        si = self.getSpaceInformation()
        self._place = RegionGoal(si, self.robot, region, tolerance=tolerance, field=self.field, seed=0)
        self.setGoal(self._place)

    def _given_start(self) -> FloatArray | None:
        return self._start

    def _check_given(self) -> None:
        """Raise an error if the start or all goals that were given are not allowed any more."""
        if self._start is not None:
            self._checked_configuration(self._start, "start")
        if self._goals:
            self._checked_goals(self._goals)

    def _scene_changed(self, *, same_checker: bool) -> None:
        super()._scene_changed(same_checker=same_checker)
        self._unchecked = True
        if self._place is not None:
            self._place.setSeed(self._place.getSeed())  # forgets the configurations that it has found

    def _check_anew(self) -> None:
        """Raise an error if the scene has changed and start or all goals are not free; only goals that are count."""
        if not self._unchecked:
            return
        if self._start is not None:
            self._checked_configuration(self._start, "start")
        if self._goals:
            region, was_goal = self._region_of(self._checked_goals(self._goals)), self._goal_region
            self._goal_region = region
            if self.getGoal() is was_goal:
                self.setGoal(region)
        self._unchecked = False

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

    def _explain_missing_goal(self) -> None:
        """Say why a planner had no goal configuration, where inverse kinematics found none."""
        place = self._place
        why = None if place is None or self.getGoal() is not place else place.failure()
        if why is not None and place is not None:
            objection = None if place.refused is None else self._objection(place.refused)
            _log.warning("%s%s", why, "" if objection is None else f"; the last one{objection}")

    def _checked_goals(self, goals: Sequence[Any]) -> list[FloatArray]:
        if len(goals) == 1:
            return [self._checked_configuration(goals[0], "goal")]
        free, refused = [], list[CollisionError]()
        for k, goal in enumerate(goals):
            try:
                free.append(self._checked_configuration(goal, f"goal {k}"))
            except CollisionError as error:
                refused.append(error)
        if refused and not free:
            raise refused[-1]
        if refused:
            more = "" if len(refused) == 1 else f"; and {len(refused) - 1} more"
            _log.warning("%d of %d goals do not count: %s%s", len(refused), len(goals), refused[0], more)
        return free

    def _checked_configuration(self, value: Any, name: str) -> FloatArray:
        super()._adopt_plugins()
        robot = self.robot
        q = configuration_of(robot, value, name)
        for i in np.flatnonzero(~robot.within_limits(q)):
            raise InputError(
                f"{name}: joint {robot.joint_names[i]!r} = {q[i]:g} is outside its limits "
                f"[{robot.lower[i]:g}, {robot.upper[i]:g}]"
            )
        objection = self._objection(q)
        if objection is not None:
            raise CollisionError(name + objection)
        # Within the tolerance of the limits a start is accepted; OMPL's own tolerance is smaller.
        return np.where(robot.continuous, q, np.clip(q, robot.lower, robot.upper))

    def setup(self) -> None:
        """Prepare for `solve`, as OMPL's `setup`.

        Raises
        ------
        InputError
            If no start or no goal is set.
        """
        self._adopt_plugins()
        self._check_problem()
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

    def _adopt_plugins(self) -> bool:
        adopted = super()._adopt_plugins()
        if adopted:  # planners would only speak of an invalid start or goal
            try:
                self._check_given()
            except CollisionError as error:
                _log.warning("%s", error)
        return adopted

    def setStateValidityChecker(self, checker: Any) -> None:
        """Have only states that a checker of the user's own accepts; parameters as in `WiredSetup`.

        Raises
        ------
        CollisionError
            If it refuses the start or all goals that are set. Then the checker stays what it was.
        InputError
            If it is no checker.
        """
        before = self._sampled
        super().setStateValidityChecker(checker)
        try:
            self._check_given()
        except BaseException:
            self._take_checker(before)
            raise

    def _check_problem(self) -> None:
        """Raise an error where OMPL would say less, or end the process."""
        self._check_anew()
        goal = self.getGoal()
        if goal is None:
            raise InputError(
                "no goal is set: call setConfigurations, setWorkspaceGoal, setGoalRegion or setGoal"
            )
        if isinstance(goal, ob.GoalLazySamples):
            raise InputError(
                "OMPL's GoalLazySamples waits for itself for ever where its sampler is Python's; take a WorkspaceGoal, "
                "or a subclass of ob.GoalSampleableRegion"
            )
        if not self.getProblemDefinition().getStartStateCount():
            raise InputError(
                "no start is set: call setConfigurations, setStartConfiguration or addStartState"
            )
        if isinstance(self.getPlanner(), og.SORRTstar) and self.getProblemDefinition().isTrivial():
            raise InputError("OMPL's SORRTstar never ends where the start is the goal; take InformedRRTstar")
