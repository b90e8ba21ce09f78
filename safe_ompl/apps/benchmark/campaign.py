"""A campaign: several planners, each with several seeds, on one scenario; and a summary of its runs."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from safe_ompl.apps.benchmark.measures import SUMMARISED, summarised_measures
from safe_ompl.apps.benchmark.runs import Run, do_tasks, rounds
from safe_ompl.common import FloatArray, PlanningError
from safe_ompl.common import documents as document
from safe_ompl.planning import PlanResult, SafeSetup, setup_scenario
from safe_ompl.planning.planners import is_ours, make_planner, needs_place, planner_names
from safe_ompl.scene import Scenario

_log = logging.getLogger(__name__)

BAND = (15, 85)  # [%]; the percentiles that the paper shows


@dataclass(frozen=True)
class Campaign:
    """Several planners, each with the same seeds, on one scenario.

    The planners take turns, so that other work of the machine affects all of them alike.

    Raises
    ------
    InputError
        No planner, one named twice, or a number of runs below 1.
    """

    scenario: Scenario  # The problem, with the parameters of its planners
    planners: Sequence[str]  # Names of `planner_names()`, all different
    runs: int = 50  # Runs of each planner
    time: float | None = None  # Time limit of a run [s]; the scenario's own by default
    seed: int = 0  # Seed of the first run; the next ones count up
    simplify: bool | float = False  # Whether paths are simplified, and for how long [s]; see `SafeSetup.plan`
    done: Collection[Run] = frozenset()  # Runs to leave out, as those that an interrupted campaign has done

    def __post_init__(self) -> None:
        self._todo()

    def __len__(self) -> int:
        return len(self._todo())

    def _todo(self) -> list[Run]:
        return rounds(self.planners, self.runs, self.seed, self.done)

    def check(self, setup: SafeSetup) -> None:
        """Raise InputError if a planner, or a parameter that the scenario gives it, does not exist."""
        for planner in self.planners:
            check_named_planner(self.scenario, planner, setup)

    def results(self, setup: SafeSetup | None = None, processes: int = 1) -> Iterator[PlanResult]:
        """Do the runs and yield their results as they come, round after round.

        The setup already holds the scenario's start and goal; it is built by default. Times are most accurate with one
        process.

        Raises
        ------
        InputError
            If the scenario cannot be planned, or a planner or parameter does not exist.
        """
        setup = setup or setup_scenario(self.scenario)
        self.check(setup)
        runs = self._todo()
        return _in_order(runs, do_tasks(CampaignRuns(self, setup), runs, processes))

    def result(self, run: Run, setup: SafeSetup) -> PlanResult:
        """Do one run. A path that the validator refuses is reported as not solved."""
        try:
            result = setup.plan(
                run.planner,
                time=self.scenario.time if self.time is None else self.time,
                seed=run.seed,
                parameters=self.scenario.planners.get(run.planner),
                simplify=self.simplify,
            )
        except PlanningError as error:
            _log.warning("%s, seed %d: %s", run.planner, run.seed, error)
            return failure(f"Error: {error}", run.planner, run.seed, setup.robot.joint_names)
        if result.interrupted:  # Ctrl-C is for all the runs
            raise KeyboardInterrupt
        return result


@dataclass(frozen=True)
class CampaignRuns:
    """The job of a campaign: its runs, each planned with one setup."""

    campaign: Campaign
    setup: SafeSetup

    def run(self, task: Run) -> PlanResult:
        """Do one run."""
        return self.campaign.result(task, self.setup)

    def crash(self, task: Run, words: str) -> PlanResult:
        """Return the result of a run whose process died: not solved."""
        _log.warning("%s, seed %d: %s", task.planner, task.seed, words)
        return failure(f"Error: {words}", task.planner, task.seed, self.setup.robot.joint_names)


def _in_order(runs: Sequence[Run], done: Iterator[tuple[Run, PlanResult]]) -> Iterator[PlanResult]:
    """Yield results in the order of their runs, each as soon as those before it are there."""
    waiting: dict[Run, PlanResult] = {}
    for run in runs:
        while run not in waiting:
            waiting.update([next(done)])
        yield waiting.pop(run)


def default_planners(scenario: Scenario) -> tuple[str, ...]:
    """Return the default planners of a comparison: OMPL's RRT-Connect, and all of ours that fit the goal."""
    has_place = scenario.goal.is_place
    ours = (name for name in planner_names() if is_ours(name) and (has_place or not needs_place(name)))
    return ("RRTConnect", *ours)


def check_named_planner(scenario: Scenario, planner: str, setup: SafeSetup) -> None:
    """Raise InputError if a planner, or a parameter that the scenario gives it, does not exist."""
    source = f"{scenario.file or scenario.name}: planners" if planner in scenario.planners else "planner"
    with document.within(source, ": "):
        make_planner(planner, setup.getSpaceInformation(), scenario.planners.get(planner))


def failure(status: str, planner: str, seed: int, joint_names: tuple[str, ...]) -> PlanResult:
    """Return the result of a run without a path."""
    return PlanResult(status, None, None, planner, seed, joint_names, planning_time=0.0)


@dataclass(frozen=True)
class Summary:
    """Statistics over the runs of one planner, of which S are solved."""

    planner: str  # Name of the planner
    runs: int  # Number of runs, and of those that found a path
    solved: int
    # (S,), for each metric its values over the S solved runs: planning_time, simplification_time [s], length
    # [rad], danger_mean, danger_max, danger_avoidable, clearance_min [m], clearance_mean [m], length_below_50mm
    # [rad], queries (collision and margin), field_configurations
    metrics: Mapping[str, FloatArray]
    profiles: FloatArray  # (S, 101), danger profiles of the solved runs
    # The solved run whose mean danger is the median (of an even number the lower one)
    typical: PlanResult | None

    @classmethod
    def of(cls, planner: str, results: Sequence[PlanResult]) -> Summary:
        """Summarise the results of one planner."""
        solved = [(result, result.report) for result in results if result.report is not None]
        measures = [summarised_measures(result) for result, _ in solved]
        metrics = {key: np.array([measured[key] for measured in measures], dtype=np.float64) for key in SUMMARISED}
        profiles = [report.danger.profile for _, report in solved if report.danger is not None]
        order = np.argsort(metrics["danger_mean"], kind="stable")
        return cls(
            planner,
            len(results),
            len(solved),
            metrics,
            np.array(profiles),
            solved[order[(len(order) - 1) // 2]][0] if solved else None,
        )

    def median(self, metric: str) -> float:
        """Return the median of a metric over the solved runs; NaN if there are none."""
        return self.percentile(metric, 50)

    def percentile(self, metric: str, percent: float) -> float:
        """Return a percentile of a metric over the solved runs; NaN if there are none."""
        values = self.metrics[metric]
        return float(np.percentile(values, percent)) if len(values) else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """Return the summary as plain numbers and strings: of each metric the median and the 15–85 % band."""
        low, high = BAND
        return {
            "planner": self.planner,
            "runs": self.runs,
            "solved": self.solved,
            "typical_seed": self.typical and self.typical.seed,
            **{
                metric: {
                    "median": self.median(metric),
                    f"p{low}": self.percentile(metric, low),
                    f"p{high}": self.percentile(metric, high),
                }
                for metric in self.metrics
            },
        }


def summarize(results: Sequence[PlanResult]) -> list[Summary]:
    """Return a summary for each planner, in the order in which they first appear."""
    planners = dict.fromkeys(result.planner for result in results)
    return [Summary.of(name, [result for result in results if result.planner == name]) for name in planners]
