"""Resampling of paths: way points close together near obstacles, far apart elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from safe_ompl.arrays import BoolArray, FloatArray

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
    """Return the same path (N, n) with short segments where it is near obstacles.

    Parameters
    ----------
    path : ndarray, shape (N, n)
        Unrolled.
    near : callable
        Says of configurations (B, n) whether they are near obstacles, (B,).
    """
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
