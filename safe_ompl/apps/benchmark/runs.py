"""The run engine: which planner runs with which seed, in this process or in others."""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections.abc import Collection, Iterator, Sequence
from logging.handlers import QueueHandler
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, Protocol, TypeVar

from safe_ompl.common import InputError, pass_on, whole_number

ATTEMPTS = 2  # of a task whose process does not survive it

TaskT = TypeVar("TaskT")
Outcome = TypeVar("Outcome")
_Task = TypeVar("_Task", contravariant=True)
_Outcome = TypeVar("_Outcome", covariant=True)


class Run(NamedTuple):
    """One run of a comparison: the name of the planner, and the seed."""

    planner: str
    seed: int


def rounds(planners: Sequence[str], number: int, seed: int = 0, done: Collection[Run] = frozenset()) -> list[Run]:
    """Return the runs of a comparison but those `done`, in their order: the planners take turns, once with each seed.

    Raises InputError for no planner, one named twice, or a number of runs below 1.
    """
    if not planners:
        raise InputError("at least one planner is needed")
    for name in planners:
        if list(planners).count(name) > 1:
            raise InputError(f"planner {name!r} is named twice")
    number = whole_number("runs", number, at_least=1)
    runs = (Run(planner, seed + k) for k in range(number) for planner in planners)
    return [run for run in runs if run not in done]


class Job(Protocol[_Task, _Outcome]):
    """Work that consists of many independent tasks, each with an outcome."""

    def run(self, task: _Task) -> _Outcome:
        """Do one task."""

    def crash(self, task: _Task, words: str) -> _Outcome:
        """Return the outcome of a task whose process died; `words` say how."""


def do_tasks(job: Job[TaskT, Outcome], tasks: Sequence[TaskT], processes: int = 1) -> Iterator[tuple[TaskT, Outcome]]:
    """Do tasks, and yield each with its outcome as they come.

    One process is this one, more are forked. Raises InputError for a number of processes below 1.
    """
    processes = whole_number("processes", processes, at_least=1)
    if processes == 1:
        return ((task, job.run(task)) for task in tasks)
    return in_processes(job, tasks, min(processes, len(tasks)))


def in_processes(job: Job[TaskT, Outcome], tasks: Sequence[TaskT], number: int) -> Iterator[tuple[TaskT, Outcome]]:
    """Do tasks in processes that are forked: jobs of any kind are there without being pickled.

    A task whose process dies is done again in a new one; if that dies, too, the task is a crash; all others finish.
    An exception that a task raises is raised here, and ends all tasks. Log records of the processes are logged here.
    """
    context = multiprocessing.get_context("fork")
    left = [(task, 1) for task in reversed(tasks)]
    working: dict[Connection, tuple[Any, TaskT, int]] = {}

    def start() -> None:
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(job, theirs, [*working, ours]), daemon=True)
        process.start()
        theirs.close()
        give(ours, process)

    def give(pipe: Connection, process: Any) -> None:
        task, attempt = left.pop()
        working[pipe] = process, task, attempt
        pipe.send(task)

    try:
        while left or working:
            while left and len(working) < number:
                start()
            for pipe in wait(list(working)):
                assert isinstance(pipe, Connection)
                process, task, attempt = working[pipe]
                try:
                    message = pipe.recv()
                except (EOFError, ConnectionResetError):
                    del working[pipe]
                    process.join()
                    if attempt < ATTEMPTS:
                        left.append((task, attempt + 1))
                        continue
                    outcome = job.crash(task, f"the process ended with exit code {process.exitcode}")
                else:
                    if isinstance(message, logging.LogRecord):
                        pass_on(message)
                        continue
                    if isinstance(message, _Raised):
                        raise message.error
                    del working[pipe]
                    outcome = message
                yield task, outcome
                if left and process.is_alive():
                    give(pipe, process)
                else:
                    pipe.close()
    finally:
        for process, _, _ in working.values():
            process.terminate()
        for process, _, _ in working.values():
            process.join()


class _Raised:
    """An exception that a worker sends to the process that started it."""

    def __init__(self, error: Exception) -> None:
        self.error = error


class _LogPipe(QueueHandler):
    """Sends log records through a pipe: handlers of the parent may hold locks that a fork copies and nobody frees."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__(pipe)  # type: ignore[arg-type]
        self._pipe = pipe

    def enqueue(self, record: logging.LogRecord) -> None:
        """Send a record."""
        self._pipe.send(record)


def _work(job: Job[Any, Any], pipe: Connection, others: Sequence[Connection]) -> None:
    """Do the tasks that come through a pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    logger = logging.getLogger("safe_ompl")
    logger.handlers, logger.propagate = [_LogPipe(pipe)], False
    for other in others:  # inherited ends would keep the others from noticing that the parent has gone
        other.close()
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        try:
            message = job.run(task)
        except Exception as error:
            message = _Raised(error)
        pipe.send(message)
