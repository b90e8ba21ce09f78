"""The danger of configurations and its gradients in compiled kernels, with danger points grouped by neighbourhood."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger.kernels import danger as kernel
from safe_ompl.danger.kernels import field as field_kernel
from safe_ompl.danger.kernels.groups import BALL, MAXIMUM, MEAN, SOFTMAX
from safe_ompl.danger.link_field import Segments
from safe_ompl.robot import Robot, plain

_GROUP = 48  # points in a group
_BLOCK = 32  # groups in a block
_LEVELS = 12  # halvings of each side of the points' box in the curve that goes through them
Aggregate: TypeAlias = Literal["max", "mean", "softmax"]
AGGREGATES: tuple[Aggregate, ...] = ("max", "mean", "softmax")
_KINDS = {"max": MAXIMUM, "mean": MEAN, "softmax": SOFTMAX}
_NO_BALLS: Any = np.empty(0, BALL)


class PointGroups(NamedTuple):
    """Danger points ordered so that neighbours of the same weight follow each other, in groups, and these in blocks.

    Attributes
    ----------
    columns : ndarray, shape (1, 3, M + H + G)
        The points and, after them, the centres of the H blocks and the G groups [m]: means, weighted by charges.
    charges : ndarray, shape (1, M)
        k₁w of each point.
    balls : ndarray, shape (H + G,)
        Blocks and groups, of type `safe_ompl.danger.kernels.groups.BALL`.
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


class Evaluation:
    """Danger of a robot at points that are given as kernels read them; nothing is checked.

    Points are (1 or B, 3, M), their charges k₁w (1, M).

    Parameters
    ----------
    robot, segments
        The robot, and the link segments of its skeleton.
    by_length : bool
        Whether links weigh in proportion to their lengths.
    aggregate : {"max", "mean", "softmax"}
    sharpness : float
        β of the softmax.
    tolerance : float
        Relative error that a mean or a softmax over groups of points may have.
    """

    def __init__(
        self,
        robot: Robot,
        segments: Segments,
        *,
        by_length: bool,
        aggregate: Aggregate,
        sharpness: float,
        tolerance: float,
    ) -> None:
        tree = robot.kinematics
        self._robot = robot
        self._skeleton = tree.joints, tree.keypoints, segments.pairs
        self._by_length = by_length
        self._kind = _KINDS[aggregate]
        self._sharpness, self._tolerance = sharpness, tolerance
        self._no_gradients = np.empty((0, len(tree.joints)))

    def values(self, Q: FloatArray, points: FloatArray, charges: FloatArray) -> FloatArray:
        """Return the danger (B,) at `Q: (B, n)`."""
        return self._danger(self._joint_values(Q), points, charges, _NO_BALLS, self._no_gradients)

    def values_and_gradients(
        self, Q: FloatArray, points: FloatArray, charges: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) at `Q: (B, n)`."""
        return self._sloped(Q, points, charges, _NO_BALLS)

    def grouped_values(self, Q: FloatArray, groups: PointGroups) -> FloatArray:
        """Return `values` at points in groups, without looking at all of them."""
        return self._danger(self._joint_values(Q), *groups, self._no_gradients)

    def grouped_values_and_gradients(
        self, Q: FloatArray, groups: PointGroups
    ) -> tuple[FloatArray, FloatArray]:
        """Return `values_and_gradients` at points in groups, without looking at all of them."""
        return self._sloped(Q, *groups)

    def levels(self, Q: FloatArray, points: FloatArray, charges: FloatArray) -> FloatArray:
        """Return k₁w CDF(p) of each point, (B, M), at `Q: (B, n)`."""
        keypoints = self._robot.keypoints_batch(Q)
        return charges * field_kernel.fields(keypoints, self._skeleton[2], points, self._by_length)

    def aggregated(self, levels: FloatArray) -> FloatArray:
        """Return the danger (B,) of levels (B, M); zero where there are none."""
        if not levels.shape[1]:
            return np.zeros(len(levels))
        return kernel.aggregates(plain(levels), self._kind, self._sharpness)

    def shares(self, levels: FloatArray) -> FloatArray:
        """Return the derivatives (B, M) of the danger by levels (B, M)."""
        return kernel.all_shares(levels, self._kind, self._sharpness)

    def _joint_values(self, Q: FloatArray) -> FloatArray:
        return plain(self._robot.coupling.values(Q))

    def _sloped(
        self, Q: FloatArray, points: FloatArray, charges: FloatArray, balls: Any
    ) -> tuple[FloatArray, FloatArray]:
        values = self._joint_values(Q)
        gradients = np.empty(values.shape)
        dangers = self._danger(values, points, charges, balls, gradients)
        return dangers, self._robot.coupling.columns(gradients)

    def _danger(
        self,
        values: FloatArray,
        points: FloatArray,
        charges: FloatArray,
        balls: Any,
        gradients: FloatArray,
    ) -> FloatArray:
        """Return the danger (B,) at `values: (B, m)` of the joints, and write its gradients (B or 0, m)."""
        joints, keys, links = self._skeleton
        found: FloatArray = kernel.dangers(
            joints,
            keys,
            links,
            values,
            points,
            charges,
            balls,
            self._by_length,
            self._kind,
            self._sharpness,
            self._tolerance,
            gradients,
        )
        return found
