"""Run planners with many seeds on one scenario, measure each run, and summarise the measurements."""

from __future__ import annotations

import logging
import math
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import chain
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np
from ompl import geometric as og

from safe_ompl.common import FloatArray, InputError, in_order, whole_number
from safe_ompl.planning import PlanResult, SafeSetup, check_named_planner, setup_scenario
from safe_ompl.planning.planners import is_ours, needs_place, planner_names
from safe_ompl.planning.simplification import SPREAD_PERCENTILES
from safe_ompl.scene import Scenario

_log = logging.getLogger(__name__)

BASELINE = "OMPL RRTConnect + OMPL's simplifier"
"""The name of the baseline in comparisons: planning with OMPL alone."""
SAFEST_OF_ROUTES = 'SafeRRTConnect, ways="all"'
"""The name, in comparisons, of SafeRRTConnect that searches several routes for the safest one."""
_PLANNERS = {BASELINE: "RRTConnect", SAFEST_OF_ROUTES: "SafeRRTConnect"}
Value = float | int | bool | str | None


class Run(NamedTuple):
    """One run of a comparison: the name of the planner, and the seed."""

    planner: str
    seed: int


def rounds(planners: Sequence[str], number: int, seed: int = 0) -> list[Run]:
    """Return the runs of a comparison in order: all planners with the first seed, then all with the next seed.

    Raises InputError if there is no planner, a planner is named twice, or the number of runs is below 1.
    """
    if not planners:
        raise InputError("at least one planner is needed")
    for name in planners:
        if list(planners).count(name) > 1:
            raise InputError(f"planner {name!r} is named twice")
    number = whole_number("runs", number, at_least=1)
    return [Run(planner, seed + k) for k in range(number) for planner in planners]


def run_planner(
    setup: SafeSetup,
    run: Run,
    *,
    planner: Any = None,
    time: float,
    parameters: Mapping[str, Any] | None = None,
    simplify: bool | float = False,
) -> PlanResult:
    """Do one run of a named or given planner. If the run raises an exception, the result has no path.

    The name may also be `SAFEST_OF_ROUTES` or `BASELINE`. With `BASELINE`, OMPL's RRTConnect plans with the setup's
    validity and motion checks, and OMPL's `PathSimplifier` simplifies the path until it finds no improvement. Runs are
    independent, and their results can be sent to other processes. Only InputError, which all runs would raise, and
    KeyboardInterrupt are passed on.
    """
    try:
        options: dict[str, Any] = {"parameters": parameters, "simplify": simplify}
        if run.planner == BASELINE:
            return _plan_baseline(setup, run, time, parameters)
        named = planner_of(run.planner) if planner is None else planner
        ways: Literal[1, "all"] = "all" if run.planner == SAFEST_OF_ROUTES else 1
        result = setup.plan(named, time=time, seed=run.seed, ways=ways, **options)
    except InputError:
        raise
    except Exception as error:
        return result_of_crash(run, str(error), setup.robot.joint_names)
    # Ctrl-C ends all runs, not only this one.
    if result.interrupted:
        raise KeyboardInterrupt
    return replace(result, planner=run.planner) if run.planner == SAFEST_OF_ROUTES else result


def _plan_baseline(setup: SafeSetup, run: Run, time: float, parameters: Mapping[str, Any] | None) -> PlanResult:
    """Plan with OMPL's RRTConnect and simplify with OMPL's simplifier, which considers only length and collision."""
    result = setup.plan(planner_of(run.planner), time=time, seed=run.seed, parameters=parameters)
    result = replace(result, planner=run.planner)
    if not result:
        return result
    begin = perf_counter()
    # OMPL's path object is simplified in place. The simplifier does not get the setup's objective, which is danger.
    og.PathSimplifier(setup.getSpaceInformation()).simplifyMax(setup.getSolutionPath())
    took, path = perf_counter() - begin, setup.solution()
    return replace(result, path=path, planned_path=result.path, simplification_time=took, report=setup.report(path))


def as_planned(setup: SafeSetup, result: PlanResult) -> PlanResult:
    """Return the result before simplification. A result that was not simplified is returned as it is."""
    path = result.planned_path
    if path is None:
        return result
    return replace(result, path=path, planned_path=None, simplification_time=0.0, report=setup.report(path))


