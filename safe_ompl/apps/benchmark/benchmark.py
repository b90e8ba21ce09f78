"""Benchmark planners on one problem with the interface of `ot.Benchmark`, and write the log for Planner Arena."""

from __future__ import annotations

import io
import os
import platform
import re
import socket
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import version
from os import PathLike
from time import perf_counter
from typing import Any

import numpy as np
from ompl import base as ob, tools as ot

from safe_ompl.apps.benchmark.campaign import Run, Value, result_of_crash, rounds, run_measures, run_planner
from safe_ompl.common import InputError, files, in_order
from safe_ompl.planning import PlanResult, SafeSetup
from safe_ompl.planning.planners import check_usable, make_planner, settings_of

# The statuses in the order of ob.PlannerStatus, with its names. OMPL's own logs call the last three "Unknown status".
_STATUSES = (
    "Unknown status",
    "Invalid start",
    "Invalid goal",
    "Unrecognized goal type",
    "Timeout",
    "Approximate solution",
    "Exact solution",
    "Crash",
    "Aborted",
    "Infeasible",
)


@dataclass
class PlannerRuns:
    """All runs of one planner. The name is unique in the experiment."""

    name: str
    # The measurements of each run, by name.
    runs: list[Mapping[str, Value]] = field(default_factory=list)
    # The values of the planner's parameters, by name.
    settings: Mapping[str, Value] = field(default_factory=dict)


@dataclass
class Experiment:
    """The content of a benchmark log."""

    # The name of the experiment. Blanks become underscores, because OMPL's reader stops at a blank.
    name: str
    planners: list[PlannerRuns] = field(default_factory=list)
    # A description of the problem, in any number of lines.
    setup: str = ""
    # The time limit of a run [s].
    time_limit: float = 0.0
    # The number of runs of each planner that were requested.
    run_count: int = 0
    # The seed of the first run.
    seed: int = 0
    # The duration of the whole experiment [s].
    duration: float = 0.0
    # The time at which the experiment began.
    begin: datetime = field(default_factory=datetime.now)


class Benchmark:
    """Run planners many times on one problem and write OMPL's log. The interface is that of `ot.Benchmark`.

    `ot.Benchmark` does not record the graphs of planners written in Python, and aborts if a planner raises an
    exception. This class runs the planners itself, with `SafeSetup.plan`, and also measures danger, clearance, proof
    and all counts. A run that raises an exception has the status "Crash", and its message is in the column `error`.
    Ctrl-C ends the benchmark and keeps the finished runs.

    Parameters
    ----------
    setup : SafeSetup
        The problem.
    name : str
        Name of the experiment.

    Examples
    --------
    >>> from ompl import tools as ot
    >>> benchmark = Benchmark(setup_scenario("planar2"), "past a person")
    >>> benchmark.addPlanner("ClassicRRTConnect")
    >>> benchmark.addPlannerAllocator(lambda si: SafeRRTConnect(si, "α = 2", alpha=2))
    >>> request = ot.Request()
    >>> request.maxTime, request.runCount, request.displayProgress = 5.0, 2, False
    >>> benchmark.benchmark(request)
    >>> [planner.name for planner in benchmark.getRecordedExperimentData().planners]
    ['ClassicRRTConnect', 'α = 2']
    """

    def __init__(self, setup: SafeSetup, name: str = "") -> None:
        if not isinstance(setup, SafeSetup):
            raise InputError(f"setup must be a SafeSetup, got {setup!r}; ot.Benchmark is for others")
        self._setup = setup
        self._sources: dict[str, Any] = {}
        self._experiment = Experiment(name)

    def __repr__(self) -> str:
        return f"Benchmark({self._setup!r}, {len(self._sources)} planners)"

    def addPlanner(self, planner: Any) -> None:
        """Add a planner object, or one of `planner_names()`. By name, a new planner is created for every run."""
        if not isinstance(planner, str | ob.Planner):
            raise InputError(f"planner must be a name or an ob.Planner, got {planner!r}")
        self._add(planner)

    def addPlannerAllocator(self, allocator: Callable[[Any], Any]) -> None:
        """Add a function that creates a planner from a space information. It is called for every run."""
        if not callable(allocator):
            raise InputError(f"planner allocator must be a function of a space information, got {allocator!r}")
        self._add(allocator)

    def _add(self, source: Any) -> None:
        own = self._planner(source).getName()
        name, k = own, 2
        while name in self._sources:
            name, k = f"{own} {k}", k + 1
        self._sources[name] = source

    def _planner(self, source: Any) -> Any:
        """Return the planner of a source, which is a name, a planner, or a function that creates a planner."""
        if isinstance(source, str):
            return make_planner(source, self._setup.getSpaceInformation())
        planner = source if isinstance(source, ob.Planner) else source(self._setup.getSpaceInformation())
        check_usable(planner)
        return planner

    def benchmark(self, request: Any = None, *, seed: int = 0, workers: int | None = None) -> None:
        """Run all planners.

        Parameters
        ----------
        request : ot.Request
            The fields maxTime, runCount, displayProgress and simplify are used; the other fields have no effect.
        seed : int
            The seed of the first run of each planner. Later runs use the next seeds. Planners that are created for
            every run (by name or allocator) give the same results in any process.
        workers : int, optional
            The number of processes. Times are most accurate with 1. The default is one process per processor.

        Raises
        ------
        InputError
            If there is no planner, or the number of runs or workers is below 1.
        """
        request = request or ot.Request()
        if request.runCount < 1:
            raise InputError(f"runCount must be at least 1, got {request.runCount!r}")
        runs = rounds(list(self._sources), request.runCount, seed)
        if workers is None:
            workers = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1

        def do(run: Run) -> PlanResult:
            planner = self._planner(self._sources[run.planner])
            return run_planner(self._setup, run, planner=planner, time=request.maxTime, simplify=request.simplify)

        planners = {
            name: PlannerRuns(name, settings=settings_of(self._planner(source)))
            for name, source in self._sources.items()
        }
        self._experiment = experiment = Experiment(
            self._experiment.name, list(planners.values()), repr(self._setup), request.maxTime, request.runCount, seed
        )
        begin = perf_counter()
        for k, (run, result) in enumerate(zip(runs, in_order(do, runs, workers, result_of_crash), strict=True), 1):
            crashed = result.status.startswith("Error: ")
            error = {"error": result.status.removeprefix("Error: ")} if crashed else {}
            planners[run.planner].runs.append({**run_measures(result), **error})
            experiment.duration = perf_counter() - begin
            if request.displayProgress:
                print(f"\r{experiment.name}: {k / len(runs):.0%}", end="\n" * (k == len(runs)), file=sys.stderr)

    def getRecordedExperimentData(self) -> Experiment:
        """Return the settings of the experiment and the measurements so far."""
        return self._experiment

    def saveResultsToFile(self, filename: str | PathLike[str]) -> bool:
        """Write the log to a file."""
        files.write(str(filename), log_text(self._experiment))
        return True

    def saveResultsToDatabase(self, log: str | PathLike[str], database: str | PathLike[str]) -> None:
        """Write the log and add it to a SQLite database for Planner Arena, which is created if it does not exist."""
        self.saveResultsToFile(log)
        # OMPL's reader prints a line for every planner, which is hidden here.
        with redirect_stdout(io.StringIO()):
            ot.readBenchmarkLog(str(database), [str(log)], False)


