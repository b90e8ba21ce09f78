"""OMPL's life cycle of our planners: seeds, start and goal states, the objective, and the path that is found."""

from __future__ import annotations

import logging
from abc import abstractmethod
from typing import Any, ClassVar, Protocol

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.counts import Counts
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.inputs import number, whole_number
from safe_ompl.planners.graphs.data_request import UnansweredRequest
from safe_ompl.planners.graphs.planner_graph import PlannerGraph
from safe_ompl.planners.parts.goals import first_goals, later_goals
from safe_ompl.planners.parts.task import Task

_log = logging.getLogger(__name__)

_UNREAD = object()  # stands for an objective until the problem's is read
_RANGE_FRACTION = (
    0.075  # of the space's extent: 1.1 rad on an arm; longer steps are trapped, shorter ones crawl
)


class Grown(Protocol):
    """What a planner has built from starts and goals: trees, or a roadmap."""

    def add_start(self, q: FloatArray) -> None:
        """Take a valid start configuration (n,)."""

    def add_goal(self, q: FloatArray) -> None:
        """Take a valid goal configuration (n,)."""

    @property
    def has_starts(self) -> bool:
        """Whether there is a start."""

    @property
    def has_goals(self) -> bool:
        """Whether there is a goal."""

    def graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        """Return vertices (N, n), edges (E, 2) in the direction of driving, and which vertices are starts and goals."""


