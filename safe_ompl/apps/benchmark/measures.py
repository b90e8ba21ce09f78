"""Measures of a run, by the names that logs, tables and summaries share; and the measured runs of a `Benchmark`."""

from __future__ import annotations

import math
import re
import resource
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from safe_ompl.apps.benchmark.runs import Run
from safe_ompl.common import Counts, InputError
from safe_ompl.paths import PathReport
from safe_ompl.planning import PlanResult, SafeSetup
from safe_ompl.planning.planners import SafePlanner, check_usable, make_planner

Value = float | int | bool | str | None

_DANGERS = ("mean", "max", "integral", "avoidable")
_OMPL_PROPERTY = re.compile(r"(.*) (REAL|INTEGER|BOOLEAN|TEXT)")
_OMPL_TYPES: Mapping[str, Callable[[str], Value]] = {
    "REAL": float,
    "INTEGER": int,
    "BOOLEAN": lambda text: bool(int(text)),
    "TEXT": str,
}


def safety_measures(report: PathReport) -> dict[str, Value]:
    """Return proof, clearance [m] and danger of a path; lengths in rad."""
    found: dict[str, Value] = {
        "certified": report.certified,
        "clearance min": report.clearance.min,
        "clearance mean": report.clearance.mean,
        "length below 50mm": report.clearance.length_below_50mm,
    }
    if report.danger is not None:
        found |= {f"danger {key}": getattr(report.danger, key) for key in _DANGERS}
    return found


def work_measures(counts: Counts) -> dict[str, Value]:
    """Return the numbers of queries and field evaluations."""
    return {key.replace("_", " "): value for key, value in counts.as_dict().items() if key != "nodes"}


def run_measures(result: PlanResult) -> dict[str, Value]:
    """Return all measures of a run: OMPL's own by its names, then danger, clearance, proof and counts."""
    report, path = result.report, result.path
    found: dict[str, Value] = {
        "time": result.planning_time,
        "simplification time": result.simplification_time,
        "solved": result.solved,
        "status": result.status,
        "seed": result.seed,
        "graph states": result.counts.nodes,
    }
    if path is not None and report is not None:
        found |= {
            "correct solution": report.certified,
            "solution length": report.length,
            "solution segments": len(path) - 1,
            "solution clearance": report.clearance.mean,
            **safety_measures(report),
        }
    return found | work_measures(result.counts)