def log_text(experiment: Experiment) -> str:
    """Return a log in OMPL's format, as Planner Arena and `ot.readBenchmarkLog` read it."""
    lines = [
        f"OMPL version {version('ompl')}",
        f"Experiment {'_'.join(experiment.name.split()) or 'NO_NAME'}",
        "0 experiment properties",
        f"Running on {'_'.join(socket.gethostname().split()) or 'UNKNOWN'}",
        f"Starting at {experiment.begin:%Y-%m-%d %H:%M:%S}",
        f"<<<|\n{experiment.setup.strip()}\n|>>>",
        f"<<<|\n{platform.platform()}\n{platform.processor()}\n|>>>",
        f"{experiment.seed} is the random seed",
        f"{experiment.time_limit:g} seconds per run",
        "0 MB per run",
        f"{experiment.run_count} runs per planner",
        f"{experiment.duration:g} seconds spent to collect the data",
        "1 enum type",
        "|".join(("status", *_STATUSES)),
        f"{len(experiment.planners)} planners",
    ]
    for planner in experiment.planners:
        names = sorted({name for run in planner.runs for name in run})
        lines += [planner.name, f"{len(planner.settings)} common properties"]
        lines += [f"{key} = {_text(key, value)}" for key, value in planner.settings.items()]
        lines.append(f"{len(names)} properties for each run")
        lines += [_column(name, [run.get(name) for run in planner.runs]) for name in names]
        lines.append(f"{len(planner.runs)} runs")
        lines += ["".join(f"{_text(name, run.get(name))}; " for name in names) for run in planner.runs]
        lines.append(".")
    return "\n".join(lines) + "\n"


def _column(name: str, values: Sequence[Value]) -> str:
    """Return a property's name and type as the log declares it."""
    if name == "status":
        return "status ENUM"
    known = [value for value in values if value is not None]
    for kind, word in ((bool | np.bool_, "BOOLEAN"), (int | np.integer, "INTEGER"), (float | int | np.number, "REAL")):
        if known and all(isinstance(value, kind) for value in known):
            return f"{name} {word}"
    return f"{name} {'TEXT' if known else 'REAL'}"


def _text(name: str, value: Any) -> str:
    """Format a value for the log: on one line and without separators. None becomes an empty text."""
    if value is None:
        return ""
    if name == "status":
        word = "Crash" if value.startswith("Error") else value
        return str(_STATUSES.index(word) if word in _STATUSES else 0)
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    return re.sub(r"[;,\s]+", " ", value) if isinstance(value, str) else f"{value}"
