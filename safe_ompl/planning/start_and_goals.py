"""Start and goals of a setup: checks of them, and removal of solutions that no longer fit them."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, NamedTuple
from weakref import proxy

import numpy as np
from ompl import base as ob, geometric as og

from safe_ompl.common import CollisionError, FloatArray, InputError, PlanningError
from safe_ompl.planning.ompl import DangerObjective, FiniteCosts, WorkspaceGoal, states_of
from safe_ompl.planning.planners import SafePlanner, accepts
from safe_ompl.robot import OwnState, Robot, ScratchState

_log = logging.getLogger(__name__)

_NEVER_NAN = DangerObjective, ob.PathLengthOptimizationObjective

# The largest distance in joint space between the ends of a path and its start and goal.
END_TOLERANCE = 1e-6  # [rad or m]


class Asked(NamedTuple):
    """The problem of a setup when a planner began: valid starts, number of given starts, goal, objective and space.

    `starts` are copies of states; `states` are the configurations of a list of goals, as bytes.
    """

    starts: list[OwnState]
    given: int
    goal: Any
    states: set[bytes]
    objective: Any
    coordinates: Any


class StartAndGoals:
    """Start and goals of an OMPL setup, checked when they are set and after the scene has changed.

    Goal configurations and a goal pose of the tip (`tip_goal`) may both be set. Each planner gets the kind that it
    plans to. This object refers to its setup weakly.
    """

    def __init__(self, setup: Any, definition: Any) -> None:
        # Goals are set by the setup, not by the definition, because OMPL's setup makes a new simplifier with each goal.
        self._setup, self._definition = proxy(setup), definition
        self._asked: Asked | None = None  # when a planner began
        self._start: FloatArray | None = None
        self.goals: Sequence[FloatArray] = ()
        self.tip_goal: WorkspaceGoal | None = None
        # The states of the goals that are valid.
        self._goal_states: Any = None
        # Whether the scene has changed since start and goals were found free.
        self._unchecked = False
        self._scratch = ScratchState(setup.bridge)

    # -------------------------------------------------------------------------------------- what is given

    @property
    def start(self) -> FloatArray | None:
        """The start configuration (n,); the first valid one if several starts were added by OMPL's methods."""
        self.forget_stale()
        if self._start is None and (starts := self._now().starts):
            return np.asarray(self._setup.bridge.read(starts[0].state))
        return self._start

    def set_configurations(self, start: Any, goals: Any) -> None:
        """Set start and goals; parameters and errors as `SafeSetup.setConfigurations`."""
        self.forget_stale()
        given = several(goals)
        free = self._checked_goals(given)
        self.set_start(start)
        self.goals = [self._setup.robot.configuration(goal, "goal configuration") for goal in given]
        self._goal_states = self._states_of(free)
        self._setup.setGoal(self._goal_states)

    def set_start(self, start: Any) -> None:
        """Set the start configuration (n,), as numbers or by name; errors as `checked`."""
        q = self.checked(self._setup.robot.clipped_start(start, "start configuration"), "start")
        self._setup.setStartState(self._scratch.set(q))
        self._start = q

    # --------------------------------------------------------------------------------------------- checks

    def checked(self, value: Any, name: str) -> FloatArray:
        """Return an allowed configuration (n,) from numbers or from a mapping by joint name.

        Raises InputError as `Robot.configuration` or outside the limits, and CollisionError for a configuration in
        collision or against a constraint.
        """
        robot: Robot = self._setup.robot
        check = self._setup.validity.check
        q = robot.configuration(value, f"{name} configuration")
        refusal = check.refusal(q)
        if refusal is not None:
            raise (CollisionError if check.within_limits(q) else InputError)(name + refusal)
        # The check has a larger tolerance of the limits than OMPL, so the configuration is clipped to the limits.
        return np.where(robot.continuous, q, np.minimum(np.maximum(q, robot.lower), robot.upper))

    def explain_missing_goal(self) -> None:
        """If inverse kinematics found no goal configuration, log the reason."""
        goal = self.tip_goal
        why = None if goal is None or self._setup.getGoal() is not goal else goal.failure()
        if why is not None and goal is not None:
            refusal = None if goal.refused is None else self._setup.validity.check.refusal(goal.refused)
            _log.warning("%s%s", why, "" if refusal is None else f"; the last one{refusal}")

    def check(self) -> list[FloatArray]:
        """Return the allowed goals; errors as `checked` if the start or all goals are no longer allowed."""
        self.forget_stale()
        if self._start is not None:
            self.checked(self._start, "start")
        return self._checked_goals(self.goals) if self.goals else []

    def scene_changed(self) -> None:
        """Note that the scene has changed, so that `check_anew` checks start and goals again."""
        self._unchecked = True
        if self.tip_goal is not None:
            # Setting the seed clears the goal configurations that inverse kinematics found.
            self.tip_goal.setSeed(self.tip_goal.getSeed())

    def check_anew(self) -> None:
        """If the scene has changed, `check` start and goals, and set the goals that are allowed now."""
        if not self._unchecked:
            return
        if free := self.check():
            before, self._goal_states = self._goal_states, self._states_of(free)
            if self._setup.getGoal() is before:
                self._setup.setGoal(self._goal_states)
        self._unchecked = False

    def check_complete(self, planner: Any) -> None:
        """Raise InputError for problems that OMPL would report poorly, or that would hang or end the process."""
        setup, si = self._setup, self._setup.getSpaceInformation()
        if si.getStateValidityChecker() is not setup.validity or si.getMotionValidator() is not setup.validator:
            raise InputError(
                "the space information of a SafeSetup proves motions with validators of its own: give yours to "
                "SafeSetup.setStateValidityChecker, which is asked besides"
            )
        self.check_anew()
        goal = self._setup.getGoal()
        if goal is None:
            raise InputError("no goal is set: call setConfigurations, setWorkspaceGoal, setGoalRegion or setGoal")
        if isinstance(goal, ob.GoalLazySamples):
            raise InputError(
                "OMPL's GoalLazySamples deadlocks if its sampler is written in Python; use a WorkspaceGoal, "
                "or a subclass of ob.GoalSampleableRegion"
            )
        if not self._definition.getStartStateCount():
            raise InputError("no start is set: call setConfigurations, setStartConfiguration or addStartState")
        if isinstance(planner, og.SORRTstar) and self._definition.isTrivial():
            raise InputError("OMPL's SORRTstar never ends if the start is the goal; use InformedRRTstar")

    def check_ends(self, path: FloatArray, name: str) -> None:
        """Raise PlanningError if the path (N, n) of a planner does not lead from a start to the goal."""
        refusal = self._refusal_of_start(path[0]) or self._refusal_of_end(path[-1])
        if refusal is not None:
            raise PlanningError(f"{name} returned a path that {refusal}")

    def _refusal_of_start(self, q: FloatArray) -> str | None:
        bridge = self._setup.bridge
        starts = [bridge.read(start.state) for start in (self._asked or self._now()).starts]
        distance = min((float(np.linalg.norm(bridge.difference(start, q))) for start in starts), default=np.inf)
        return None if distance <= END_TOLERANCE else f"begins {distance:.3g} rad away from every start"

    def _refusal_of_end(self, q: FloatArray) -> str | None:
        goal, state = self._definition.getGoal(), self._scratch.set(q)
        if isinstance(goal, ob.GoalRegion):
            short, unit = float(goal.distanceGoal(state)), "m" if hasattr(goal, "target") else "rad"
            if not short <= max(END_TOLERANCE, goal.getThreshold()):
                return f"ends {short:.3g} {unit} away from the goal"
        elif not goal.isSatisfied(state):
            return "does not end in the goal"
        return None

    # ------------------------------------------------------------------------------ what was found for the problem

    def begin(self) -> None:
        """Store the present problem when a planner begins."""
        self._asked = self._now()

    def forget_stale(self) -> None:
        """Clear solutions and planner data if starts, goal, objective or space have changed since planning began.

        OMPL does not notify of such changes, and users may also change the problem definition itself. Therefore the
        stored problem is compared with the present one.
        """
        definition, asked = self._definition, self._asked
        goal = definition.getGoal()
        if self._start is not None and not definition.hasStartState(self._scratch.set(self._start), 0):
            self._start = None
        if goal is not None and goal is not self._goal_states and goal is not self.tip_goal:
            self.goals, self._goal_states, self.tip_goal = (), None, None
        if asked is None:
            return
        same_space = asked.coordinates == self._setup.bridge.coordinates()
        same_objective = asked.objective is definition.getOptimizationObjective()
        same_starts = asked.given == definition.getStartStateCount() and all(
            definition.hasStartState(start.state, 0) for start in asked.starts
        )
        same_goal = asked.goal is goal and asked.states == self._states_in(goal)
        if same_space and same_objective and same_starts and same_goal:
            return
        self._asked = None
        definition.clearSolutionPaths()
        planner = self._setup.getPlanner()
        # Planners of this package find out themselves which parts of their trees are still valid.
        if planner is None or isinstance(planner, SafePlanner):
            return
        if same_space and same_objective:
            planner.clearQuery()
        else:
            planner.clear()

    def forget_wrong(self) -> str | None:
        """Clear a solution that does not lead from a start to the goal, and return what is wrong with it, or None."""
        if not self._definition.hasSolution():
            return None
        path, read = self._definition.getSolutionPath(), self._setup.bridge.read
        refusal = self._refusal_of_start(read(path.getState(0)))
        if refusal is None and not self._definition.hasApproximateSolution():
            refusal = self._refusal_of_end(read(path.getState(path.getStateCount() - 1)))
        if refusal is not None:
            self._definition.clearSolutionPaths()
        return refusal

    @contextmanager
    def without_nan(self, planner: Any) -> Iterator[None]:
        """Replace NaN costs by infinity for OMPL's SORRTstar within the block: it never ends if a path costs NaN."""
        objective = self._definition.getOptimizationObjective()
        wrapped = self._may_be_nan and isinstance(planner, og.SORRTstar)
        if wrapped:
            self._definition.setOptimizationObjective(FiniteCosts(objective))
        try:
            yield
        finally:
            if wrapped:
                self._definition.setOptimizationObjective(objective)

    def forget_nan(self) -> bool:
        """Clear the solution if the objective is NaN on it, and return whether it was.

        A user's objective may be NaN for forbidden states. Comparisons with NaN are always false, so planners may keep
        such a path.
        """
        if not (self._may_be_nan and self._definition.hasSolution()):
            return False
        objective, bridge = self._definition.getOptimizationObjective(), self._setup.bridge
        path = bridge.way_points(self._definition.getSolutionPath())
        first, second = self._scratch, ScratchState(bridge)
        costs = [objective.stateCost(first.set(q)) for q in path]
        costs += [objective.motionCost(first.set(a), second.set(b)) for a, b in pairwise(path)]
        wrong = any(np.isnan(cost.value() if isinstance(cost, ob.Cost) else cost) for cost in costs)
        if wrong:
            self._definition.clearSolutionPaths()
        return wrong

    @property
    def _may_be_nan(self) -> bool:
        """Whether the objective is a user's, whose costs may be NaN."""
        objective = self._definition.getOptimizationObjective()
        return objective is not None and not isinstance(objective, _NEVER_NAN)

    def _now(self) -> Asked:
        definition, si = self._definition, self._setup.getSpaceInformation()
        inputs, starts = ob.PlannerInputStates(), list[OwnState]()
        # Without this call OMPL's bindings would free the states of the problem definition.
        inputs.use(definition)
        while inputs.haveMoreStartStates() and (state := inputs.nextStart()) is not None:
            starts.append(OwnState(self._setup.bridge))
            si.copyState(starts[-1].state, state)
        goal, objective = definition.getGoal(), definition.getOptimizationObjective()
        coordinates = self._setup.bridge.coordinates()
        return Asked(starts, definition.getStartStateCount(), goal, self._states_in(goal), objective, coordinates)

    def _states_in(self, goal: Any) -> set[bytes]:
        return {q.tobytes() for q in states_of(goal, self._setup.bridge)}

    # --------------------------------------------------------------------------------------- which goal

    def choose_goal(self, planner: Any, seed: int) -> None:
        """If a goal pose and goal configurations are both set, take the goal that the planner accepts."""
        self.forget_stale()
        if self.tip_goal is None:
            return
        self.tip_goal.setSeed(seed)
        if self._goal_states is not None:
            self._setup.setGoal(self._goal_states if accepts(planner, self._goal_states) else self.tip_goal)

    def choose_place(self, planner: Any) -> None:
        """Set the goal pose for a planner that does not accept the goal configurations that were set later."""
        goal = self._setup.getGoal()
        if self.tip_goal is not None and goal is self._goal_states and not accepts(planner, goal):
            self._setup.setGoal(self.tip_goal)

    # ----------------------------------------------------------------------------------------- internals

    def _states_of(self, goals: Sequence[FloatArray]) -> Any:
        states, scratch = ob.GoalStates(self._setup.getSpaceInformation()), ScratchState(self._setup.bridge)
        for q in goals:
            states.addState(scratch.set(q))
        return states

    def _checked_goals(self, goals: Sequence[Any]) -> list[FloatArray]:
        if len(goals) == 1:
            return [self.checked(goals[0], "goal")]
        free, refused = [], list[CollisionError]()
        for k, goal in enumerate(goals):
            try:
                free.append(self.checked(goal, f"goal {k}"))
            except CollisionError as error:
                refused.append(error)
        if refused and not free:
            raise refused[-1]
        if refused:
            more = "" if len(refused) == 1 else f"; and {len(refused) - 1} more"
            _log.warning("%d of %d goals do not count: %s%s", len(refused), len(goals), refused[0], more)
        return free


def several(goals: Any) -> list[Any]:
    """Return a list of configurations from one configuration, in any form, or from several."""
    if isinstance(goals, (Mapping, str)):
        return [goals]
    if isinstance(goals, Sequence) and any(isinstance(goal, (Mapping, str)) for goal in goals):
        return list(goals)
    if isinstance(goals, np.ndarray) and goals.dtype != object:
        return list(np.atleast_2d(goals))
    return [list(row) for row in np.atleast_2d(np.asarray(goals, dtype=object))]
