"""Danger points: their weights, obstacles and groups, and the danger that a robot has at them."""

from __future__ import annotations

from collections.abc import Callable, Sized
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, finite_array
from safe_ompl.danger.kernels import danger as kernel
from safe_ompl.danger.kernels import groups as group_kernel
from safe_ompl.danger.kernels.groups import BALL, Points
from safe_ompl.danger.link_field import Segments, columns
from safe_ompl.robot import Robot, plain
from safe_ompl.scene import Scene

_MANY = 400  # points that are worth grouping
_GROUP = 48  # points in a group
_BLOCK = 32  # groups in a block
_LEVELS = 12  # halvings of each side of the points' box in the curve that goes through them

Aggregate: TypeAlias = Literal["max", "mean", "softmax"]
AGGREGATES: tuple[Aggregate, ...] = ("max", "mean", "softmax")
_KINDS = {"max": group_kernel.MAXIMUM, "mean": group_kernel.MEAN, "softmax": group_kernel.SOFTMAX}

PointSource: TypeAlias = Callable[[FloatArray], ArrayLike]


class DangerPoints:
    """Danger points with weights (M,) > 0, 1 by default; k₁ of the field scales their charges.

    The source is an array (M, 3) [m], or a callable that maps a configuration (n,) to one, always of equally many.
    Raises InputError if points or weights have the wrong shape, are not finite, or weights are not positive.
    """

    def __init__(self, source: ArrayLike | PointSource, weights: ArrayLike | None, k1: float) -> None:
        self.source: FloatArray | PointSource = source if callable(source) else _checked_points(source)
        number = None if self.fixed is None else len(self.fixed)
        self.weights: FloatArray | None = None if weights is None else _checked_weights(weights, number)
        self._k1 = k1
        self._prepared = None if self.fixed is None else self._ungrouped(self.fixed)

    @property
    def fixed(self) -> FloatArray | None:
        """The points (M, 3) [m], read-only; None where a callable gives them."""
        return self.source if isinstance(self.source, np.ndarray) else None

    def at(self, Q: FloatArray) -> FloatArray:
        """Return the points, (M, 3) or, where they depend on the configuration, (B, M, 3), at `Q: (B, n)`.

        Raises InputError if the callable gives other numbers of points, or points that are none.
        """
        if isinstance(self.source, np.ndarray):
            return self.source
        found = [_checked_points(self.source(q)) for q in Q]
        numbers = {len(points) for points in found}
        if self.weights is not None:
            numbers.add(len(self.weights))
        if len(numbers) > 1:
            raise InputError(f"the number of danger points must not change, got {sorted(numbers)}")
        return np.reshape(found, (len(Q), *(numbers or {1}), 3))

    def prepared(self, Q: FloatArray) -> Points:
        """Return points (1 or B, 3, M) and charges k₁w (1, M), as kernels read them, at `Q: (B, n)`; no groups."""
        return self._ungrouped(self.at(Q)) if self._prepared is None else self._prepared

    @cached_property
    def groups(self) -> Points | None:
        """The points in groups of neighbours; None where they are few, or a callable gives them."""
        if self.fixed is None or self._prepared is None or len(self.fixed) <= _MANY:
            return None
        return grouped(self.fixed, self._prepared.charges[0])

    def chosen(self, points: FloatArray, rows: IntArray, terms: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return points (C, 1, 3) and weights (C, 1): for each of `rows: (C,)` the one of `terms: (C,)`."""
        places = points[terms] if points.ndim == 2 else points[rows, terms]
        weights = np.ones(len(terms)) if self.weights is None else self.weights[terms]
        return places[:, None], weights[:, None]

    def _ungrouped(self, points: FloatArray) -> Points:
        turned = columns(points)
        weights = np.ones(turned.shape[2]) if self.weights is None else self.weights
        return Points(turned, (self._k1 * weights)[None], None)


def _checked_points(points: ArrayLike) -> FloatArray:
    """Return danger points (M, 3); read-only."""
    if isinstance(points, Sized) and not len(points):
        points = np.zeros((0, 3))
    checked = finite_array(points, (None, 3), "danger points")
    checked.setflags(write=False)
    return checked


def _checked_weights(weights: ArrayLike, number: int | None) -> FloatArray:
    checked = finite_array(weights, (number,), "danger weights")
    if not (checked > 0).all():
        raise InputError(f"danger weights must be positive, got {checked[checked <= 0].tolist()}; leave out the others")
    checked.setflags(write=False)
    return checked


class DangerousObstacles:
    """The danger points of a scene, and of scenes in which nothing but places of obstacles differs.

    `spacing` is the distance between danger points [m]; None: the scene's own.
    """

    def __init__(self, scene: Scene, spacing: float | None = None) -> None:
        self._scene = scene
        self._spacing = spacing

    @property
    def points(self) -> tuple[FloatArray, FloatArray]:
        """Points (M, 3) [m] and their weights (M,), as `Scene.danger_points`."""
        return self._scene.danger_points(self._spacing)[:2]

    def move(self, scene: Scene) -> bool:
        """Take the places of another scene; return whether a dangerous obstacle is elsewhere.

        Raises InputError if anything but places differs. Then all stays as it was.
        """
        before = self._scene
        if scene.names != before.names or scene.spacing != before.spacing:
            raise InputError(f"must have the same obstacles and spacing as {before!r}, got {scene!r}")
        moved = [(old, new) for old, new in zip(before, scene, strict=True) if old is not new and old != new]
        for old, new in moved:
            if not old.same_but_for_place(new):
                raise InputError(f"{old.name!r} may move, but not become another: {old!r} to {new!r}")
        self._scene = scene
        return any(new.weight > 0 for _, new in moved)

    def replace(self, scene: Scene) -> bool:
        """Take any other scene; return whether what is dangerous differs."""
        known = [[o for o in s if o.weight > 0] for s in (self._scene, scene)]
        changed = known[0] != known[1] or scene.spacing != self._scene.spacing
        self._scene = scene
        return changed


# ------------------------------------------------------------------------------------------------------ groups


def grouped(points: FloatArray, charges: FloatArray) -> Points:
    """Return `points: (M ≥ 1, 3)` with `charges: (M,)` in groups of neighbours of the same weight, these in blocks.

    Columns are (1, 3, M + H + G): after the points the centres of the H blocks and the G groups [m], means that are
    weighted by charges; charges (1, M); balls (H + G,).
    """
    order = np.lexsort((_places_on_curve(points), charges))
    points, charges = np.ascontiguousarray(points[order].T), charges[order]
    groups, blocks = (_runs(len(order), size) for size in (_GROUP, _GROUP * _BLOCK))
    found = [_balls(points, charges, runs) for runs in (blocks, groups)]
    balls = np.concatenate([records for _, records in found])
    held = np.concatenate([len(blocks) + _runs(len(groups), _BLOCK), groups])
    balls["begin"], balls["end"] = held.T
    places = np.concatenate([points, *(centres for centres, _ in found)], axis=1)
    return Points(places[None], charges[None], balls)


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


# -------------------------------------------------------------------------------------------------- evaluation


class Evaluation:
    """Danger of a robot at points given as kernels read them; nothing is checked. Arguments as of `DangerField`."""

    def __init__(
        self, robot: Robot, segments: Segments, by_length: bool, measure: tuple[Aggregate, float, float]
    ) -> None:
        tree = robot.kinematics
        self._robot = robot
        self.tables = kernel.Tables(tree.joints, tree.keypoints, segments.pairs, by_length)
        aggregate, sharpness, tolerance = measure
        self.aggregate = group_kernel.Aggregate(_KINDS[aggregate], sharpness, tolerance)
        self._no_gradients = np.empty((0, len(tree.joints)))

    def values(self, Q: FloatArray, points: Points) -> FloatArray:
        """Return the danger (B,) at `Q: (B, n)`."""
        values = plain(self._robot.coupling.values(Q))
        dangers: FloatArray = kernel.dangers(self.tables, values, points, self.aggregate, self._no_gradients)
        return dangers

    def mean(self, ends: FloatArray, points: Points, panels: int, tolerance: float) -> tuple[float, int]:
        """Return the mean danger on the straight way between `ends: (2, n)`, and from how many configurations.

        `panels` and `tolerance` are those of `kernels.danger.mean_danger`.
        """
        values = plain(self._robot.coupling.values(ends))
        found: tuple[float, int] = kernel.mean_danger(self.tables, values, points, self.aggregate, panels, tolerance)
        return found

    def values_and_gradients(self, Q: FloatArray, points: Points) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) at `Q: (B, n)`."""
        values = plain(self._robot.coupling.values(Q))
        gradients = np.empty(values.shape)
        dangers = kernel.dangers(self.tables, values, points, self.aggregate, gradients)
        return dangers, self._robot.coupling.columns(gradients)

    def high_levels(
        self, Q: FloatArray, points: Points, least: float = 0.0, share: float = 0.0, *, sloped: bool = False
    ) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Return rows, points and values (C,) of high levels k₁w CDF(p) at `Q: (B, n)`, and their gradients (C, n).

        These are at least `least`, and at least a share of the highest of their row. No gradients unless `sloped`.
        """
        if not points.columns.size:
            nothing = np.zeros(0, dtype=np.int64)
            return nothing, nothing, np.zeros(0), np.zeros((0, Q.shape[1]))
        values = plain(self._robot.coupling.values(Q))
        found = kernel.high_levels(self.tables, values, points, least, share, sloped)
        return *found[:3], self._robot.coupling.columns(found[3])

    def aggregated(self, levels: FloatArray) -> FloatArray:
        """Return the danger (B,) of levels (B, M); zero where there are none."""
        if not levels.shape[1]:
            return np.zeros(len(levels))
        return kernel.aggregates(plain(levels), self.aggregate.kind, self.aggregate.sharpness)

    def shares(self, levels: FloatArray) -> FloatArray:
        """Return the derivatives (B, M) of the danger by levels (B, M)."""
        return kernel.all_shares(levels, self.aggregate.kind, self.aggregate.sharpness)
