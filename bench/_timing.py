"""Timing for the benches: things that are run in turn, in one process, so that a busy machine slows all alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from time import perf_counter

import numpy as np


class Times:
    """Times of several calls, one row for each round in which all of them ran.

    Attributes
    ----------
    rounds : dict of str to list of float
        Seconds per item of each round.
    """

    def __init__(self, rounds: Mapping[str, list[float]]) -> None:
        self.rounds = dict(rounds)

    def microseconds(self, name: str) -> float:
        """Return the median time per item [µs]."""
        return 1e6 * float(np.median(self.rounds[name]))

    def ratio(self, name: str, reference: str) -> float:
        """Return the median, over the rounds, of the time of `name` divided by that of `reference`."""
        return float(np.median(np.array(self.rounds[name]) / np.array(self.rounds[reference])))


def in_turn(calls: Mapping[str, Callable[[], object]], items: int, rounds: int) -> Times:
    """Run every call once in each of `rounds` rounds, and time it.

    Parameters
    ----------
    calls : mapping of str to callable
        What to time; each call works through all the items.
    items : int
        How many things one call does: times are per item.
    rounds : int
        How often.
    """
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()  # warm up
    for _ in range(rounds):
        for name, call in calls.items():
            begin = perf_counter()
            call()
            taken[name].append((perf_counter() - begin) / items)
    return Times(taken)


def print_table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    """Print rows under a header, numbers to the right."""
    cells = [[_text(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    for row in cells:
        first, *others = (
            cell.ljust(w) if k == 0 else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        print("  ".join([first, *others]))


def _text(cell: object) -> str:
    return f"{cell:.3g}" if isinstance(cell, float) else str(cell)