def failure(status: str, planner: str, seed: int, joint_names: tuple[str, ...]) -> PlanResult:
    """Return the result of a run without a path."""
    return PlanResult(status, None, None, planner, seed, joint_names, planning_time=0.0)


def result_of_crash(run: Run, words: str, joint_names: tuple[str, ...] = ()) -> PlanResult:
    """Return the result of a run that raised an exception, and log the reason `words`."""
    _log.warning("%s, seed %d: %s", run.planner, run.seed, words)
    return failure(f"Error: {words}", run.planner, run.seed, joint_names)


@dataclass(frozen=True)
class Campaign:
    """A comparison of several planners, all with the same seeds, on one scenario.

    The planners run in turn, so that other load of the machine affects all planners equally. Raises InputError if there
    is no planner, a planner is named twice, or the number of runs is below 1.
    """

    # The problem, with the parameters of its planners.
    scenario: Scenario
    # Names of `planner_names()`, or `BASELINE`. All names differ.
    planners: Sequence[str]
    # The number of runs of each planner.
    runs: int = 50
    # The time limit of a run [s]. None takes the scenario's.
    time: float | None = None
    # The seed of the first run. Later runs take the next seeds.
    seed: int = 0
    # Whether paths are simplified, and for how long [s]; see `SafeSetup.plan`.
    simplify: bool | float = False

    def __post_init__(self) -> None:
        rounds(self.planners, self.runs, self.seed)

    def __len__(self) -> int:
        return self.runs * len(self.planners)

    def check(self, setup: SafeSetup) -> None:
        """Raise InputError if a planner or one of its parameters in the scenario does not exist."""
        for planner in self.planners:
            check_named_planner(self.scenario, planner_of(planner), setup)

    def results(
        self, setup: SafeSetup | None = None, workers: int | Executor = 1, done: Iterable[PlanResult] = ()
    ) -> Iterator[PlanResult]:
        """Do the runs and yield their results, seed after seed.

        `setup` must hold the scenario's start and goal; by default it is built. `workers` is the number of processes,
        which does not change the paths; times are most accurate with one. It may also be an executor of
        `concurrent.futures` or of a dask client (`get_executor()`), whose workers may run on other machines; each
        worker builds the setup from the scenario. `done` holds results of an interrupted campaign: they are yielded
        first, and their runs are not repeated. Raises InputError if the scenario cannot be planned, a planner or
        parameter does not exist, or there are less than 1 workers.
        """
        setup = setup or setup_scenario(self.scenario)
        self.check(setup)
        runs = rounds(self.planners, self.runs, self.seed)
        own = set(runs)
        known = {run: result for result in done if (run := Run(result.planner, result.seed)) in own}
        left = [run for run in runs if run not in known]
        do = partial(_run, pickle.dumps(self)) if isinstance(workers, Executor) else self._runner(setup)
        return chain(known.values(), in_order(do, left, workers, result_of_crash))

    def _runner(self, setup: SafeSetup) -> Callable[[Run], PlanResult]:
        time = self.scenario.time if self.time is None else self.time

        def do(run: Run) -> PlanResult:
            parameters = self.scenario.planners.get(planner_of(run.planner))
            return run_planner(setup, run, time=time, parameters=parameters, simplify=self.simplify)

        return do


def _run(campaign: bytes, run: Run) -> PlanResult:
    """Do a run of a campaign in a worker of an executor."""
    return _runner_of(campaign)(run)


# A worker builds the setup once and keeps it.
@lru_cache(maxsize=1)
def _runner_of(campaign: bytes) -> Callable[[Run], PlanResult]:
    own: Campaign = pickle.loads(campaign)
    return own._runner(setup_scenario(own.scenario))


def default_planners(scenario: Scenario) -> tuple[str, ...]:
    """Return the default planners of a comparison.

    They are the baseline, `SAFEST_OF_ROUTES`, and this package's planners that fit the goal.
    Planners that need a target pose only fit goals that are target poses.
    """
    has_place = scenario.goal.is_place
    ours = (name for name in planner_names() if is_ours(name) and (has_place or not needs_place(name)))
    return (BASELINE, SAFEST_OF_ROUTES, *ours)


def planner_of(name: str) -> str:
    """Return the planner's own name for a name in a comparison, which may be `BASELINE` or `SAFEST_OF_ROUTES`."""
    return _PLANNERS.get(name, name)


