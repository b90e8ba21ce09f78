"""`SafePlanner`, the base class of the planners: parameters, OMPL's planner interface, starts, goals and solutions."""

from __future__ import annotations

import logging
import sys
from abc import abstractmethod
from collections import ChainMap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar, cast, overload

import numpy as np
from ompl import base as ob, geometric as og, util as ou

from safe_ompl.common import Counts, FloatArray, InputError, UnknownNameError, flag, number, warn_once, whole_number
from safe_ompl.planning.ompl import states_of
from safe_ompl.planning.planners.problem import DangerWeight, PlanningProblem
from safe_ompl.planning.planners.roadmap import Roadmap
from safe_ompl.planning.planners.tree import PlannerGraph, Trees, TwoTrees

_log = logging.getLogger(__name__)

_FIRST_GOALS = 100  # taken before planning begins
# This marks an objective that has not been read from the problem.
_UNREAD = object()
# The default length of an extension is this share of the space's extent: 1.1 rad for an arm. Longer extensions are
# blocked more often; shorter ones need more nodes.
_RANGE_FRACTION = 0.075
T = TypeVar("T", bool, int, float)


@dataclass(eq=False)
class Parameter(Generic[T]):
    """Descriptor of a planner's parameter: an attribute with a default, whose values are checked on assignment.

    >>> class Planner(SafePlanner):  # doctest: +SKIP
    ...     goal_bias = Parameter(0.05, at_most=1)
    ...     setGoalBias, getGoalBias = goal_bias.methods()

    Values have the type of the default. Numbers must be at least 0, unless another lower bound is given.
    """

    default: T
    at_least: float = 0.0
    above: float | None = None
    at_most: float | None = None

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, planner: None, owner: type) -> Parameter[T]: ...
    @overload
    def __get__(self, planner: object, owner: type | None = None) -> T: ...
    def __get__(self, planner: object | None, owner: type | None = None) -> Parameter[T] | T:
        return self if planner is None else cast(T, planner.__dict__.get(self.name, self.default))

    def __set__(self, planner: object, value: T) -> None:
        kind, checked = type(self.default), cast(Any, value)
        if kind is bool:
            checked = flag(self.name, value)
        elif kind is int:
            checked = whole_number(self.name, value, at_least=int(self.at_least))
        else:
            least = self.at_least if self.above is None else None
            checked = number(self.name, value, above=self.above, at_least=least, at_most=self.at_most)
        planner.__dict__[self.name] = checked

    def methods(self) -> tuple[Callable[[Any, T], None], Callable[[Any], T]]:
        """Return the setter and the getter of the parameter, as OMPL's planners have them."""

        def setter(planner: Any, value: T) -> None:
            """Set the parameter; an InputError if the value is refused."""
            self.__set__(planner, value)

        def getter(planner: Any) -> T:
            """Return the parameter."""
            return self.__get__(planner)

        return setter, getter


def parameters_of(kind: type) -> dict[str, Parameter[Any]]:
    """Return the parameters of a planner class by name, parameters of its base class first."""
    attributes = ChainMap(*(dict(vars(owner)) for owner in kind.__mro__))
    return {name: value for name, value in attributes.items() if isinstance(value, Parameter)}


def camel_case(name: str) -> str:
    """Convert a name with underscores to camel case: goal_bias to GoalBias."""
    return "".join(word.capitalize() for word in name.split("_"))


class UnansweredRequest:
    """`getPlannerData` of planners in Python: OMPL's base method, which returns no data, with a warning.

    A method in Python is not possible, because OMPL's bindings would end the process when they call it.
    """

    def __get__(self, planner: Any, owner: type | None = None) -> Any:
        if planner is None:
            return ob.Planner.getPlannerData
        warn_once(
            _log,
            f"{planner.getName()}: getPlannerData of the planner, of a plain SimpleSetup and of ompl.tools.Benchmark "
            "stays empty, as OMPL's bindings have no version of it in Python: call safe_ompl.planner_data(planner), or "
            "take SafeSetup and safe_ompl.Benchmark",
        )
        return ob.Planner.getPlannerData.__get__(planner)


class Query(NamedTuple):
    """The query of a planner: problem definition, goal, valid starts by their bytes, and the states of a goal list."""

    problem: Any
    goal: Any
    starts: dict[bytes, FloatArray]
    goals: set[bytes]


