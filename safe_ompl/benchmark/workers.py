"""Where the runs of a benchmark are done: here, in processes of this machine, or on a cluster."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from ompl import base as ob
from ompl import util as ou

from safe_ompl.benchmark.runs import Entry, Events, Limits, Measured, crash, measure
from safe_ompl.errors import InputError

_ATTEMPTS = 2  # of a run that its process does not survive


class Task(NamedTuple):
    """One run: number of the planner, and seed."""

    planner: int
    seed: int


class Job(NamedTuple):
    """All that a run needs; `setup` is a function that builds the problem where it cannot travel itself."""

    setup: Any
    entries: Sequence[Entry]
    limits: Limits
    events: Events

    def run(self, task: Task) -> Measured:
        """Do one run."""
        return measure(self.setup, self.entries[task.planner], task.seed, self.limits, self.events)


def in_turn(job: Job, tasks: Sequence[Task]) -> Iterator[tuple[Task, Measured]]:
    """Do the runs here, one after the other."""
    for task in tasks:
        yield task, job.run(task)


def in_processes(job: Job, tasks: Sequence[Task], number: int) -> Iterator[tuple[Task, Measured]]:
    """Do the runs in processes that are forked: callbacks and planners of any kind are there without being pickled.

    A run whose process dies is done again in a new one; if that dies, too, the run is a crash. All others finish.
    """
    context = multiprocessing.get_context("fork")
    left = [(task, 1) for task in reversed(tasks)]
    working: dict[Connection, tuple[Any, Task, int]] = {}

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
                process, task, attempt = working.pop(pipe)
                try:
                    measured = pipe.recv()
                except (EOFError, ConnectionResetError):
                    process.join()
                    if attempt < _ATTEMPTS:
                        left.append((task, attempt + 1))
                        continue
                    measured = crash(task.seed, f"the process ended with exit code {process.exitcode}")
                yield task, measured
                if left and process.is_alive():
                    give(pipe, process)
                else:
                    pipe.close()
    finally:
        for process, _, _ in working.values():
            process.terminate()
        for process, _, _ in working.values():
            process.join()


def _work(job: Job, pipe: Connection, others: Sequence[Connection]) -> None:
    """Do the runs that come through a pipe until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's
    ou.noOutputHandler()
    for other in others:  # inherited ends would keep the others from noticing that the parent has gone
        other.close()
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        pipe.send(job.run(task))


def on_cluster(job: Job, tasks: Sequence[Task], client: Any) -> Iterator[tuple[Task, Measured]]:
    """Do the runs on a cluster of dask.distributed.

    Its scheduler does by itself what a long comparison needs: runs of a worker that was lost are done by another,
    workers may come and go, and dask-jobqueue or dask-kubernetes start them on most clusters. joblib was the
    alternative: its own backend gives up all runs when one worker dies, and on a cluster it needs dask underneath.

    Parameters
    ----------
    client : distributed.Client or str
        Where to, or the address of its scheduler.
    """
    from distributed import Client, KilledWorker, as_completed

    if not callable(job.setup):
        raise InputError(
            "on a cluster the benchmark needs a function that builds the setup, in place of the setup"
        )
    for entry in job.entries:
        if isinstance(entry.source, ob.Planner):
            raise InputError(
                f"on a cluster planner {entry.name!r} must be given by name or by addPlannerAllocator: "
                "OMPL's objects do not travel"
            )
    own = Client(client) if isinstance(client, str) else None
    try:
        blob = _dumps(job)
        futures = {(own or client).submit(_run_from, blob, task, pure=False): task for task in tasks}
        for future in as_completed(list(futures)):
            error = future.exception()
            if error is None:
                yield futures[future], future.result()
            elif isinstance(error, KilledWorker):
                yield futures[future], crash(futures[future].seed, f"the run ended its workers: {error}")
            else:
                raise error
    finally:
        if own is not None:
            own.close()


def _dumps(job: Job) -> bytes:
    import cloudpickle

    data: bytes = cloudpickle.dumps(job)
    return data


def _run_from(blob: bytes, task: Task) -> Measured:
    return _job_from(blob).run(task)


@lru_cache(maxsize=1)  # a worker builds the problem once, not for every run
def _job_from(blob: bytes) -> Job:
    ou.noOutputHandler()
    job: Job = pickle.loads(blob)
    build: Callable[[], Any] = job.setup
    return job._replace(setup=build())