class SafePlanner(ob.Planner):  # type: ignore[misc]
    """Base of the planners: subclasses implement `_search` on arrays and never meet an OMPL state.

    Parameters
    ----------
    si : ob.SpaceInformation
        Any space of real vectors and SO(2) parts, with any validity checker and motion validator.
    name : str
        Name in logs and benchmarks.

    Attributes
    ----------
    plans_to : type
        What goals the planner plans to: by default those that offer configurations.
    counts : Counts
        Counts the nodes.
    """

    plans_to: ClassVar[Any] = ob.GoalSampleableRegion

    def __init__(self, si: Any, name: str) -> None:
        super().__init__(si, name)
        self.counts = Counts()
        self.setSeed(int(np.random.SeedSequence().generate_state(1)[0]))
        self._task = Task(si)
        self._bridge = self._task.bridge
        self._objective: Any = _UNREAD
        self._max_danger = 0.0
        self._range = 0.0
        self._default_range = _RANGE_FRACTION * self._bridge.extent

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.getName()!r}, seed={self._seed})"

    # ------------------------------------------------------------------------------------------- parameters

    def setSeed(self, seed: int) -> None:
        """Start the planner's random numbers anew; the same seed gives the same path."""
        self._seed = whole_number("seed", seed, at_least=0)
        self._rng = np.random.default_rng(self._seed)

    def getSeed(self) -> int:
        """Return the seed."""
        return self._seed

    def setRange(self, distance: float) -> None:
        """Set the largest length of one extension, before it slides [rad]; 0 takes 7.5 % of the space's extent."""
        self._range = number("range", distance, at_least=0)

    def getRange(self) -> float:
        """Return the largest length of one extension [rad]."""
        return self._range or self._default_range

    def setMaxDanger(self, danger: float) -> None:
        """Set the danger that no configuration of a path may exceed, proven along whole motions; 0: any.

        It is in the units of the problem's danger objective. Trees grown under another limit are dropped.
        """
        self._max_danger = number("max danger", danger, at_least=0)
        self._objective = _UNREAD

    def getMaxDanger(self) -> float:
        """Return the danger that no configuration of a path may exceed; 0: any."""
        return self._max_danger

    # ------------------------------------------------------------------------------------------- life cycle

    def accepts(self, goal: Any) -> bool:
        """Return whether the planner can plan to a goal."""
        return isinstance(goal, self.plans_to)

    def setup(self) -> None:
        """Prepare for `solve`: read the problem's objective."""
        ob.Planner.setup(self)
        if self.getProblemDefinition() is not None:
            self._read_objective()

    def clear(self) -> None:
        """Forget everything but the parameters. Random numbers go on: the runs of a benchmark must differ."""
        ob.Planner.clear(self)
        self.counts.reset()
        self._forget()

    def solve(self, ptc: Any) -> Any:
        """Search until a path is found or `ptc` says stop.

        Parameters
        ----------
        ptc : ob.PlannerTerminationCondition or float
            When to give up; a number is a time limit [s].

        Returns
        -------
        ob.PlannerStatus
            EXACT_SOLUTION, TIMEOUT, INVALID_START, INVALID_GOAL or UNRECOGNIZED_GOAL_TYPE.
        """
        if isinstance(ptc, (int, float)):
            ptc = ob.timedPlannerTerminationCondition(float(ptc))
        if self.getProblemDefinition() is None:
            raise InputError(f"{self.getName()}: no problem definition set")
        try:
            return ob.PlannerStatus(self._outcome(ptc))
        except BaseException:  # Ctrl-C, too, may come between two halves of a step
            self.clear()
            raise

    def plannerGraph(self) -> PlannerGraph:
        """Return what the planner has built so far: vertices with their danger, edges, starts and goals."""
        configurations, edges, starts, goals = self._graph()
        ends = configurations[edges]
        return PlannerGraph(
            configurations,
            self._task.cost.values(configurations),
            edges,
            np.linalg.norm(self._bridge.difference(ends[:, 0], ends[:, 1]), axis=1),
            starts,
            goals,
        )

    getPlannerData = UnansweredRequest()

    def fillPlannerData(self, data: Any) -> None:
        """Append what the planner has built to an `ob.PlannerData`, as `plannerGraph` orders it.

        It stands in for `getPlannerData`, of which OMPL's bindings allow no version in Python.
        """
        self.plannerGraph().fill(data, self._bridge)

    # ------------------------------------------------------------------------- what a planner must implement

    @property
    @abstractmethod
    def _grown(self) -> Grown:
        """What has been built so far."""

    @abstractmethod
    def _forget(self) -> None:
        """Drop what has been built, and begin anew without starts and goals."""

    @abstractmethod
    def _search(self, ptc: Any) -> FloatArray | None:
        """Return a path (N, n) whose motions are free, or None when `ptc` fires."""

    # ------------------------------------------------------------------------------------- starts and goals

    def _has_goals(self) -> bool:
        return self._grown.has_goals

    def _graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        return self._grown.graph()

    def _take_starts(self) -> None:
        inputs = self.getPlannerInputStates()
        while inputs.haveMoreStartStates():
            state = inputs.nextStart()
            if state is None:
                return
            q = self._bridge.read(state)
            if not self._too_dangerous("start", q):
                self._grown.add_start(q)

    def _take_goals(self, ptc: Any) -> None:
        """Take the goals that the problem offers: all at first, later one now and then."""
        inputs, goal = self.getPlannerInputStates(), self.getProblemDefinition().getGoal()
        found = (
            later_goals(inputs, self.counts.nodes) if self._has_goals() else first_goals(inputs, goal, ptc)
        )
        for state in found:
            if state is not None and not self._too_dangerous("goal", q := self._bridge.read(state)):
                self._grown.add_goal(q)

    def _too_dangerous(self, name: str, q: FloatArray) -> bool:
        limit = self._task.limit
        if limit is None or limit.allows(q):
            return False
        _log.warning(
            "%s: %s has danger %.4g, above the limit %.4g", self.getName(), name, limit.danger(q), limit.limit
        )
        return True

    # -------------------------------------------------------------------------------------------- internals

    def _outcome(self, ptc: Any) -> Any:
        problem = self.getProblemDefinition()
        if problem.getOptimizationObjective() is not self._objective:
            self._read_objective()
        if not self.accepts(goal := problem.getGoal()):
            _log.error(
                "%s plans to a %s, not to a %s: set one, or take another planner",
                *(self.getName(), self.plans_to.__name__, type(goal).__name__),
            )
            return ob.PlannerStatus.UNRECOGNIZED_GOAL_TYPE
        self._take_starts()
        if not self._grown.has_starts:
            return ob.PlannerStatus.INVALID_START
        self._take_goals(ptc)
        if not self._has_goals():
            return ob.PlannerStatus.TIMEOUT if ptc() else ob.PlannerStatus.INVALID_GOAL
        path = self._search(ptc)
        if path is None:
            return ob.PlannerStatus.TIMEOUT
        self._publish(path)
        return ob.PlannerStatus.EXACT_SOLUTION

    def _read_objective(self) -> None:
        """Read the problem's objective; what was built under another one is dropped, its costs are stale."""
        self._objective = _UNREAD  # also where an error ends this half-way
        objective = self.getProblemDefinition().getOptimizationObjective()
        limit = DangerLimit(self._danger_field(objective), self._max_danger) if self._max_danger else None
        self._task.take(objective, limit)
        if self._task.cost.is_zero:
            _log.info("%s: the problem has no danger objective; planning is classical", self.getName())
        self._forget()
        self.getPlannerInputStates().restart()
        self._objective = objective

    def _danger_field(self, objective: Any) -> DangerField:
        """Return the field of the problem's danger objective; without it there is nothing to prove."""
        field = getattr(objective, "field", None)
        if not isinstance(field, DangerField):
            raise InputError(f"{self.getName()}: max danger {self._max_danger:g} needs a DangerObjective")
        return field

    def _publish(self, path: FloatArray) -> None:
        solution = og.PathGeometric(self.getSpaceInformation())
        for q in path:
            solution.append(self._task.state(q))
        self.getProblemDefinition().addSolutionPath(solution, False, 0.0, self.getName())
