"""Danger points, their weights, and the obstacles that they belong to."""

from __future__ import annotations

from collections.abc import Callable, Sized
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, finite_array
from safe_ompl.danger.evaluation import PointGroups
from safe_ompl.danger.link_field import columns
from safe_ompl.scene import Scene

_MANY = 400  # points that are worth grouping

PointSource: TypeAlias = Callable[[FloatArray], ArrayLike]


class DangerPoints:
    """Danger points that are fixed, or given by a callable for every configuration, with their weights.

    Parameters
    ----------
    source : array_like, shape (M, 3), or callable
        The points [m], or what maps a configuration (n,) to them, always equally many.
    weights : array_like, shape (M,), optional
        w > 0; 1 by default.
    k1 : float
        k₁ of the field, by which the charges are scaled.

    Attributes
    ----------
    source : ndarray, shape (M, 3), read-only, or callable
    weights : ndarray, shape (M,), read-only, or None

    Raises
    ------
    InputError
        If points or weights have the wrong shape, are not finite, or weights are not positive.
    """

    def __init__(self, source: ArrayLike | PointSource, weights: ArrayLike | None, k1: float) -> None:
        self.source: FloatArray | PointSource = source if callable(source) else _checked_points(source)
        number = None if self.fixed is None else len(self.fixed)
        self.weights: FloatArray | None = None if weights is None else _checked_weights(weights, number)
        self._k1 = k1
        self._columns = None if self.fixed is None else columns(self.fixed)
        self._charges = self._charged(number)

    @property
    def fixed(self) -> FloatArray | None:
        """The points (M, 3) [m]; None where a callable gives them."""
        return self.source if isinstance(self.source, np.ndarray) else None

    def at(self, Q: FloatArray) -> FloatArray:
        """Return the points, (M, 3) or, where they depend on the configuration, (B, M, 3), at `Q: (B, n)`.

        Raises
        ------
        InputError
            If the callable gives other numbers of points, or points that are none.
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

    def prepared(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (1 or B, 3, M) and charges k₁w (1, M), as kernels read them, at `Q: (B, n)`."""
        if self._columns is not None and self._charges is not None:
            return self._columns, self._charges
        turned = columns(self.at(Q))
        charges = self._charges if self._charges is not None else self._charged(turned.shape[2])
        assert charges is not None
        return turned, charges

    @cached_property
    def groups(self) -> PointGroups | None:
        """The points in groups of neighbours; None where they are few, or a callable gives them."""
        if self.fixed is None or self._charges is None or len(self.fixed) <= _MANY:
            return None
        return PointGroups.of(self.fixed, self._charges[0])

    def chosen(self, points: FloatArray, rows: IntArray, terms: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return points (C, 1, 3) and weights (C, 1): for each of `rows: (C,)` the one of `terms: (C,)`."""
        places = points[terms] if points.ndim == 2 else points[rows, terms]
        weights = np.ones(len(terms)) if self.weights is None else self.weights[terms]
        return places[:, None], weights[:, None]

    def _charged(self, number: int | None) -> FloatArray | None:
        """Return the charges (1, M); None where their number is not known."""
        if self.weights is not None:
            return (self._k1 * self.weights)[None]
        return None if number is None else np.full((1, number), self._k1)


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
        raise InputError(
            f"danger weights must be positive, got {checked[checked <= 0].tolist()}; leave out the others"
        )
    checked.setflags(write=False)
    return checked


class DangerousObstacles:
    """The danger points of a scene, and of scenes in which nothing but places of obstacles differs.

    Parameters
    ----------
    scene : Scene
        The obstacles.
    spacing : float, optional
        Distance between danger points [m]; default: the scene's own.
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

        Raises
        ------
        InputError
            If anything but places differs. Then all stays as it was.
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
