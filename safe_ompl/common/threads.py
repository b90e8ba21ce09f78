"""Concurrent queries of one model: working memory for each thread, and detection of changes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Generic, TypeVar

_Memory = TypeVar("_Memory")


class PerThread(threading.local, Generic[_Memory]):
    """Working memory of each thread, made when a thread first asks for it.

    Parameters
    ----------
    make : callable
        Makes the memory of one thread.

    Attributes
    ----------
    own : object
        That of the thread that asks.
    """

    def __init__(self, make: Callable[[], _Memory]) -> None:
        self.own = make()


class Changes:
    """Counts the changes of a model, so that a query notices one that another thread makes meanwhile.

    A query reads `done` when it begins. Where `begun` is still the same when it ends, nothing has changed in between;
    otherwise its answer may mix two scenes: it waits for the change to end, and asks again.

    Attributes
    ----------
    begun, done : int
        How many changes have begun, and how many of them have ended.
    """

    def __init__(self) -> None:
        self.begun = self.done = 0
        self._lock = threading.RLock()

    @contextmanager
    def one(self) -> Iterator[None]:
        """Make one change; that of another thread is waited for."""
        with self._lock:
            self.begun += 1
            try:
                yield
            finally:
                self.done = self.begun

    def none(self) -> AbstractContextManager[Any]:
        """Let nothing change; a change of another thread is waited for."""
        return self._lock
