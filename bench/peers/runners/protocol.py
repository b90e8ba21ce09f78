"""What every runner speaks: problems come in and paths go out, one JSON document a line. Standard library only.

Before the first problem it says which versions of packages it found.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from importlib.metadata import distributions
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any, Protocol

Waypoints = list[list[float]]


class System(Protocol):
    """A system under test, in a process of its own. It has read the robot when it is made."""

    def build(self, problem: dict[str, Any]) -> None:
        """Make whatever a new scene and a new query need."""

    def plan(self, seed: int, seconds: float) -> Waypoints | None:
        """Return a path, or None."""

    def smooth(self, path: Waypoints) -> Waypoints:
        """Return the path as the system's users would have it."""


def serve(make: Callable[[dict[str, Any], dict[str, Any]], System]) -> None:
    """Make a system from the robot and the options in the arguments, then answer problems until the input ends.

    Every answer holds the path (or null), the CPU seconds of the three steps, and the error of one that failed; and
    the `remarks` of a system that has some.
    What libraries print goes to stderr.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    robot, options = json.loads(Path(sys.argv[1]).read_text()), json.loads(sys.argv[2])
    system = make(robot, options)
    versions = {package.name: package.version for package in distributions()}
    print(json.dumps({"versions": versions}), file=answers, flush=True)
    for line in sys.stdin:
        problem = json.loads(line)
        # While a process waits for the others, caches and memory lose its code and data, so that its next call may take
        # several times as long. Therefore each problem is solved twice, and the second answer counts.
        _answer(system, problem)
        print(json.dumps(_answer(system, problem)), file=answers, flush=True)


def _answer(system: System, problem: dict[str, Any]) -> dict[str, Any]:
    """Return path and times; where the system raises an error, which it is: the next problem may be better."""
    times, path, error = [process_time()], None, None
    try:
        system.build(problem)
        times.append(process_time())
        path = system.plan(problem["seed"], problem["time"])
        times.append(process_time())
        if path is not None:
            path = system.smooth(path)
    except Exception as raised:
        path, error = None, f"{type(raised).__name__}: {raised}"
    times += [process_time()] * (4 - len(times))
    building, planning, smoothing = (b - a for a, b in pairwise(times))
    answer = {"path": path, "building": building, "planning": planning, "smoothing": smoothing}
    return {**answer, "error": error, **getattr(system, "remarks", {})}
