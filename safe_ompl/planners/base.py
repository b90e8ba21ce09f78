"""What the planners share: OMPL's life cycle, seeds, start and goal states, motions, and the cost scale."""

from __future__ import annotations

import logging
from abc import abstractmethod
from itertools import islice
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.counts import Counts
from safe_ompl.danger.certified import DangerLimit
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.planners.parts.graph import PlannerGraph
from safe_ompl.plugins.objective import StateCost
from safe_ompl.plugins.states import ScratchState, StateBridge

_log = logging.getLogger(__name__)

_UNREAD = object()  # stands for an objective until the problem's is read
_SCALE_SAMPLES = 50
_SCALE_SEED = 0  # the scale belongs to robot and scene: it must not change with the planner's seed
_FIRST_GOALS = 100  # taken before planning begins
_RANGE_FRACTION = (
    0.075  # of the space's extent: 1.1 rad on an arm; longer steps are trapped, shorter ones crawl
)


class SafePlanner(ob.Planner):  # type: ignore[misc]
    """Base of the planners: subclasses implement `_search` on arrays and never meet an OMPL state.

    Parameters
    ----------
    si : ob.SpaceInformation
        Any space of real vectors and SO(2) parts, with any validity checker and motion validator.
    name : str
        Name in logs and benchmarks.
    """

    def __init__(self, si: Any, name: str) -> None:
        super().__init__(si, name)
        self.counts = Counts()
        self.setSeed(int(np.random.SeedSequence().generate_state(1)[0]))
        self._bridge = StateBridge(si.getStateSpace())
        self._from, self._to = ScratchState(self._bridge), ScratchState(self._bridge)
        self._objective: Any = _UNREAD
        self._max_danger = 0.0
        self._danger_limit: DangerLimit | None = None
        self._cost = StateCost(None, self._bridge)
        self._cost_scale = 0.0
        self._alpha = 1.0
        self._range = 0.0
        self._default_range = _RANGE_FRACTION * self._bridge.extent

    # ------------------------------------------------------------------------------------------- parameters

    def setSeed(self, seed: int) -> None:
        """Start the planner's random numbers anew; the same seed gives the same path."""
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
            raise InputError(f"seed must be a non-negative integer, got {seed!r}")
        self._seed = int(seed)
        self._rng = np.random.default_rng(self._seed)

    def getSeed(self) -> int:
        """Return the seed."""
        return self._seed

    def setAlpha(self, alpha: float) -> None:
        """Set the weight of danger α, in the robot's own scale; 0 plans classically."""
        self._alpha = non_negative("alpha", alpha)

    def getAlpha(self) -> float:
        """Return the weight of danger α."""
        return self._alpha

    def setRange(self, distance: float) -> None:
        """Set the largest length of one extension, before it slides [rad]; 0 takes 7.5 % of the space's extent."""
        self._range = non_negative("range", distance)

    def getRange(self) -> float:
        """Return the largest length of one extension [rad]."""
        return self._range or self._default_range

    def setMaxDanger(self, danger: float) -> None:
        """Set the danger that no configuration of a path may exceed, proven along whole motions; 0: any.

        It is in the units of the problem's danger objective. Trees grown under another limit are dropped.
        """
        self._max_danger = non_negative("max danger", danger)
        self._objective = _UNREAD

    def getMaxDanger(self) -> float:
        """Return the danger that no configuration of a path may exceed; 0: any."""
        return self._max_danger

    # ------------------------------------------------------------------------------------------- life cycle

    def setup(self) -> None:
        """Prepare for `solve`: read the problem's objective and measure its scale."""
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
            self._cost.values(configurations),
            edges,
            np.linalg.norm(self._bridge.difference(ends[:, 0], ends[:, 1]), axis=1),
            starts,
            goals,
        )

    def fillPlannerData(self, data: Any) -> None:
        """Append what the planner has built to an `ob.PlannerData`, as `plannerGraph` orders it.

        It stands in for `getPlannerData`, of which OMPL's bindings allow no version in Python.
        """
        self.plannerGraph().fill(data, self._bridge)

    # ------------------------------------------------------------------------- what a planner must implement

    def _accepts(self, goal: Any) -> bool:
        """Return whether the planner can plan to such a goal; by default one that offers configurations."""
        return isinstance(goal, ob.GoalSampleableRegion)

    @abstractmethod
    def _forget(self) -> None:
        """Drop all trees and graphs."""

    @abstractmethod
    def _add_start(self, q: FloatArray) -> None:
        """Take a valid start configuration (n,)."""

    @abstractmethod
    def _add_goal(self, q: FloatArray) -> None:
        """Take a valid goal configuration (n,)."""

    @abstractmethod
    def _has_starts(self) -> bool: ...

    @abstractmethod
    def _has_goals(self) -> bool: ...

    @abstractmethod
    def _search(self, ptc: Any) -> FloatArray | None:
        """Return a path (N, n) whose edges `_motion_is_free` accepts, or None when `ptc` fires."""

    @abstractmethod
    def _graph(self) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
        """Return vertices (N, n), edges (E, 2) in the direction of driving, and which vertices are starts and goals."""

    # --------------------------------------------------------------------------------- what planners can ask

    @property
    def _danger_weight(self) -> float:
        """α in units of length per danger; 0 where there is no danger to heed."""
        return self._alpha / self._cost_scale if self._cost_scale else 0.0

    def _random_configuration(self) -> FloatArray:
        return self._bridge.between_bounds(self._rng.random(self._bridge.n))

    def _is_valid(self, q: FloatArray) -> bool:
        if not self.getSpaceInformation().isValid(self._from.set(q)):
            return False
        return self._danger_limit is None or self._danger_limit.allows(q)

    def _motion_is_free(self, start: FloatArray, end: FloatArray) -> bool:
        if not self.getSpaceInformation().checkMotion(self._from.set(start), self._to.set(end)):
            return False
        return self._danger_limit is None or self._danger_limit.allows_motion(start, end)

    def _take_goals(self, ptc: Any) -> None:
        """Take the goals that the problem offers: all at first, later one now and then.

        Where there is none yet, this waits for the first until `ptc` fires; later calls never wait. Goals taken
        while planning stay fewer than half of the nodes, as in OMPL: a region may have goals without end.
        """
        inputs, goal = self.getPlannerInputStates(), self.getProblemDefinition().getGoal()
        if self._has_goals():
            if 2 * inputs.getSampledGoalsCount() < self.counts.nodes:
                self._take_goal(inputs.nextGoal())
            return
        if not goal.maxSampleCount():
            self._take_goal(inputs.nextGoal(ptc))
        for _ in range(_FIRST_GOALS):
            if ptc() or not inputs.haveMoreGoalStates():
                return
            self._take_goal(inputs.nextGoal())

    def _take_goal(self, state: Any) -> None:
        if state is not None and not self._too_dangerous("goal", q := self._bridge.read(state)):
            self._add_goal(q)

    def _take_starts(self) -> None:
        inputs = self.getPlannerInputStates()
        while inputs.haveMoreStartStates():
            state = inputs.nextStart()
            if state is None:
                return
            q = self._bridge.read(state)
            if not self._too_dangerous("start", q):
                self._add_start(q)

    def _too_dangerous(self, name: str, q: FloatArray) -> bool:
        limit = self._danger_limit
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
        if not self._accepts(problem.getGoal()):
            return ob.PlannerStatus.UNRECOGNIZED_GOAL_TYPE
        self._take_starts()
        if not self._has_starts():
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
        self._cost = StateCost(objective, self._bridge)
        self._danger_limit = None  # the scale belongs to robot and scene, whatever the limit
        self._cost_scale = 0.0 if self._cost.is_zero else self._measure_scale()
        if self._cost.is_zero:
            _log.info("%s: the problem has no danger objective; planning is classical", self.getName())
        if self._max_danger:
            self._danger_limit = DangerLimit(self._danger_field(objective), self._max_danger)
        self._forget()
        self.getPlannerInputStates().restart()
        self._objective = objective

    def _danger_field(self, objective: Any) -> DangerField:
        """Return the field of the problem's danger objective; without it there is nothing to prove."""
        field = getattr(objective, "field", None)
        if not isinstance(field, DangerField):
            raise InputError(f"{self.getName()}: max danger {self._max_danger:g} needs a DangerObjective")
        return field

    def _measure_scale(self) -> float:
        """Return the median of ‖∇c‖ over valid configurations: what α is measured in (`math.md` §2)."""
        rng = np.random.default_rng(_SCALE_SEED)
        candidates = self._bridge.between_bounds(rng.random((8 * _SCALE_SAMPLES, self._bridge.n)))
        valid = list(islice((q for q in candidates if self._is_valid(q)), _SCALE_SAMPLES))
        norms = self._cost.gradient_norms(np.array(valid or candidates))
        norms = norms[np.isfinite(norms)]
        return float(np.median(norms)) if len(norms) else 0.0

    def _publish(self, path: FloatArray) -> None:
        solution = og.PathGeometric(self.getSpaceInformation())
        for q in path:
            solution.append(self._from.set(q))
        self.getProblemDefinition().addSolutionPath(solution, False, 0.0, self.getName())


def non_negative(name: str, value: float) -> float:
    """Return `value` as a float, or raise InputError if it is not a finite number ≥ 0."""
    if not (isinstance(value, (int, float, np.number)) and np.isfinite(value) and value >= 0):
        raise InputError(f"{name} must be a finite number >= 0, got {value!r}")
    return float(value)


def fraction(name: str, value: float) -> float:
    """Return `value` as a float, or raise InputError if it is not in [0, 1]."""
    if non_negative(name, value) > 1:
        raise InputError(f"{name} must be in [0, 1], got {value!r}")
    return float(value)
