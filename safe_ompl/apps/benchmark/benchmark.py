"""The benchmark of planners on one problem: `ot.Benchmark` for planners in Python, with safety measured."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from os import PathLike
from time import perf_counter
from types import SimpleNamespace
from typing import Any

from ompl import base as ob
from ompl import tools as ot
from ompl import util as ou

from safe_ompl.apps.benchmark.log import Experiment, PlannerRuns, save_database
from safe_ompl.apps.benchmark.measures import Entry, Events, Measured, MeasuredRuns, RunLimits, Value
from safe_ompl.apps.benchmark.runs import Run, do_tasks, rounds
from safe_ompl.common import InputError
from safe_ompl.planning import SafeSetup


class Benchmark:
    """Runs planners many times on one problem, and writes OMPL's log; called like `ot.Benchmark`.

    `ot.Benchmark` does not record graphs, settings and progress of planners in Python, aborts when a callback raises,
    and leaves a broken log handler behind. This class does the runs itself. It measures what OMPL measures, under the
    same names; for a `SafeSetup` also danger, clearance, proof and all counts. A run that raises an exception is a
    crash, with the message in the column `error`. Ctrl-C ends the benchmark and keeps the runs done so far.

    Parameters
    ----------
    setup : og.SimpleSetup or callable
        The problem, or a function without arguments that builds it.
    name : str
        Name of the experiment.

    Examples
    --------
    >>> benchmark = Benchmark(setup, "shelf")                                           # doctest: +SKIP
    >>> benchmark.addPlanner("SafePRM")                                                 # doctest: +SKIP
    >>> benchmark.addPlannerAllocator(lambda si: SafeRRTConnect(si, "α = 2", alpha=2))  # doctest: +SKIP
    >>> benchmark.benchmark(ot.Request(maxTime=2.0, runCount=50))                       # doctest: +SKIP
    >>> benchmark.saveResultsToFile("shelf.log")                                        # doctest: +SKIP
    """

    def __init__(self, setup: Any, name: str = "") -> None:
        if not (callable(setup) or hasattr(setup, "getSpaceInformation")):
            raise InputError(f"setup must be a SimpleSetup or a function that builds one, got {setup!r}")
        self._given = setup
        self._setup = setup() if callable(setup) else setup
        self._entries: list[Entry] = []
        self._events = Events()
        self._switch: Callable[[Any], None] | None = None
        self._parameters: dict[str, Value] = {}
        self._experiment = Experiment(name)
        self._status = SimpleNamespace(running=False, activePlanner="", activeRun=0, progressPercentage=0.0)

    def __repr__(self) -> str:
        return f"Benchmark({self._given!r}, {len(self._entries)} planners)"

    def addPlanner(self, planner: Any) -> None:
        """Add a planner, or the name of one of `planner_names()`. By name it is made anew for every run."""
        if not isinstance(planner, str | ob.Planner):
            raise InputError(f"planner must be a name or an ob.Planner, got {planner!r}")
        self._add(planner)

    def addPlannerAllocator(self, allocator: Callable[[Any], Any]) -> None:
        """Add a planner by a function that makes it from a space information, anew for every run."""
        if not callable(allocator):
            right = "a function of a space information"
            raise InputError(f"planner allocator must be {right}, got {allocator!r}")
        self._add(allocator)

    def _add(self, source: Any) -> None:
        planner = Entry("", source).planner(self._setup)
        taken = [entry.name for entry in self._entries]
        name, k = planner.getName(), 2
        while name in taken:
            name, k = f"{planner.getName()} {k}", k + 1
        self._entries.append(Entry(name, source))

    def clearPlanners(self) -> None:
        """Remove all planners."""
        self._entries.clear()

    def addExperimentParameter(self, name: str, type: str, value: str) -> None:
        """Add a property of the experiment; the type is found in the value."""
        self._parameters[name] = {"INTEGER": int, "REAL": float}.get(type.upper(), str)(value)

    def getExperimentParameters(self) -> dict[str, str]:
        """Return the properties of the experiment."""
        return {name: str(value) for name, value in self._parameters.items()}

    def numExperimentParameters(self) -> int:
        """Return the number of properties of the experiment."""
        return len(self._parameters)

    def setExperimentName(self, name: str) -> None:
        """Set the name of the experiment."""
        self._experiment.name = name

    def getExperimentName(self) -> str:
        """Return the name of the experiment."""
        return self._experiment.name

    def setPlannerSwitchEvent(self, event: Callable[[Any], None]) -> None:
        """Set a function that gets every planner before its first run, in this process."""
        self._switch = event

    def setPreRunEvent(self, event: Callable[[Any], None]) -> None:
        """Set a function that gets the planner before every run."""
        self._events.before = event

    def setPostRunEvent(self, event: Callable[[Any, dict[str, Any]], None]) -> None:
        """Set a function that gets planner and measurements after every run, and may change and add measurements.

        Names are words (`run["joint effort"] = 2.5`); OMPL's form (`run["joint effort REAL"] = "2.5"`) works, too.
        """
        self._events.after = event

    def benchmark(self, request: Any = None, *, seed: int = 0, processes: int | None = None) -> None:
        """Do the runs.

        Parameters
        ----------
        request : ot.Request
            maxTime, maxMem, runCount, timeBetweenUpdates, displayProgress, saveConsoleOutput, simplify.
        seed : int
            Seed of the first run of each planner; the next ones count up. Planners that are made anew for every run
            (by name or allocator) do the same in any process.
        processes : int, optional
            How many runs go on at the same time; times are most accurate with 1. By default one for each processor,
            or 1 if events are set, since these may change objects of this process.

        Raises
        ------
        InputError
            No planner, or a number of runs or processes below 1.
        """
        request = request or ot.Request()
        if request.runCount < 1:
            raise InputError(f"runCount must be at least 1, got {request.runCount!r}")
        tasks = rounds([entry.name for entry in self._entries], request.runCount, seed)
        if processes is None:
            machine = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
            processes = 1 if self._events else machine
        limits = RunLimits(request.maxTime, request.maxMem, request.timeBetweenUpdates, request.simplify)
        job = MeasuredRuns(self._setup, {entry.name: entry for entry in self._entries}, limits, self._events)
        runs = do_tasks(job, tasks, processes)
        if self._switch is not None:
            for entry in self._entries:
                self._switch(entry.planner(self._setup))
        found: dict[Run, Measured] = {}
        begin, clock = datetime.now(), perf_counter()
        self._status.running = True
        try:
            with _console_output(request.saveConsoleOutput, self._experiment.name):
                for run, measured in runs:
                    found[run] = measured
                    self._report(request.displayProgress, run, len(found) / len(tasks))
        finally:
            self._status.running = False
            self._experiment = Experiment(
                self._experiment.name,
                [_collect(entry.name, tasks, found) for entry in self._entries],
                self._describe(),
                request.maxTime,
                request.maxMem,
                request.runCount,
                seed,
                perf_counter() - clock,
                begin,
                self._parameters,
            )

    def _report(self, display: bool, run: Run, share: float) -> None:
        self._status.activePlanner = run.planner
        self._status.activeRun += 1
        self._status.progressPercentage = 100 * share
        if display:
            print(f"\r{self._experiment.name}: {share:.0%}", end="\n" if share == 1 else "", file=sys.stderr)

    def _describe(self) -> str:
        if isinstance(self._setup, SafeSetup):
            return repr(self._setup)
        space = self._setup.getStateSpace()  # printing a SimpleSetup would make thousands of queries
        return f"{space.getName()}, {space.getDimension()} dimensions"

    def getStatus(self) -> SimpleNamespace:
        """Return the state of the benchmark: running, activePlanner, activeRun, progressPercentage."""
        return self._status

    def getRecordedExperimentData(self) -> Experiment:
        """Return what was measured so far."""
        return self._experiment

    def saveResultsToFile(self, filename: str | PathLike[str] | None = None) -> bool:
        """Write the log; by default to NAME_HOST_TIME.log in the current folder."""
        self._experiment.save(filename or _file_name(self._experiment.name, "log"))
        return True

    def saveResultsToStream(self) -> bool:
        """Print the log."""
        print(self._experiment.text(), end="")
        return True

    def saveResultsToDatabase(self, log: str | PathLike[str], database: str | PathLike[str]) -> None:
        """Write the log, and add it to a SQLite database for Planner Arena."""
        self._experiment.save(log)
        save_database([log], database)


def _collect(planner: str, tasks: list[Run], found: Mapping[Run, Measured]) -> PlannerRuns:
    """Return the runs of one planner in the order of their seeds."""
    runs = [found[task] for task in tasks if task.planner == planner and task in found]
    settings = next((run.settings for run in runs if run.settings), {})
    names = next((run.progress_names for run in runs if run.progress_names), ())
    progress = [run.progress for run in runs] if names else []
    return PlannerRuns(planner, settings, [run.properties for run in runs], names, progress)


@contextmanager
def _console_output(save: bool, name: str) -> Iterator[None]:
    """Send OMPL's messages to a file, or nowhere, and restore the handler afterwards."""
    handler, level = ou.getOutputHandler(), ou.getLogLevel()
    file = ou.OutputHandlerFile(_file_name(name, "console")) if save else None
    if file is None:
        ou.noOutputHandler()
    else:
        ou.useOutputHandler(file)
        ou.setLogLevel(min(level, ou.LogLevel.LOG_INFO, key=lambda kind: kind.value))
    try:
        yield
    finally:
        ou.setLogLevel(level)
        if handler is None:
            ou.noOutputHandler()
        else:
            ou.useOutputHandler(handler)


def _file_name(name: str, ending: str) -> str:
    words = "_".join(name.split()) or "ompl"
    return f"{words}_{socket.gethostname()}_{datetime.now():%Y-%m-%d_%H-%M-%S}.{ending}"
