"""Runs of planners: one run, many in an order, and in other processes."""

from __future__ import annotations

import logging
import multiprocessing
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from logging.handlers import QueueHandler
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from safe_ompl.common import InputError, ctrl_c_as_such, pass_on, whole_number
from safe_ompl.planning import PlanResult, SafeSetup

_log = logging.getLogger(__name__)


class Run(NamedTuple):
    """One run of a comparison: the name of the planner, and the seed."""

    planner: str
    seed: int


def rounds(planners: Sequence[str], number: int, seed: int = 0) -> list[Run]:
    """Return the runs of a comparison in their order: the planners take turns, once with each seed.

    Raises InputError for no planner, one named twice, or a number of runs below 1.
    """
    if not planners:
        raise InputError("at least one planner is needed")
    for name in planners:
        if list(planners).count(name) > 1:
            raise InputError(f"planner {name!r} is named twice")
    number = whole_number("runs", number, at_least=1)
    return [Run(planner, seed + k) for k in range(number) for planner in planners]


def run_planner(
    setup: SafeSetup,
    run: Run,
    *,
    planner: Any = None,
    time: float,
    parameters: Mapping[str, Any] | None = None,
    simplify: bool | float = False,
) -> PlanResult:
    """Do one run, of the planner by its name or as it is given; what goes wrong in it is a result without a path.

    It does not know of other runs, and its result can be sent to other processes: anything may spread runs out. Only an
    InputError, which all runs would raise, and Ctrl-C arrive here.
    """
    try:
        options: dict[str, Any] = {"parameters": parameters, "simplify": simplify}
        with ctrl_c_as_such():
            result = setup.plan(run.planner if planner is None else planner, time=time, seed=run.seed, **options)
    except InputError:
        raise
    except Exception as error:
        return _failed(run, str(error), setup.robot.joint_names)
    if result.interrupted:  # Ctrl-C is for all the runs
        raise KeyboardInterrupt
    return result


def failure(status: str, planner: str, seed: int, joint_names: tuple[str, ...]) -> PlanResult:
    """Return the result of a run without a path."""
    return PlanResult(status, None, None, planner, seed, joint_names, planning_time=0.0)


def _failed(run: Run, words: str, joint_names: tuple[str, ...] = ()) -> PlanResult:
    _log.warning("%s, seed %d: %s", run.planner, run.seed, words)
    return failure(f"Error: {words}", run.planner, run.seed, joint_names)


def results_of(do: Callable[[Run], PlanResult], runs: Sequence[Run], processes: int = 1) -> Iterator[PlanResult]:
    """Do runs, and yield their results in their order; one process is this one, more are forked.

    A run whose process dies has no path. An InputError ends all. Log records of the processes are logged here.
    """
    if whole_number("processes", processes, at_least=1) == 1:
        yield from map(do, runs)
        return
    waiting: dict[Run, PlanResult] = {}
    done = _in_processes(do, runs, min(processes, len(runs)))
    for run in runs:
        while run not in waiting:
            waiting.update([next(done)])
        yield waiting.pop(run)


def _in_processes(
    do: Callable[[Run], PlanResult], runs: Sequence[Run], number: int
) -> Iterator[tuple[Run, PlanResult]]:
    """Do runs in processes that are forked, so that setup and planners need not be pickled; yield them as they come."""
    context = multiprocessing.get_context("fork")
    left = list(reversed(runs))
    working: dict[Connection, tuple[Any, Run]] = {}

    def start() -> None:
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(do, theirs, [*working, ours]), daemon=True)
        process.start()
        theirs.close()
        give(ours, process)

    def give(pipe: Connection, process: Any) -> None:
        working[pipe] = process, left.pop()
        pipe.send(working[pipe][1])

    try:
        while left or working:
            while left and len(working) < number:
                start()
            for pipe in wait(list(working)):
                assert isinstance(pipe, Connection)
                process, run = working[pipe]
                try:
                    message = pipe.recv()
                except (EOFError, ConnectionResetError):
                    process.join()
                    message = _failed(run, f"the process ended with exit code {process.exitcode}")
                if isinstance(message, logging.LogRecord):
                    pass_on(message)
                    continue
                if isinstance(message, Exception):
                    raise message
                del working[pipe]
                yield run, message
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
    """Sends log records through a pipe: handlers of the parent may hold locks that a fork copies and nobody frees."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__(pipe)  # type: ignore[arg-type]
        self._pipe = pipe

    def enqueue(self, record: logging.LogRecord) -> None:
        """Send a record."""
        self._pipe.send(record)


def _work(do: Callable[[Run], PlanResult], pipe: Connection, others: Sequence[Connection]) -> None:
    """Do the runs that come through a pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    logger = logging.getLogger("safe_ompl")
    logger.handlers, logger.propagate = [_LogPipe(pipe)], False
    for other in others:  # inherited ends would keep the others from noticing that the parent has gone
        other.close()
    while True:
        try:
            run = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(do(run))
        except Exception as error:
            pipe.send(error)
