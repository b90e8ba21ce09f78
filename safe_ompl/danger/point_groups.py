"""Many danger points in groups of neighbours, so that most of them need not be looked at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray

_GROUP = 64  # points in a group
_BLOCK = 16  # groups in a block
_LEVELS = 12  # halvings of each side of the points' box in the curve that goes through them


class PointGroups(NamedTuple):
    """Danger points ordered so that neighbours of the same weight follow each other, in groups, and these in blocks.

    Attributes
    ----------
    points : ndarray, shape (3, M)
        [m]
    charges : ndarray, shape (M,)
        k₁w of each.
    centres : ndarray, shape (3, H + G)
        Of the H blocks, then of the G groups [m].
    radii : ndarray, shape (H + G,)
        None of its points is farther from a centre [m].
    tops : ndarray, shape (H + G,)
        The largest charge in each.
    spans : ndarray, shape (H + G, 2)
        Begin and end of each block among the balls, blocks counted along, and of each group among the points.
    blocks : int
        H.
    """

    points: FloatArray
    charges: FloatArray
    centres: FloatArray
    radii: FloatArray
    tops: FloatArray
    spans: IntArray
    blocks: int

    @classmethod
    def of(cls, points: FloatArray, charges: FloatArray) -> PointGroups:
        """Group `points: (M ≥ 1, 3)` with `charges: (M,)`."""
        order = np.lexsort((_places_on_curve(points), charges))
        points, charges = np.ascontiguousarray(points[order].T), charges[order]
        groups, blocks = (_runs(len(order), size) for size in (_GROUP, _GROUP * _BLOCK))
        balls = [_balls(points, runs) for runs in (blocks, groups)]
        tops = [np.maximum.reduceat(charges, runs[:, 0]) for runs in (blocks, groups)]
        held = len(blocks) + _runs(len(groups), _BLOCK)
        return cls(
            points,
            charges,
            np.concatenate([centres for centres, _ in balls], axis=1),
            np.concatenate([radii for _, radii in balls]),
            np.concatenate(tops),
            np.concatenate([held, groups]),
            len(blocks),
        )


def _runs(number: int, size: int) -> IntArray:
    """Return begin and end (R, 2) of runs of `size`, the last one perhaps shorter."""
    begins = np.arange(0, number, size)
    return np.stack([begins, np.minimum(begins + size, number)], axis=1)


def _balls(points: FloatArray, runs: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return centres (3, R) and radii (R,) of balls that hold the runs of points (3, M)."""
    low, high = (extreme.reduceat(points, runs[:, 0], axis=1) for extreme in (np.minimum, np.maximum))
    centres = (low + high) / 2
    offsets = np.linalg.norm(points - np.repeat(centres, runs[:, 1] - runs[:, 0], axis=1), axis=0)
    return centres, np.maximum.reduceat(offsets, runs[:, 0]) * (1 + 1e-12)


def _places_on_curve(points: FloatArray) -> IntArray:
    """Return where points (M, 3) are on Hilbert's curve, whose neighbours are neighbours in space (Skilling 2004)."""
    low = points.min(axis=0)
    side = max(float((points.max(axis=0) - low).max()), 1e-300)
    x = np.minimum((points - low).T / side * 2**_LEVELS, 2**_LEVELS - 1).astype(np.intp)
    for bit in range(_LEVELS - 1, 0, -1):
        below = (1 << bit) - 1
        for axis in range(3):
            swapped = (x[0] ^ x[axis]) & below
            turned = (x[axis] >> bit) & 1 == 1
            x[axis] ^= np.where(turned, 0, swapped)
            x[0] ^= np.where(turned, below, swapped)
    x[1] ^= x[0]
    x[2] ^= x[1]
    parity = np.zeros_like(x[0])
    for bit in range(_LEVELS - 1, 0, -1):
        parity ^= np.where((x[2] >> bit) & 1 == 1, (1 << bit) - 1, 0)
    x ^= parity
    places: IntArray = np.zeros(len(points), dtype=np.intp)
    for bit in range(_LEVELS - 1, -1, -1):
        for axis in range(3):
            places = (places << 1) | ((x[axis] >> bit) & 1)
    return places