# The measures that are summarised over runs, by the keys of reports; several are added up.
SUMMARISED: Mapping[str, tuple[str, ...]] = {
    "planning_time": ("time",),
    "simplification_time": ("simplification time",),
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


def summarised_measures(result: PlanResult) -> dict[str, float]:
    """Return the measures of `SUMMARISED` of a solved run by their keys; NaN where danger is not known."""
    measures: Mapping[str, Any] = run_measures(result)
    return {key: sum(float(measures.get(name, math.nan)) for name in names) for key, names in SUMMARISED.items()}


@dataclass
class RunLimits:
    """Limits of a run in time and memory, and whether its path is simplified; as in `ot.Request`."""

    time: float  # [s], [MB]
    memory: float
    interval: float  # Between two samples of the progress [s]
    simplify: bool  # Whether paths are simplified


@dataclass
class Events:
    """Functions of the user, called before and after each run as in `ot.Benchmark`; `after` may change measurements."""

    before: Callable[[Any], None] | None = None
    after: Callable[[Any, dict[str, Any]], None] | None = None

    def __bool__(self) -> bool:
        return self.before is not None or self.after is not None


@dataclass
class Measured:
    """The measurements of one run."""

    properties: dict[str, Value]  # As in `PlannerRuns`
    settings: Mapping[str, Value] = field(default_factory=dict)  # Parameters of the planner
    progress_names: tuple[str, ...] = ()  # What was recorded while planning
    progress: Sequence[tuple[float, ...]] = ()  # Samples (time [s], values …)


@dataclass
class Entry:
    """A planner of a benchmark: its name, and how it is made or the planner itself."""

    name: str
    source: Any

    def planner(self, setup: Any) -> Any:
        """Return a planner on the space of `setup`."""
        si = setup.getSpaceInformation()
        if isinstance(self.source, str):
            return make_planner(self.source, si)
        planner = self.source if isinstance(self.source, ob.Planner) else self.source(si)
        check_usable(planner)
        return planner


@dataclass
class MeasuredRuns:
    """The job of a benchmark: its runs, each with what was measured of it."""

    setup: Any  # The problem
    entries: Mapping[str, Entry]  # The planners by their names
    limits: RunLimits  # Of each run
    events: Events  # What is called before and after each run

    def run(self, task: Run) -> Measured:
        """Do one run; if the planner or a callback raises an exception, the run is a crash with its message."""
        try:
            return _measure(self.setup, self.entries[task.planner], task.seed, self.limits, self.events)
        except Exception as error:
            return self.crash(task, f"{type(error).__name__}: {error}")

    def crash(self, task: Run, words: str) -> Measured:
        """Return the outcome of a run that an error ended."""
        return Measured({"status": "Crash", "solved": False, "seed": task.seed, "error": words})


def _measure(setup: Any, entry: Entry, seed: int, limits: RunLimits, events: Events) -> Measured:
    planner = _prepared_planner(setup, entry, seed)
    if events.before:
        events.before(planner)
    counts = setup.counts.copy() if isinstance(setup, SafeSetup) else None
    progress = _ProgressWatch(planner, limits)
    before = resident_megabytes()
    status = setup.solve(ob.PlannerTerminationCondition(progress.is_over))
    properties: dict[str, Any] = {
        "time": perf_counter() - progress.begin,
        "memory": max(0.0, resident_megabytes() - before),
        "status": status.asString(),
        "solved": setup.haveExactSolutionPath(),
        "approximate solution": setup.haveSolutionPath() and not setup.haveExactSolutionPath(),
        "seed": seed,
    }
    if counts is not None:
        properties |= work_measures(setup.counts - counts)
    properties |= _graph_size(planner)
    if setup.haveSolutionPath():
        properties |= _solution(setup, "solution")
        if limits.simplify:
            begin = perf_counter()
            setup.simplifySolution()
            properties["simplification time"] = perf_counter() - begin
            properties |= _solution(setup, "simplified solution")
        if isinstance(setup, SafeSetup):
            properties |= safety_measures(setup.report(setup.solution()))
    if events.after:
        events.after(planner, properties)
        properties = dict(_typed(name, value) for name, value in properties.items())
    return Measured(properties, planner_settings(planner), progress.names, progress.samples)


def _prepared_planner(setup: Any, entry: Entry, seed: int) -> Any:
    """Return the planner, with the problem ready for it."""
    space = setup.getSpaceInformation()
    if not space.isSetup():
        space.setup()  # draws random numbers, so it goes before the seed
    ou.RNG.setSeed(seed + 1)  # zero would mean "by the clock"; planners made later follow it
    planner = entry.planner(setup)
    if isinstance(setup, SafeSetup):
        return setup.prepare(planner, seed)[0]
    if isinstance(planner, SafePlanner):
        planner.setSeed(seed)
    setup.clear()
    setup.setPlanner(planner)
    setup.setup()
    return planner


class _ProgressWatch:
    """The termination condition of a run, which also samples the planner's progress whenever it is asked."""

    def __init__(self, planner: Any, limits: RunLimits) -> None:
        self.names = tuple(
            name
            for name, getter in (("best cost", "bestCost"), ("iterations", "numIterations"))
            if hasattr(planner, getter)
        )
        self.samples: list[tuple[float, ...]] = []
        self._planner, self._limits = planner, limits
        self.begin = perf_counter()
        self._next = self.begin + limits.interval

    def is_over(self) -> bool:
        now = perf_counter()
        if now >= self._next:
            self._next = now + self._limits.interval
            if self.names:
                self._look(now - self.begin)
            if resident_megabytes() > self._limits.memory:
                return True
        return now - self.begin >= self._limits.time

    def _look(self, time: float) -> None:
        cost = self._planner.bestCost().value() if "best cost" in self.names else None
        if cost is not None and not math.isfinite(cost):
            return
        count = float(self._planner.numIterations()) if "iterations" in self.names else None
        self.samples.append((time, *(value for value in (cost, count) if value is not None)))


def _graph_size(planner: Any) -> dict[str, Value]:
    """Return the numbers of vertices and edges. Of BITstar, whose graph leaks when it is read, only its samples."""
    if isinstance(planner, SafePlanner):
        graph = planner.plannerGraph()
        return {"graph states": len(graph.configurations), "graph motions": len(graph.edges)}
    if isinstance(planner, og.BITstar):
        return {"graph states": int(planner.numBatches() * planner.getSamplesPerBatch())}
    data = ob.PlannerData(planner.getSpaceInformation())
    planner.getPlannerData(data)
    return {"graph states": int(data.numVertices()), "graph motions": int(data.numEdges())}


def _solution(setup: Any, name: str) -> dict[str, Value]:
    path = setup.getSolutionPath()
    return {
        f"{name} length": float(path.length()),
        f"{name} segments": int(path.getStateCount()) - 1,
        f"{name} smoothness": float(path.smoothness()),
        f"{name} clearance": float(path.clearance()),
        f"correct {name}" if name == "solution" else "simplified correct solution": bool(path.check()),
    }


def planner_settings(planner: Any) -> dict[str, Value]:
    """Return the parameters of a planner: what has a setter and a getter, by the name that `make_planner` takes."""
    kind = type(planner)
    found: dict[str, Value] = {}
    for setter in (name for name in dir(kind) if re.match(r"set[A-Z]", name)):
        getter = getattr(planner, "g" + setter[1:], None)
        if getter is None or setter in ("setName", "setProblemDefinition", "setSeed"):
            continue
        value = getter()
        if isinstance(value, (bool, int, float, str, np.number)):
            found[re.sub(r"(?<=[a-z])(?=[A-Z])", "_", setter[3:]).lower()] = value  # type: ignore[assignment]
    return found


def _typed(name: str, value: Any) -> tuple[str, Value]:
    """Accept OMPL's form of a property too, where the type follows the name and the value is text."""
    match = _OMPL_PROPERTY.fullmatch(name)
    if match is None:
        return name, value
    try:
        return match[1], _OMPL_TYPES[match[2]](value)
    except ValueError:
        raise InputError(f"property {match[1]!r}: {value!r} is not of type {match[2]}") from None


def resident_megabytes() -> float:
    """Return the memory that this process occupies [MB]; where that is not known, the most that it did so far."""
    pages = Path("/proc/self/statm")
    if pages.exists():
        return int(pages.read_text().split()[1]) * resource.getpagesize() / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
