"""Many danger points in groups of neighbours, so that most of them need not be looked at."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from safe_ompl.arrays import FloatArray, IntArray
from safe_ompl.maths.kernels.groups import BALL

_GROUP = 48  # points in a group
_BLOCK = 32  # groups in a block
_LEVELS = 12  # halvings of each side of the points' box in the curve that goes through them


class PointGroups(NamedTuple):
    """Danger points ordered so that neighbours of the same weight follow each other, in groups, and these in blocks.

    Attributes
    ----------
    columns : ndarray, shape (1, 3, M + H + G)
        The points and, after them, the centres of the H blocks and the G groups [m]: means, weighted by charges.
    charges : ndarray, shape (1, M)
        k₁w of each point.
    balls : ndarray, shape (H + G,)
        Blocks and groups, of type `safe_ompl.maths.kernels.groups.BALL`.
    """

    columns: FloatArray
    charges: FloatArray
    balls: Any

    @classmethod
    def of(cls, points: FloatArray, charges: FloatArray) -> PointGroups:
        """Group `points: (M ≥ 1, 3)` with `charges: (M,)`."""
        order = np.lexsort((_places_on_curve(points), charges))
        points, charges = np.ascontiguousarray(points[order].T), charges[order]
        groups, blocks = (_runs(len(order), size) for size in (_GROUP, _GROUP * _BLOCK))
        found = [_balls(points, charges, runs) for runs in (blocks, groups)]
        balls = np.concatenate([records for _, records in found])
        held = np.concatenate([len(blocks) + _runs(len(groups), _BLOCK), groups])
        balls["begin"], balls["end"] = held.T
        columns = np.concatenate([points, *(centres for centres, _ in found)], axis=1)
        return cls(columns[None], charges[None], balls)


def _runs(number: int, size: int) -> IntArray:
    """Return begin and end (R, 2) of runs of `size`, the last one perhaps shorter."""
    begins = np.arange(0, number, size)
    return np.stack([begins, np.minimum(begins + size, number)], axis=1)


def _balls(points: FloatArray, charges: FloatArray, runs: IntArray) -> tuple[FloatArray, Any]:
    """Return centres (3, R) and records (R,) of balls that hold the runs of points (3, M)."""
    begins, numbers = runs[:, 0], runs[:, 1] - runs[:, 0]
    balls = np.zeros(len(runs), BALL)
    total = np.add.reduceat(charges, begins)
    centres = np.add.reduceat(charges * points, begins, axis=1) / total
    squared = np.square(points - np.repeat(centres, numbers, axis=1)).sum(axis=0)
    balls["radius"] = np.sqrt(np.maximum.reduceat(squared, begins)) * (1 + 1e-12)
    balls["spread"] = np.add.reduceat(charges * squared, begins) / total
    balls["lightest"] = np.minimum.reduceat(charges, begins)
    balls["heaviest"] = np.maximum.reduceat(charges, begins)
    balls["charge"], balls["number"] = total / numbers, numbers
    return centres, balls


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
