"""Virtual environments of the systems, and their runners as processes that answer one problem at a time."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from selectors import EVENT_READ, DefaultSelector
from typing import Any

from bench.peers.systems import System

RUNNERS = Path(__file__).parent / "runners"
GRACE = 60.0  # [s] beyond the time limit of planning, after which a runner counts as hanging
STARTS = 3  # of a system's process
WARMING = 900.0  # [s] for the first answer, which does not count: kernels are compiled, caches are filled


class UnavailableError(Exception):
    """A system that cannot be run here; the message says why."""


def python_of(system: System, folder: Path) -> Path:
    """Return the interpreter of a system's environment, which is made if it is not there yet."""
    if not system.environment:
        return Path(sys.executable)
    requirements = system.requirements
    if system.sources:
        if not os.environ.get(system.sources):
            raise UnavailableError(f"{system.sources} does not name a folder with its sources")
        requirements = (os.environ[system.sources],)
    environment = folder / system.environment
    log = folder / f"{system.environment}.log"
    if not (environment / "made").exists():
        print(f"making the environment of {system.environment}", file=sys.stderr)
        environment.mkdir(parents=True, exist_ok=True)
        with log.open("w") as stream:
            subprocess.run([sys.executable, "-m", "venv", environment], check=True, stdout=stream, stderr=stream)
            command = [environment / "bin/python", "-m", "pip", "install", *requirements]
            made = subprocess.run(command, check=False, stdout=stream, stderr=stream).returncode == 0
        (environment / "made").write_text("yes" if made else "no")
    if (environment / "made").read_text() != "yes":
        raise UnavailableError(f"pip does not install {' '.join(requirements)}: {_reason(log)}")
    return environment / "bin/python"


def _reason(log: Path) -> str:
    """Return the first error of a log with the line after it; that a process of pip ended says nothing."""
    lines = [line.strip() for line in log.read_text().splitlines() if line.strip()]
    errors = [k for k, x in enumerate(lines) if re.search(r"error\b.*:", x, re.I) and "subprocess-" not in x]
    return " ".join(lines[errors[0] : errors[0] + 2]) if errors else "see the log"


class Runner:
    """The process of one system, on one core."""

    def __init__(self, system: System, robot: Path, folder: Path) -> None:
        python = python_of(system, folder)
        kept = ("HOME", "PATH", "LANG")
        environment = {name: os.environ[name] for name in kept if name in os.environ}
        environment |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
        if not system.environment:
            environment["PYTHONPATH"] = str(Path(__file__).parents[2])
        self._name = system.name
        self._log = (robot.parent / f"{system.runner}.log").open("w")
        self._process = subprocess.Popen(
            [python, RUNNERS / f"{system.runner}.py", robot, json.dumps(system.options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            env=environment,
            preexec_fn=_on_one_core,
        )
        wanted = {re.split("[<>=]", requirement)[0] for requirement in system.requirements}
        versions = self._answer(WARMING)["versions"]
        self.versions = {name: number for name, number in versions.items() if name in wanted}

    def ask(self, problem: dict[str, Any], grace: float | None = None) -> dict[str, Any]:
        """Return the answer to a problem; raise UnavailableError if the process ends, or hangs."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(problem).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise UnavailableError(f"{self._name} ended: {self._last_words()}") from None
        return self._answer(problem["time"] + (GRACE if grace is None else grace))

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        self._log.close()

    def _answer(self, seconds: float) -> dict[str, Any]:
        assert self._process.stdout is not None
        with DefaultSelector() as selector:
            selector.register(self._process.stdout, EVENT_READ)
            if not selector.select(seconds):
                self.close()
                raise UnavailableError(f"{self._name} gave no answer within {seconds:g} s")
        line = self._process.stdout.readline()
        if not line:
            raise UnavailableError(f"{self._name} ended: {self._last_words()}")
        return dict(json.loads(line))

    def _last_words(self) -> str:
        self._process.wait()
        lines = Path(self._log.name).read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"status {self._process.returncode}"


class Comparison:
    """The systems that run, what they answered, and why others do not run.

    Parameters
    ----------
    chosen : sequence of System
        Those that are compared.
    robot : path-like
        The exported robot.
    environments : path-like
        Where their virtual environments are.
    """

    def __init__(self, chosen: Sequence[System], robot: Path, environments: Path) -> None:
        self.runs: dict[str, list[Any]] = {system.name: [] for system in chosen}
        self.unavailable: dict[str, str] = {}
        self.versions: dict[str, str] = {}
        self._systems, self._where = {system.name: system for system in chosen}, (robot, environments)
        self._runners: dict[str, Runner] = {}
        self._starts = dict.fromkeys(self._systems, 0)
        for name in self._systems:
            self._start(name)

    def _start(self, name: str) -> None:
        """Start a system, for the first time or anew."""
        self._starts[name] += 1
        try:
            self._runners[name] = Runner(self._systems[name], *self._where)
            self.versions |= self._runners[name].versions
        except UnavailableError as reason:
            self.unavailable[name] = str(reason)

    def warm_up(self, problem: dict[str, Any]) -> None:
        """Have every system answer a problem that does not count, however long that takes."""
        self.ask(problem, WARMING)

    def ask(self, problem: dict[str, Any], grace: float | None = None) -> dict[str, dict[str, Any]]:
        """Return the answers of the systems that run, in turn; one that ends or hangs is started anew."""
        answers: dict[str, dict[str, Any]] = {}
        for name in [name for name in self._systems if name in self._runners]:
            runner = self._runners[name]
            try:
                answers[name] = runner.ask(problem, grace)
            except UnavailableError as reason:
                answers[name] = {**dict.fromkeys(("building", "planning", "smoothing"), 0.0), "path": None}
                answers[name]["error"] = str(reason)
                del self._runners[name]
                if self._starts[name] < STARTS:
                    self._start(name)
                else:
                    self.unavailable[name] = f"after {len(self.runs[name])} problems: {reason}"
        return answers

    def close(self) -> None:
        """End all processes."""
        for runner in self._runners.values():
            runner.close()


def _on_one_core() -> None:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
