"""What models share: counters of work, memory for each thread, detection of changes, a sequence; notebooks."""

from __future__ import annotations

import threading
from base64 import b64encode
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, fields
from html import escape
from importlib import import_module
from itertools import count, islice
from typing import Any, Generic, TypeVar

import numpy as np

from safe_ompl.common.documents import FloatArray

_Memory = TypeVar("_Memory")


class PerThread(threading.local, Generic[_Memory]):
    """Working memory of each thread, made by `make` when a thread first asks for its `own`."""

    def __init__(self, make: Callable[[], _Memory]) -> None:
        self._make = make

    def __getattr__(self, name: str) -> _Memory:
        if name != "own":
            raise AttributeError(name)
        self.own: _Memory = self._make()
        return self.own


class Changes:
    """Counts the changes of a model, so that a query notices one that another thread makes meanwhile.

    A query reads `done`, how many have ended, when it begins. Where `begun`, how many have begun, is still the same
    when it ends, nothing has changed in between; otherwise its answer may mix two scenes: it waits for the change to
    end, and asks again.
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


@dataclass
class Counts:
    """Numbers of queries of the whole robot, shared by the models of one planning problem."""

    nodes: int = 0  # That the planner kept
    # Collision queries without margin.
    collision_queries: int = 0
    # Collision queries with security margins, for proofs of motions.
    margin_queries: int = 0
    # The places of motions at which bounds of distances were computed for proofs, without coal.
    bound_queries: int = 0
    distance_queries: int = 0
    # The configurations at which the danger field was evaluated.
    field_configurations: int = 0
    # The number of danger points that were evaluated, summed over these configurations.
    field_points: int = 0

    @property
    def queries(self) -> int:
        """Number of configurations at which the whole robot was checked for collisions, in any way."""
        return self.collision_queries + self.margin_queries + self.bound_queries

    def reset(self) -> None:
        """Set every counter to zero."""
        for field in fields(self):
            setattr(self, field.name, 0)

    def __sub__(self, earlier: Counts) -> Counts:
        """Work done since `earlier`, a copy."""
        return Counts(**{key: value - getattr(earlier, key) for key, value in asdict(self).items()})


def notebook_html(shown: object) -> str:
    """Return what a notebook shows of an object, its `_repr_html_`.

    Each line of its text is a row; what stands before the first colon is its head. Beside them is a picture where there
    is something to draw, and Matplotlib to draw it.
    """
    rows = "".join(f"<tr>{_cells(line)}</tr>" for line in str(shown).splitlines())
    table = f"<table>{rows}</table>"
    # The drawing package stands above this one and may need extras, so only a notebook that shows an object imports it.
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


def halton_point(index: int, dimension: int) -> FloatArray:
    """Return point number `index` ≥ 1 of Halton's sequence in [0, 1)ⁿ, which fills the cube evenly.

    Its i-th coordinate is the radical inverse of the index in the i-th prime: the digits mirrored at the point.
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
