"""The parameter sweep: danger, success and time for values of the planners' parameters, on every scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from _paper.dependence import Point, plot_dependence, write_page
from _paper.store import Store
from _paper.studies import Pair
from safe_ompl.apps.benchmark.campaign import Campaign
from safe_ompl.apps.benchmark.runs import do_tasks
from safe_ompl.apps.cli.output import error_console, progress_bar
from safe_ompl.common import FloatArray
from safe_ompl.common.errors import SafeOmplError
from safe_ompl.paths.measures import PROFILE_POINTS, Curve
from safe_ompl.planning.from_scenario import setup_scenario
from safe_ompl.planning.planners.registry import make_planner
from safe_ompl.planning.result import PlanResult
from safe_ompl.planning.safe_setup import SafeSetup
from safe_ompl.scene.scenario import Scenario, list_scenarios

TIME = 5.0  # [s] for each run
RANGE = "range"


@dataclass(frozen=True)
class Parameter:
    """A parameter of a planner or of the danger field, with the values to try.

    Attributes
    ----------
    name : str
        Of the planner's parameter, or of an option of the danger field.
    values : tuple
        What to try; for the range, multiples of its default.
    label : str
        What it is.
    of_field : bool
        Whether it belongs to the danger field.
    """

    name: str
    values: tuple[Any, ...]
    label: str
    of_field: bool = False


PARAMETERS = (
    Parameter("alpha", (0.0, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0), "weight of danger α"),
    Parameter("nearest_fraction", (0.0, 0.1, 0.3, 0.5, 0.8, 1.0), "share that ignores danger ε"),
    Parameter("slide", (0.0, 0.2, 0.4, 0.8, 1.0), "slide"),
    Parameter("threshold_rise", (0.0, 0.02, 0.05, 0.1, 0.2), "rise of the threshold (0: none)"),
    Parameter(RANGE, (0.25, 0.5, 1.0, 2.0), "step, × default"),
    Parameter("goal_bias", (0.05, 0.1, 0.2, 0.4), "share towards the goal"),
    Parameter("null_space_gain", (0.0, 0.5, 1.0, 2.0), "gain in the null space"),
    Parameter("spacing", (0.05, 0.1, 0.2, 0.4), "spacing of danger points [m]", of_field=True),
    Parameter("weighting", ("unit", "length"), "weighting of links", of_field=True),
)


class Choice(NamedTuple):
    """A planner on a scenario, with one parameter chosen, or none for a classical planner."""

    scenario: str
    planner: str
    runs: int
    parameter: Parameter | None = None
    value: Any = None

    @property
    def name(self) -> str:
        """What the choice is called in file names."""
        return f"{self.planner}_{self.parameter.name}={self.value}" if self.parameter else self.planner


class Outcome(NamedTuple):
    """Mean danger along the paths, share of solved runs, median time [s]."""

    danger: float
    solved: float
    time: float


def sweep(folder: Path, pairs: Sequence[Pair], runs: int, processes: int) -> Path:
    """Try all values of all parameters, one at a time; draw a figure for each planner; return the page."""
    scenarios = list(list_scenarios())
    classic = [Choice(name, pair.classic, _runs(pair, runs)) for name in scenarios for pair in pairs]
    varied = [choice for name in scenarios for pair in pairs for choice in _choices(name, pair, runs)]
    with progress_bar(error_console()) as progress:
        task = progress.add_task("trying parameters", total=len(classic) + len(varied))
        every = _outcomes(folder / "sweep", [*classic, *varied], processes, lambda: progress.advance(task))
    points = _points(every, pairs)
    labels = {parameter.name: parameter.label for parameter in PARAMETERS}
    files = {}
    for planner in dict.fromkeys(point.planner for point in points):
        files[planner] = folder / f"sweep_{planner}.png"
        plot_dependence([point for point in points if point.planner == planner], labels, files[planner])
    page = folder / "sweep.md"
    write_page(page, points, files)
    return page


def _runs(pair: Pair, runs: int) -> int:
    return 1 if pair.deterministic else runs


def _choices(scenario: str, pair: Pair, runs: int) -> Iterator[Choice]:
    """Yield a choice for each value of each parameter that the safe planner of a pair has."""
    planner = make_planner(pair.safe, _setup(scenario).getSpaceInformation())
    for parameter in PARAMETERS:
        setter = "set" + "".join(word.capitalize() for word in parameter.name.split("_"))
        if parameter.of_field or hasattr(planner, setter):
            for value in parameter.values:
                yield Choice(scenario, pair.safe, _runs(pair, runs), parameter, value)


def _points(outcomes: Sequence[tuple[Choice, Outcome]], pairs: Sequence[Pair]) -> list[Point]:
    """Put every outcome in relation to that of the classical counterpart on the same scenario."""
    counterpart = {pair.safe: pair.classic for pair in pairs}
    classic = {(c.scenario, c.planner): outcome for c, outcome in outcomes if c.parameter is None}
    points = []
    for choice, outcome in outcomes:
        if choice.parameter is not None:
            other = classic[choice.scenario, counterpart[choice.planner]]
            points.append(
                Point(
                    choice.scenario,
                    choice.planner,
                    choice.parameter.name,
                    choice.value,
                    outcome.danger / other.danger,
                    outcome.solved,
                    outcome.time / other.time,
                )
            )
    return points


# ------------------------------------------------------------------------------------------------ the runs


def _outcomes(
    folder: Path, choices: Sequence[Choice], processes: int, advance: Callable[[], object]
) -> list[tuple[Choice, Outcome]]:
    """Return the outcomes of choices, of which `processes` are tried at the same time."""
    found = {}
    for choice, outcome in do_tasks(TriedChoices(folder), choices, processes):
        found[choice] = outcome
        advance()
    return [(choice, found[choice]) for choice in choices]


@dataclass(frozen=True)
class TriedChoices:
    """The job of a sweep: choices, each with its outcome; their runs are kept in a folder."""

    folder: Path

    def run(self, task: Choice) -> Outcome:
        """Try a choice."""
        return _tried(self.folder, task)

    def crash(self, task: Choice, words: str) -> Outcome:
        """Raise an error: runs that are done are kept, and the sweep can go on from there."""
        raise SafeOmplError(f"{task.scenario}, {task.name}: {words}")


def _tried(folder: Path, choice: Choice) -> Outcome:
    """Do the runs of a choice that are not done; danger counts in the scenario's own field, whatever was used."""
    scenario, parameter = _scenario(choice.scenario), choice.parameter
    setup = _setup(choice.scenario)
    if parameter is not None and parameter.of_field:
        scenario = replace(scenario, danger={**scenario.danger, parameter.name: choice.value})
        setup = setup_scenario(scenario)
    elif parameter is not None:
        scenario = replace(scenario, planners={choice.planner: {parameter.name: _given(choice)}})
    store = Store(folder / choice.scenario / choice.name, scenario)
    for result in Campaign(scenario, [choice.planner], choice.runs, done=store.done()).results(setup):
        store.add(result)
    results = store.results()
    times = [result.planning_time for result in results if result.solved]
    return Outcome(
        mean_danger(_setup(choice.scenario), results),
        sum(result.solved for result in results) / len(results),
        float(np.median(times)) if times else float("nan"),
    )


def _given(choice: Choice) -> Any:
    """Return the value as the planner takes it."""
    assert choice.parameter is not None
    if choice.parameter.name != RANGE:
        return choice.value
    usual = make_planner(choice.planner, _setup(choice.scenario).getSpaceInformation()).getRange()
    return round(choice.value * usual, 6)


def mean_danger(setup: SafeSetup, results: Sequence[PlanResult]) -> float:
    """Return the mean danger along paths in the setup's field, averaged over the solved runs; NaN if none is."""
    assert setup.field is not None
    paths = [_samples(setup, result.path) for result in results if result.path is not None]
    return float(np.mean([setup.field.values(path).mean() for path in paths])) if paths else float("nan")


def _samples(setup: SafeSetup, path: FloatArray) -> FloatArray:
    curve = Curve(setup.robot, path)
    return curve.at(np.linspace(0.0, curve.length, PROFILE_POINTS))


@cache
def _scenario(name: str) -> Scenario:
    """Return a scenario with its planners' defaults."""
    return replace(Scenario.load(list_scenarios()[name]), planners={}, time=TIME)


@cache
def _setup(name: str) -> SafeSetup:
    return setup_scenario(_scenario(name))
