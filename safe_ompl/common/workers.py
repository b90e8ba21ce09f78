"""Running tasks in forked processes, in which only results are pickled, or in an executor."""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from functools import partial
from logging.handlers import QueueHandler
from multiprocessing.connection import Connection, wait
from statistics import median
from time import perf_counter
from typing import Any, TypeVar

from safe_ompl.common.documents import whole_number
from safe_ompl.common.errors import InputError, pass_on

_Task = TypeVar("_Task")
_Outcome = TypeVar("_Outcome")
# An executor gets this many tasks one by one at first. Later batches have at most this many tasks.
_FIRST = 16
# Duration of a batch of tasks. Dask takes about 10 ms to send a batch.
_WORTH = 0.5  # [s]


def in_order(
    do: Callable[[_Task], _Outcome],
    tasks: Sequence[_Task],
    workers: int | Executor,
    lost: Callable[[_Task, str], _Outcome],
) -> Iterator[_Outcome]:
    """Run tasks and yield the results in the order of the tasks. One worker is this process, more are forked.

    If the process of a task dies, its result is `lost(task, reason)`. An exception in a task is raised here and ends
    the iteration. Log records of the processes are logged here, too. An executor gets `do` and the tasks pickled, short
    tasks in batches. The executor decides how to handle dead workers, and a broken executor ends the iteration. Raises
    InputError for fewer than 1 worker.
    """
    if isinstance(workers, Executor):
        return _by_executor(do, tasks, workers, lost)
    if whole_number("workers", workers, at_least=1) == 1:
        return map(do, tasks)
    return _sorted(_in_processes(do, tasks, min(workers, len(tasks))), tasks, lost)


def _by_executor(
    do: Callable[[_Task], _Outcome], tasks: Sequence[_Task], executor: Executor, lost: Callable[[_Task, str], _Outcome]
) -> Iterator[_Outcome]:
    """Run tasks in an executor. The first are sent one by one; their durations decide the size of later batches."""
    waiting: deque[tuple[Sequence[_Task], Future[tuple[float, list[_Outcome]]]]] = deque()
    seconds: list[float] = []

    def send(some: Sequence[_Task], size: int) -> None:
        for k in range(0, len(some), size):
            waiting.append((some[k : k + size], executor.submit(partial(_together, do), *some[k : k + size])))

    try:
        send(tasks[:_FIRST], 1)
        left = tasks[_FIRST:]
        while waiting:
            batch, future = waiting[0]
            try:
                taken, outcomes = future.result()
                seconds.append(taken / len(batch))
            except (InputError, BrokenExecutor):
                raise
            except Exception as error:
                # An example is dask's error that the tasks have ended several workers.
                if len(batch) > 1:
                    outcomes = list(_by_executor(do, batch, executor, lost))  # one by one
                else:
                    outcomes = [lost(batch[0], f"{type(error).__name__}: {error}")]
            waiting.popleft()
            if left and len(waiting) <= _FIRST // 2:
                send(left, int(min(max(_WORTH / max(median(seconds or [_WORTH]), 1e-9), 1), _FIRST)))
                left = left[:0]
            yield from outcomes
    finally:
        for _, future in waiting:
            future.cancel()


def _together(do: Callable[[_Task], _Outcome], *tasks: _Task) -> tuple[float, list[_Outcome]]:
    """Run tasks in a worker of an executor. Return the duration [s] and the results."""
    begin = perf_counter()
    outcomes = [do(task) for task in tasks]
    return perf_counter() - begin, outcomes


class _Lost(str):
    """The reason why a process ended, instead of the result of its task."""


def _sorted(
    done: Iterator[tuple[int, _Outcome | _Lost]], tasks: Sequence[_Task], lost: Callable[[_Task, str], _Outcome]
) -> Iterator[_Outcome]:
    """Yield results sorted by their numbers 0, 1, 2, …; `lost` is called in this order, too."""
    waiting: dict[int, _Outcome | _Lost] = {}
    number = 0
    for k, found in done:
        waiting[k] = found
        while number in waiting:
            outcome = waiting.pop(number)
            yield lost(tasks[number], outcome) if isinstance(outcome, _Lost) else outcome
            number += 1


def _in_processes(
    do: Callable[[_Task], _Outcome], tasks: Sequence[_Task], workers: int
) -> Iterator[tuple[int, _Outcome | _Lost]]:
    """Run tasks in forked processes. Yield the number and the result of each task as soon as it ends."""
    context = multiprocessing.get_context("fork")
    left = list(reversed(range(len(tasks))))
    working: dict[Connection, tuple[Any, int]] = {}

    def start() -> None:
        ours, theirs = context.Pipe()
        work = (lambda k: do(tasks[k])), theirs, [*working, ours]
        process = context.Process(target=_work, args=work, daemon=True)
        process.start()
        theirs.close()
        give(ours, process)

    def give(pipe: Connection, process: Any) -> None:
        working[pipe] = process, left.pop()
        pipe.send(working[pipe][1])

    try:
        while left or working:
            while left and len(working) < workers:
                start()
            for pipe in wait(list(working)):
                assert isinstance(pipe, Connection)
                process, number = working[pipe]
                try:
                    message = pipe.recv()
                except (EOFError, ConnectionResetError):
                    process.join()
                    message = _Lost(f"the process ended with exit code {process.exitcode}")
                if isinstance(message, logging.LogRecord):
                    pass_on(message)
                    continue
                if isinstance(message, Exception):
                    raise message
                del working[pipe]
                yield number, message
                if left and process.is_alive():
                    give(pipe, process)
                else:
                    pipe.close()
    finally:
        for process, _ in working.values():
            process.terminate()
        for process, _ in working.values():
            process.join()


class _LogPipe(QueueHandler):
    """Sends log records through a pipe, since handlers of the parent may hold locks that a fork never releases."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__(pipe)  # type: ignore[arg-type]
        self._pipe = pipe

    def enqueue(self, record: logging.LogRecord) -> None:
        """Send a record through the pipe."""
        self._pipe.send(record)


def _work(do: Callable[[int], object], pipe: Connection, others: Sequence[Connection]) -> None:
    """Run the tasks whose numbers arrive through a pipe, until the pipe is closed."""
    # Only the parent handles Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logger = logging.getLogger("safe_ompl")
    logger.handlers, logger.propagate = [_LogPipe(pipe)], False
    for other in others:
        # With inherited ends of pipes left open, other workers would not notice that the parent has ended.
        other.close()
    while True:
        try:
            number = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(do(number))
        except Exception as error:
            pipe.send(error)
