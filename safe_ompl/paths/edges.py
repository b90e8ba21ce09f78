"""The edges of paths: their proofs, which are remembered, and resampling by the distance from obstacles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from safe_ompl.collision import CertifiedMotion
from safe_ompl.common import BoolArray, FloatArray, InputError

_FINE = (
    0.12  # [rad] segments near obstacles are divided until they are shorter; finer ones descend more slowly
)
_HALVINGS = 3


def path_length(path: FloatArray) -> float:
    """Return the length [rad] of an unrolled path (N, n)."""
    return float(np.linalg.norm(path[1:] - path[:-1], axis=1).sum())


def divided(path: FloatArray, spacing: float) -> FloatArray:
    """Return the same path (N, n) with way points no more than `spacing` apart [rad]."""
    steps = path[1:] - path[:-1]
    counts = np.maximum(1, np.ceil(np.linalg.norm(steps, axis=1) / spacing)).astype(int)
    segment = np.repeat(np.arange(len(steps)), counts)
    place = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts)
    inner = path[segment] + (place / counts[segment])[:, None] * steps[segment]
    # Way points of the path stay what they are to the last bit.
    inner[place == 0] = path[:-1]
    return np.vstack([inner, path[-1]])


def refined(path: FloatArray, near: Callable[[FloatArray], BoolArray]) -> FloatArray:
    """Return the same unrolled path (N, n) with short segments where configurations (B, n) are `near` obstacles."""
    close = near(path)
    for _ in range(_HALVINGS):
        middles = 0.5 * (path[1:] + path[:-1])
        lengths = np.linalg.norm(path[1:] - path[:-1], axis=1)
        long = lengths > _FINE
        at_middle = np.zeros(len(middles), dtype=bool)
        at_middle[long] = near(middles[long])
        split = long & (close[:-1] | close[1:] | at_middle)
        if not split.any():
            break
        where = 1 + np.flatnonzero(split)
        path = np.insert(path, where, middles[split], axis=0)
        close = np.insert(close, where, at_middle[split])
    return path


def with_way_points(path: FloatArray, places: FloatArray, apart: float) -> FloatArray:
    """Return the same path (N, n) with way points at arc lengths (K,), unless others are less than `apart` away."""
    steps = path[1:] - path[:-1]
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    for place in places:
        if np.abs(arc - place).min() >= apart:
            k = int(np.searchsorted(arc, place))
            share = (place - arc[k - 1]) / (arc[k] - arc[k - 1])
            path = np.insert(path, k, path[k - 1] + share * (path[k] - path[k - 1]), axis=0)
            arc = np.insert(arc, k, place)
    return path


_REACH = 0.5  # [rad] of path on each side of a refused edge are held back at first,
_WIDENINGS = 6  # then twice as much, so many times


class EdgeProofs:
    """Proves that every edge of a path is free, and keeps more than a margin from obstacles, until `stop` says so."""

    def __init__(self, motion: CertifiedMotion, stop: Callable[[], bool] = lambda: False) -> None:
        self._free = self._clear = motion
        self._stop = stop
        self._proven: set[bytes] = set()
        self._inherited: set[bytes] = set()

    def check(self, path: FloatArray) -> None:
        """Accept the edges of a path (N, n) without a margin; raise InputError if one is not proven free."""
        for k, (start, end) in enumerate(pairwise(path)):
            if not self._free.is_free(start, end):
                raise InputError(f"path: the edge from way point {k} on is not proven free")
        self.accept(path)

    def accept(self, path: FloatArray) -> None:
        """Accept the edges of a path (N, n), which are known to be free."""
        self._proven.update(_keys(path))

    def inherit(self, path: FloatArray) -> None:
        """Accept the edges of a path (N, n), parts of accepted ones, as soon as they are proven without the margin.

        Parts of what is free are free but for rounding; they are proven when they are asked for: few of them ever are.
        """
        self._inherited.update(_keys(path))

    def keep(self, margin: float) -> None:
        """From here on ask for a clearance [m] of all edges that are not accepted yet."""
        self._clear = self._free.with_margin(max(margin, self._free.margin))

    def accepts(self, start: FloatArray, end: FloatArray) -> bool:
        """Return whether the edge between two configurations (n,) is proven."""
        key = start.tobytes() + end.tobytes()
        if key in self._proven:
            return True
        motion = self._free if key in self._inherited else self._clear
        proven = not self._stop() and motion.is_free(start, end)
        if proven:
            self._proven.add(key)
        return proven

    def refused(self, path: FloatArray) -> list[int]:
        """Return the edges of a path (N, n) that are not proven."""
        return [k for k, (start, end) in enumerate(pairwise(path)) if not self.accepts(start, end)]

    def held_back(self, path: FloatArray, known: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return `path: (N, n)`, held back to a known one where edges are refused, and which way points are there (N,).

        Way points beside a refused edge go back to where they were in the accepted path `known: (N, n)`, and those
        around them in part, so that there is no kink; if that does not help, more of them, and in the end all.
        """
        refused, reach = self.refused(path), _REACH
        if not refused:
            return path, np.zeros(len(path), dtype=bool)
        lengths = np.linalg.norm(known[1:] - known[:-1], axis=1)
        arc = np.concatenate([[0.0], np.cumsum(lengths)])
        share, held = np.ones(len(path)), path
        for _ in range(_WIDENINGS):
            for k in refused:
                beyond = np.maximum(arc[k] - arc, arc - arc[k + 1])
                share = np.minimum(share, np.maximum(0.0, beyond) / reach)
                share[k : k + 2] = 0.0
            held = np.where(share[:, None] < 1, known + share[:, None] * (path - known), path)
            held[share == 0] = known[share == 0]
            refused = self.refused(held)
            if not refused:
                return held, share == 0
            reach *= 2.0
        return known.copy(), np.ones(len(path), dtype=bool)


def _keys(path: FloatArray) -> Iterator[bytes]:
    return (start.tobytes() + end.tobytes() for start, end in pairwise(path))
