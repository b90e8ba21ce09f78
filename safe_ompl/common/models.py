"""Helpers of models: counters of queries, memory per thread, locks for changes, Halton points, notebook display."""

from __future__ import annotations

import threading
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from functools import lru_cache
from html import escape
from importlib import import_module
from itertools import count, islice
from typing import Any, Generic, TypeVar

import numpy as np

from safe_ompl.common.documents import FloatArray

_Memory = TypeVar("_Memory")


class PerThread(threading.local, Generic[_Memory]):
    """Working memory per thread. `make` creates the memory at a thread's first access to `own`."""

    def __init__(self, make: Callable[[], _Memory]) -> None:
        self._make = make

    def __getattr__(self, name: str) -> _Memory:
        if name != "own":
            raise AttributeError(name)
        self.own: _Memory = self._make()
        return self.own


class Changes:
    """Counts the changes of a model, so that a query detects a concurrent change by another thread.

    A query reads `done`, the number of completed changes, at its beginning. If `begun`, the number of started changes,
    is the same at its end, the model has not changed. Otherwise the result may mix two scenes: the query waits for the
    end of the change and runs again.
    """

    def __init__(self) -> None:
        self.begun = self.done = 0
        self._lock = threading.RLock()

    @contextmanager
    def write_lock(self) -> Iterator[None]:
        """Lock the model for one change, after changes of other threads have ended."""
        with self._lock:
            self.begun += 1
            try:
                yield
            finally:
                self.done = self.begun

    def read_lock(self) -> AbstractContextManager[Any]:
        """Lock the model against changes, after a change of another thread has ended."""
        return self._lock


@dataclass
class Counts:
    """Numbers of queries of the whole robot, shared by the models of one planning problem."""

    # Nodes in the trees of the planner.
    nodes: int = 0
    # Collision queries without margin.
    collision_queries: int = 0
    # Collision queries with security margins, for proofs of motions.
    margin_queries: int = 0
    # Configurations on motions at which distance bounds were computed for proofs, without coal.
    bound_queries: int = 0
    distance_queries: int = 0
    # Configurations at which the danger field was evaluated.
    field_configurations: int = 0
    # Number of evaluated danger points, summed over these configurations.
    field_points: int = 0

    @property
    def queries(self) -> int:
        """Number of configurations at which the whole robot was checked for collisions by any kind of query."""
        return self.collision_queries + self.margin_queries + self.bound_queries

    def reset(self) -> None:
        """Set all counters to zero."""
        vars(self).update(dict.fromkeys(vars(self), 0))

    def __sub__(self, earlier: Counts) -> Counts:
        """Return the difference from an `earlier` copy."""
        return Counts(**{key: value - getattr(earlier, key) for key, value in asdict(self).items()})


def notebook_html(shown: object) -> str:
    """Return the HTML of an object for its `_repr_html_` in notebooks.

    Each line of `str(shown)` becomes a row, with the text before the first colon as its heading. A picture stands
    beside the table if the object can be drawn and Matplotlib is installed.
    """
    rows = "".join(f"<tr>{_cells(line)}</tr>" for line in str(shown).splitlines())
    table = f"<table>{rows}</table>"
    # The drawing package is in a higher layer and may need extras, so it is imported only here.
    png = import_module("safe_ompl.drawing").small_picture(shown)
    if not png:
        return table
    image = f'<img alt="" src="data:image/png;base64,{b64encode(png).decode()}"/>'
    return f'<div style="display: flex; align-items: center; gap: 1em">{image}{table}</div>'


def _cells(line: str) -> str:
    head, _, rest = line.partition(": ")
    left = 'style="text-align: left"'
    if not rest:
        return f'<td colspan="2" {left}>{escape(line.strip())}</td>'
    return f"<th {left}>{escape(head.strip())}</th><td {left}>{escape(rest)}</td>"


@lru_cache
def uniform_shares(count: int, dimension: int) -> FloatArray:
    """Return random numbers (count, dimension) in [0, 1), read-only and always the same."""
    shares = np.random.default_rng(0).random((count, dimension))
    shares.setflags(write=False)
    return shares


def halton_point(index: int, dimension: int) -> FloatArray:
    """Return point `index` ≥ 1 of Halton's low-discrepancy sequence in [0, 1)ⁿ.

    Its i-th coordinate is the radical inverse of the index in base of the i-th prime: its digits mirrored at the point.
    """
    primes = (number for number in count(2) if all(number % divisor for divisor in range(2, number)))
    return np.array([_radical_inverse(index, prime) for prime in islice(primes, dimension)])


def _radical_inverse(index: int, base: int) -> float:
    inverse, place = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        place /= base
        inverse += digit * place
    return inverse