def run_measures(result: PlanResult) -> dict[str, Value]:
    """Return all measurements of a run: those of OMPL with OMPL's names, then danger, clearance, proof and counts."""
    report, path = result.report, result.path
    found: dict[str, Value] = {
        "time": result.planning_time,
        "simplification time": result.simplification_time,
        "solved": result.solved,
        "status": result.status,
        "seed": result.seed,
        "graph states": result.counts.nodes,
    }
    found |= {key.replace("_", " "): value for key, value in asdict(result.counts).items() if key != "nodes"}
    if path is None or report is None:
        return found
    found |= {
        "correct solution": report.certified,
        "certified": report.certified,
        "solution length": report.length,
        "solution segments": len(path) - 1,
        "clearance min": report.clearance.min,
        "clearance mean": report.clearance.mean,
        "length below 50mm": report.clearance.length_below_50mm,
    }
    if report.danger is not None:
        found |= {f"danger {key}": getattr(report.danger, key) for key in ("mean", "max", "integral", "avoidable")}
    return found


# For each key of a report, the measurements whose sum is summarised over the runs.
SUMMARISED: Mapping[str, tuple[str, ...]] = {
    "planning_time": ("time",),
    "simplification_time": ("simplification time",),
    "total_time": ("time", "simplification time"),
    "length": ("solution length",),
    "danger_mean": ("danger mean",),
    "danger_max": ("danger max",),
    "danger_avoidable": ("danger avoidable",),
    "clearance_min": ("clearance min",),
    "clearance_mean": ("clearance mean",),
    "length_below_50mm": ("length below 50mm",),
    "queries": ("collision queries", "margin queries", "bound queries"),
    "field_configurations": ("field configurations",),
}


@dataclass(frozen=True)
class Summary:
    """Statistics over the runs of one planner, of which S are solved."""

    planner: str
    # The number of runs, and the number of runs that found a path.
    runs: int
    solved: int
    # Values (S,) of the solved runs by the keys of `SUMMARISED` [s, rad, m]. NaN if a measurement is missing.
    metrics: Mapping[str, FloatArray]
    # Danger profiles of the solved runs (S, 101).
    profiles: FloatArray
    # The solved run with the median of the mean danger (the lower median of an even number of runs).
    typical: PlanResult | None

    @classmethod
    def of(cls, planner: str, results: Sequence[PlanResult]) -> Summary:
        """Summarise the results of one planner."""
        solved = [result for result in results if result.report is not None]
        measures: list[Mapping[str, Any]] = [run_measures(result) for result in solved]
        metrics = {
            key: np.array([sum(float(found.get(name, math.nan)) for name in names) for found in measures])
            for key, names in SUMMARISED.items()
        }
        reports = [result.report for result in solved]
        profiles = [report.danger.profile for report in reports if report is not None and report.danger is not None]
        order = np.argsort(metrics["danger_mean"], kind="stable")
        typical = solved[order[(len(order) - 1) // 2]] if solved else None
        return cls(planner, len(results), len(solved), metrics, np.array(profiles), typical)

    def percentile(self, metric: str, percent: float = 50) -> float:
        """Return a percentile of a metric over the solved runs, by default the median; NaN if there are none."""
        values = self.metrics[metric]
        # Without obstacles clearances are infinite, and NumPy subtracts them.
        with np.errstate(invalid="ignore"):
            return float(np.percentile(values, percent)) if len(values) else float("nan")

    def spread(self, metric: str) -> float:
        """Return the width of the 15–85 % band of a metric over the seeds; inf for less than two solved runs."""
        low, high = (self.percentile(metric, percent) for percent in SPREAD_PERCENTILES)
        return high - low if self.solved > 1 else math.inf

    def as_dict(self) -> dict[str, Any]:
        """Return the summary as plain numbers and strings, with the median and the 15–85 % band of each metric."""
        marks = {"median": 50, **{f"p{percent}": percent for percent in SPREAD_PERCENTILES}}
        return {
            "planner": self.planner,
            "runs": self.runs,
            "solved": self.solved,
            "typical_seed": self.typical and self.typical.seed,
            **{
                metric: {name: self.percentile(metric, percent) for name, percent in marks.items()}
                for metric in self.metrics
            },
        }


def summarize(results: Sequence[PlanResult]) -> list[Summary]:
    """Return a summary for each planner, in the order in which the planners first appear."""
    planners = dict.fromkeys(result.planner for result in results)
    return [Summary.of(name, [result for result in results if result.planner == name]) for name in planners]