class SafePlanner(ob.Planner):  # type: ignore[misc]
    """Base class of the planners. Subclasses declare parameters and implement `_search` on arrays, not OMPL states.

    A planner plans in any space of real vectors, SO(2) and SO(3) components, with any validity checker, motion
    validator and objective. It accepts goals of the class `plans_to`, by default goals that can be sampled. `counts`
    has the number of nodes.

    Parameters
    ----------
    si : ob.SpaceInformation
        The space, with its validity checker and motion validator.
    name : str, optional
        Name in logs and benchmarks; by default the name of the class. A bool in its place, as OMPL's RRT and PRM take,
        has no effect except a warning.
    range : float >= 0, default 0.0 [rad]
        Largest length of one extension, before it is moved sideways; 0 means 7.5 % of the space's extent.
    **parameters
        Values of the parameters that the class of the planner declares.
    """

    plans_to: ClassVar[Any] = ob.GoalSampleableRegion
    _danger: DangerWeight
    _structure: TwoTrees[Any] | Roadmap  # built so far
    # The query for which `_structure` was built.
    _query: Query | None
    _goals: int  # taken so far
    # The settings with which `_structure` was built.
    _settings: tuple[Any, ...]

    range = Parameter(0.0)

    def __init__(self, si: Any, name: str | bool | None = None, **parameters: Any) -> None:
        if not (name is None or isinstance(name, (str, bool))):
            raise InputError(f"name of {type(self).__name__} must be a string, got {name!r}")
        own = type(self).__name__ if isinstance(name, bool) or not name else name
        super().__init__(si, own)
        if isinstance(name, bool):
            warn_once(
                _log,
                f"{own}(si, {name}): the flag has no effect. Of OMPL's planners it asks for intermediate states or for "
                "the star strategy, which ours do not have",
            )
        self.counts = Counts()
        # The seed follows from `ou.RNG.setSeed`, if it was called before, as in OMPL's own planners.
        self.setSeed(ou.RNG().getLocalSeed())
        # The objective in use.
        self._read: Any = _UNREAD
        self._take_space()
        for key, value in parameters.items():
            self.setParameter(key, value)
        self._begin_anew()

    def __repr__(self) -> str:
        values = {name: getattr(self, name) for name in parameters_of(type(self))}
        values["range"] = round(self.getRange(), 6)
        shown = "".join(f", {name}={value!r}" for name, value in values.items())
        return f"{type(self).__name__}({self.getName()!r}{shown}, seed={self._seed})"

    # ------------------------------------------------------------------------------------------- parameters

    def setParameter(self, name: str, value: Any) -> None:
        """Set a parameter by name, such as "goal_bias"; an UnknownNameError or, for an invalid value, InputError."""
        known = parameters_of(type(self))
        if name not in known:
            raise UnknownNameError(f"parameter of {self.getName()}", name, sorted(known))
        setattr(self, name, value)

    def setRange(self, length: float) -> None:
        """Set the largest length of one extension [rad]; 0 means 7.5 % of the space's extent."""
        self.range = length

    def setSeed(self, seed: int) -> None:
        """Seed the planner's random number generator; the same seed gives the same path."""
        self._seed = whole_number("seed", seed, at_least=0)
        self._generator: np.random.Generator | None = None

    @property
    def _rng(self) -> np.random.Generator:
        """The planner's random number generator, made on first use after `setSeed`."""
        if self._generator is None:
            self._generator = np.random.default_rng(self._seed)
        return self._generator

    def getSeed(self) -> int:
        """Return the seed."""
        return self._seed

    def getRange(self) -> float:
        """Return the largest length of one extension [rad]."""
        return self.range or _RANGE_FRACTION * self._problem.extent

    # ------------------------------------------------------------------------------------------- life cycle

    def accepts(self, goal: Any) -> bool:
        """Return whether the planner can plan to a goal."""
        return isinstance(goal, self.plans_to)

    def setup(self) -> None:
        """Prepare for `solve`: take changed parameters, read the problem's objective, and prepare the danger weight."""
        ob.Planner.setup(self)
        self._notice_changes()
        if self.getProblemDefinition() is not None:
            self._read_objective()
        # The planners of the paper as printed have no `_danger`.
        if hasattr(self, "_danger"):
            self._danger.prepare()

    def clear(self) -> None:
        """Clear all data except the parameters. The generator is not seeded again: runs of a benchmark must differ."""
        ob.Planner.clear(self)
        self._begin_anew()

    def clearQuery(self) -> None:
        """Clear starts and goals and the data built for them; roadmaps keep their nodes and edges."""
        self._forget_ends()
        self._query, self._goals = None, 0
        self.getPlannerInputStates().restart()

    def solve(self, ptc: Any) -> Any:
        """Search until a path is found or `ptc`, a termination condition or a time limit [s], ends the search.

        The status is EXACT_SOLUTION, APPROXIMATE_SOLUTION, TIMEOUT, INVALID_START, INVALID_GOAL or
        UNRECOGNIZED_GOAL_TYPE. If no path is found in time, the approximate solution is the path that ends nearest to
        the goal, and its difference is the goal's distance. There is no approximate solution if no node is nearer to
        the goal than a start.
        """
        if isinstance(ptc, (int, float)):
            ptc = ob.timedPlannerTerminationCondition(float(ptc))
        if self.getProblemDefinition() is None:
            raise InputError(f"{self.getName()}: no problem definition set")
        try:
            return ob.PlannerStatus(self._outcome(ptc))
        # An exception such as Ctrl-C may leave a step of the search unfinished, so the data are cleared.
        except BaseException:
            self.clear()
            raise

    def plannerGraph(self) -> PlannerGraph:
        """Return the planner's tree or roadmap as a graph."""
        return self._structure.graph()

    getPlannerData = UnansweredRequest()

    def fillPlannerData(self, data: Any) -> None:
        """Append the planner's graph to an `ob.PlannerData`, in the order of `plannerGraph`."""
        self.plannerGraph().fill(data, self._bridge)

    # ------------------------------------------------------------------------- what a planner must implement

    @abstractmethod
    def _search(self, ptc: Any) -> FloatArray | None:
        """Return a path (N, n) whose motions are free, or None if `ptc` ends the search."""

    def _make_parts(self) -> None:
        """Make the planner's helper objects for the present space."""

    def _apply_parameters(self) -> None:
        """Pass the values of parameters to the helper objects before a search."""

    def _forget(self) -> None:
        """Replace the trees or the roadmap by an empty structure, without starts and goals."""
        self._structure = self._trees = Trees(self._bridge, self._problem.cost, self.counts)

    def _forget_ends(self) -> None:
        """Clear the data built for starts and goals."""
        self.counts.reset()
        self._forget()

    # ------------------------------------------------------------------------------------- starts and goals

    def _take_query(self) -> None:
        """Add the problem's new starts; first clear the old query if the problem definition has changed.

        OMPL does not notify a planner of changed starts or goals, nor of another problem definition.
        """
        # The planner's own PlannerInputStates only counts starts, so it does not notice that a start was replaced.
        inputs, starts = ob.PlannerInputStates(self), dict[bytes, FloatArray]()
        while inputs.haveMoreStartStates() and (state := inputs.nextStart()) is not None:
            q = self._bridge.read(state)
            starts[q.tobytes()] = q
        problem = self.getProblemDefinition()
        goals = {q.tobytes() for q in states_of(problem.getGoal(), self._bridge)}
        now, before = Query(problem, problem.getGoal(), starts, goals), self._query
        if before is not None and not self._still_serves(before, now):
            self.clearQuery()
        known = {} if self._query is None else self._query.starts
        self._query = now
        for key, q in starts.items():
            if key not in known:
                self._structure.add_start(q)

    def _still_serves(self, before: Query, now: Query) -> bool:
        """Return whether the data built for the query `before` are valid for the query `now`."""
        same_goal = now.goal is before.goal and before.goals <= now.goals
        return now.problem is before.problem and before.starts.keys() <= now.starts.keys() and same_goal

    def _take_goals(self, ptc: Any, samples: int = 1) -> None:
        """Add goals of the problem: at first all of them, later valid goals among `samples` new samples."""
        for state in self._later_goals(ptc, samples) if self._structure.has_goals else self._first_goals(ptc):
            if state is not None:
                self._goals += 1
                self._structure.add_goal(self._bridge.read(state))

    def _first_goals(self, ptc: Any) -> Iterator[Any]:
        """Yield the first goal states, up to a hundred, or until the first valid one if none of these is valid."""
        inputs = self.getPlannerInputStates()
        if not self.getProblemDefinition().getGoal().maxSampleCount():
            yield inputs.nextGoal(ptc)
        for k in count():
            if ptc() or not inputs.haveMoreGoalStates() or (k >= _FIRST_GOALS and self._structure.has_goals):
                return
            yield inputs.nextGoal()

    def _later_goals(self, ptc: Any, samples: int) -> Iterator[Any]:
        """Yield further goal states or None, without waiting. As in OMPL, goals are fewer than half of the nodes."""
        for _ in range(samples):
            if self.counts.nodes <= self._enough_nodes or ptc():
                return
            yield self.getPlannerInputStates().nextGoal()

    @property
    def _enough_nodes(self) -> int:
        """Another goal is sampled if there are more nodes than this; infinite if there are no further goals."""
        return 2 * self._goals if self.getPlannerInputStates().haveMoreGoalStates() else sys.maxsize

    # -------------------------------------------------------------------------------------------- internals

    def _outcome(self, ptc: Any) -> Any:
        problem = self.getProblemDefinition()
        self._notice_changes()
        if problem.getOptimizationObjective() is not self._read:
            self._read_objective()
        if not self.accepts(goal := problem.getGoal()):
            _log.error(
                "%s plans to a %s, not to a %s: set one, or take another planner",
                *(self.getName(), self.plans_to.__name__, type(goal).__name__),
            )
            return ob.PlannerStatus.UNRECOGNIZED_GOAL_TYPE
        self._take_query()
        if not self._structure.has_starts:
            return ob.PlannerStatus.INVALID_START
        self._take_goals(ptc)
        if not self._structure.has_goals:
            return ob.PlannerStatus.TIMEOUT if ptc() else ob.PlannerStatus.INVALID_GOAL
        path, difference = self._search(ptc), 0.0
        if path is None:
            path = self._approach()
            if len(path) == 1:
                return ob.PlannerStatus.TIMEOUT
            if not goal.isSatisfied(end := self._problem.state(path[-1])):
                difference = goal.distanceGoal(end)
        solution = og.PathGeometric(self.getSpaceInformation())
        for q in path:
            solution.append(self._problem.state(q))
        problem.addSolutionPath(solution, difference > 0.0, difference, self.getName())
        return ob.PlannerStatus.APPROXIMATE_SOLUTION if difference > 0.0 else ob.PlannerStatus.EXACT_SOLUTION

    def _approach(self) -> FloatArray:
        """Return the free path (N, n) from a start to the node nearest to a goal."""
        return self._structure.approach(self._bridge)

    def _read_objective(self) -> None:
        """Read the problem's objective, and clear the data built under another objective, whose costs are stale."""
        # If an error ends this method, the objective is read again next time.
        self._read = _UNREAD
        objective = self.getProblemDefinition().getOptimizationObjective()
        self._problem.take(objective)
        cost = self._problem.cost
        if cost.is_zero:
            _log.info("%s: danger is 0, because the problem has no danger objective", self.getName())
        elif cost.field is not None and not len(cost.field.points):
            _log.info("%s: danger is 0, because no obstacle has a danger weight", self.getName())
        self._begin_anew()
        self._read = objective

    def _take_space(self) -> None:
        """Make the planning problem and the helper objects for the present space."""
        self._problem = PlanningProblem(self.getSpaceInformation())
        self._bridge = self._problem.bridge
        self._make_parts()

    def _notice_changes(self) -> None:
        """Take changed parameters and bounds of the space; clear the data built under other settings."""
        if not self._bridge.is_current:
            self._take_space()
            self._read = _UNREAD
        self._apply_parameters()
        if self._problem.settings != self._settings:
            self._begin_anew()

    def _begin_anew(self) -> None:
        """Clear all data, and read starts and goals again."""
        self._settings = self._problem.settings
        self.counts.reset()
        self._forget()
        self._query, self._goals = None, 0
        self.getPlannerInputStates().restart()
