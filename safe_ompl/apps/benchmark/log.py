"""Benchmark logs in OMPL's format, as Planner Arena and `ot.readBenchmarkLog` read them, and their SQLite databases."""

from __future__ import annotations

import io
import platform
import re
import socket
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from importlib.metadata import version
from os import PathLike
from typing import Any, TextIO

import numpy as np
from ompl import tools as ot

from safe_ompl.apps.benchmark.measures import Value
from safe_ompl.common import InputError, files

# In the order of ob.PlannerStatus, in its words; its own logs call the last three "Unknown status".
STATUSES = (
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
CRASH = STATUSES.index("Crash")

_NAME = re.compile(r"[A-Za-z]\w*( \w+)*")


@dataclass
class PlannerRuns:
    """All runs of one planner."""

    name: str  # Name of the planner, different from all others of the experiment
    settings: Mapping[str, Value] = field(default_factory=dict)  # Its parameters
    # Measurements of each run; what a run has not is left empty. Names are words and blanks
    runs: list[Mapping[str, Value]] = field(default_factory=list)
    progress_names: tuple[str, ...] = ()  # What was recorded while planning, without "time"
    # For each run the samples (time [s], values …); none by default
    progress: list[Sequence[tuple[float, ...]]] = field(default_factory=list)


@dataclass
class Experiment:
    """The content of a benchmark log."""

    name: str  # Name of the experiment; blanks become underscores, since OMPL's reader stops at them
    planners: list[PlannerRuns] = field(default_factory=list)  # What was measured
    setup: str = ""  # What the problem is, in any number of lines
    time_limit: float = 0.0  # Of a run [s], [MB]
    memory_limit: float = 0.0
    run_count: int = 0  # How many runs of each planner were asked for
    seed: int = 0  # Of the first run
    duration: float = 0.0  # Of the whole experiment [s]
    begin: datetime = field(default_factory=datetime.now)  # When it began
    parameters: Mapping[str, Value] = field(default_factory=dict)  # Further properties of the experiment

    def save(self, file: str | PathLike[str]) -> None:
        """Write the log to a file."""
        files.write(str(file), self.text())

    def text(self) -> str:
        """Return the log, or raise InputError if a property has a name that cannot be a column of the database."""
        stream = io.StringIO()
        self._write_header(stream)
        for planner in self.planners:
            _write_planner(stream, planner)
        return stream.getvalue()

    def _write_header(self, stream: TextIO) -> None:
        line = partial(print, file=stream)
        line(f"OMPL version {version('ompl')}")
        line(f"Experiment {'_'.join(self.name.split()) or 'NO_NAME'}")
        line(f"{len(self.parameters)} experiment properties")
        for name, value in self.parameters.items():
            line(f"{_column(name, [value])} = {_text(value)}")
        line(f"Running on {'_'.join(socket.gethostname().split()) or 'UNKNOWN'}")
        line(f"Starting at {self.begin:%Y-%m-%d %H:%M:%S}")
        for block in (self.setup, f"{platform.platform()}\n{platform.processor()}"):
            line(f"<<<|\n{block.strip()}\n|>>>")
        line(f"{self.seed} is the random seed")
        line(f"{self.time_limit:g} seconds per run")
        line(f"{self.memory_limit:g} MB per run")
        line(f"{self.run_count} runs per planner")
        line(f"{self.duration:g} seconds spent to collect the data")
        line("1 enum type")
        line("|".join(("status", *STATUSES)))
        line(f"{len(self.planners)} planners")


def save_database(logs: Sequence[str | PathLike[str]], database: str | PathLike[str]) -> None:
    """Add benchmark logs to a SQLite database as Planner Arena loads it, which is made if there is none."""
    with redirect_stdout(io.StringIO()):  # OMPL's reader reports every planner
        ot.readBenchmarkLog(str(database), [str(log) for log in logs], False)


def status_number(status: str) -> int:
    """Return OMPL's number of an outcome; an error counts as a crash, other unknown words as unknown."""
    if status.startswith("Error"):
        return CRASH
    return STATUSES.index(status) if status in STATUSES else 0


def _write_planner(stream: TextIO, planner: PlannerRuns) -> None:
    print(planner.name, file=stream)
    print(f"{len(planner.settings)} common properties", file=stream)
    for name, value in sorted(planner.settings.items()):
        print(f"{name} = {_text(value)}", file=stream)
    names = sorted({name for run in planner.runs for name in run})
    print(f"{len(names)} properties for each run", file=stream)
    for name in names:
        print(_column(name, [run.get(name) for run in planner.runs]), file=stream)
    print(f"{len(planner.runs)} runs", file=stream)
    for run in planner.runs:
        values = ({**run, "status": status_number(str(run["status"]))} if "status" in run else run).get
        print("".join(f"{_text(values(name))}; " for name in names), file=stream)
    if any(planner.progress):
        _write_progress(stream, planner)
    print(".", file=stream)


def _write_progress(stream: TextIO, planner: PlannerRuns) -> None:
    names = ("time", *planner.progress_names)
    print(f"{len(names)} progress properties for each run", file=stream)
    for name in names:
        print(_column(name, [0.0]), file=stream)
    print(f"{len(planner.progress)} runs", file=stream)
    for samples in planner.progress:
        rows = {sample[0]: sample for sample in samples}  # times are the keys of the database
        print("".join("".join(f"{_text(v)}," for v in row) + ";" for row in rows.values()), file=stream)


def _column(name: str, values: Sequence[Value]) -> str:
    """Return a property's name and type as the log declares it."""
    if not _NAME.fullmatch(name):
        raise InputError(f"property {name!r}: its name must be words with single blanks between them")
    if name == "status":
        return "status ENUM"
    known = [value for value in values if value is not None]
    for kind, word in ((bool | np.bool_, "BOOLEAN"), (int | np.integer, "INTEGER"), (float | int | np.number, "REAL")):
        if known and all(isinstance(value, kind) for value in known):
            return f"{name} {word}"
    return f"{name} {'TEXT' if known else 'REAL'}"


def _text(value: Any) -> str:
    """Return a value as the log writes it: empty for what is not known, one line, no separators."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return str(int(value))
    return re.sub(r"[;,\s]+", " ", str(value)) if isinstance(value, str) else f"{value}"
